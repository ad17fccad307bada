"""`takt ros2` by an independent implementation: sessions of eclipse-zenoh (PyPI) with the keys of rmw_zenoh, messages by rosbags (PyPI).
No ROS runs here; its nodes would send and receive the same bytes."""

from __future__ import annotations

import importlib
import pathlib
import queue
import socket
import struct
import subprocess
import time
import uuid
from collections.abc import Iterator
from typing import Any
from xml.etree import ElementTree

import numpy
import pytest
from conftest import BENT, ROOT, program, tool
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

import takt

zenoh: Any = importlib.import_module("zenoh")
"""Its types are incomplete."""

DOMAIN = 7
SEND_GOAL = "control_msgs::action::dds_::FollowJointTrajectory_SendGoal_/RIHS01_b13789dddc325a7a962825c45e28c77d37237ec129dd0c34dc5994562938c57f"
GET_RESULT = "control_msgs::action::dds_::FollowJointTrajectory_GetResult_/RIHS01_e3ceb38e3e1867c8dc0f46014df26e90eb93422f27e9e97f936e07f94be4bc8b"
FEEDBACK = "control_msgs::action::dds_::FollowJointTrajectory_FeedbackMessage_/RIHS01_80398fcb9674a79081a9906e2ccf0c804dd7cb15e22e362e606ee87186beab71"
CANCEL = "action_msgs::srv::dds_::CancelGoal_/RIHS01_573d8b0a534451d7bc2ac8c5ffde8ac14b8593b7001175d0cd6516dcbeb8689a"
JOINT_STATE = "sensor_msgs::msg::dds_::JointState_/RIHS01_a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e"
TRAJECTORY = "trajectory_msgs::msg::dds_::JointTrajectory_/RIHS01_179b33eba59d676f6d967ac71fe35e7ca2f64b2f3928f4a018cec115e213796e"
GRIP_GOAL = "control_msgs::action::dds_::GripperCommand_SendGoal_/RIHS01_6bf8cc4ce80cd499e7dd3258c03c50c3fa6672b469ff8355339ef1df77fcd212"
GRIP_RESULT = "control_msgs::action::dds_::GripperCommand_GetResult_/RIHS01_7e60a7606063d4a2728d21badac099e68b734a196ac3ab42d1d4c668eb0bb3cd"
PARALLEL_GOAL = "control_msgs::action::dds_::ParallelGripperCommand_SendGoal_/RIHS01_567c37373fed1260adbe047415688c73e4f3e94b2e3982761ecc71fd63d710a7"
PARALLEL_RESULT = "control_msgs::action::dds_::ParallelGripperCommand_GetResult_/RIHS01_e4c7f0e8a831ce5625ed20abcd13796406d945f92ebc7ad5972e0b0d29b381bd"
SET_BOOL = "std_srvs::srv::dds_::SetBool_/RIHS01_abe9e4bb6b41b40e6789712c00ec8871923e089af3f667a79992a428cff2da0a"
TF = "tf2_msgs::msg::dds_::TFMessage_/RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087"
WRENCH = "geometry_msgs::msg::dds_::WrenchStamped_/RIHS01_8dc3deaf06b2ab281f9f9a742a8961c328ca7cec16e3fd6586d3a5c83fa78f77"
STRING = "std_msgs::msg::dds_::String_/RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
DIAGNOSTICS = "diagnostic_msgs::msg::dds_::DiagnosticArray_/RIHS01_5a8a36efb05fb25070fa0fb3810290c0e6cd4862b54a8fb975a1ee8dc55a333e"

