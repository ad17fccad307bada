"""Blending between two poses, one motion ahead: a table of all motions, how they ended and how fast the flange was.

A motion that is not taken over comes to rest before the next one begins; the table shows how many were.
"""

import time

import takt

ROUNDS = 9


def main() -> None:
    with takt.emulate("two_lwr") as cell:
        robot = cell.arm("left")
        robot.ptp([0, 0.5, 0, -1.2, 0, 0.8, 0]).run()
        c = robot.pose()
        e = takt.Pose.xyz(0, 0.12, 0) * c
        handles: list[tuple[str, takt.Handle, float]] = []
        started = time.monotonic()
        for _ in range(ROUNDS):
            for name, pose in (("E", e), ("C", c)):
                handle = robot.lin(pose, blend=0.8).begin()  # returns when it runs: one motion ahead
                handles.append((name, handle, time.monotonic() - started))
        robot.finish()
        print("motion  begun at / s  outcome")
        for number, (name, handle, begun) in enumerate(handles):
            print(f"{number:3} to {name}  {begun:12.2f}  {handle.wait()}")
        taken = sum(handle.wait() == takt.Outcome.TakenOver for _, handle, _ in handles)
        print(f"{taken} of {len(handles) - 1} hand-overs blended")


if __name__ == "__main__":
    main()
