"""A force: the arm touches a table, presses on it with 20 N, and stops when the table vanishes: a table of the steps."""

import time

import takt

ABOVE = [0, 0.6, 0, -1.3, 0, 1.2416, 0]
FORCE = 20.0


def main() -> None:
    with takt.emulate("lwr_table") as cell:
        arm, table = cell.arm("arm"), cell.frame("table")

        def note(name: str, outcome: takt.Outcome) -> None:
            height = arm.pose().position[2]
            print(f"{name:8}  {outcome!s:28}  {cell.value(arm.force.z):9.1f}  {height:10.4f}")

        arm.ptp(ABOVE).run()
        print("step      outcome                       force / N  height / m")
        here = arm.pose()
        note("approach", arm.lin(takt.Pose.xyz(0, 0, 0.42 - here.position[2]) * here).run())
        vanished = {"vanished": (arm.force.z < 2.0).after(arm.force.z > 10.0)}
        press = arm.press(table.direction([0, 0, -1]), FORCE, until=vanished).begin()
        note("press", press.wait())
        time.sleep(1.0)
        note("hold", press.wait())
        cell.io("arm").set(0, True).run()  # the digital output 0 takes the emulated table away
        outcome = press.wait_to_end(timeout=10.0)
        note("vanish", outcome)
        assert outcome.is_stopped_by("vanished")
        note("rest", arm.ptp(ABOVE).run())


if __name__ == "__main__":
    main()