STORE = get_typestore(Stores.ROS2_JAZZY)
for name, text in {
    "control_msgs/msg/JointTolerance": "string name\nfloat64 position\nfloat64 velocity\nfloat64 acceleration",
    "control_msgs/msg/JointComponentTolerance": (
        "string joint_name\nuint16 component\nfloat64 position\nfloat64 velocity\nfloat64 acceleration"
    ),
    "control_msgs/msg/SendGoal": (
        "unique_identifier_msgs/UUID goal_id\ntrajectory_msgs/JointTrajectory trajectory\n"
        "trajectory_msgs/MultiDOFJointTrajectory multi_dof_trajectory\ncontrol_msgs/JointTolerance[] path_tolerance\n"
        "control_msgs/JointComponentTolerance[] component_path_tolerance\ncontrol_msgs/JointTolerance[] goal_tolerance\n"
        "control_msgs/JointComponentTolerance[] component_goal_tolerance\nbuiltin_interfaces/Duration goal_time_tolerance"
    ),
    "control_msgs/msg/Accepted": "bool accepted\nbuiltin_interfaces/Time stamp",
    "control_msgs/msg/Result": "int8 status\nint32 error_code\nstring error_string",
    "control_msgs/msg/Feedback": (
        "unique_identifier_msgs/UUID goal_id\nstd_msgs/Header header\nstring[] joint_names\n"
        "trajectory_msgs/JointTrajectoryPoint desired\ntrajectory_msgs/JointTrajectoryPoint actual\n"
        "trajectory_msgs/JointTrajectoryPoint error\nstring[] multi_dof_joint_names\n"
        "trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_desired\n"
        "trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_actual\n"
        "trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_error"
    ),
    "control_msgs/msg/Grip": "unique_identifier_msgs/UUID goal_id\nfloat64 position\nfloat64 max_effort",
    "control_msgs/msg/Gripped": "int8 status\nfloat64 position\nfloat64 effort\nbool stalled\nbool reached_goal",
    "control_msgs/msg/GripParallel": "unique_identifier_msgs/UUID goal_id\nsensor_msgs/JointState command",
    "control_msgs/msg/GrippedParallel": "int8 status\nsensor_msgs/JointState state\nbool stalled\nbool reached_goal",
    "std_srvs/msg/Switch": "bool data",
    "std_srvs/msg/Switched": "bool success\nstring message",
    "control_msgs/msg/Cancelling": "int8 return_code\naction_msgs/GoalInfo[] goals_canceling",
}.items():
    STORE.register(get_types_from_msg(text, name))

SUCCEEDED, CANCELED = 4, 5


def make(name: str, *values: Any) -> Any:
    """A message of that type."""
    return STORE.types[name](*values)


def encode(message: Any) -> bytes:
    """Its bytes."""
    return bytes(STORE.serialize_cdr(message, message.__msgtype__))


def decode(data: bytes, name: str) -> Any:
    """A message of these bytes."""
    return STORE.deserialize_cdr(data, name)


def numbers(values: Any) -> Any:
    """A sequence of doubles."""
    return numpy.array(values, dtype=numpy.float64)


def span(name: str, seconds: float) -> Any:
    """A time or a duration."""
    whole = int(numpy.floor(seconds))
    return make(f"builtin_interfaces/msg/{name}", whole, int((seconds - whole) * 1e9))


def trajectory(names: list[str], points: list[tuple[float, list[float]]]) -> Any:
    """A trajectory through positions at times, which begins at once."""
    header = make("std_msgs/msg/Header", span("Time", 0.0), "")
    none = numbers([])
    rows = [
        make("trajectory_msgs/msg/JointTrajectoryPoint", numbers(q), none, none, none, span("Duration", time)) for time, q in points
    ]
    return make("trajectory_msgs/msg/JointTrajectory", header, names, rows)


