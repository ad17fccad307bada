"""Bad input and lost programs: one typed error with the caller's line each, and a robot at rest."""

from __future__ import annotations

import math
import os
import pathlib
import pickle
import signal
import subprocess
import sys
import threading
import time
from typing import Any

import numpy as np
import pytest
from conftest import BENT, Controller, python, wait_for_rest

import takt


def line_of(error: takt.Error) -> str:
    """The line that an error names, which is one of this file."""
    assert error.filename == __file__ and error.lineno is not None
    assert f"{__file__}:{error.lineno}" in str(error)
    return pathlib.Path(__file__).read_text().splitlines()[error.lineno - 1]


def test_joint_count_error_names_line(left: takt.Arm) -> None:
    with pytest.raises(takt.Invalid) as caught:
        left.ptp([0.0] * 6).run()
    assert isinstance(caught.value, ValueError) and "left has 7 joints, not 6" in str(caught.value)
    assert "left.ptp([0.0] * 6)" in line_of(caught.value)


@pytest.mark.parametrize("factor", [0.0, 0.09, 10.1, -1.0, math.nan, math.inf])
def test_real_time_factor_out_of_range_is_invalid(factor: float) -> None:
    with pytest.raises(takt.Invalid) as caught:
        takt.simulate_time(factor)
    assert "0.1 to 10 times" in str(caught.value)
    assert "takt.simulate_time(factor)" in line_of(caught.value)


@pytest.mark.parametrize("bad", [math.nan, math.inf, 3.0])
def test_joint_value_out_of_range_is_limit(left: takt.Arm, bad: float) -> None:
    with pytest.raises(takt.Limit) as caught:
        left.ptp([bad, *BENT[1:]]).begin()
    assert caught.value.joint == "left joint 0" and caught.value.max == pytest.approx(2.9)


@pytest.mark.parametrize("bad", ["text", None, [None] * 7, [[0.0] * 7], {}, 7])
def test_joint_values_of_wrong_type_are_rejected(left: takt.Arm, bad: Any) -> None:
    with pytest.raises(TypeError):
        left.ptp(bad)


@pytest.mark.parametrize(
    "bad", ["text", None, 5, np.eye(3), [1, 2, 3], ([1, 2], [0, 0, 0, 1]), ([1, 2, 3], [0, 0, 1])]
)
def test_pose_of_wrong_type_is_rejected(left: takt.Arm, bad: Any) -> None:
    with pytest.raises((TypeError, ValueError)):
        left.lin(bad)


@pytest.mark.parametrize(
    "bad", [np.eye(4) * 2, -np.eye(4), np.full((4, 4), math.nan), ([1, 2, 3], [0, 0, 0, 0])]
)
def test_pose_without_rotation_is_invalid(left: takt.Arm, bad: Any) -> None:
    with pytest.raises(takt.Invalid):
        left.lin(bad)


def test_pose_not_finite_is_invalid(left: takt.Arm) -> None:
    with pytest.raises(takt.Invalid):
        left.lin(takt.Pose.xyz(math.nan, 0.0, 0.5)).run()


@pytest.mark.parametrize("options", [{"speed": 0.0}, {"speed": 1.5}, {"speed": math.nan}, {"blend": 1.0}])
def test_option_out_of_bounds_is_invalid(left: takt.Arm, options: dict[str, Any]) -> None:
    with pytest.raises(takt.Invalid):
        left.ptp(BENT, **options).begin()


def test_error_survives_pickle(left: takt.Arm) -> None:
    with pytest.raises(takt.Limit) as caught:
        left.ptp([9.0] * 7).begin()
    copy = pickle.loads(pickle.dumps(caught.value))
    assert type(copy) is takt.Limit and str(copy) == str(caught.value) and vars(copy) == vars(caught.value)


def test_device_unknown_lists_known(cell: takt.Cell) -> None:
    with pytest.raises(takt.NoDevice) as caught:
        cell.arm("middle")
    assert caught.value.name == "middle" and "left, right" in str(caught.value)
    assert isinstance(caught.value, LookupError) and "cell.arm" in line_of(caught.value)


def test_expression_has_no_truth(left: takt.Arm) -> None:
    number: Any = left.joint(0)
    with pytest.raises(TypeError, match="hint"):
        bool(number > 0.1)
    with pytest.raises(TypeError):
        _ = number == 0.1
    with pytest.raises(TypeError):
        _ = number + "text"
    with pytest.raises(takt.Invalid):
        _ = number > math.nan
    with pytest.raises(takt.Invalid):
        left.joint(7)
    wrong: Any = {"touch": True}
    with pytest.raises(TypeError, match="touch"):
        left.ptp(BENT, until=wrong)


def test_pose_out_of_reach_fails_at_rest(left: takt.Arm) -> None:
    far = left.lin(takt.Pose.xyz(1.0, 0.0, 0.0) * left.pose())
    # Near the end of its reach the elbow stretches faster than the joints may.
    with pytest.raises((takt.Unreachable, takt.TooFast, takt.DeviceFailed)) as caught:
        far.run()
    assert caught.value.device == "left" and "far = left.lin" in line_of(caught.value)
    wait_for_rest(left)
    assert left.ptp(BENT).run() == takt.Outcome.Completed


