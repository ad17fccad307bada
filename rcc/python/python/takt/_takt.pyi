"""Types of the native part. Lengths are m, angles rad, forces N, torques Nm, times s."""

from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from os import PathLike
from types import TracebackType
from typing import Any, ClassVar, Generic, Literal, Protocol, TypedDict, TypeVar, final, overload

import numpy as np
from numpy.typing import NDArray
from typing_extensions import Unpack

from ._errors import Error

class _HasMatrix(Protocol):
    def as_matrix(self) -> Any: ...

class _HasQuaternion(Protocol):
    def as_quat(self) -> Any: ...

_Numbers = Sequence[float] | NDArray[Any]
_Orientation = _Numbers | _HasQuaternion
_PoseLike = Pose | NDArray[Any] | Sequence[Sequence[float]] | tuple[_Numbers, _Orientation] | _HasMatrix

_T = TypeVar("_T", contravariant=True)

class _Options(TypedDict, total=False):
    speed: float | None
    until: Mapping[str, Condition] | None
    now: bool

class _MotionOptions(_Options, total=False):
    blend: float | None

class _Limits(TypedDict, total=False):
    velocity: float | None
    acceleration: float | None
    jerk: float | None
    rot_velocity: float | None
    rot_acceleration: float | None
    rot_jerk: float | None
class _ForceLimits(TypedDict, total=False):
    approach: float
    velocity: float
    travel: float
    touch: float
    tolerance: float
    force_max: float
    damping: float

_GoalLike = _PoseLike | Goal
_DirectionLike = _Numbers | Direction

def connect(address: str | None = None, token: str | None = None) -> Cell:
    """Connects to a controller.

    `address`: `host:port`, or the path of its Unix socket; without it, the controller of this host. `token`: required
    by controllers that listen beyond this host.

    Raises `Connection` if no controller listens there, `Refused` if it requires another token.
    """

def emulate(name: str) -> Cell:
    """Starts a controller with emulated robots inside of the program, and connects to it. It needs no hardware.

    `name`: `two_lwr` (arms `left`, `right`), `iiwa` (`arm`), `factory` (`left`, `right`, `tx90`, youBot `arm`, `hand`,
    `base`), `lwr_wsg` (`arm`, `gripper`), `lwr_table` (`arm` above a table at the frame `table`, which vanishes while the
    digital output 0 of `arm` is true), `assembly` (`left`, `right`, `left_hand`, `right_hand`, `base`), or `lola` (`arm`).

    Raises `Invalid` for another name.
    """

def simulate_time(real_time_factor: float = 1.0) -> None:
    """Lets emulated cells of this program run in simulated time from now on and to its end.

    The time waits for threads that the host runs late, so robots and controller miss no cycle on a host that is busy or
    stalls. For tests and demonstrations; not beside real robots.

    `real_time_factor`: how fast it runs while the host keeps up, 0.1 to 10 times the host's time. Further calls change
    nothing.

    Raises `Invalid` if the factor is out of its range, or this program has embedded a cell file.
    """

def embed(path: str | PathLike[str]) -> Cell:
    """Starts the controller of a cell file inside of the program, and connects to it. It waits for no device.

    Only this program can command it. Raises `Invalid` if the file is no valid cell, `Connection` if the system refuses
    threads, sockets or devices.
    """

def fleet(
    *endpoints: str,
    ca: str | PathLike[str] | None = None,
    certificate: str | PathLike[str] | None = None,
    key: str | PathLike[str] | None = None,
) -> Fleet:
    """Connects to a fleet: `takt.fleet("tcp/127.0.0.1:7447")["weld3"].arm("left")`.

    `endpoints`: cells or routers, `tcp/HOST:PORT` on loopback, `tls/HOST:PORT` with `ca`, `certificate` and `key`, which are
    files in PEM.

    Raises `Invalid` if an endpoint is none or lacks certificates, `Connection` if none answers.
    """

def deg(angle: float) -> float:
    """An angle in degrees as radians."""

def together(*activities: Activity) -> Composite:
    """Combines activities of different devices to one that begins when all of the devices are ready, in the same cycle.

    Raises `TypeError` for anything else than activities.
    """

def either(*activities: Activity) -> Composite:
    """The first of several activities that is possible: the next is tried if one is invalid, or the controller rejects it.

    Raises `TypeError` for anything else than activities.
    """

def when(condition: Condition) -> Waiting:
    """Waits for a condition, without a device: `when(condition).start(activity)`."""

def coupled(object: _PoseLike, arms: Sequence[Arm]) -> Coupled:
    """Couples arms that hold an object, which is at `object` in the world now.

    Each arm keeps its flange where it is now in the object; the arms have their bases in the world by `Arm.with_base`.
    Raises `DeviceFailed` if an arm is offline, `Invalid` if there is none, or they are of different cells.
    """