class Client:
    """A client as nodes of ROS are, in a zenoh session of its own."""

    def __init__(self, address: str) -> None:
        config = zenoh.Config()
        config.insert_json5("mode", '"client"')
        config.insert_json5("connect/endpoints", f'["{address}"]')
        config.insert_json5("scouting/multicast/enabled", "false")
        self.session = zenoh.open(config)
        self.sequence = 0

    def subscribe(self, key: str) -> tuple[list[bytes], Any]:
        """The messages of a topic as they come, and their subscriber."""
        found: list[bytes] = []

        def take(sample: Any) -> None:
            found.append(bytes(sample.payload))

        return found, self.session.declare_subscriber(f"{DOMAIN}/{key}", take)

    def attachment(self) -> bytes:
        """Number, time and identifier of a message: 33 bytes."""
        self.sequence += 1
        return struct.pack("<qqB16s", self.sequence, time.time_ns(), 16, b"takt-test-client")

    def call(self, name: str, kind: str, request: bytes, timeout: float = 30.0) -> bytes:
        """The answer of a service; it repeats the number of the request."""
        attachment = self.attachment()
        replies = list(
            self.session.get(
                f"{DOMAIN}/{name}/{kind}",
                payload=request,
                attachment=attachment,
                target=zenoh.QueryTarget.ALL_COMPLETE,
                consolidation=zenoh.ConsolidationMode.LATEST,
                timeout=timeout,
            )
        )
        assert len(replies) == 1, f"{len(replies)} answers of {name}"
        sample = replies[0].ok
        assert sample is not None and sample.attachment is not None
        answered = bytes(sample.attachment)
        assert len(answered) == 33
        assert (answered[:8], answered[16:]) == (attachment[:8], attachment[16:])
        return bytes(sample.payload)

    def latched(self, key: str, timeout: float = 30.0) -> bytes:
        """The last message of a topic that keeps it for those that come late."""
        found: queue.Queue[bytes] = queue.Queue()

        def take(sample: Any) -> None:
            found.put(bytes(sample.payload))

        history = zenoh.ext.HistoryConfig(detect_late_publishers=True)
        subscriber = zenoh.ext.declare_advanced_subscriber(self.session, f"{DOMAIN}/{key}", take, history=history)
        data = found.get(timeout=timeout)
        subscriber.undeclare()
        return data

    def goal(self, arm: str, wanted: Any) -> tuple[bool, bytes]:
        """Sends a goal; whether it is accepted, and its identifier."""
        goal_id = uuid.uuid4().bytes
        identifier = make("unique_identifier_msgs/msg/UUID", numpy.frombuffer(goal_id, dtype=numpy.uint8))
        none = make("trajectory_msgs/msg/MultiDOFJointTrajectory", make("std_msgs/msg/Header", span("Time", 0.0), ""), [], [])
        request = make("control_msgs/msg/SendGoal", identifier, wanted, none, [], [], [], [], span("Duration", 0.0))
        answer = self.call(f"{arm}/follow_joint_trajectory/_action/send_goal", SEND_GOAL, encode(request))
        return bool(decode(answer, "control_msgs/msg/Accepted").accepted), goal_id

    def result(self, arm: str, goal_id: bytes) -> Any:
        """Waits for the result of a goal."""
        request = b"\x00\x01\x00\x00" + goal_id
        answer = self.call(f"{arm}/follow_joint_trajectory/_action/get_result", GET_RESULT, request)
        return decode(answer, "control_msgs/msg/Result")


