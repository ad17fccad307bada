"""A controller with two simulated arms for the suite, and one of its own for tests that break connections."""

from __future__ import annotations

import os
import pathlib
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Iterator

import pytest

import takt

BENT = [0.0, 0.5, 0.0, -1.2, 0.0, 0.8, 0.0]
"""Joint positions of an arm from which lines are possible, rad."""

ROOT = pathlib.Path(__file__).resolve().parents[3]


def program(name: str) -> str:
    """The path of a helper program in the target directory."""
    target = pathlib.Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target"))
    path = ROOT / target / "debug" / "examples" / name
    if not path.exists():
        pytest.fail(f"there is no {path}\nhint: cargo xtask test python builds it")
    return str(path)


def tool() -> str:
    """The path of the command `takt` in the target directory."""
    target = pathlib.Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target"))
    path = ROOT / target / "debug" / "takt"
    if not path.exists():
        pytest.fail(f"there is no {path}\nhint: cargo xtask test python builds it")
    return str(path)


@pytest.fixture(scope="session")
def viewer_packages() -> pathlib.Path:
    """The folder with the packages from npm that viewers are made of, and the programs that use them; skips without npm."""
    if not shutil.which("node") or not shutil.which("npm"):
        pytest.skip("needs node and npm")
    source = pathlib.Path(__file__).resolve().parent / "foxglove_peer"
    target = pathlib.Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target"))
    folder = ROOT / target / "foxglove_peer"
    folder.mkdir(parents=True, exist_ok=True)
    wanted = (source / "package.json").read_text()
    complete = folder / "complete"
    if not complete.exists() or complete.read_text() != wanted:
        (folder / "package.json").write_text(wanted)
        install = ["npm", "install", "--no-audit", "--no-fund", "--loglevel=error"]
        if subprocess.run(install, cwd=folder, timeout=300.0).returncode != 0:
            pytest.skip("npm cannot install the packages of Foxglove")
        complete.write_text(wanted)
    for program in source.glob("*.mjs"):
        shutil.copy(program, folder)
    return folder


def free_endpoint() -> str:
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{listener.getsockname()[1]}"


def start_member(folder: pathlib.Path, fleet: str) -> subprocess.Popen[bytes]:
    """A controller with a simulated arm in a fleet."""
    folder.mkdir()
    config = folder / "cell.toml"
    config.write_text(
        "[controller]\nwebsocket = '127.0.0.1:0'\ntcp = '127.0.0.1:0'\nsocket = ''\nflight_recorder = ''\n"
        f"stop_socket = '{folder}/stop.sock'\n"
        "[[device]]\nname = 'left'\ntype = 'arm_sim'\nmodel = 'kuka_lwr4'\n"
        f"[fleet]\n{fleet}\n"
    )
    with (folder / "log").open("wb") as log:
        return subprocess.Popen([tool(), "run", "--config", str(config)], stdout=log, stderr=log)


class Controller:
    """A controller in a process of its own."""

    def __init__(self) -> None:
        command = [program("controller")]
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        assert self.process.stdout is not None
        self.address = self.process.stdout.readline().strip()

    def stop(self) -> None:
        """Ends it at once, as if the host had failed."""
        self.process.kill()
        self.process.wait()


@pytest.fixture(scope="session")
def controller() -> Iterator[Controller]:
    """The controller of the suite."""
    controller = Controller()
    yield controller
    controller.stop()


@pytest.fixture
def address(controller: Controller) -> str:
    """The address of the controller."""
    return controller.address


@pytest.fixture
def cell(address: str) -> Iterator[takt.Cell]:
    """A connection of its own."""
    with takt.connect(address) as cell:
        yield cell


@pytest.fixture
def left(cell: takt.Cell) -> takt.Arm:
    """The left arm, bent."""
    arm = cell.arm("left")
    assert arm.ptp(BENT).run() == takt.Outcome.Completed
    return arm


def python(source: str, *arguments: str) -> None:
    """Runs a program in an interpreter of its own, to its end of any kind."""
    subprocess.run([sys.executable, "-c", source, *arguments], timeout=60, check=False)


def wait_for_rest(arm: takt.Arm) -> None:
    """Waits until the commanded positions stay equal."""
    last = arm.commanded()
    for _ in range(300):
        time.sleep(0.02)
        now = arm.commanded()
        if abs(now - last).max() == 0.0:
            return
        last = now
    raise AssertionError("the arm still moves")