@final
class Cell:
    """The controller of a cell, by `takt.connect`. As a context manager it is closed at the end, also after Ctrl-C.

    When the program ends without closing it, the controller cancels what the program began, and aborts what does not end.
    """

    def arm(self, name: str) -> Arm:
        """An arm by its name.

        Raises `NoDevice` if the controller has no arm of that name; the text lists those that it has.
        """
    def io(self, device: str) -> Io:
        """Inputs and outputs of a device. Raises `NoDevice`, which lists the devices that have any."""
    def gripper(self, name: str) -> Gripper:
        """A gripper by its name. Raises `NoDevice`, which lists those that the controller has."""
    def base(self, name: str) -> Base:
        """A mobile base by its name. Raises `NoDevice`, which lists those that the controller has."""
    def frame(self, name: str) -> Frame:
        """A frame of the cell by its name: one of the cell file, `world`, `DEVICE.base`, `DEVICE.flange` or a tool of it.

        Of a mobile base also `DEVICE.odometry`, where it started. Raises `NoDevice`, which lists all frames.
        """
    def frames(self) -> list[Frame]:
        """All frames of the cell, by their names. Raises `Lost` if the connection is lost."""
    def arms(self) -> list[Arm]:
        """All arms. Raises `Lost` if the connection is lost."""
    def ios(self) -> list[Io]:
        """All devices with inputs or outputs. Raises `Lost` if the connection is lost."""
    def grippers(self) -> list[Gripper]:
        """All grippers. Raises `Lost` if the connection is lost."""
    def set_override(self, factor: float) -> None:
        """Sets the speed of all activities of this program, 0 to 1, as part of their own: also of those that run.

        At 0 they stand still on their paths and go on with a larger factor. Raises `Invalid` for another factor.
        """
    def override_factor(self) -> float:
        """The speed that `set_override` has set, 0 to 1."""
    def value(self, number: Number) -> float | None:
        """The present value of a number, in its unit; `None` if a device does not know it.

        The history of averages and durations begins with the call. Raises `Rejected`, or `Lost`.
        """
    def holds(self, condition: Condition) -> bool:
        """Whether a condition holds at present; not if it depends on a number that a device does not know."""
    @overload
    def on_change(self, expression: Number, callback: Callable[[float | None], object]) -> Listener:
        """Calls `callback` with the value of a number, then at each change, until the listener is closed.

        It is `None` while a device does not know it. The callback runs in a thread of its
        own: it may take its time. Raises `Rejected`, `Lost`, and `TypeError` for anything else.
        """
    @overload
    def on_change(self, expression: Condition, callback: Callable[[bool], object]) -> Listener:
        """The same for a condition, which is not true while a device does not know what it depends on."""
    def embedded_address(self) -> str | None:
        """Where other programs reach the controller in this program; `None` if it runs elsewhere."""
    def stop(self) -> None:
        """Stops everything that this program began, from any thread, and waits until it is at rest.

        Robots brake on their paths within their limits. What waits does not begin, nor does what another thread is planning;
        what is begun afterwards does. It is no emergency stop: that is `takt stop`, or a switch on the robot.

        Raises `Ended` if a device still moves after 10 s, and `Lost` if the connection ended: the controller stops it then.
        """
    def close(self) -> None:
        """Cancels everything that this program began, waits until it is at rest, and ends the session.

        Raises `Lost` if the connection is lost, `Ended` if something still moves after ten seconds; the session is
        ended in any case. A second call does nothing.
        """
    def __enter__(self) -> Cell: ...
    def __exit__(
        self,
        kind: type[BaseException] | None,
        _value: BaseException | None,
        _traceback: TracebackType | None,
        /,
    ) -> None: ...

@final
class Fleet:
    """The cells of a fleet, by `takt.fleet`. Cells that were found through it stay connected without it."""

    def cells(self) -> list[str]:
        """Names of the cells that are alive and can be reached. Raises `Connection` if the connection is lost."""
    def __getitem__(self, name: str, /) -> Cell:
        """Connects to a cell by its name.

        When the program, or the last link to the cell, is lost, the controller cancels what the program began, and aborts what
        does not end.

        Raises `NoDevice` if no cell of that name is alive, `Connection` if it gives this program no right to command.
        """

@final
class JointLimits:
    """Limits of a joint."""

    @property
    def position_min(self) -> float:
        """Smallest position, rad."""
    @property
    def position_max(self) -> float:
        """Largest position, rad."""
    @property
    def velocity(self) -> float:
        """Largest speed, rad/s."""
    @property
    def acceleration(self) -> float:
        """Largest acceleration, rad/s²."""
    @property
    def jerk(self) -> float:
        """Largest jerk of motions, rad/s³."""

@final
class Force:
    """Force and torque at the tool of an arm, as its driver reports them."""

    @property
    def x(self) -> Number:
        """Force along x, N."""
    @property
    def y(self) -> Number:
        """Force along y, N."""
    @property
    def z(self) -> Number:
        """Force along z, N."""
    @property
    def torque_x(self) -> Number:
        """Torque about x, Nm."""
    @property
    def torque_y(self) -> Number:
        """Torque about y, Nm."""
    @property
    def torque_z(self) -> Number:
        """Torque about z, Nm."""

