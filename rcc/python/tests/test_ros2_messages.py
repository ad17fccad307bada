"""Bytes and type hashes of ROS 2 messages by rosbags, which the tests of takt-fleet compare with those of Takt."""

from __future__ import annotations

import pathlib
from typing import Any

import numpy
from rosbags.typesys import Stores, get_typestore

GOLDEN = pathlib.Path(__file__).parents[2] / "fleet/tests/ros2/rosbags.txt"
STORE = get_typestore(Stores.ROS2_JAZZY)


def make(name: str, *values: Any) -> Any:
    """A message of that type."""
    return STORE.types[name](*values)


def header(frame: str) -> Any:
    """A header with a stamp that needs all of its bits."""
    return make("std_msgs/msg/Header", make("builtin_interfaces/msg/Time", 1_700_000_000, 123_456_789), frame)


def numbers(*values: float) -> Any:
    """A sequence of doubles."""
    return numpy.array(values, dtype=numpy.float64)


def messages() -> list[Any]:
    """One message of each type; the same values stand in the test of takt-fleet."""
    vector = "geometry_msgs/msg/Vector3"
    wrench = make("geometry_msgs/msg/Wrench", make(vector, 1.0, 2.0, 3.0), make(vector, 4.0, 5.0, 6.0))
    place = make("geometry_msgs/msg/Transform", make(vector, 0.1, 0.2, 0.3), make("geometry_msgs/msg/Quaternion", 0.0, 0.6, 0.0, 0.8))
    status = make(
        "diagnostic_msgs/msg/DiagnosticStatus", 2, "left", "offline", "KUKA LWR", [make("diagnostic_msgs/msg/KeyValue", "lost", "7")]
    )
    goal = make("action_msgs/msg/GoalInfo", make("unique_identifier_msgs/msg/UUID", numpy.full(16, 9, dtype=numpy.uint8)), header("").stamp)
    return [
        make("std_msgs/msg/String", "<robot/>"),
        make("sensor_msgs/msg/JointState", header(""), ["a1", "joint_2"], numbers(0.5, -1.25), numbers(0.0, 1e-3), numbers(10.0, 20.0)),
        make("geometry_msgs/msg/WrenchStamped", header("left/flange"), wrench),
        make("tf2_msgs/msg/TFMessage", [make("geometry_msgs/msg/TransformStamped", header("world"), "left/base", place)]),
        make("diagnostic_msgs/msg/DiagnosticArray", header(""), [status]),
        make("action_msgs/msg/GoalStatusArray", [make("action_msgs/msg/GoalStatus", goal, 4)]),
    ]


def line(message: Any) -> str:
    """Type, hash and bytes."""
    name = message.__msgtype__
    return f"{name} {STORE.hash_rihs01(name)} {bytes(STORE.serialize_cdr(message, name)).hex()}"


def test_ros2_golden_bytes_are_those_of_rosbags() -> None:
    assert GOLDEN.read_text().splitlines() == [line(message) for message in messages()]
