"""Jogging with a dead man: the arm moves while a key is held, and brakes when it is released. A table of what was held.

A key that is held sends its velocity 50 times a second. Nothing else stops the arm: it brakes as well if the program sleeps,
hangs or dies.
"""

import time

import numpy as np

import takt

KEYS = {
    "up": takt.Twist.xyz(0, 0, 0.1),
    "left": takt.Twist.xyz(0, 0.1, 0),
    "turn": takt.Twist.xyz(0, 0, 0).turning(0, 0, 0.3),
}


def main() -> None:
    with takt.emulate("two_lwr") as cell:
        robot = cell.arm("left")
        robot.ptp([0, 0.5, 0, -1.2, 0, 0.8, 0]).run()
        print("key    held / s  x / mm  y / mm  z / mm  turned / rad  speed 0.5 s after / rad/s")
        with robot.jog().begin() as jog:
            for key, velocity in KEYS.items():
                start, pressed = robot.pose(), time.monotonic()
                while time.monotonic() < pressed + 0.8:
                    jog.send(velocity)
                    time.sleep(0.02)
                held = time.monotonic() - pressed
                time.sleep(0.5)  # released
                speed = -robot.commanded()
                time.sleep(0.1)
                speed = abs(speed + robot.commanded()).max() / 0.1
                x, y, z = (robot.pose().position - start.position) * 1e3
                turned = 2 * np.arcsin(np.linalg.norm((start.inverse() * robot.pose()).orientation[:3]))
                print(f"{key:5}  {held:8.2f}  {x:6.1f}  {y:6.1f}  {z:6.1f}  {turned:12.3f}  {speed:26.4f}")
        print("the jog ended:", jog.outcome())


if __name__ == "__main__":
    main()
