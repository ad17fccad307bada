"""The exceptions of the package: one tree, with the values of each error as attributes."""

from __future__ import annotations


class Error(Exception):
    """Something was not begun, or did not end as requested. The text gives the cause first, then a hint.

    `filename` and `lineno` name the line of the program that described what failed, or `None` where there is none: an
    error that `wait()` raises names the line of the motion, not that of the call.
    """

    filename: str | None = None
    lineno: int | None = None

    def __init__(self, text: str, **values: object) -> None:
        """`values` are the attributes that the class describes."""
        line = f"\nat {values['filename']}:{values['lineno']}" if "filename" in values else ""
        super().__init__(text + line)
        vars(self).update(values)


class Connection(Error, ConnectionError):
    """The controller cannot be reached."""


class Version(Connection):
    """The controller at `address` does not fit this package, for `reason`."""

    address: str
    reason: str


class Lost(Connection):
    """The connection ended; the controller cancels what this program began."""


class Invalid(Error, ValueError):
    """An argument is out of its bounds; nothing was begun."""


class Limit(Invalid):
    """A joint position is out of its range; nothing was begun. `value`, `min` and `max` in rad."""

    joint: str
    value: float
    min: float
    max: float


class NoDevice(Error, LookupError):
    """The controller has no device of this `name`; the text lists those that it has."""

    name: str


class NoPort(Error, LookupError):
    """`device` has no input or output of this number and kind; the text says what it has. Nothing was begun."""

    device: str
    port: int


class NotConnected(Error):
    """The pose of one frame in another changes with motions, or is not known; nothing was begun.

    `frames` has the name of each frame and that of the frame in which it is placed in the end.
    """

    frames: list[tuple[str, str]]


class Rejected(Error):
    """The controller rejected the net of an activity; `faults` lists why, with positions in its text."""

    faults: list[str]


class Refused(Error):
    """The controller refused a command or a rule, with its reason."""


class _OfDevice(Error):
    device: str


class Conflict(_OfDevice):
    """Another program or net commands `device`, and goes on.

    `joint` is the number of its joint and `holder` names the net, its session and its program; `None` if not known.
    """

    def __init__(
        self,
        text: str,
        *,
        device: str,
        joint: int | None,
        holder: str | None,
        filename: str | None = None,
        lineno: int | None = None,
    ) -> None:
        super().__init__(text, device=device, filename=filename, lineno=lineno)
        self.joint = joint
        self.holder = holder


class Unreachable(_OfDevice):
    """The path leaves the reach of `device` after the part `progress` of it, 0 to 1."""

    progress: float


class TooFast(_OfDevice):
    """A `joint` of `device` would move at `velocity`, beyond its `limit`, rad/s; at `speed` the path fits. Nothing was begun."""

    joint: int
    progress: float
    velocity: float
    limit: float
    speed: float


class Stale(_OfDevice):
    """A prepared activity of `device` no longer fits, for `cause`; nothing was begun."""

    cause: str


class Callback(Error):
    """A callback raised; its listener has ended."""


class Unsupported(_OfDevice):
    """`device` has no such ability (`wanted`), or refuses it, for `cause`."""

    wanted: str
    cause: str


class ForceNotReached(_OfDevice):
    """`device` has moved `travel`, m, under force and not reached `force`, N: nothing was there, or it gave way. It is at rest."""

    force: float
    travel: float


class ContactLost(_OfDevice):
    """What `device` pressed against is there no more; it is at rest."""


class ForceExceeded(_OfDevice):
    """The force at the tool of `device` exceeds `limit`, N; it is at rest."""

    limit: float


class Deviation(_OfDevice):
    """Joint `joint` of `device` is `deviation`, rad, from the `place`, `path` or `goal`, of its trajectory; it is at rest."""

    place: str
    joint: int
    deviation: float


class Unplanned(_OfDevice):
    """A motion of `device` cannot be planned, for `cause`; nothing was begun."""

    cause: str


class DeviceFailed(_OfDevice):
    """`device` does not follow its commands, for `cause`."""

    cause: str


class PredecessorFailed(Error):
    """What was to run before ended with `error`; nothing was begun."""

    error: Error


class Ended(_OfDevice):
    """The net of an activity of `device` ended without a result, for `reason`."""

    reason: str


class Timeout(Error, TimeoutError):
    """What was waited for has not ended in time, and goes on."""


def _name_package() -> None:
    """Lets tracebacks name the classes as programs write them."""
    for value in globals().values():
        if isinstance(value, type) and issubclass(value, Error):
            value.__module__ = "takt"


_name_package()
