"""Cells of a fleet by their names: a program commands two, and what it moves ends with it."""

from __future__ import annotations

import json
import pathlib
import subprocess
import sys
import time
from collections.abc import Iterator

import pytest
from conftest import free_endpoint, start_member, tool

import takt

WITHIN = 60.0
"""Seconds that nothing takes on a busy host."""

GOAL = [0, 0.5, 0, -1.0, 0, 0.5, 0]


@pytest.fixture(scope="module")
def endpoint(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """Where programs reach cell-a, which routes to cell-b."""
    folder = tmp_path_factory.mktemp("fleet")
    endpoint = free_endpoint()
    allow = "allow = [{ rights = ['read', 'command'] }]"
    members = [
        start_member(folder / "a", f"cell = 'cell-a'\nmode = 'router'\nlisten = ['{endpoint}']\n{allow}"),
        start_member(folder / "b", f"cell = 'cell-b'\nconnect = ['{endpoint}']\n{allow}"),
    ]
    yield endpoint
    for member in members:
        member.kill()
        member.wait()


def connected(endpoint: str) -> takt.Fleet:
    """The fleet, once both cells have joined."""
    until = time.monotonic() + WITHIN
    while True:
        try:
            line = takt.fleet(endpoint)
            if line.cells() == ["cell-a", "cell-b"]:
                return line
        except takt.Connection:
            pass
        assert time.monotonic() < until
        time.sleep(0.1)


def nets(endpoint: str) -> str:
    """The nets of cell-b, as another program reads them."""
    call = [tool(), "fleet", "call", "cell-b", "get", "nets", "--connect", endpoint, "--timeout", "20s"]
    return subprocess.run(call, capture_output=True, check=True, text=True).stdout


def test_program_commands_cells_by_their_names(endpoint: str) -> None:
    line = connected(endpoint)
    with line["cell-a"] as a, line["cell-b"] as b:
        [left, other] = [cell.arm("left") for cell in (a, b)]
        first = other.ptp([0.2, *GOAL[1:]], speed=0.5).begin()
        second = other.ptp([0.4, *GOAL[1:]], speed=0.5).queue()
        assert left.ptp(GOAL, speed=0.5).run() == takt.Outcome.Completed
        first.wait()
        assert second.wait() == takt.Outcome.Completed
        assert b.value(other.joint(0)) == pytest.approx(0.4, abs=1e-3)


def test_unknown_cell_and_endpoint_are_named(endpoint: str) -> None:
    line = connected(endpoint)
    with pytest.raises(takt.NoDevice, match=r"no cell `cell-c`(.|\n)*cell-a, cell-b"):
        line["cell-c"]
    with pytest.raises(takt.Invalid, match="no name of a cell"):
        line["*"]
    with pytest.raises(takt.Connection, match="no cell or router answers at"):
        takt.fleet(free_endpoint())
    for wrong in ("udp/127.0.0.1:1", "tls/line2.local:7447"):
        with pytest.raises(takt.Invalid, match="hint: "):
            takt.fleet(wrong)
    with pytest.raises(takt.Invalid, match="together"):
        takt.fleet(endpoint, ca="ca.pem")


def test_motion_ends_with_killed_program(endpoint: str, tmp_path: pathlib.Path) -> None:
    connected(endpoint)
    script = tmp_path / "sweep.py"
    script.write_text(
        "import sys, takt\n"
        "cell = takt.fleet(sys.argv[1])['cell-b']\n"
        f"handle = cell.arm('left').ptp([-1.5, *{GOAL[1:]}], speed=0.01).begin()\n"
        "print('moves', flush=True)\n"
        "handle.wait()\n"
    )
    with subprocess.Popen([sys.executable, str(script), endpoint], stdout=subprocess.PIPE, text=True) as program:
        assert program.stdout is not None
        assert program.stdout.readline() == "moves\n"
        assert "RUNNING" in nets(endpoint)
        program.kill()
    until = time.monotonic() + WITHIN
    # Without a net, the list has no such key.
    while any(net["status"] == "RUNNING" for net in json.loads(nets(endpoint)).get("net", [])):
        assert time.monotonic() < until
        time.sleep(0.1)
