"""Recordings of `takt scope`, read by software of others: the readers of MCAP and of rosbag2."""

from __future__ import annotations

import json
import pathlib
import subprocess
from collections.abc import Iterator

import pytest
from conftest import program, tool
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

PROBES = ["left.joint.0.measured", "left.joint.6.following_error", "thread:nets.cycle"]


@pytest.fixture(scope="module")
def captured(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[pathlib.Path, dict[str, int]]]:
    """A recording of half a second of probes of a running controller, and the number of samples of each."""
    path = tmp_path_factory.mktemp("scope") / "scope.mcap"
    process = subprocess.Popen([program("controller")], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert process.stdin is not None and process.stdout is not None
    _, http, _ = (process.stdout.readline().strip() for _ in range(3))
    command = [tool(), "scope", "--connect", http, "--duration", "500ms", "--mcap", str(path), "--json", "--probe", *PROBES]
    report = json.loads(subprocess.run(command, check=True, capture_output=True, text=True, timeout=60.0).stdout)
    process.stdin.close()
    assert process.wait(timeout=60.0) == 0
    yield path, {probe["name"]: probe["samples"] for probe in report["probes"]}


def test_scope_recording_opens_with_mcap_readers(captured: tuple[pathlib.Path, dict[str, int]]) -> None:
    path, samples = captured
    assert set(samples) == set(PROBES)
    found: dict[str, list[float]] = {}
    times: dict[str, list[int]] = {}
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        for schema, channel, message, decoded in reader.iter_decoded_messages():
            assert schema is not None and schema.encoding == "ros2msg"
            for name in decoded.__slots__:
                if isinstance(value := getattr(decoded, name), float):
                    found.setdefault(f"{channel.topic}.{name}", []).append(value)
            times.setdefault(channel.topic, []).append(message.log_time)
    assert sum(len(values) for values in found.values()) == sum(samples.values()) > 1000
    assert all(list_ == sorted(list_) for list_ in times.values())
    cycles = next(values for name, values in found.items() if "cycle" in name)
    assert cycles == sorted(cycles) and cycles[-1] - cycles[0] > 300


def test_scope_recording_opens_with_rosbags(captured: tuple[pathlib.Path, dict[str, int]]) -> None:
    path, samples = captured
    with AnyReader([path], default_typestore=get_typestore(Stores.EMPTY)) as reader:
        counts = [0 for _ in reader.connections]
        for connection, _, data in reader.messages():
            assert reader.deserialize(data, connection.msgtype) is not None
            counts[connection.id % len(counts)] += 1
    assert sum(counts) >= max(samples.values())