@final
class Arm:
    """An arm of a cell, by `Cell.arm`.

    All motions take: `speed`, a factor above 0 to 1 that multiplies with that of `with_speed`; `blend`, the part of the
    path (0 to below 1) from which the next motion may take over; `until`, conditions by name that stop the motion on its
    path, of which the first that holds decides; `now`, to begin in the next cycle in place of what the arm does.
    """

    @property
    def name(self) -> str:
        """Its name in the cell."""
    @property
    def kind(self) -> str:
        """Its type, such as `kuka_lwr_fri`."""
    @property
    def period(self) -> float:
        """Period of the nets that command it, s."""
    @property
    def model(self) -> str:
        """Model of its kinematics, such as `kuka_lwr4`; empty if it is not described."""
    @property
    def base(self) -> Pose:
        """Its base in the world; the world's origin, unless set by `with_base`."""
    @property
    def base_frame(self) -> Frame:
        """Its base as a frame."""
    @property
    def joints(self) -> list[JointLimits]:
        """Limits of its joints, from the base."""
    @property
    def limits(self) -> _Limits:
        """Its limits on lines, arcs, curves and jogs, by the keywords of `with_limits`, in their units."""
    @property
    def force(self) -> Force:
        """Force and torque at the tool, as expressions."""
    def with_speed(self, factor: float) -> Arm:
        """The same arm, slower: the speed of its motions is multiplied by `factor`, above 0 to 1."""
    def with_limits(self, **limits: Unpack[_Limits]) -> Arm:
        """The same arm with these limits on lines and arcs, m/s, m/s², m/s³, rad/s, rad/s², rad/s³.

        Those left out are 0.25, 1, 10, 0.5, 2.5 and 25. Raises `Invalid` for a limit that is not above 0.
        """
    @property
    def force_limits(self) -> _ForceLimits:
        """Its limits on motions under force, by the keywords of `with_force_limits`, in their units."""
    def with_force_limits(self, **limits: Unpack[_ForceLimits]) -> Arm:
        """The same arm with these limits on motions under force, each above 0. Those left out are the default.

        `approach`: speed until contact, 0.02 m/s. `velocity`: largest speed in contact along the force, 0.01 m/s. `travel`:
        longest way along the force, 0.1 m. `touch`: force from which on there is contact, 5 N; at most half of the wanted force
        counts. `tolerance`: how far a held force may be off, 2 N. `force_max`: largest force at the tool, 100 N. `damping`:
        missing force by velocity, 2000 Ns/m: lower is faster, and overshoots more on stiff objects. Raises `Invalid`.
        """
    def with_tool(self, tool: _PoseLike) -> Arm:
        """The same arm with another motion centre, given in the flange: motions lead it, such as the tip of a tool."""
    def with_base(self, base: _PoseLike) -> Arm:
        """The same arm with its base at this pose in the world, which coupled arms share."""
    def ptp(self, to: _Numbers, **options: Unpack[_MotionOptions]) -> Activity:
        """A motion to joint positions, rad, one for each joint: all joints start and arrive together."""
    def home(self, **options: Unpack[_MotionOptions]) -> Activity:
        """The same to the home position of the arm: that of `[[home]]` in the cell file.

        Without one every joint goes to 0, or to the middle of its range if it cannot be at 0. Raises `Limit` at the begin if the
        position of the cell file is out of range.
        """
    def ptp_to(self, to: _GoalLike, **options: Unpack[_MotionOptions]) -> Activity:
        """A motion of all joints together to a pose of the motion centre in the base of the arm, or in frames.

        Of all joint positions for it, those next to where the arm begins. Raises `Invalid` if a matrix is no pose.
        """
    def ptp_near(self, to: _GoalLike, hint: _Numbers, **options: Unpack[_MotionOptions]) -> Activity:
        """The same to the joint positions next to `hint`, rad, one for each joint."""
    def lin(self, to: _GoalLike, **options: Unpack[_MotionOptions]) -> Activity:
        """A motion of the motion centre along a straight line to a pose in the base of the arm, or in frames.

        Raises `Invalid` if a matrix or quaternion is no pose.
        """
    def circ(self, via: _GoalLike, to: _GoalLike, **options: Unpack[_MotionOptions]) -> Activity:
        """A motion of the motion centre along the arc through `via` to `to`, both in the base of the arm, or in frames.

        Raises `Invalid` if a matrix or quaternion is no pose.
        """
    def spline(self, through: Iterable[_GoalLike], **options: Unpack[_MotionOptions]) -> Activity:
        """A motion of the motion centre along a smooth curve through 1 to 63 poses in the base of the arm, or in frames.

        Raises `Invalid` if a matrix or quaternion is no pose.
        """
    def trajectory(
        self,
        times: Iterable[float],
        positions: Iterable[Iterable[float]],
        velocities: Iterable[Iterable[float]] | None = None,
        accelerations: Iterable[Iterable[float]] | None = None,
        *,
        path_tolerance: Iterable[float] | None = None,
        goal_tolerance: Iterable[float] | None = None,
        goal_time: float = 1.0,
        **options: Unpack[_MotionOptions],
    ) -> Activity:
        """A motion of the joints through positions (rad, shape times x joints) at given times, s from its start.

        Between points positions are quintic polynomials where both have `accelerations`, rad/s^2, else cubic ones; without
        `velocities`, rad/s, they follow from the points beside. A point at 0 is where the arm should be, within 0.01 rad. With
        `now` it begins in motion, without a jump of position, velocity or acceleration.

        `path_tolerance` and `goal_tolerance`, rad, one value for all joints or one for each, bound the deviation of measured
        positions on the way and at the end, where the arm has `goal_time` s more, below 0 as long as it takes. It fails at rest
        with `Deviation`. Raises `Unplanned` if a limit of a joint is exceeded, `Invalid` for other numbers of rows.
        """
    def hold(self, **options: Unpack[_Options]) -> Activity:
        """Brakes the arm and keeps it under command where it comes to rest: `Outcome.Maintaining`.

        It ends when another activity takes over, or it is cancelled.
        """
    def press(self, direction: _DirectionLike, force: float, **options: Unpack[_Options]) -> Activity:
        """Presses with `force`, N, in a direction: of the base of the arm, of a frame or of the motion centre (`Direction`).

        The arm approaches until it touches something, and then moves as the missing force requires (admittance control),
        within `force_limits`; its orientation and its place aside stay. It is `Outcome.Maintaining` when the force is held,
        and goes on until a cancel, a condition or another activity. An arm that is in contact already holds the force without
        approach. The load of the tool must not be part of the force.

        It fails at rest: `ForceNotReached` after `travel`; `ContactLost`, if the force is less than half of `touch` for 0.1 s;
        `ForceExceeded` beyond `force_max`; `Unreachable`; `DeviceFailed`, if the force becomes unknown. Raises `Unsupported` if
        the arm does not know the force at its tool, `Invalid` for a force or direction out of bounds.
        """
    def press_to(
        self, to: _GoalLike, direction: _DirectionLike, force: float, **options: Unpack[_Options]
    ) -> Activity:
        """The same on the way to a pose: the motion centre moves aside under force, within `limits`, and turns.

        The place of the pose along the direction does not matter. It is `Outcome.Maintaining` at the pose, with the force held.
        """
    def follow(self, frame: MovingFrame, **options: Unpack[_Options]) -> Activity:
        """Follows a frame that moves, within `limits`.

        It is `Outcome.Maintaining` as long as the motion centre is within 1 mm and 0.01 rad, and goes on until a cancel, a
        condition or another activity. Where the arm cannot follow, it brakes on its path and fails with `Unreachable` at rest,
        and where the place of the frame becomes unknown, with `DeviceFailed`. Raises `NotConnected` if the frame moves in
        another one than the base of the arm, `Invalid` if the arm follows itself.
        """
    def centre(self) -> MovingFrame:
        """Its motion centre as a frame that moves, where the arm is commanded."""
    def switch_to(self, control: Control, **options: Unpack[_Options]) -> Activity:
        """Switches how the arm is controlled, as soon as it rests. The mode stays until the arm switches again.

        Some arms leave command mode for that and come back: completed when the arm follows again. Raises `Unsupported` if the
        arm or the program of its robot cannot, `Invalid` for a stiffness or damping out of its range.
        """
    def jog(self, **options: Unpack[_Options]) -> Live[Twist | _Numbers]:
        """Jogging of the motion centre: it moves at the velocity that the program sends, and brakes without a new one for 0.1 s.

        Send a `Twist`, or 6 numbers (m/s, rad/s) in the axes of the base, at 20 Hz or more, within the limits of
        `with_limits`. Where the arm cannot follow, it brakes on its path, and the activity fails with `Unreachable`.
        """
    def jog_joints(self, **options: Unpack[_Options]) -> Live[_Numbers]:
        """The same for velocities of the joints, rad/s, one for each joint. A joint brakes before the end of its range."""
    def stream(self, **options: Unpack[_Options]) -> Live[_Numbers]:
        """A motion to joint positions that the program sends, rad, one for each joint, at 10 to 100 Hz or when it likes.

        Every joint moves to its latest goal as fast as its limits, `speed` and the override allow, and rests there.
        """
    def stream_poses(self, **options: Unpack[_Options]) -> Live[_PoseLike]:
        """The same for poses of the motion centre in the base of the arm: the joint positions next to those of the arm.

        Where the arm cannot reach a pose, it brakes, and the activity fails with `Unreachable`.
        """
    def positions(self) -> NDArray[np.float64]:
        """Measured positions of the joints, rad, one for each joint. Raises `DeviceFailed` if the arm is offline."""
    def commanded(self) -> NDArray[np.float64]:
        """Commanded positions of the joints, rad, one for each joint. Raises `DeviceFailed` if the arm is offline."""
    def pose(self) -> Pose:
        """The measured pose of the flange in the base of the arm.

        Raises `DeviceFailed` if the arm is offline or has no kinematics.
        """
    def joint(self, axis: int) -> Number:
        """The measured position of a joint, rad, from 0, as an expression. Raises `Invalid` if there is none."""
    def input(self, port: int) -> Condition:
        """A digital input of the arm, as a condition."""
    def cancel(self) -> None:
        """Requests that what the arm does end, and everything that waits for it. Returns at once."""
    def finish(self, timeout: float | None = None) -> None:
        """Waits until the arm has done everything that was requested of it, at most for `timeout`, s.

        How the activities ended is in their handles. Raises `Timeout`, or `Lost` if the connection is lost.
        """

