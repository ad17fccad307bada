"""A motion that a condition stops on its path: the controller evaluates it in each cycle, not the program."""

import takt


def main() -> None:
    with takt.emulate("two_lwr") as cell:
        robot = cell.arm("left").with_speed(0.3)
        bent = [0, 0.5, 0, -1.2, 0, 0.8, 0]
        robot.ptp(bent).run()
        print("limit / rad  outcome                   at / rad")
        for limit in (0.1, 0.3, 0.5):
            turned = (robot.joint(0) > limit) & ~(abs(robot.force.z) > 50)
            outcome = robot.ptp([1.0, *bent[1:]], until={"turned": turned}).run()
            print(f"{limit:11}  {outcome!s:24}  {robot.commanded()[0]:8.3f}")
            robot.ptp(bent).run()


if __name__ == "__main__":
    main()
