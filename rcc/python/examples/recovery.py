"""Errors and recovery: what goes wrong is an exception with values, the arm is at rest, and the program goes on."""

from collections.abc import Callable

import takt


def main() -> None:
    with takt.emulate("two_lwr") as cell:
        robot = cell.arm("left").with_speed(0.5)
        bent = [0, 0.5, 0, -1.2, 0, 0.8, 0]
        robot.ptp(bent).run()
        start = robot.pose()
        attempts: dict[str, Callable[[], takt.Activity]] = {
            "six joints": lambda: robot.ptp(bent[:6]),
            "joint 0 at 4 rad": lambda: robot.ptp([4.0, *bent[1:]]),
            "speed of 4": lambda: robot.ptp(bent, speed=4),
            "one metre further": lambda: robot.lin(takt.Pose.xyz(1, 0, 0) * start),
        }
        print(f"{'attempt':18}  {'error':14}  recovered")
        for name, attempt in attempts.items():
            try:
                attempt().run()
                raise SystemExit(f"{name}: no error")
            except takt.Error as error:
                recovered = robot.ptp(bent).run()
                print(f"{name:18}  {type(error).__name__:14}  {recovered}")


if __name__ == "__main__":
    main()