@final
class Activity:
    """An activity that was described and not begun: nothing moves before `begin`, `queue`, `run` or `await`."""

    def speed(self, factor: float) -> Activity:
        """The same, with its speed multiplied by `factor`, above 0 to 1."""
    def blend(self, progress: float) -> Activity:
        """The same, but a successor may take over from this part of the path on, 0 to below 1."""
    def until(self, name: str, condition: Condition) -> Activity:
        """The same, stopped on its path when the condition holds; the outcome names it."""
    def now(self) -> Activity:
        """The same, to begin in the next cycle, in place of what the arm does, at rest or in motion."""
    def unchecked(self) -> Activity:
        """The same without a check of its path beforehand: where the arm cannot follow, it fails on its way."""
    def then(self, next: Activity | Composite) -> Composite:
        """Lets `next` follow: both are loaded and scheduled before the first one begins."""
    def on(self, event: Event, next: Activity | Composite) -> Composite:
        """Lets `next` begin at an event of this activity, decided by the controller; else it is skipped."""
    def after_failure(self) -> Composite:
        """Lets it begin also if what it follows fails or is cancelled."""
    def begin(self) -> Handle:
        """Begins it, and returns when it runs: a program is at most one activity ahead.

        Raises `Invalid`, `Limit` or `Rejected` if nothing was begun, `PredecessorFailed` if what the arm does before
        fails. Ctrl-C while it waits cancels it.
        """
    def queue(self) -> Handle:
        """Lets it begin after what the arm does, and returns at once. Raises as `begin`."""
    def run(self) -> Outcome:
        """Begins it and waits until it has ended. Raises as `begin` and `Handle.wait`; Ctrl-C cancels it."""
    def plan(self) -> Plan:
        """Plans it from where what its device does now ends, or from where the device is: nothing is loaded.

        Raises `Invalid`, `Unreachable`, `TooFast`, or `Unplanned` if its path is not known before it runs.
        """
    def prepare(self) -> Prepared:
        """Plans, writes and loads it, so that `Prepared.begin` later is one request; nothing moves.

        It is to begin where its arm is now, or where what the arm does now leaves it. Raises as `begin`, and `Invalid` if
        an arc or a curve is to begin by `now`: it leads from where the arm is then.
        """
    def explain(self) -> Explanation:
        """What it becomes if it is begun now; the controller checks the net, and nothing moves.

        Raises `Invalid` or `Limit`, and `Rejected` if the controller rejects the net.
        """
    def __await__(self) -> Generator[Any, None, Outcome]: ...

@final
class Composite:
    """Several activities that are begun in one call, by `takt.together`, `takt.either` or `then`.

    All are loaded and scheduled before the first one begins; the controller decides in its cycle which follows.
    """

    def then(self, next: Activity | Composite) -> Composite:
        """The same, followed by `next`."""
    def on(self, event: Event, next: Activity | Composite) -> Composite:
        """The same; `next` begins at an event of the last activity, decided by the controller; else it is skipped."""
    def after_failure(self) -> Composite:
        """The same; what begins first begins also if what its devices do before fails or is cancelled."""
    def prepare(self) -> Prepared:
        """Plans, writes and loads them, to begin them later with one request each. Raises as `Activity.prepare`."""
    def begin(self) -> Handle:
        """Begins them, and returns when they run. Raises as `Activity.begin`."""
    def queue(self) -> Handle:
        """The same, but does not wait until they run."""
    def run(self) -> Outcome:
        """Begins them and waits until all have ended; the outcome is the one that is furthest from completion."""
    def __await__(self) -> Generator[Any, None, Outcome]: ...

@final
class Prepared:
    """An activity, or several that begin in one call, loaded and not begun: begun once, or discarded.

    Motions to joint positions begin from anywhere. What leads from where its arms are, such as a line, is refused with
    `Stale` if they rest elsewhere when it begins, by more than 2 mrad in a joint, or if what it then follows leaves them
    elsewhere. As a context manager it is discarded at the end of the block, unless it was begun; so is one that is
    garbage. While it exists, the controller keeps the devices that it needs.
    """

    def begin(self) -> Handle:
        """Begins it with one request for each activity, and returns when it runs.

        Raises `Stale` if it no longer fits, `Invalid` if it was begun or discarded before, else as `Activity.begin`.
        """
    def queue(self) -> Handle:
        """Lets it begin after what its devices do, and returns at once. Raises as `begin`."""
    def run(self) -> Outcome:
        """Begins it and waits until it has ended. Raises as `begin` and `Handle.wait`; Ctrl-C cancels it."""
    def discard(self) -> None:
        """Unloads it, unless it was begun."""
    def __enter__(self) -> Prepared: ...
    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, traceback: TracebackType | None
    ) -> None: ...
    def __await__(self) -> Generator[Any, None, Outcome]: ...

