"""A recording, read by software of others: every message with the readers of MCAP, of rosbag2 and of Foxglove."""

from __future__ import annotations

import json
import math
import pathlib
import subprocess
from collections import Counter
from typing import Any

import pytest
from conftest import BENT, program
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

import takt


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> pathlib.Path:
    """A recording of a motion of the left arm and of an output that is set and reset."""
    path = tmp_path_factory.mktemp("recording") / "run.mcap"
    process = subprocess.Popen([program("controller"), str(path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert process.stdin is not None and process.stdout is not None
    with takt.connect(process.stdout.readline().strip()) as cell:
        assert cell.arm("left").ptp(BENT).run() == takt.Outcome.Completed
        for value in (True, False):
            assert cell.io("plant").set(3, value).run() == takt.Outcome.Completed
    process.stdin.close()
    assert process.wait(timeout=60.0) == 0
    return path


@pytest.fixture(scope="module")
def messages(recording: pathlib.Path) -> dict[str, list[Any]]:
    """All messages by topic, as the MCAP reader for ROS 2 gives them."""
    found: dict[str, list[Any]] = {}
    with recording.open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        assert reader.get_header().profile == "ros2"
        for _, channel, message, decoded in reader.iter_decoded_messages():
            found.setdefault(channel.topic, []).append((message.log_time, decoded))
    return found


def test_joint_states_end_at_goal(messages: dict[str, list[Any]]) -> None:
    states = [state for _, state in messages["/left/joint_states"]]
    assert list(states[-1].name) == [f"left.joint_{number}" for number in range(1, 8)]
    assert list(states[-1].position) == pytest.approx(BENT, abs=1e-3)
    # What is not known yet is not a number.
    assert any(abs(state.velocity[3]) > 0.1 for state in states)
    commanded = [command for _, command in messages["/left/set_points"]]
    assert list(commanded[-1].position) == pytest.approx(BENT, abs=1e-6)
    assert "/right/set_points" not in messages, "only one arm was commanded"


def test_reader_of_foxglove_decodes_all_and_seeks(
    recording: pathlib.Path, messages: dict[str, list[Any]], viewer_packages: pathlib.Path
) -> None:
    topic = "/left/joint_states"
    command = ["node", str(viewer_packages / "recording.mjs"), str(recording), topic]
    read = json.loads(subprocess.run(command, capture_output=True, check=True, timeout=120.0).stdout)
    assert (read["profile"], read["isSorted"]) == ("ros2", True)
    counts = {name: len(found) for name, found in messages.items()}
    assert counts == read["counts"] == {name: it["count"] for name, it in read["topics"].items()}
    assert read["topics"][topic]["value"]["position"] == list(messages[topic][-1][1].position)
    # By the indexes alone.
    assert read["half"] == sum(time >= int(read["startTime"]) for time, _ in messages[topic]) > 0


def test_time_of_messages_is_time_in_them(messages: dict[str, list[Any]]) -> None:
    for time, state in messages["/left/joint_states"]:
        assert time == state.header.stamp.sec * 10**9 + state.header.stamp.nanosec
    times = [time for time, _ in messages["/left/joint_states"]]
    assert times == sorted(times)


def test_frames_connect_pen_and_world(messages: dict[str, list[Any]]) -> None:
    frames = [*messages["/tf_static"], *messages["/tf"]]
    parents = {frame.child_frame_id: frame.header.frame_id for _, list_ in frames for frame in list_.transforms}
    chain = ["left.pen"]
    while chain[-1] in parents:
        chain.append(parents[chain[-1]])
    assert chain == ["left.pen", "left.flange", "left.base", "world"]
    for _, list_ in frames:
        for frame in list_.transforms:
            turn = frame.transform.rotation
            assert math.hypot(turn.x, turn.y, turn.z, turn.w) == pytest.approx(1.0)


def test_cycles_nets_devices_and_log_are_shown(messages: dict[str, list[Any]]) -> None:
    cycles = [cycle for _, cycle in messages["/takt/thread"]]
    assert len(cycles) == len(messages["/takt/cycles"]) > 500
    for before, after in zip(cycles, cycles[1:]):
        assert after.cycle == before.cycle + 1 + after.missed
    assert max(cycle.nets for cycle in cycles) == 1
    events = [(event.event, event.cause) for _, event in messages["/takt/net_events"]]
    assert [event for event, _ in events][0] == "started" and events[-1] == ("ended", "terminated")
    net, *others = dict.fromkeys(event.net for _, event in messages["/takt/net_events"])
    assert len(others) == 2, "one for each value of the output"
    progress = [value.progress for _, value in messages[f"/takt/nets/{net}"]]
    assert progress == sorted(progress) and progress[-1] == pytest.approx(1.0)
    shown = Counter(status.name for _, array in messages["/diagnostics"] for status in array.status)
    assert {"left", "right", "platform", "gripper", "plant"} <= set(shown)
    levels = {status.level for _, array in messages["/diagnostics"] for status in array.status}
    assert levels <= {b"\x00", b"\x01", b"\x02", 0, 1, 2}
    assert "the recording has begun" in [line.msg for _, line in messages["/rosout"]]


def test_signals_are_steps_between_neighbouring_cycles(messages: dict[str, list[Any]]) -> None:
    times = [time for time, _ in messages["/takt/thread"]]
    before = dict(zip(times[1:], times))
    signals = messages["/plant/signals"]
    for (last, old), (time, new) in zip(signals, signals[1:]):
        values = [str([*it.digital_inputs, *it.digital_outputs, *it.analogue_inputs, *it.analogue_outputs]) for it in (old, new)]
        assert values[0] == values[1] or last == before[time]
        assert time - last <= 1.1e9
    outputs = [signal.digital_outputs[3] for _, signal in signals]
    steps = [(old, new) for old, new in zip(outputs, outputs[1:]) if old != new and not math.isnan(new - old)]
    assert steps == [(0.0, 1.0), (1.0, 0.0)]


def test_frames_come_at_most_a_hundred_times_a_second(messages: dict[str, list[Any]]) -> None:
    times = [time for time, list_ in messages["/tf"] if list_.transforms[0].child_frame_id == "left.flange"]
    assert 50 < len(times) <= (times[-1] - times[0]) / 1e7 + 2


def test_machine_states_are_shown(messages: dict[str, list[Any]]) -> None:
    events = [event for _, event in messages["/takt/machine_events"]]
    assert {event.machine for event in events} == {"Blink"}
    assert (events[0].event, events[0].status) == ("added", "inactive")
    assert (events[-1].event, events[-1].state, events[-1].status) == ("changed", "Off", "finished")
    assert all(one.cycle <= other.cycle for one, other in zip(events, events[1:]))


def test_rosbag_reader_reads_every_message(recording: pathlib.Path, messages: dict[str, list[Any]]) -> None:
    # It takes the definitions of all messages from the file.
    with AnyReader([recording], default_typestore=get_typestore(Stores.EMPTY)) as reader:
        counts: Counter[str] = Counter()
        for connection, _, data in reader.messages():
            reader.deserialize(data, connection.msgtype)
            counts[connection.topic] += 1
    assert counts == {topic: len(list_) for topic, list_ in messages.items()}