def test_connection_without_controller_fails() -> None:
    with pytest.raises(takt.Connection) as caught:
        takt.connect("127.0.0.1:1")
    assert isinstance(caught.value, ConnectionError)
    with pytest.raises(takt.Invalid):
        takt.connect("127.0.0.1:1", token="short")


def test_cell_closed_refuses_use(address: str) -> None:
    cell = takt.connect(address)
    cell.close()
    cell.close()
    with pytest.raises(takt.Invalid, match="closed"):
        cell.arm("left")


def test_controller_lost_in_motion_is_lost() -> None:
    controller = Controller()
    try:
        cell = takt.connect(controller.address)
        handle = cell.arm("left").ptp(BENT, speed=0.1).begin()
        threading.Timer(0.2, controller.stop).start()
        with pytest.raises(takt.Lost):
            handle.wait(timeout=20.0)
    finally:
        controller.stop()


def test_exit_of_with_brakes(address: str) -> None:
    cell = takt.connect(address)
    with cell:
        handle = cell.arm("right").ptp([1.5, *BENT[1:]], speed=0.2).begin()
        time.sleep(0.1)
    assert handle.outcome() == takt.Outcome.Cancelled


MOVING = """
import sys, takt
cell = takt.connect(sys.argv[1])
handle = cell.arm("right").ptp([-1.5, 0.5, 0, -1.2, 0, 0.8, 0], speed=0.2).begin()
"""


@pytest.mark.parametrize("end", ["", "import os; os._exit(3)", "import os; os.kill(os.getpid(), 9)"])
def test_interpreter_exit_in_motion_brakes(cell: takt.Cell, address: str, end: str) -> None:
    right = cell.arm("right")
    assert right.ptp(BENT).run() == takt.Outcome.Completed
    python(MOVING + end, address)
    wait_for_rest(right)
    assert right.commanded()[0] > -1.4
    assert right.ptp(BENT, speed=0.5).run() == takt.Outcome.Completed


def test_thread_dead_with_handle_leaves_motion(left: takt.Arm) -> None:
    held: list[takt.Handle] = []

    def begin() -> None:
        held.append(left.ptp([0.4, *BENT[1:]], speed=0.5).begin())
        held.clear()
        sys.exit()

    thread = threading.Thread(target=begin)
    thread.start()
    thread.join()
    left.finish(timeout=20.0)
    assert left.commanded()[0] == pytest.approx(0.4)


def test_interpreter_lock_held_while_chain_runs(left: takt.Arm) -> None:
    handles = [left.ptp([first, *BENT[1:]], speed=0.5, blend=0.8).queue() for first in (0.4, -0.4, 0.2)]
    interval = sys.getswitchinterval()
    sys.setswitchinterval(10.0)
    try:
        held = time.monotonic() + 3.0
        while time.monotonic() < held:
            pass
    finally:
        sys.setswitchinterval(interval)
    ends = [handle.outcome() for handle in handles]
    assert ends[0] is not None and ends[1] is not None, ends
    left.finish(timeout=20.0)
    assert left.commanded()[0] == pytest.approx(0.2)


def test_fork_child_is_refused_and_parent_goes_on(left: takt.Arm) -> None:
    handle = left.ptp([0.8, *BENT[1:]], speed=0.2).begin()
    child = os.fork()
    if child == 0:
        try:
            left.positions()
        except takt.Invalid as error:
            text = str(error)
            del left, handle
            os._exit(42 if "fork" in text else 1)
        os._exit(2)
    _, status = os.waitpid(child, 0)
    assert os.waitstatus_to_exitcode(status) == 42
    assert handle.wait(timeout=30.0) == takt.Outcome.Completed


INTERRUPTED = """
import sys, time, takt
with takt.connect(sys.argv[1]) as cell:
    right = cell.arm("right")
    activity = right.ptp([1.5, 0.5, 0, -1.2, 0, 0.8, 0], speed=0.05)
    print("ready", flush=True)
    try:
        if sys.argv[2] == "run":
            activity.run()
        handle = activity.begin()
        if sys.argv[2] == "wait":
            handle.wait()
        elif sys.argv[2] == "jog":
            with right.jog_joints(now=True).begin() as jog:
                while True:
                    jog.send([0.2, 0, 0, 0, 0, 0, 0])
                    time.sleep(0.02)
        elif sys.argv[2] == "begin":
            activity.begin()
        right.finish()
    except KeyboardInterrupt:
        print(time.time(), flush=True)
        raise
"""


@pytest.mark.parametrize("call", ["run", "wait", "begin", "finish", "jog"])
def test_interrupt_reaches_blocked_call(cell: takt.Cell, address: str, call: str) -> None:
    command = [sys.executable, "-c", INTERRUPTED, address, call]
    program = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert program.stdout is not None
    assert program.stdout.readline() == "ready\n"
    time.sleep(1.0)
    sent = time.time()
    program.send_signal(signal.SIGINT)
    out, err = program.communicate(timeout=30.0)
    assert "KeyboardInterrupt" in err and out, err
    print(f"{call}: KeyboardInterrupt after {(float(out) - sent) * 1e3:.0f} ms")
    # The session ended at rest: another program has the arm at once.
    right = cell.arm("right")
    rest = right.commanded()
    time.sleep(0.1)
    np.testing.assert_array_equal(right.commanded(), rest)
    assert right.ptp(BENT).run() == takt.Outcome.Completed
