"""The first program: two emulated arms move, and one of them blends two lines."""

import takt

with takt.emulate("two_lwr") as cell:
    left, right = cell.arm("left"), cell.arm("right")
    bent = [0, takt.deg(30), 0, takt.deg(-70), 0, takt.deg(45), 0]
    takt.together(left.ptp(bent, speed=0.5), right.ptp(bent, speed=0.5)).run()
    start = left.pose()
    first = left.lin(takt.Pose.xyz(0, 0.1, 0) * start, blend=0.8).begin()
    print(left.lin(start).run(), first.wait())
