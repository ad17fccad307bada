"""The first program: two emulated arms lift a box together."""

import takt

bent = [0, 0.6, 0, -1.1, 0, 0.7, 0]
with takt.emulate("two_lwr") as cell:  # or takt.connect("host:8081")
    left = cell.arm("left").with_base(takt.Pose.xyz(0, 0.3, 0))
    right = cell.arm("right").with_base(takt.Pose.xyz(0, -0.3, 0))
    takt.together(left.ptp(bent), right.ptp(bent)).run()
    table = takt.Pose.xyz(0.6, 0, 0.5)  # of the box between the flanges
    print(takt.coupled(table, [left, right]).lin(takt.Pose.xyz(0, 0, 0.1) * table).run())
