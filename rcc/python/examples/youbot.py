"""A KUKA youBot drives to a place, grips there and comes back: a table of the steps.

The arm bends while the base drives, in one call. The robot searches its stops first, which takes seconds.
"""

import takt

CANDLE = [0, 0, 0, 0, 0]
BENT = [0, 0.9, 0.6, 0.7, 0]


def main() -> None:
    with takt.emulate("factory") as cell:
        base, arm, hand = cell.base("base"), cell.arm("arm"), cell.gripper("hand")
        home = base.pose()
        there = home * takt.Pose.xyz(0.3, 0.1, 0).abc(0.4, 0, 0)
        steps: dict[str, takt.Activity | takt.Composite] = {
            "drive and bend": takt.together(base.go_to(there), arm.ptp(BENT), hand.open()),
            "grip": hand.move_to(0.005),
            "lift": arm.ptp(CANDLE, speed=0.5),
            "back off": base.drive([-0.1, 0, 0], 0.5),
            "drive home": base.go_to(home),
            "release": hand.open(),
        }
        print("step            outcome               x / m   y / m  fingers / mm")
        for name, step in steps.items():
            outcome = step.run()
            x, y, _ = base.pose().position
            width = cell.value(hand.width) or 0.0
            print(f"{name:14}  {outcome!s:18}  {x:7.3f} {y:7.3f}  {width * 1e3:12.1f}")


if __name__ == "__main__":
    main()
