"""Robot programs without real-time knowledge.

A program describes a motion and begins it; the controller executes it in its own real-time cycle, and the next motion
takes over in the cycle in which the first one permits it. Lengths are m, angles rad, forces N, times s.

    import takt

    with takt.emulate("two_lwr") as cell:  # or takt.connect()
        left = cell.arm("left")
        left.ptp([0, 0.5, 0, -1.2, 0, 0.8, 0], speed=0.3).run()
        down = left.pose() * takt.Pose.xyz(0, 0, 0.1)
        print(left.lin(down, until={"touch": abs(left.force.z) > 5}).run())
"""

from ._errors import (
    Conflict,
    Connection,
    DeviceFailed,
    Ended,
    Error,
    Invalid,
    Limit,
    Lost,
    NoDevice,
    NoPort,
    NotConnected,
    PredecessorFailed,
    Refused,
    Rejected,
    Timeout,
    TooFast,
    Unplanned,
    Unreachable,
    Version,
)
from ._takt import (
    Activity,
    Arm,
    Cell,
    Composite,
    Condition,
    Coupled,
    Event,
    Force,
    Handle,
    JointLimits,
    Number,
    Outcome,
    Plan,
    Pose,
    Waiting,
    connect,
    coupled,
    deg,
    either,
    embed,
    emulate,
    together,
    when,
)

__all__ = [
    "Activity",
    "Arm",
    "Cell",
    "Composite",
    "Condition",
    "Conflict",
    "Connection",
    "Coupled",
    "DeviceFailed",
    "Ended",
    "Error",
    "Event",
    "Force",
    "Handle",
    "Invalid",
    "JointLimits",
    "Limit",
    "Lost",
    "NoDevice",
    "NoPort",
    "NotConnected",
    "Number",
    "Outcome",
    "Plan",
    "Pose",
    "PredecessorFailed",
    "Refused",
    "Rejected",
    "Timeout",
    "TooFast",
    "Unplanned",
    "Unreachable",
    "Version",
    "Waiting",
    "connect",
    "coupled",
    "deg",
    "either",
    "embed",
    "emulate",
    "together",
    "when",
]
