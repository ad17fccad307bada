"""Two arms lift, put down and swing a box that they hold: a table of the motions and of the grasp.

The arms are coupled: one motion of the box, which both follow. The last column is how far the flanges have moved towards or
away from each other; it would be a force in the box.
"""

import numpy as np

import takt

BENT = [0, 0.6, 0, -1.1, 0, 0.7, 0]


def main() -> None:
    with takt.emulate("two_lwr") as cell:
        left = cell.arm("left").with_base(takt.Pose.xyz(0, 0.3, 0).abc(-0.2, 0, 0))
        right = cell.arm("right").with_base(takt.Pose.xyz(0, -0.3, 0).abc(0.2, 0, 0))
        takt.together(left.ptp(BENT, speed=0.5), right.ptp(BENT, speed=0.5)).run()

        def flanges() -> tuple[takt.Pose, takt.Pose]:
            return left.base * left.pose(), right.base * right.pose()

        a, b = flanges()
        table = takt.Pose.xyz(*((a.position + b.position) / 2))
        held = a.inverse() * b
        box = takt.coupled(table, [left, right]).with_speed(0.5)
        above = takt.Pose.xyz(0, 0, 0.1) * table
        side = takt.Pose.xyz(0.03, 0, 0.05) * table
        motions = {
            "lift": box.lin(above),
            "put down": box.circ(side, table),
            "swing": box.spline([side, table]),
        }
        print("motion    planned / s  outcome             height / m  grasp moved / mm")
        for name, motion in motions.items():
            planned = motion.plan().duration
            outcome = motion.run()
            a, b = flanges()
            height = (a.position + b.position)[2] / 2
            moved = np.linalg.norm((a.inverse() * b).position - held.position) * 1e3
            print(f"{name:8}  {planned:11.2f}  {outcome!s:18}  {height:10.3f}  {moved:16.3f}")


if __name__ == "__main__":
    main()