@final
class Explanation:
    """What an activity becomes if it is begun. As a text: its rules, its cost, and its net."""

    @property
    def net(self) -> str:
        """The text of its net, equal to that of Rust byte for byte."""
    @property
    def rules(self) -> list[str]:
        """What it follows, what it permits, and what ends it, a sentence each."""
    @property
    def cost(self) -> Cost:
        """What it costs in each cycle."""
    @property
    def plan(self) -> Plan | None:
        """Its course, if that is known before it runs."""
    def svg(self) -> str | None:
        """Its plan as a picture, as of `Plan.svg`; `None` without a plan."""

@final
class Cost:
    """Worst-case cost of a net."""

    @property
    def cycle(self) -> float:
        """Longest time that its evaluation takes in one cycle, s."""
    @property
    def period(self) -> float:
        """Its period, s."""
    @property
    def budget(self) -> float:
        """Time of a period that all nets of its thread may take together, s."""
    @property
    def primitives(self) -> int:
        """Number of its primitives."""
    @property
    def share(self) -> float:
        """Part of the period that it takes, above 0."""

@final
class Listener:
    """Calls of the program at each change of a number or a condition, by `Cell.on_change`, until it is closed or garbage.

    A condition is reported at its change, a number every 10 ms while it changes. A callback that takes longer misses the
    values in between, and is always called with the latest one. What it raises goes to `sys.unraisablehook`; the listener has
    ended then, with `error`. It runs in a thread of its own and may use the cell.
    """

    @property
    def missed(self) -> int:
        """How many values were replaced by later ones before the callback was called with them."""
    @property
    def error(self) -> Error | None:
        """Why it has ended by itself: `Callback`, `Lost`, or `Ended` if its net was ended on the controller."""
    def close(self) -> None:
        """Ends it; at most the call in progress is completed."""
    def __enter__(self) -> Listener: ...
    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, traceback: TracebackType | None
    ) -> None: ...

@final
class Event:
    """What may start another activity, for `on`."""

    Completed: ClassVar[Event]
    """It reached its goal."""
    Cancelled: ClassVar[Event]
    """It was cancelled and is at rest."""
    Failed: ClassVar[Event]
    """A device fails, or the path leaves its reach. An end without a result, such as an abort, is no event."""
    @staticmethod
    def Stopped(name: str) -> Event:
        """The condition of this name stopped it, and it is at rest."""
    @staticmethod
    def Progress(progress: float) -> Event:
        """It has completed this part of its path, 0 to below 1."""
    def __eq__(self, other: object, /) -> bool: ...

@final
class Waiting:
    """A condition that is to start an activity, by `takt.when`."""

    def start(self, next: Activity | Composite) -> Composite:
        """Begins `next` in the cycle after the one in which the condition holds, once its devices are ready."""
    def choose(self, yes: Activity | Composite, no: Activity | Composite) -> Composite:
        """Begins `yes` if the condition holds in the first cycle, else `no`. A condition over null does not hold."""

@final
class Coupled:
    """An object that two or more arms hold, by `takt.coupled`: they move with it as one, and brake as one.

    Motions take the same options as those of an arm. Where an arm cannot follow, or fails, all arms brake on the path, and
    the activity ends with an error when they are at rest.
    """

    def with_speed(self, factor: float) -> Coupled:
        """The same object, slower: the speed of its motions is multiplied by `factor`, above 0 to 1."""
    def with_limits(self, **limits: Unpack[_Limits]) -> Coupled:
        """The same object with these limits on its motions, in the units and with the defaults of `Arm.with_limits`."""
    def lin(self, to: _PoseLike, **options: Unpack[_MotionOptions]) -> Activity:
        """A motion of the object along a straight line to a pose in the world."""
    def circ(self, via: _PoseLike, to: _PoseLike, **options: Unpack[_MotionOptions]) -> Activity:
        """A motion of the object along the arc through `via` to `to`, both in the world."""
    def spline(self, through: Iterable[_PoseLike], **options: Unpack[_MotionOptions]) -> Activity:
        """A motion of the object along a smooth curve through 1 to 63 poses in the world."""

@final
class Plan:
    """The motion of an arm before anything is loaded, from rest to rest: the same course as that of the net, by cycles.

    Times are s after the start, at least 0; after the end, values are those at the goal.
    """

    @property
    def device(self) -> str:
        """Name of the arm."""
    @property
    def partners(self) -> list[Plan]:
        """The plans of the other arms that move with this one."""
    @property
    def duration(self) -> float:
        """Time from the start to rest at the goal, s."""
    def progress(self, time: float) -> float:
        """Completed part of the path at a time, 0 to 1."""
    def positions(self, time: float) -> NDArray[np.float64]:
        """Positions of the joints at a time, rad, one for each joint."""
    def velocities(self, time: float) -> NDArray[np.float64]:
        """Velocities of the joints at a time, rad/s, one for each joint."""
    def pose(self, time: float) -> Pose | None:
        """The pose of the flange in the base of the arm; `None` without a known model of the kinematics."""
    def first(self, condition: Callable[[float, NDArray[np.float64]], object]) -> float | None:
        """The first time at which `condition(progress, positions)` is true, else `None`. What it raises is passed on."""
    def svg(self) -> str:
        """A picture, as the text of an SVG file: positions of the joints, velocities as parts of their limits, over time."""
    def end(self) -> NDArray[np.float64]:
        """The joint positions at the goal, rad."""
    def cycles(self) -> list[NDArray[np.float64]]:
        """The motion by cycles: times (n), progress (n), joint positions, rad (n x joints)."""

