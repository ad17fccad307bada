"""The Foxglove WebSocket, with software of others: `websockets` for the connection, the ROS 2 decoder of MCAP for the messages."""

from __future__ import annotations

import asyncio
import json
import math
import socket
import struct
import subprocess
import urllib.parse
import urllib.request
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import pytest
from conftest import program
from mcap.records import Schema
from mcap_ros2.decoder import DecoderFactory
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import InvalidStatus
from websockets.typing import Origin, Subprotocol

V1 = Subprotocol("foxglove.sdk.v1")

SWING = """{
    clock=Core::Clock(), part=Core::Interval(inValue=clock.outValue, Max='1'),
    smooth=Core::DoubleBezier(inValue=part.outValue, To='0.5'),
    joint=RobotArm::JointPosition(inPosition=smooth.outValue, Robot='left', Axis='6'),
    t=Core::DoubleNetcommOut(inValue=clock.outValue, Key='t'),
    end=Core::DoubleGreater(inFirst=clock.outValue, Second='1'), outTerminate=end.outValue }"""
"""Moves the last joint of the left arm from 0 to 0.5 rad within a second."""


@pytest.fixture(scope="module")
def addresses() -> Iterator[SimpleNamespace]:
    """A controller of its own: the addresses of HTTP and of the Foxglove WebSocket."""
    process = subprocess.Popen([program("controller")], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert process.stdin is not None and process.stdout is not None
    _, http, foxglove = (process.stdout.readline().strip() for _ in range(3))
    yield SimpleNamespace(http=f"http://{http}", foxglove=f"ws://{foxglove}")
    process.stdin.close()
    assert process.wait(timeout=60.0) == 0


class Client:
    """A client that keeps what the server announces."""

    def __init__(self, connection: ClientConnection) -> None:
        self.socket = connection
        self.channels: dict[str, dict[str, Any]] = {}
        self.services: dict[str, int] = {}
        self.topics: dict[int, str] = {}
        self.decoders: dict[str, Any] = {}
        self.calls = 0

    async def receive(self) -> dict[str, Any]:
        """The next message; one of a topic with the operation `message`."""
        data = await asyncio.wait_for(self.socket.recv(), 30.0)
        if isinstance(data, bytes):
            if data[0] == 3:
                _, call, length = struct.unpack_from("<III", data, 1)
                return {"op": "response", "call": call, "payload": json.loads(data[13 + length :])}
            assert data[0] == 1
            subscription, at = struct.unpack_from("<IQ", data, 1)
            topic = self.topics[subscription]
            return {"op": "message", "topic": topic, "time": at, "value": self.decoders[topic](data[13:])}
        message: dict[str, Any] = json.loads(data)
        for channel in message.get("channels", []):
            self.channels[channel["topic"]] = channel
        for service in message.get("services", []):
            self.services[service["name"]] = service["id"]
        return message

    async def text(self, op: str) -> dict[str, Any]:
        """The next message of an operation."""
        while True:
            message = await self.receive()
            if message["op"] == op:
                return message

    async def subscribe(self, *topics: str) -> None:
        """Subscribes topics, with the decoder of the schema that the server announced."""
        for topic in topics:
            while topic not in self.channels:
                await self.text("advertise")
            channel = self.channels[topic]
            assert (channel["encoding"], channel["schemaEncoding"]) == ("cdr", "ros2msg")
            schema = Schema(
                id=channel["id"], name=channel["schemaName"], encoding="ros2msg", data=channel["schema"].encode()
            )
            decoder = DecoderFactory().decoder_for("cdr", schema)
            assert decoder is not None
            subscription = 100 + channel["id"]
            self.topics[subscription], self.decoders[topic] = topic, decoder
            pairs = [{"id": subscription, "channelId": channel["id"]}]
            await self.socket.send(json.dumps({"op": "subscribe", "subscriptions": pairs}))

    async def call(self, service: str, request: dict[str, Any]) -> dict[str, Any]:
        """Calls a service."""
        while service not in self.services:
            await self.text("advertiseServices")
        self.calls += 1
        head = struct.pack("<BIII", 2, self.services[service], self.calls, 4)
        await self.socket.send(head + b"json" + json.dumps(request).encode())
        while True:
            message = await self.receive()
            if message["op"] in ("response", "serviceCallFailure"):
                return message


def client(addresses: SimpleNamespace) -> connect:
    """A connection that is to be entered."""
    return connect(addresses.foxglove, subprotocols=[V1], max_size=None, close_timeout=0.2)


def http(addresses: SimpleNamespace, path: str) -> Any:
    """A resource of the controller."""
    with urllib.request.urlopen(f"{addresses.http}{path}?format=json", timeout=10.0) as response:
        return json.load(response)


def load(addresses: SimpleNamespace, text: str) -> str:
    """Loads a net; returns its name."""
    body = urllib.parse.urlencode({"dionet": text}).encode()
    with urllib.request.urlopen(f"{addresses.http}/nets/", body, timeout=10.0) as response:
        return str(response.url.rstrip("/").rsplit("/", 1)[-1])


def test_foxglove_samples_have_no_gap(addresses: SimpleNamespace) -> None:
    async def run() -> None:
        async with client(addresses) as connection:
            assert connection.subprotocol == V1
            viewer = Client(connection)
            info = await viewer.text("serverInfo")
            assert {"parameters", "services"} <= set(info["capabilities"])
            await viewer.subscribe("/takt/thread", "/left/joint_states")
            cycles: list[int] = []
            states: list[dict[str, Any]] = []
            missed = 0
            while len(cycles) < 3000:
                message = await viewer.receive()
                if message["op"] != "message":
                    continue
                if message["topic"] == "/takt/thread":
                    missed += message["value"].missed if cycles else 0
                    cycles.append(message["value"].cycle)
                else:
                    stamp = message["value"].header.stamp
                    assert message["time"] == stamp.sec * 10**9 + stamp.nanosec
                    states.append(message)
            # Cycles that this host missed are said to be.
            assert cycles[-1] - cycles[0] == 2999 + missed, f"{missed} missed"
            assert len(states) >= 2900
            times = [state["time"] for state in states]
            assert times == sorted(set(times))
            assert list(states[0]["value"].name) == [f"left.joint_{number}" for number in range(1, 8)]

    asyncio.run(run())


def test_foxglove_service_moves_arm_to_values_of_resource(addresses: SimpleNamespace) -> None:
    """A net that a service starts moves the arm; two clients and HTTP see where it comes to rest."""
    net = load(addresses, SWING)

    async def run() -> None:
        async with client(addresses) as connection:
            viewer = Client(connection)
            await viewer.subscribe("/left/set_points", "/diagnostics", "/tf", f"/takt/nets/{net}")
            response = await viewer.call("/takt/net/start", {"net": net})
            assert response["payload"] == {"ok": True}
            await viewer.subscribe("/takt/net_events")
            seen: dict[str, list[Any]] = {}
            while "ended" not in {event.event for event in seen.get("/takt/net_events", [])}:
                message = await viewer.receive()
                if message["op"] == "message":
                    seen.setdefault(message["topic"], []).append(message["value"])
            assert seen["/takt/net_events"][-1].cause == "terminated"
            assert len(seen["/left/set_points"]) >= 900, "each cycle of a second"
            clock = [value.t for value in seen[f"/takt/nets/{net}"] if not math.isnan(value.t)]
            assert clock == sorted(clock) and clock[-1] == pytest.approx(1.0, abs=0.01)
            assert seen["/diagnostics"][0].status[0].message == "operational"
            frames = {(it.header.frame_id, it.child_frame_id) for value in seen["/tf"] for it in value.transforms}
            assert ("left.base", "left.flange") in frames, frames
        async with client(addresses) as first, client(addresses) as second:
            both = Client(first), Client(second)
            for each in both:
                await each.subscribe("/left/joint_states")
            shown = [await at_rest(each) for each in both]
        joints = http(addresses, "/devices/left/robotarm/")["joint"]
        wanted = [joint["measured"] for joint in sorted(joints, key=lambda joint: int(joint["axis"]))]
        assert wanted[6] == pytest.approx(0.5, abs=1e-3), "it moved"
        for positions in shown:
            assert positions == pytest.approx([float(value) for value in wanted], abs=1e-9)

    asyncio.run(run())


async def at_rest(viewer: Client) -> list[float]:
    """The joint positions of the left arm when they stay for 100 cycles."""
    last: list[float] = []
    same = 0
    while same < 100:
        message = await viewer.receive()
        if message.get("topic") == "/left/joint_states":
            positions = list(message["value"].position)
            same = same + 1 if positions == last else 0
            last = positions
    return last


def test_foxglove_parameters_are_read_only(addresses: SimpleNamespace) -> None:
    async def run() -> None:
        async with client(addresses) as connection:
            viewer = Client(connection)
            failure = await viewer.call("/takt/net/start", {"net": "rpinet99"})
            assert failure["op"] == "serviceCallFailure" and "rpinet99" in failure["message"]
            await connection.send(json.dumps({"op": "getParameters", "parameterNames": [], "id": "1"}))
            message = await viewer.text("parameterValues")
            values = {it["name"]: it["value"] for it in message["parameters"]}
            assert message["id"] == "1"
            assert values["takt.period_s"] == 0.001
            assert values["takt.device.left.joints"] == 7
            assert values["takt.stopped"] is False
            change = {"op": "setParameters", "parameters": [{"name": "takt.period_s", "value": 1.0}]}
            await connection.send(json.dumps(change))
            assert "read-only" in (await viewer.text("status"))["message"]

    asyncio.run(run())


def test_foxglove_stop_service_stops(addresses: SimpleNamespace) -> None:
    async def run() -> None:
        async with client(addresses) as connection:
            viewer = Client(connection)
            response = await viewer.call("/takt/stop", {})
            assert response["payload"] == {"ok": True}
            await connection.send(json.dumps({"op": "getParameters", "parameterNames": ["takt.stopped"]}))
            values = await viewer.text("parameterValues")
            assert values["parameters"] == [{"name": "takt.stopped", "value": True}]

    asyncio.run(run())


def test_foxglove_bad_client_does_not_disturb(addresses: SimpleNamespace) -> None:
    async def run() -> None:
        for origin in ("https://evil.example", "null"):
            with pytest.raises(InvalidStatus) as refused:
                await connect(addresses.foxglove, subprotocols=[V1], origin=Origin(origin))
            assert refused.value.response.status_code == 403
        async with client(addresses) as bad, client(addresses) as good:
            viewer = Client(good)
            await viewer.subscribe("/takt/thread")
            for garbage in (b"\xff" * 1000, b"\x02abc", "{", '{"op":"subscribe","subscriptions":[{"id":1,"channelId":4e9}]}'):
                await bad.send(garbage)
            assert (await Client(bad).text("status"))["level"] == 2
            channel = viewer.channels["/takt/thread"]["id"]
            pairs = [{"id": number, "channelId": channel} for number in range(1000)]
            deaf = unread(addresses, json.dumps({"op": "subscribe", "subscriptions": pairs}).encode())
            last = None
            for _ in range(1500):
                message = await viewer.receive()
                if message["op"] == "message":
                    value = message["value"]
                    assert last is None or value.cycle == last + 1 + value.missed
                    last = value.cycle
            deaf.close()

    asyncio.run(run())


def unread(addresses: SimpleNamespace, message: bytes) -> socket.socket:
    """A connection that sends a message and reads nothing, not even in the background."""
    host, port = addresses.foxglove.removeprefix("ws://").split(":")
    deaf = socket.create_connection((host, int(port)), timeout=10.0)
    head = f"GET / HTTP/1.1\r\nHost: {host}\r\nConnection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\n"
    key = "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n"
    deaf.sendall(f"{head}{key}Sec-WebSocket-Protocol: {V1}\r\n\r\n".encode())
    assert deaf.recv(12) == b"HTTP/1.1 101"
    # Masked by zeros.
    deaf.sendall(struct.pack(">BBH4x", 0x81, 0x80 | 126, len(message)) + message)
    return deaf
