"""The Foxglove WebSocket with the packages that Foxglove publishes for viewers (npm): their client, their parser of definitions,
their decoder. What they decode is compared with the resources of the controller."""

from __future__ import annotations

import json
import pathlib
import subprocess
import time
import urllib.parse
import urllib.request
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import pytest
from conftest import program

SWING = """{
    clock=Core::Clock(), part=Core::Interval(inValue=clock.outValue, Max='1'),
    smooth=Core::DoubleBezier(inValue=part.outValue, To='0.5'),
    joint=RobotArm::JointPosition(inPosition=smooth.outValue, Robot='left', Axis='6'),
    t=Core::DoubleNetcommOut(inValue=clock.outValue, Key='t'),
    end=Core::DoubleGreater(inFirst=clock.outValue, Second='1'), outTerminate=end.outValue }"""
"""Moves the last joint of the left arm to 0.5 rad within a second."""


@pytest.fixture(scope="module")
def peer(viewer_packages: pathlib.Path) -> pathlib.Path:
    """The client."""
    return viewer_packages / "peer.mjs"


@pytest.fixture(scope="module")
def addresses() -> Iterator[SimpleNamespace]:
    """A controller of its own: the addresses of HTTP and of the Foxglove WebSocket."""
    process = subprocess.Popen([program("controller")], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert process.stdin is not None and process.stdout is not None
    _, http, foxglove = (process.stdout.readline().strip() for _ in range(3))
    yield SimpleNamespace(http=f"http://{http}", foxglove=f"ws://{foxglove}")
    process.stdin.close()
    assert process.wait(timeout=60.0) == 0


def watch(peer: pathlib.Path, addresses: SimpleNamespace, subprotocol: str, *call: str) -> subprocess.Popen[str]:
    """The client for 2,500 messages of the topic with the most."""
    command = ["node", str(peer), addresses.foxglove, subprotocol, "2500", *call]
    return subprocess.Popen(command, stdout=subprocess.PIPE, text=True)


def seen(process: subprocess.Popen[str]) -> dict[str, Any]:
    """What the client saw."""
    text, _ = process.communicate(timeout=120.0)
    found: dict[str, Any] = json.loads(text)
    assert found["failures"] == [], found["failures"]
    return found


def http(addresses: SimpleNamespace, path: str) -> Any:
    """A resource of the controller."""
    with urllib.request.urlopen(f"{addresses.http}{path}?format=json", timeout=10.0) as response:
        return json.load(response)


@pytest.mark.parametrize("subprotocol", ["foxglove.websocket.v1", "foxglove.sdk.v1"])
def test_foxglove_peer_decodes_every_topic(peer: pathlib.Path, addresses: SimpleNamespace, subprotocol: str) -> None:
    body = urllib.parse.urlencode({"dionet": SWING}).encode()
    with urllib.request.urlopen(f"{addresses.http}/nets/", body, timeout=10.0) as response:
        net = str(response.url.rstrip("/").rsplit("/", 1)[-1])
    found = seen(watch(peer, addresses, subprotocol, "/takt/net/start", json.dumps({"net": net})))
    assert found["subprotocol"] == subprotocol
    assert json.loads(found["response"]["text"]) == {"ok": True}
    assert {"parameters", "services"} <= set(found["info"]["capabilities"])
    values = {it["name"]: it["value"] for it in found["parameters"]}
    assert values["takt.device.left.joints"] == 7
    topics = found["topics"]
    assert all((it["encoding"], it["schemaEncoding"]) == ("cdr", "ros2msg") for it in topics.values())
    silent = [topic for topic, it in topics.items() if it["count"] == 0]
    assert {"/left/joint_states", "/left/set_points", "/takt/thread", "/tf", f"/takt/nets/{net}", "/takt/net_events"} <= (
        set(topics) - set(silent)
    ), silent
    # Cycles are counted without a gap, but for those that the host missed.
    cycles = topics["/takt/thread"]
    first, last = (cycles[key]["value"]["cycle"] for key in ("first", "last"))
    assert last - first >= cycles["count"] - 1
    states = topics["/left/joint_states"]["last"]["value"]
    assert states["name"] == [f"left.joint_{number}" for number in range(1, 8)]
    for _ in range(100):
        if http(addresses, f"/nets/{net}/")["status"] == "TERMINATED":
            break
        time.sleep(0.1)
    # At rest, every decoded joint is that of the controller.
    states = seen(watch(peer, addresses, subprotocol))["topics"]["/left/joint_states"]["last"]["value"]
    joints = sorted(http(addresses, "/devices/left/robotarm/")["joint"], key=lambda joint: int(joint["axis"]))
    assert states["position"] == pytest.approx([float(joint["measured"]) for joint in joints], abs=1e-9)
    assert states["position"][6] == pytest.approx(0.5, abs=1e-3)