@final
class Live(Generic[_T]):
    """An activity that follows what a program sends, by `Arm.jog` or `Arm.stream`, described and not begun."""

    def speed(self, factor: float) -> Live[_T]:
        """The same, with its speed multiplied by `factor`, above 0 to 1."""
    def until(self, name: str, condition: Condition) -> Live[_T]:
        """The same, stopped when the condition holds; the outcome names it."""
    def now(self) -> Live[_T]:
        """The same, to begin in the next cycle, in place of what the arm does, at rest or in motion."""
    def begin(self) -> LiveHandle[_T]:
        """Begins it, and returns when it runs: the arm brakes, and waits for set-points. Raises as `Activity.begin`."""
    def queue(self) -> LiveHandle[_T]:
        """Lets it begin after what the arm does, and returns at once. What is sent before its net is loaded is `Invalid`."""
    def explain(self) -> Explanation:
        """What it becomes if it is begun now, as of `Activity.explain`. Raises `Invalid` and `Rejected`."""

@final
class Twist:
    """Velocity of a motion centre, in the axes of the base of its arm."""

    @staticmethod
    def xyz(x: float, y: float, z: float) -> Twist:
        """A velocity without rotation, m/s."""
    def turning(self, x: float, y: float, z: float) -> Twist:
        """The same with a rotational velocity about x, y and z, rad/s."""
    @property
    def velocity(self) -> NDArray[np.float64]:
        """Velocity, m/s: array of 3."""
    @property
    def rotation(self) -> NDArray[np.float64]:
        """Rotational velocity about x, y and z, rad/s: array of 3."""
    def __eq__(self, other: object, /) -> bool: ...

@final
class Io:
    """Digital and analogue inputs and outputs of a device, by `Cell.io`. Ports count from 0.

    Inputs are expressions, outputs are set by activities. Each output is a device of its own: activities of different outputs
    do not wait for each other. An output stays as it is set. A port that the device does not have is `NoPort`.
    """

    @property
    def name(self) -> str:
        """The name of the device."""
    @property
    def kind(self) -> str:
        """Its device type, such as `kuka_lwr_fri`."""
    def state(self) -> IoState:
        """The present states of all inputs and outputs. Raises `Rejected` if the controller does not read them, or `Lost`."""
    def input(self, port: int) -> Condition:
        """A digital input."""
    def analogue_input(self, port: int) -> Number:
        """An analogue input, in the unit of the device."""
    def output(self, port: int) -> Condition:
        """The present state of a digital output, whichever client set it."""
    def analogue_output(self, port: int) -> Number:
        """The present value of an analogue output, in the unit of the device, whichever client set it."""
    def set(self, port: int, state: bool) -> Activity:
        """Sets a digital output. Completed when the device reports it; `DeviceFailed` if it does not within 1 s."""
    def pulse(self, port: int, state: bool, duration: float) -> Activity:
        """Sets a digital output to `state` for `duration`, s, above 0 to 3600, and then to the contrary.

        At once if it is cancelled. After an abort the output keeps its state.
        """
    def set_analogue(self, port: int, value: float) -> Activity:
        """Sets an analogue output, in the unit of the device. `Invalid` if `value` is not finite."""

@final
class IoState:
    """States of inputs and outputs, by `Io.state`; each list by ports, `None` where the device does not know one."""

    @property
    def digital_inputs(self) -> list[bool | None]:
        """Digital inputs."""
    @property
    def digital_outputs(self) -> list[bool | None]:
        """Digital outputs, whichever client set them."""
    @property
    def analogue_inputs(self) -> list[float | None]:
        """Analogue inputs, in the unit of the device."""
    @property
    def analogue_outputs(self) -> list[float | None]:
        """Analogue outputs, in the unit of the device, whichever client set them."""

@final
class Gripper:
    """A gripper of a cell, by `Cell.gripper`: fingers that move to a width, or one with commands of its own (Schunk WSG).

    Widths are distances between the fingers, m. Its activities take `speed`, `until` and `now` as those of an arm do. They
    raise `Invalid` for a width or force out of its bounds, `DeviceFailed` if the gripper does not execute the command in time.
    """

    @property
    def name(self) -> str:
        """Its name in the cell."""
    @property
    def kind(self) -> str:
        """Its device type, such as `schunk_wsg`."""
    @property
    def width_max(self) -> float | None:
        """The largest width, m; `None` if only the gripper itself knows it."""
    def with_speed(self, factor: float) -> Gripper:
        """The same gripper, slower: the speed of its commands is multiplied by `factor`, above 0 to 1.

        At 1 the fingers of a gripper with commands of its own move at 0.2 m/s. Others have one speed.
        """
    def with_timeout(self, timeout: float) -> Gripper:
        """The same gripper with another time-out of its commands at the speed 1, s; by default 5."""
    def open(self, **options: Unpack[_Options]) -> Activity:
        """Opens it wide: at its outer end stop, which a gripper with commands of its own needs once after power-on."""
    def close(self, **options: Unpack[_Options]) -> Activity:
        """Closes it without a part. Fails with `DeviceFailed` if a part blocks a gripper with commands of its own."""
    def move_to(self, width: float, **options: Unpack[_Options]) -> Activity:
        """Moves the fingers to a width, m."""
    def grasp(self, width: float, force: float, **options: Unpack[_Options]) -> Activity:
        """Grips a part of a width, m, with at most a force, N; `DeviceFailed` if there is none.

        Only grippers with commands of their own can (else `Invalid`): they keep the force up when the activity has ended.
        """
    @property
    def width(self) -> Number:
        """The measured width, m, as an expression."""
    @property
    def force(self) -> Number:
        """The measured gripping force, N, as an expression. Raises `Invalid` if the gripper does not measure it."""
    @property
    def holds(self) -> Condition:
        """Whether it holds a part. Raises `Invalid` if the gripper does not know it."""
    def cancel(self) -> None:
        """Requests that what the gripper does end, and everything that waits for it. Returns at once."""

