"""A cell of a fleet with `eclipse-zenoh`, the zenoh of Python: it subscribes, queries, sees liveliness and gets no command through without
the right."""

from __future__ import annotations

import json
import queue
import subprocess
import time
from collections.abc import Iterator
from typing import Any

import pytest
from conftest import free_endpoint, start_member

zenoh = pytest.importorskip("zenoh")

WITHIN = 60.0
"""Seconds that nothing takes on a busy host."""


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Any, subprocess.Popen[bytes]]]:
    """A session of the foreign peer at cell-a, which routes to cell-b, and the process of cell-b."""
    folder = tmp_path_factory.mktemp("fleet")
    endpoint = free_endpoint()
    allow = "allow = [{ rights = ['read', 'command'] }]"
    router = start_member(folder / "a", f"cell = 'cell-a'\nmode = 'router'\nlisten = ['{endpoint}']\n{allow}")
    other = start_member(folder / "b", f"cell = 'cell-b'\nconnect = ['{endpoint}']")
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([endpoint]))
    config.insert_json5("scouting/multicast/enabled", "false")
    until = time.monotonic() + WITHIN
    while True:
        try:
            session = zenoh.open(config)
            break
        except zenoh.ZError:
            assert time.monotonic() < until, (folder / "a" / "log").read_text()
            time.sleep(0.1)
    while alive(session) != {"takt/cell-a/alive", "takt/cell-b/alive"}:
        assert time.monotonic() < until, (folder / "b" / "log").read_text()
        time.sleep(0.1)
    yield session, other
    session.close()
    for process in (router, other):
        process.kill()
        process.wait()


def alive(session: Any) -> set[str]:
    """Keys of the tokens of cells."""
    replies = session.liveliness().get("takt/*/alive", timeout=5.0)
    return {str(reply.ok.key_expr) for reply in replies if reply.ok is not None}


def ask(session: Any, key: str, payload: str = "", timeout: float = WITHIN) -> list[tuple[str, Any]]:
    """Keys and values of all answers; refusals have no key."""
    answers: list[tuple[str, Any]] = []
    for reply in session.get(key, payload=payload, timeout=timeout):
        if reply.ok is not None:
            answers.append((str(reply.ok.key_expr), json.loads(reply.ok.payload.to_string())))
        elif reply.err.payload.to_string() != "Timeout":
            answers.append(("", reply.err.payload.to_string()))
    return answers


def test_zenoh_peer_reads_resources_of_all_cells(fleet: tuple[Any, Any]) -> None:
    session, _ = fleet
    found = dict(ask(session, "takt/*/info", timeout=5.0))
    assert found.keys() == {"takt/cell-a/info", "takt/cell-b/info"}
    assert found["takt/cell-a/info"]["boot"] != found["takt/cell-b/info"]["boot"]
    devices = dict(ask(session, "takt/*/resource/devices", timeout=5.0))
    for value in devices.values():
        assert "left" in [device["name"] for device in value["device"]]
    assert len(devices) == 2


def test_zenoh_peer_gets_newest_telemetry_and_each_change(fleet: tuple[Any, Any]) -> None:
    session, _ = fleet
    values: queue.Queue[tuple[str, Any]] = queue.Queue()

    def take(sample: Any) -> None:
        values.put((str(sample.key_expr), json.loads(sample.payload.to_string())))

    history = zenoh.ext.HistoryConfig(detect_late_publishers=True)
    subscriber = zenoh.ext.declare_advanced_subscriber(session, "takt/cell-b/**", take, history=history)
    seen: dict[str, Any] = {}
    wanted = {"takt/cell-b/device/left/state", "takt/cell-b/clock", "takt/cell-b/log", "takt/cell-b/findings"}
    until = time.monotonic() + WITHIN
    while not wanted <= seen.keys():
        key, value = values.get(timeout=max(0.0, until - time.monotonic()))
        seen[key] = value
    assert seen["takt/cell-b/device/left/state"]["state"] == "op"
    assert seen["takt/cell-b/clock"]["state"] in {"free", "locked", "holdover"}
    subscriber.undeclare()


def test_zenoh_peer_commands_by_session_and_not_by_wildcard(fleet: tuple[Any, Any]) -> None:
    session, _ = fleet
    key = "takt/cell-a/cmd/session"
    [(_, hello)] = ask(session, key, json.dumps({"op": "hello"}))
    opening = {"op": "open", "boot": hello["boot"], "open": "0" * 31 + "1", "client": "python"}
    [(_, granted)] = ask(session, key, json.dumps(opening))
    assert granted["result"] == "granted"
    command = {
        "boot": granted["boot"],
        "session": granted["session"],
        "seq": 1,
        "nonce": granted["nonce"],
        "not_after_ns": granted["expires_ns"],
        "line": "a=din()",
    }
    answers = ask(session, "takt/cell-a/cmd/directio", json.dumps(command))
    # The nonce is short-lived: a host that stalls gets a refusal that names that, and nothing else.
    [(_, done)] = answers
    assert done["result"] == "done" or done["reason"]["code"] in {"late", "no_session"}, done
    wild = ask(session, "takt/*/cmd/directio", json.dumps(command), timeout=2.0)
    assert all(key == "" for key, _ in wild), wild


def test_zenoh_peer_without_right_gets_no_command_through(fleet: tuple[Any, Any]) -> None:
    session, _ = fleet
    assert ask(session, "takt/cell-b/cmd/session", json.dumps({"op": "hello"}), timeout=2.0) == []


def test_zenoh_peer_sees_killed_cell_by_its_token(fleet: tuple[Any, Any]) -> None:
    session, other = fleet
    ends: queue.Queue[str] = queue.Queue()

    def take(sample: Any) -> None:
        if sample.kind == zenoh.SampleKind.DELETE:
            ends.put(str(sample.key_expr))

    subscriber = session.liveliness().declare_subscriber("takt/*/alive", take, history=True)
    other.kill()
    assert ends.get(timeout=WITHIN) == "takt/cell-b/alive"
    assert alive(session) == {"takt/cell-a/alive"}
    subscriber.undeclare()
