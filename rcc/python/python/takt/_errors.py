"""The exceptions of the package: one tree, with the values of each error as attributes."""

from __future__ import annotations


class Error(Exception):
    """Something was not begun, or did not end as requested. The text gives the cause first, then a hint.

    `filename` and `lineno` name the line of the program that described what failed, or `None` where there is none: an
    error that `wait()` raises names the line of the motion, not that of the call.
    """

    filename: str | None
    lineno: int | None

    def __init__(self, text: str, *, filename: str | None = None, lineno: int | None = None) -> None:
        line = "" if filename is None else f"\nat {filename}:{lineno}"
        super().__init__(text + line)
        self.filename = filename
        self.lineno = lineno


class Connection(Error, ConnectionError):
    """The controller cannot be reached."""


class Version(Connection):
    """The controller at `address` does not fit this package, for `reason`."""

    def __init__(
        self,
        text: str,
        *,
        address: str,
        reason: str,
        filename: str | None = None,
        lineno: int | None = None,
    ) -> None:
        super().__init__(text, filename=filename, lineno=lineno)
        self.address = address
        self.reason = reason


class Lost(Connection):
    """The connection ended; the controller cancels what this program began."""


class Invalid(Error, ValueError):
    """An argument is out of its bounds; nothing was begun."""


class Limit(Invalid):
    """A joint position is out of its range; nothing was begun. `value`, `min` and `max` in rad."""

    def __init__(
        self,
        text: str,
        *,
        joint: str,
        value: float,
        min: float,
        max: float,
        filename: str | None = None,
        lineno: int | None = None,
    ) -> None:
        super().__init__(text, filename=filename, lineno=lineno)
        self.joint = joint
        self.value = value
        self.min = min
        self.max = max


class NoDevice(Error, LookupError):
    """The controller has no device of this `name`; the text lists those that it has."""

    def __init__(
        self, text: str, *, name: str, filename: str | None = None, lineno: int | None = None
    ) -> None:
        super().__init__(text, filename=filename, lineno=lineno)
        self.name = name


class NoPort(Error, LookupError):
    """`device` has no input or output of this number and kind; the text says what it has. Nothing was begun."""

    def __init__(
        self,
        text: str,
        *,
        device: str,
        port: int,
        filename: str | None = None,
        lineno: int | None = None,
    ) -> None:
        super().__init__(text, filename=filename, lineno=lineno)
        self.device = device
        self.port = port


class NotConnected(Error):
    """The pose of one frame in another changes with motions, or is not known; nothing was begun.

    `frames` has the name of each frame and that of the frame in which it is placed in the end.
    """

    def __init__(
        self,
        text: str,
        *,
        frames: list[tuple[str, str]],
        filename: str | None = None,
        lineno: int | None = None,
    ) -> None:
        super().__init__(text, filename=filename, lineno=lineno)
        self.frames = frames


class Rejected(Error):
    """The controller rejected the net of an activity; `faults` lists why, with positions in its text."""

    def __init__(
        self, text: str, *, faults: list[str], filename: str | None = None, lineno: int | None = None
    ) -> None:
        super().__init__(text, filename=filename, lineno=lineno)
        self.faults = faults


class Refused(Error):
    """The controller refused a command or a rule, with its reason."""


class _OfDevice(Error):
    def __init__(
        self, text: str, *, device: str, filename: str | None = None, lineno: int | None = None
    ) -> None:
        super().__init__(text, filename=filename, lineno=lineno)
        self.device = device


class Conflict(_OfDevice):
    """Another program or net commands the joints of `device`."""


class Unreachable(_OfDevice):
    """The path leaves the reach of `device` after the part `progress` of it, 0 to 1."""

    def __init__(
        self,
        text: str,
        *,
        device: str,
        progress: float,
        filename: str | None = None,
        lineno: int | None = None,
    ) -> None:
        super().__init__(text, device=device, filename=filename, lineno=lineno)
        self.progress = progress


class TooFast(_OfDevice):
    """A `joint` of `device` would move at `velocity`, beyond its `limit`, rad/s; at `speed` the path fits. Nothing was begun."""

    def __init__(
        self,
        text: str,
        *,
        device: str,
        joint: int,
        progress: float,
        velocity: float,
        limit: float,
        speed: float,
        filename: str | None = None,
        lineno: int | None = None,
    ) -> None:
        super().__init__(text, device=device, filename=filename, lineno=lineno)
        self.joint = joint
        self.progress = progress
        self.velocity = velocity
        self.limit = limit
        self.speed = speed


class Unplanned(_OfDevice):
    """A motion of `device` cannot be planned, for `cause`; nothing was begun."""

    def __init__(
        self,
        text: str,
        *,
        device: str,
        cause: str,
        filename: str | None = None,
        lineno: int | None = None,
    ) -> None:
        super().__init__(text, device=device, filename=filename, lineno=lineno)
        self.cause = cause


class DeviceFailed(_OfDevice):
    """`device` does not follow its commands, for `cause`."""

    def __init__(
        self,
        text: str,
        *,
        device: str,
        cause: str,
        filename: str | None = None,
        lineno: int | None = None,
    ) -> None:
        super().__init__(text, device=device, filename=filename, lineno=lineno)
        self.cause = cause


class PredecessorFailed(Error):
    """What was to run before ended with `error`; nothing was begun."""

    def __init__(
        self, text: str, *, error: Error, filename: str | None = None, lineno: int | None = None
    ) -> None:
        super().__init__(text, filename=filename, lineno=lineno)
        self.error = error


class Ended(_OfDevice):
    """The net of an activity of `device` ended without a result, for `reason`."""

    def __init__(
        self,
        text: str,
        *,
        device: str,
        reason: str,
        filename: str | None = None,
        lineno: int | None = None,
    ) -> None:
        super().__init__(text, device=device, filename=filename, lineno=lineno)
        self.reason = reason


class Timeout(Error, TimeoutError):
    """What was waited for has not ended in time, and goes on."""


def _name_package() -> None:
    """Lets tracebacks name the classes as programs write them."""
    for value in globals().values():
        if isinstance(value, type) and issubclass(value, Error):
            value.__module__ = "takt"


_name_package()