@final
class Base:
    """A mobile base of a cell, by `Cell.base`. Its motions take `speed`, `until` and `now` as those of an arm do."""

    @property
    def name(self) -> str:
        """Its name in the cell."""
    @property
    def limits(self) -> tuple[float, float]:
        """Its largest speed, m/s, and rotational speed, rad/s."""
    def with_speed(self, factor: float) -> Base:
        """The same base, slower: the speed of its motions is multiplied by `factor`, above 0 to 1."""
    def go_to(self, pose: _PoseLike, **options: Unpack[_Options]) -> Activity:
        """Moves straight to a pose in the frame in which the base started; its height and tilt do not matter.

        At the speed 1 with half of its largest speed in x and y, within its largest acceleration. Completed when less than
        0.01 m and 0.01 rad are left, and it is at rest.
        """
    def drive(self, velocity: _Numbers, duration: float, **options: Unpack[_Options]) -> Activity:
        """Moves at a velocity in its own frame (x and y, m/s; the turn about z, rad/s) for `duration`, s, above 0 to 3600.

        It changes its speed within its largest acceleration, and then brakes to rest. A program that requests it again with
        `now` before the time is over keeps the base in motion. Raises `Invalid` for a velocity beyond `limits`.
        """
    def centre(self) -> MovingFrame:
        """Itself as a frame that moves, where the base is measured. Raises `Lost` without connection."""
    def pose(self) -> Pose:
        """The measured pose in the frame in which the base started. Raises `DeviceFailed` if it is offline."""
    def wheel(self, wheel: int) -> Number:
        """The measured angle of a wheel, from 0, since the start, rad, as an expression."""
    def cancel(self) -> None:
        """Requests that what the base does end, and everything that waits for it. Returns at once."""

class Handle:
    """An activity that was begun, or several that began together. `await` gives its outcome in asyncio.

    Dropping the handle does not end the activity. A task that is cancelled while it awaits one cancels the activity, and
    ends when the robot is at rest.
    """

    def wait(self, timeout: float | None = None) -> Outcome:
        """Waits until it has ended, at most for `timeout`, s.

        Raises the error with which it ended (`Unreachable`, `DeviceFailed`, `Conflict`, `PredecessorFailed`, `Ended`,
        `Lost`), with the line of the program that described it, or `Timeout`. Ctrl-C interrupts it; the activity goes on
        until the cell is closed.
        """
    def wait_to_end(self, timeout: float | None = None) -> Outcome:
        """Waits until it has ended, also if it is `Outcome.Maintaining` meanwhile, at most for `timeout`, s.

        Until a condition stops it, another activity takes over, or it is cancelled. Raises as `wait`.
        """
    def cancel(self) -> None:
        """Requests that it end: it brakes on its path. One that has not begun does not begin. Returns at once."""
    def progress(self) -> float:
        """Part of the path that it has completed, 0 to 1; of several activities the smallest."""
    def outcome(self) -> Outcome | None:
        """The outcome, or `None` if it has not ended. Raises as `wait`."""
    def on_end(self, callback: Callable[[Handle], object]) -> None:
        """Calls `callback` with this handle when it has ended, in a thread for all callbacks.

        What it raises is reported by `sys.unraisablehook` and stops nothing.
        """
    def _wake(self, callback: Callable[[], object]) -> None: ...
    def __await__(self) -> Generator[Any, None, Outcome]: ...

@final
class LiveHandle(Handle, Generic[_T]):
    """An activity that follows what the program sends, and was begun; it goes on until it is cancelled, a condition stops it,
    or another activity takes over with `now`.

    As a context manager it is cancelled at the end of the block, also after an exception and Ctrl-C, and waited for: the
    arm is at rest then. Its error is raised there, unless the program has it from `send`.
    """

    def send(self, set_point: _T) -> None:
        """Sends a set-point, which takes effect in the next cycle of the controller; returns when the controller has it.

        Raises `Invalid`, `Limit` or `Unreachable` if it is out of its bounds (the last one remains in effect, for 0.1 s if
        it is a velocity), the error with which the activity ended, or `Ended`, or `Lost`.
        """
    def __enter__(self) -> LiveHandle[_T]: ...
    def __exit__(
        self,
        kind: type[BaseException] | None,
        value: BaseException | None,
        _traceback: TracebackType | None,
        /,
    ) -> None: ...

@final
class Outcome:
    """How an activity ended; errors are exceptions. Outcomes compare by value, and match as `Outcome(kind, name)`."""

    __match_args__: ClassVar[tuple[Literal["kind"], Literal["name"]]]
    Completed: ClassVar[Outcome]
    """It reached its goal."""
    Cancelled: ClassVar[Outcome]
    """It was cancelled and is at rest on its path, or was not begun."""
    Maintaining: ClassVar[Outcome]
    """It reached its goal and keeps it up until another activity takes over, or it is finished or cancelled."""
    Skipped: ClassVar[Outcome]
    """It did not begin: the result that was to start it did not occur, or an alternative began instead."""
    TakenOver: ClassVar[Outcome]
    """Another activity took over while it moved."""
    @staticmethod
    def Stopped(name: str) -> Outcome:
        """The condition of this name stopped it; it is at rest on its path."""
    @property
    def kind(self) -> str:
        """`completed`, `cancelled`, `maintaining`, `skipped`, `taken_over` or `stopped`."""
    @property
    def name(self) -> str | None:
        """The name of the condition that stopped it, else `None`."""
    def is_stopped_by(self, name: str) -> bool:
        """Whether the condition of this name stopped the activity."""
    def __eq__(self, other: object, /) -> bool: ...
    def __hash__(self) -> int: ...

@final
class Pose:
    """A position and an orientation in a reference frame, by default the base of the arm that moves there.

    Wherever a pose is expected, a 4x4 matrix, a pair of position and quaternion (x, y, z, w), a pair of position and
    `scipy.spatial.transform.Rotation`, or a scipy `RigidTransform` will do. `a * b` is the pose `b` in the frame of `a`.
    """

    def __new__(cls, pose: _PoseLike | _Numbers, orientation: _Orientation | None = None) -> Pose: ...
    @staticmethod
    def xyz(x: float, y: float, z: float) -> Pose:
        """A position, m, with the orientation of the reference frame."""
    def abc(self, a: float, b: float, c: float) -> Pose:
        """The same position, turned by `a` about z, then by `b` about the new y, then by `c` about the new x, rad."""
    @staticmethod
    def quaternion(position: _Numbers, quaternion: _Numbers) -> Pose:
        """A position, m, and a quaternion (x, y, z, w), which is normalised."""
    @property
    def position(self) -> NDArray[np.float64]:
        """Position, m: array of 3."""
    @property
    def orientation(self) -> NDArray[np.float64]:
        """Orientation as a quaternion (x, y, z, w): array of 4."""
    def matrix(self) -> NDArray[np.float64]:
        """The homogeneous matrix, 4x4."""
    def in_(self, frame: Frame) -> Goal:
        """This pose in a frame of the cell, as a goal of motions."""
    def inverse(self) -> Pose:
        """The pose of the reference frame in this one."""
    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]: ...
    def __mul__(self, other: Pose, /) -> Pose: ...
    def __matmul__(self, other: Pose, /) -> Pose: ...
    def __eq__(self, other: object, /) -> bool: ...

