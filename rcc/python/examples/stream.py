"""A goal that a program streams at 30 Hz: a table of how far the flange is behind it, by turns of a circle.

One net follows all the while; each goal takes effect in the cycle after it arrives.
"""

import math
import time

import numpy as np

import takt

RATE = 30
TURNS = 2
RADIUS = 0.05
TURN_TIME = 2.5


def main() -> None:
    with takt.emulate("two_lwr") as cell:
        robot = cell.arm("left")
        robot.ptp([0, 0.6, 0, -1.2, 0, 0.9, 0]).run()
        start = robot.pose()
        print("turn  goals  mean behind / mm  most behind / mm")
        with robot.stream_poses().begin() as stream:
            for turn in range(TURNS):
                behind: list[float] = []
                due = time.monotonic()
                for step in range(round(RATE * TURN_TIME)):
                    angle = 2 * math.pi * step / round(RATE * TURN_TIME)
                    y, z = RADIUS * math.sin(angle), RADIUS * (1 - math.cos(angle))
                    goal = takt.Pose.xyz(0, y, z) * start
                    stream.send(goal)
                    behind.append(float(np.linalg.norm(robot.pose().position - goal.position)) * 1e3)
                    due += 1 / RATE
                    time.sleep(max(0.0, due - time.monotonic()))
                print(f"{turn + 1:4}  {len(behind):5}  {np.mean(behind):16.1f}  {max(behind):16.1f}")
        print("the stream ended:", stream.outcome())


if __name__ == "__main__":
    main()
