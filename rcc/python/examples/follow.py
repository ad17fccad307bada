"""A frame that moves: the right arm keeps 10 cm beside the flange of the left one: a table of how far it is behind."""

import numpy as np

import takt

BENT = [0, 0.6, 0, -1.2, 0, 0.9, 0]


def main() -> None:
    with takt.emulate("two_lwr") as cell:
        # Both bases are at the origin of the world.
        left, right = (cell.arm(name).with_base(np.eye(4)) for name in ("left", "right"))
        takt.together(left.ptp(BENT), right.ptp(BENT)).run()
        start, beside = left.pose(), takt.Pose.xyz(0, 0.1, 0)
        follow = right.follow(left.centre().pose(beside)).begin()
        print("the right arm has come to its frame:", follow.wait())
        side, over = (takt.Pose.xyz(0, y, z) * start for y, z in ((0.15, 0), (0.075, 0.075)))
        print("motion  outcome             most behind / mm")
        for name, motion in (("arc", left.circ(over, side)), ("line", left.lin(start))):
            handle = motion.begin()
            behind: list[float] = []
            while handle.outcome() is None:
                away = (left.pose() * beside).position - right.pose().position
                behind.append(float(np.linalg.norm(away)) * 1e3)
            print(f"{name:6}  {handle.wait()!s:18}  {max(behind):16.1f}")
        right.cancel()
        print("following ended:", follow.wait_to_end())


if __name__ == "__main__":
    main()