@final
class Frame:
    """A named frame of a cell, by `Cell.frame`, where it was placed when the program requested it."""

    @property
    def name(self) -> str:
        """Its name."""
    @property
    def root(self) -> str:
        """The frame in which it is placed in the end, such as `world` or `left.flange`."""
    def pose(self, pose: _PoseLike) -> Goal:
        """A pose in this frame, as a goal of motions."""
    def direction(self, direction: _Numbers) -> Direction:
        """A direction along the axes of this frame, of any length but 0."""
    def within(self, other: Frame) -> Pose:
        """Its pose in another frame. Raises `NotConnected` if that changes with motions, or is not known."""
    def __eq__(self, other: object, /) -> bool: ...

@final
class Goal:
    """A pose in a frame, by `Pose.in_` or `Frame.pose`, wherever a motion of an arm expects a pose.

    The activity raises `NotConnected` when it begins if the frame is not connected with the base of the arm.
    """

    def __eq__(self, other: object, /) -> bool: ...

@final
class Direction:
    """The direction of a force, by `Frame.direction` or `of_centre`. Three numbers are one along the axes of the base."""

    @staticmethod
    def of_centre(direction: _Numbers) -> Direction:
        """A direction along the axes of the motion centre, with which it turns, of any length but 0."""
    def __eq__(self, other: object, /) -> bool: ...

@final
class MovingFrame:
    """A frame that moves, for `Arm.follow`: by `Arm.centre`, `Base.centre` or `of`."""

    @staticmethod
    def of(position: Sequence[Number | float], rotation: Sequence[Number | float] | None = None) -> MovingFrame:
        """The frame at three numbers, m, turned by three more about z, the new y and the new x, rad.

        In the base of the arm that follows it, or in the frame of `in_`.
        """
    def in_(self, frame: Frame) -> MovingFrame:
        """The frame of numbers that are given in a frame of the cell."""
    def pose(self, pose: _PoseLike) -> MovingFrame:
        """A pose that moves with the frame."""

@final
class Control:
    """How an arm is controlled, for `Arm.switch_to`."""

    @staticmethod
    def position() -> Control:
        """The arm follows positions, whatever pushes it."""
    @staticmethod
    def joints(stiffness: _Numbers, damping: _Numbers) -> Control:
        """Springs at the joints: stiffness, 0 to 5000 Nm/rad, and damping ratio, 0 to 1, one for each joint."""
    @staticmethod
    def cartesian(stiffness: _Numbers, damping: _Numbers) -> Control:
        """Springs at the tool: stiffness along x, y, z, N/m, and about x, y, z, Nm/rad, 0 to 10,000; damping ratio, 0 to 1.

        The axes are those that the program of the robot selects.
        """
    def __eq__(self, other: object, /) -> bool: ...

@final
class Number:
    """A number that the controller evaluates in each cycle. A number that its device does not know is null.

    Operators: + - * / abs, and > < to a `Condition`. Constants are finite, or `Invalid` is raised.
    """

    def abs(self) -> Number:
        """Its magnitude."""
    def sqrt(self) -> Number:
        """Its square root; a negative number has none, and nothing holds of it."""
    def sin(self) -> Number:
        """Sine of an angle, rad."""
    def cos(self) -> Number:
        """Cosine of an angle, rad."""
    def tan(self) -> Number:
        """Tangent of an angle, rad."""
    def asin(self) -> Number:
        """Arc sine, rad."""
    def acos(self) -> Number:
        """Arc cosine, rad."""
    def average(self, duration: float) -> Number:
        """Its mean over the last `duration`, s, or since the start if that is less."""
    def min(self, other: Number | float) -> Number:
        """The smaller of both."""
    def max(self, other: Number | float) -> Number:
        """The larger of both."""
    def over(self, limit: Number | float) -> Condition:
        """Whether it is greater than `limit`: the operator >."""
    def under(self, limit: Number | float) -> Condition:
        """Whether it is less than `limit`: the operator <."""
    def __add__(self, other: Number | float, /) -> Number: ...
    def __radd__(self, other: Number | float, /) -> Number: ...
    def __sub__(self, other: Number | float, /) -> Number: ...
    def __rsub__(self, other: Number | float, /) -> Number: ...
    def __mul__(self, other: Number | float, /) -> Number: ...
    def __rmul__(self, other: Number | float, /) -> Number: ...
    def __truediv__(self, other: Number | float, /) -> Number: ...
    def __rtruediv__(self, other: Number | float, /) -> Number: ...
    def __neg__(self) -> Number: ...
    def __abs__(self) -> Number: ...
    def __gt__(self, other: Number | float, /) -> Condition: ...
    def __lt__(self, other: Number | float, /) -> Condition: ...

@final
class Condition:
    """A state that the controller evaluates in each cycle. Operators: & | ~. A condition over null is not true."""

    def rises(self) -> Condition:
        """Whether it has just become true; also if it is true from the start."""
    def falls(self) -> Condition:
        """Whether it has just become false; also if it is false from the start."""
    def after(self, other: Condition) -> Condition:
        """Whether it holds once `other` has held since the activity began."""
    def lasting(self, duration: float) -> Condition:
        """Whether it has been true for `duration`, s, without a break."""
    def __and__(self, other: Condition, /) -> Condition: ...
    def __or__(self, other: Condition, /) -> Condition: ...
    def __invert__(self) -> Condition: ...