def free_address() -> str:
    """An address of this host that nobody listens at."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return f"127.0.0.1:{free.getsockname()[1]}"


class Bridge:
    """`takt ros2` beside a controller."""

    def __init__(self, folder: pathlib.Path, lines: str, http: str, *options: str) -> None:
        self.lines = lines
        self.router = f"tcp/{free_address()}"
        command = [tool(), "ros2", "--program", lines, "--connect", http, "--router", self.router, "--with-router"]
        command += ["--domain", str(DOMAIN), "--rate", "500", *options]
        self.log = folder / "stderr"
        with self.log.open("w") as log:
            self.bridge = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=log, text=True)
        assert self.bridge.stdout is not None
        for line in self.bridge.stdout:
            if line.startswith("domain"):
                break
        self.client = Client(self.router)

    def complaints(self) -> str:
        """What it has said on standard error."""
        return self.log.read_text()

    def states(self, seconds: float) -> list[Any]:
        """Joint states that come in a time."""
        found, subscriber = self.client.subscribe(f"joint_states/{JOINT_STATE}")
        time.sleep(seconds)
        subscriber.undeclare()
        return [decode(data, "sensor_msgs/msg/JointState") for data in found]

    def positions(self, arm: str) -> list[float]:
        """The measured positions of an arm."""
        for _ in range(100):
            last = [state for state in self.states(0.1) if state.name[0].startswith(f"{arm}.")]
            if last:
                return list(last[-1].position)
        raise AssertionError(f"no joint states of {arm}")

    def frames(self, key: str, count: int) -> dict[str, tuple[str, Any]]:
        """Parent and matrix of each frame in so many messages of a topic, by name."""
        found, subscriber = self.client.subscribe(key)
        until = time.monotonic() + 30.0
        while len(found) < count and time.monotonic() < until:
            time.sleep(0.05)
        subscriber.undeclare()
        assert len(found) >= count, self.complaints()
        return placed(found)

    def stop(self) -> None:
        """Ends it as an operator does."""
        self.client.session.close()
        self.bridge.terminate()
        assert self.bridge.wait(timeout=30.0) == 0, self.complaints()


def placed(messages: list[bytes]) -> dict[str, tuple[str, Any]]:
    """Parent and matrix of each frame, by name."""
    frames: dict[str, tuple[str, Any]] = {}
    for data in messages:
        for frame in decode(data, "tf2_msgs/msg/TFMessage").transforms:
            place, turn = frame.transform.translation, frame.transform.rotation
            matrix = numpy.eye(4)
            x, y, z, w = turn.x, turn.y, turn.z, turn.w
            assert x * x + y * y + z * z + w * w == pytest.approx(1.0, abs=1e-9)
            matrix[:3, :3] = [
                [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
            ]
            matrix[:3, 3] = [place.x, place.y, place.z]
            parent = frame.header.frame_id
            assert frames.get(frame.child_frame_id, (parent,))[0] == parent, "a frame has one parent"
            frames[frame.child_frame_id] = (parent, matrix)
    return frames


def within(frames: dict[str, tuple[str, Any]], name: str, root: str) -> Any:
    """Where a frame is in another one before it."""
    matrix = numpy.eye(4)
    for _ in range(len(frames)):
        if name == root:
            return matrix
        name, own = frames[name]
        matrix = own @ matrix
    raise AssertionError(f"{root} is not reached, but {name}")


@pytest.fixture(scope="module")
def bridge(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Bridge]:
    """Beside a controller with two simulated arms, grippers, a mobile base and outputs."""
    controller = subprocess.Popen([program("controller")], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert controller.stdin is not None and controller.stdout is not None
    lines, http, _ = (controller.stdout.readline().strip() for _ in range(3))
    bridge = Bridge(tmp_path_factory.mktemp("ros2"), lines, http)
    yield bridge
    bridge.stop()
    controller.stdin.close()
    controller.wait(timeout=60.0)


PANDA = ROOT / "examples" / "cells" / "panda.urdf"


@pytest.fixture(scope="module")
def described(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Bridge]:
    """With a description, beside a controller with the arm in it and an emulated KUKA LWR, which has a force sensor."""
    folder = tmp_path_factory.mktemp("described")
    lines, http, robot = free_address(), free_address(), free_address()
    config = folder / "cell.toml"
    config.write_text(
        f"[controller]\nwebsocket = '{http}'\ntcp = '{lines}'\nsocket = ''\nflight_recorder = ''\n"
        f"stop_socket = '{folder}/stop.sock'\n"
        f"[[device]]\nname = 'left'\ntype = 'kuka_lwr_fri'\nlisten = '{robot}'\n"
        f"[[device]]\nname = 'right'\ntype = 'arm_sim'\nmodel = 'urdf:{PANDA}'\nbase_link = 'panda_link0'\ntip_link = 'tool0'\n"
        "start = [10, -45, 20, -135, 30, 90, 45]\n[[base]]\ndevice = 'right'\nposition = [0.5, -0.8, 0.1]\n"
    )
    with (folder / "log").open("w") as log:
        controller = subprocess.Popen([tool(), "run", "--config", str(config)], stdout=log, stderr=log)
        arm = subprocess.Popen([tool(), "emulate", "lwr", "--connect", robot], stdout=log, stderr=log)
    until = time.monotonic() + 60.0
    while True:
        try:
            with takt.connect(lines) as cell:
                cell.arm("left").positions()
            break
        except takt.Error:
            assert time.monotonic() < until, (folder / "log").read_text()
            time.sleep(0.2)
    bridge = Bridge(folder, lines, http, "--description", str(PANDA), "--chain", "right=panda_link0:tool0")
    yield bridge
    bridge.stop()
    for process in (controller, arm):
        process.terminate()
        process.wait(timeout=60.0)


def joints(arm: str) -> list[str]:
    """Names of the joints of an arm."""
    return [f"{arm}.joint_{number}" for number in range(1, 8)]


def move(bridge: Bridge, arm: str, to: list[float], seconds: float = 1.5) -> None:
    """Moves an arm by a goal of one point."""
    accepted, goal_id = bridge.client.goal(arm, trajectory(joints(arm), [(seconds, to)]))
    assert accepted, bridge.complaints()
    result = bridge.client.result(arm, goal_id)
    assert (result.status, result.error_code) == (SUCCEEDED, 0), result.error_string


def test_ros2_joint_states_have_names_stamps_and_rate(bridge: Bridge) -> None:
    bridge.states(0.3)
    states = [state for state in bridge.states(1.0) if state.name == joints("left")]
    # 500 Hz, on a host that may stall.
    assert len(states) > 250, len(states)
    stamps = [state.header.stamp.sec + state.header.stamp.nanosec * 1e-9 for state in states]
    assert all(later > earlier for earlier, later in zip(stamps, stamps[1:], strict=False))
    assert abs(stamps[-1] - time.time()) < 5.0
    assert len(states[-1].position) == len(states[-1].velocity) == 7


def test_ros2_graph_has_node_actions_and_topics(bridge: Bridge) -> None:
    tokens = [str(reply.ok.key_expr) for reply in bridge.client.session.liveliness().get(f"@ros2_lv/{DOMAIN}/**", timeout=10.0) if reply.ok]
    assert any("/NN/" in token and token.endswith("/takt") for token in tokens), tokens
    for kind, name in [
        ("MP", "%joint_states"),
        ("MP", "%diagnostics"),
        ("SS", "%left%follow_joint_trajectory%_action%send_goal"),
        ("SS", "%arms%follow_joint_trajectory%_action%cancel_goal"),
        ("MP", "%right%follow_joint_trajectory%_action%status"),
        ("MS", "%left%joint_trajectory"),
    ]:
        assert any(f"/{kind}/" in token and f"/{name}/" in token for token in tokens), (kind, name, tokens)


def test_ros2_goal_is_followed_with_feedback_and_result(bridge: Bridge) -> None:
    found, subscriber = bridge.client.subscribe(f"left/follow_joint_trajectory/_action/feedback/{FEEDBACK}")
    middle = [q + 0.1 for q in BENT]
    accepted, goal_id = bridge.client.goal("left", trajectory(joints("left"), [(1.0, middle), (2.0, BENT)]))
    assert accepted, bridge.complaints()
    result = bridge.client.result("left", goal_id)
    subscriber.undeclare()
    assert (result.status, result.error_code) == (SUCCEEDED, 0), result.error_string
    assert bridge.positions("left") == pytest.approx(BENT, abs=0.011)
    feedback = [decode(data, "control_msgs/msg/Feedback") for data in found]
    assert len(feedback) > 10
    assert all(bytes(message.goal_id.uuid) == goal_id for message in feedback)
    assert list(feedback[0].joint_names) == joints("left")
    for message in feedback:
        difference = message.desired.positions - message.actual.positions
        assert message.error.positions == pytest.approx(difference, abs=1e-9)
    # The result stays for those that ask late.
    assert bridge.client.result("left", goal_id).status == SUCCEEDED


def test_ros2_goal_in_motion_takes_over_without_jump(bridge: Bridge) -> None:
    move(bridge, "left", BENT)
    states, subscriber = bridge.client.subscribe(f"joint_states/{JOINT_STATE}")
    there = [BENT[0] + 0.8, *BENT[1:]]
    back = [BENT[0] - 0.2, *BENT[1:]]
    accepted, first = bridge.client.goal("left", trajectory(joints("left"), [(2.0, there)]))
    assert accepted, bridge.complaints()
    time.sleep(0.9)
    accepted, second = bridge.client.goal("left", trajectory(joints("left"), [(2.0, back)]))
    assert accepted, bridge.complaints()
    replaced = bridge.client.result("left", first)
    assert replaced.status == CANCELED and "another goal" in replaced.error_string
    result = bridge.client.result("left", second)
    assert (result.status, result.error_code) == (SUCCEEDED, 0), result.error_string
    subscriber.undeclare()
    decoded = [decode(data, "sensor_msgs/msg/JointState") for data in states]
    rows = [
        (state.header.stamp.sec + state.header.stamp.nanosec * 1e-9, state.position[0], state.velocity[0])
        for state in decoded
        if state.name == joints("left")
    ]
    assert max(velocity for _, _, velocity in rows) > 0.3, "it moved when the second goal came"
    for (before, _, slow), (after, _, fast) in zip(rows, rows[1:], strict=False):
        # A jump of the velocity would be one of 0.3 rad/s or more.
        assert abs(fast - slow) < 0.05 + 8.0 * (after - before), (before, slow, fast)
    assert bridge.positions("left") == pytest.approx(back, abs=0.011)


def test_ros2_cancel_brakes_on_the_path(bridge: Bridge) -> None:
    move(bridge, "left", BENT)
    there = [BENT[0] + 0.8, *BENT[1:]]
    accepted, goal_id = bridge.client.goal("left", trajectory(joints("left"), [(3.0, there)]))
    assert accepted, bridge.complaints()
    time.sleep(1.0)
    request = b"\x00\x01\x00\x00" + goal_id + bytes(8)
    answer = bridge.client.call("left/follow_joint_trajectory/_action/cancel_goal", CANCEL, request)
    cancelling = decode(answer, "control_msgs/msg/Cancelling")
    assert cancelling.return_code == 0 and bytes(cancelling.goals_canceling[0].goal_id.uuid) == goal_id
    result = bridge.client.result("left", goal_id)
    assert (result.status, result.error_string) == (CANCELED, "cancelled")
    at = bridge.positions("left")
    assert BENT[0] + 0.01 < at[0] < there[0] - 0.01
    assert bridge.positions("left") == pytest.approx(at, abs=1e-6), "it rests"


def test_ros2_wrong_goals_are_rejected_and_said(bridge: Bridge) -> None:
    before = bridge.positions("left")
    names = joints("left")
    far = [before[0] + 1.0, *before[1:]]
    for wanted, cause in [
        (trajectory(["left.joint_1"], [(1.0, [0.0])]), "joint `left.joint_2` is missing"),
        (trajectory([*names[:6], "elbow"], [(1.0, before)]), "joint `elbow` is none of this arm"),
        (trajectory(names, [(1.0, before), (0.5, before)]), "not after the one before it"),
        (trajectory(names, [(0.05, far)]), "joint 0"),
        (trajectory(names, [(5.0, [9.0, *before[1:]])]), "joint 0"),
        (trajectory(names, [(1.0, [float("nan"), *before[1:]])]), "is not a number"),
        (trajectory(names, []), "no points"),
    ]:
        accepted, _ = bridge.client.goal("left", wanted)
        assert not accepted, cause
        assert cause in bridge.complaints(), bridge.complaints()
    # Bytes that are no goal have the same answer, and disturb nothing.
    for garbage in [b"", b"\x00\x01\x00\x00", b"\x00\x01\x00\x00" + b"\xff" * 400]:
        answer = bridge.client.call("left/follow_joint_trajectory/_action/send_goal", SEND_GOAL, garbage)
        assert not decode(answer, "control_msgs/msg/Accepted").accepted
    assert bridge.positions("left") == pytest.approx(before, abs=1e-6), "nothing moved"
    unknown = bridge.client.result("left", uuid.uuid4().bytes)
    assert unknown.status == 0 and "no such goal" in unknown.error_string


def test_ros2_one_goal_moves_both_arms(bridge: Bridge) -> None:
    move(bridge, "left", BENT)
    move(bridge, "right", BENT)
    there = [q + 0.1 for q in BENT]
    names = joints("right") + joints("left")
    accepted, goal_id = bridge.client.goal("arms", trajectory(names, [(1.0, there + BENT), (2.0, there + there)]))
    assert accepted, bridge.complaints()
    result = bridge.client.result("arms", goal_id)
    assert (result.status, result.error_code) == (SUCCEEDED, 0), result.error_string
    assert bridge.positions("left") == pytest.approx(there, abs=0.011)
    assert bridge.positions("right") == pytest.approx(there, abs=0.011)


def test_ros2_trajectory_of_topic_is_followed(bridge: Bridge) -> None:
    move(bridge, "right", BENT)
    there = [q - 0.1 for q in BENT]
    key = f"{DOMAIN}/right/joint_trajectory/{TRAJECTORY}"
    wanted = trajectory(joints("right"), [(1.0, there)])
    bridge.client.session.put(key, encode(wanted), attachment=bridge.client.attachment())
    for _ in range(50):
        if bridge.positions("right") == pytest.approx(there, abs=0.011):
            return
    raise AssertionError(bridge.complaints())


def test_ros2_diagnostics_name_each_device(bridge: Bridge) -> None:
    found, subscriber = bridge.client.subscribe(f"diagnostics/{DIAGNOSTICS}")
    for _ in range(100):
        if found:
            break
        time.sleep(0.1)
    subscriber.undeclare()
    array = decode(found[-1], "diagnostic_msgs/msg/DiagnosticArray")
    levels = {status.name: int(status.level) if not isinstance(status.level, bytes) else status.level[0] for status in array.status}
    assert levels["takt: left"] == 0 and levels["takt: right"] == 0, levels


def test_ros2_frames_have_flanges_bases_and_cell(bridge: Bridge) -> None:
    frames = bridge.frames(f"tf/{TF}", 100)
    with takt.connect(bridge.lines) as cell:
        pose = cell.arm("left").pose()
    parent, flange = frames["left.flange"]
    assert parent == "left.base"
    assert list(flange[:3, 3]) == pytest.approx(list(pose.position), abs=1e-6)
    assert frames["right.flange"][0] == "right.base"
    assert frames["platform.base"][0] == "platform.odometry"
    fixed = placed([bridge.client.latched(f"tf_static/{TF}")])
    assert fixed.keys().isdisjoint(frames.keys())


def test_ros2_frames_of_description_are_those_of_its_joints(described: Bridge) -> None:
    frames = placed([described.client.latched(f"tf_static/{TF}")]) | described.frames(f"tf/{TF}", 50)
    positions: dict[str, float] = {}
    for state in described.states(0.5):
        positions |= dict(zip(state.name, state.position, strict=True))
    # The same chain, multiplied here.
    wanted = numpy.eye(4)
    for joint in ElementTree.parse(PANDA).getroot().iter("joint"):
        origin = joint.find("origin")
        assert origin is not None
        roll, pitch, yaw = (float(angle) for angle in origin.get("rpy", "0 0 0").split())
        step = turned(2, yaw) @ turned(1, pitch) @ turned(0, roll)
        step[:3, 3] = [float(part) for part in origin.get("xyz", "0 0 0").split()]
        name = joint.get("name", "")
        wanted = wanted @ step @ turned(2, positions.get(name, 0.0))
    assert within(frames, "tool0", "panda_link0") == pytest.approx(wanted, abs=1e-6)
    assert within(frames, "right.flange", "right.base") == pytest.approx(wanted, abs=1e-6)
    assert list(within(frames, "panda_link0", "world")[:3, 3]) == pytest.approx([0.5, -0.8, 0.1])
    assert frames["left.flange"][0] == "left.base"
    text = decode(described.client.latched(f"robot_description/{STRING}"), "std_msgs/msg/String")
    assert text.data == PANDA.read_text()


def turned(axis: int, angle: float) -> Any:
    """A turn about a coordinate axis."""
    matrix = numpy.eye(4)
    first, second = [(1, 2), (2, 0), (0, 1)][axis]
    matrix[first, first] = matrix[second, second] = numpy.cos(angle)
    matrix[second, first] = numpy.sin(angle)
    matrix[first, second] = -matrix[second, first]
    return matrix


def test_ros2_wrench_comes_from_flange_of_arm_with_sensor(described: Bridge) -> None:
    found, subscriber = described.client.subscribe(f"left/wrench/{WRENCH}")
    until = time.monotonic() + 30.0
    while len(found) < 50 and time.monotonic() < until:
        time.sleep(0.05)
    subscriber.undeclare()
    assert len(found) >= 50, described.complaints()
    for message in (decode(data, "geometry_msgs/msg/WrenchStamped") for data in found):
        assert message.header.frame_id == "left.flange"
        force = message.wrench.force
        assert all(abs(part) < 1000.0 for part in (force.x, force.y, force.z)), force
    assert "force" not in described.complaints()


def identifier() -> tuple[bytes, Any]:
    """An identifier of a goal, as bytes and as message."""
    goal_id = uuid.uuid4().bytes
    return goal_id, make("unique_identifier_msgs/msg/UUID", numpy.frombuffer(goal_id, dtype=numpy.uint8))


def test_ros2_gripper_moves_and_grips(bridge: Bridge) -> None:
    def perform(position: float, effort: float) -> Any:
        goal_id, message = identifier()
        request = encode(make("control_msgs/msg/Grip", message, position, effort))
        answer = bridge.client.call("gripper/gripper_cmd/_action/send_goal", GRIP_GOAL, request)
        assert decode(answer, "control_msgs/msg/Accepted").accepted, bridge.complaints()
        answer = bridge.client.call("gripper/gripper_cmd/_action/get_result", GRIP_RESULT, b"\x00\x01\x00\x00" + goal_id)
        return decode(answer, "control_msgs/msg/Gripped")

    with takt.connect(bridge.lines) as cell:
        cell.gripper("gripper").open().run()
    moved = perform(0.09, 0.0)
    assert (moved.status, moved.reached_goal, moved.stalled) == (SUCCEEDED, True, False)
    assert moved.position == pytest.approx(0.09, abs=0.002)
    gripped = perform(0.05, 20.0)
    assert (gripped.status, gripped.reached_goal, gripped.stalled) == (SUCCEEDED, False, True)
    assert gripped.position == pytest.approx(0.05, abs=0.002)
    goal_id, message = identifier()
    command = make("sensor_msgs/msg/JointState", make("std_msgs/msg/Header", span("Time", 0.0), ""), ["gripper"], numbers([0.08]), numbers([]), numbers([]))
    request = encode(make("control_msgs/msg/GripParallel", message, command))
    answer = bridge.client.call("gripper/parallel_gripper_cmd/_action/send_goal", PARALLEL_GOAL, request)
    assert decode(answer, "control_msgs/msg/Accepted").accepted, bridge.complaints()
    answer = bridge.client.call("gripper/parallel_gripper_cmd/_action/get_result", PARALLEL_RESULT, b"\x00\x01\x00\x00" + goal_id)
    result = decode(answer, "control_msgs/msg/GrippedParallel")
    assert (result.status, result.reached_goal) == (SUCCEEDED, True)
    assert list(result.state.name) == ["gripper"]
    assert result.state.position[0] == pytest.approx(0.08, abs=0.002)


def test_ros2_outputs_are_set_by_services(bridge: Bridge) -> None:
    with takt.connect(bridge.lines) as cell:
        plant = cell.io("plant")
        for wanted in (True, False):
            request = encode(make("std_srvs/msg/Switch", wanted))
            answer = decode(bridge.client.call("plant/output_1", SET_BOOL, request), "std_srvs/msg/Switched")
            assert (answer.success, answer.message) == (True, ""), bridge.complaints()
            assert plant.state().digital_outputs[1] == wanted
    answer = decode(bridge.client.call("plant/output_1", SET_BOOL, b"\x00\x01\x00\x00"), "std_srvs/msg/Switched")
    assert not answer.success and "malformed" in answer.message
