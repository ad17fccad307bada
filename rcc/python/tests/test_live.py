"""Jogging and streamed goals: what a program sends is followed, and what it ceases to send ends the motion."""

from __future__ import annotations

import math
import subprocess
import sys
import threading
import time
from typing import Any

import numpy as np
import pytest
from conftest import BENT, wait_for_rest

import takt
from takt import Outcome, Pose, Twist

UP = Twist.xyz(0, 0, 0.1)


def send_for(seconds: float, jog: takt.LiveHandle[Twist]) -> None:
    """Holds a key."""
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        jog.send(UP)
        time.sleep(0.02)


def test_jog_moves_while_sent_and_rests_after(left: takt.Arm) -> None:
    start = left.pose().position
    with left.jog().begin() as jog:
        send_for(0.6, jog)
        time.sleep(0.8)
        rest = left.commanded()
        time.sleep(0.1)
        np.testing.assert_array_equal(left.commanded(), rest)
        assert jog.outcome() is None, "it waits for the next velocity"
        moved = left.pose().position - start
        assert moved[2] > 0.02 and abs(moved[:2]).max() < 1e-3, moved
        jog.send(np.array([0, 0, -0.05, 0, 0, 0.1]))
    assert jog.wait() == Outcome.Cancelled
    with pytest.raises(takt.Ended):
        jog.send(UP)


def test_jog_ends_at_rest_after_exception(left: takt.Arm) -> None:
    handles: list[takt.LiveHandle[Any]] = []
    with pytest.raises(ZeroDivisionError), left.jog_joints(speed=0.5).begin() as jog:
        handles.append(jog)
        for _ in range(10):
            jog.send([0.5, 0, 0, 0, 0, 0, 0])
            time.sleep(0.02)
        _ = 1 / 0
    before = left.commanded()
    assert handles[0].outcome() == Outcome.Cancelled
    time.sleep(0.1)
    np.testing.assert_array_equal(left.commanded(), before)


@pytest.mark.parametrize(
    "bad", [[math.nan] * 7, [0.1] * 6, [9.0] * 7, [math.inf] + [0.0] * 6, np.full(7, -math.nan)]
)
def test_joint_velocity_out_of_bounds_is_invalid(left: takt.Arm, bad: Any) -> None:
    with left.jog_joints().begin() as jog:
        with pytest.raises(takt.Invalid) as caught:
            jog.send(bad)
        assert caught.value.filename == __file__
        for wrong in ("text", None, UP, [None] * 7):
            with pytest.raises(TypeError):
                jog.send(wrong)  # type: ignore[arg-type]  # pyright: ignore[reportArgumentType]
        jog.send([0.0] * 7)


@pytest.mark.parametrize("bad", [Twist.xyz(math.nan, 0, 0), Twist.xyz(0, 0, 9), UP.turning(0, 0, 9)])
def test_twist_out_of_bounds_is_invalid(left: takt.Arm, bad: Twist) -> None:
    with left.jog().begin() as jog:
        with pytest.raises(takt.Invalid):
            jog.send(bad)
        with pytest.raises(ValueError):
            jog.send([0.0, 0.0, 0.1])


def test_twist_reads_back() -> None:
    twist = Twist.xyz(1, 2, 3).turning(4, 5, 6)
    np.testing.assert_array_equal(twist.velocity, [1, 2, 3])
    np.testing.assert_array_equal(twist.rotation, [4, 5, 6])
    assert twist == Twist.xyz(1, 2, 3).turning(4, 5, 6) != UP
    assert repr(UP) == "Twist.xyz(0, 0, 0.1).turning(0, 0, 0)"


def test_streamed_goals_are_followed(left: takt.Arm) -> None:
    goal = np.array(BENT)
    with left.stream(speed=0.5).begin() as stream:
        for _ in range(20):
            goal[0] += 0.01
            stream.send(goal)
            time.sleep(0.02)
        deadline = time.monotonic() + 20.0
        while abs(left.commanded() - goal).max() > 1e-5 and time.monotonic() < deadline:
            time.sleep(0.02)
        np.testing.assert_allclose(left.commanded(), goal, atol=1e-5)
        for bad in ([9.0] * 7, [math.nan] * 7):
            with pytest.raises(takt.Limit):
                stream.send(bad)
        with pytest.raises(takt.Invalid):
            stream.send(goal[:6])
    assert stream.outcome() == Outcome.Cancelled


def test_streamed_pose_takes_over_and_is_reached(left: takt.Arm) -> None:
    stream = left.stream().begin()
    start = left.pose()
    with left.stream_poses(now=True).begin() as poses:
        assert stream.wait(timeout=10.0) == Outcome.TakenOver
        to = Pose.xyz(0, 0, 0.05) * start
        poses.send(to.matrix())
        deadline = time.monotonic() + 20.0
        while abs(left.pose().position - to.position).max() > 1e-3 and time.monotonic() < deadline:
            time.sleep(0.02)
        np.testing.assert_allclose(left.pose().position, to.position, atol=1e-3)
        with pytest.raises(takt.Unreachable):
            poses.send(Pose.xyz(5, 0, 0))


def test_condition_stops_stream(left: takt.Arm) -> None:
    with left.stream(until={"turned": left.joint(0) > 0.2}).begin() as stream:
        stream.send([1.0, *BENT[1:]])
        assert stream.wait(timeout=20.0) == Outcome.Stopped("turned")
    assert left.stream().until("turned", left.joint(0) > 9).now().speed(0.3).explain().net


def test_queued_stream_refuses_before_begin(left: takt.Arm) -> None:
    first = left.ptp([1.0, *BENT[1:]], speed=0.1).begin()
    stream = left.stream().queue()
    stream.cancel()
    first.cancel()
    assert stream.wait(timeout=20.0) == Outcome.Cancelled
    with pytest.raises(takt.Ended):
        stream.send(BENT)
    first.wait(timeout=20.0)


def test_option_unknown_lists_known(left: takt.Arm) -> None:
    wrong: Any = {"sped": 0.5}
    with pytest.raises(TypeError, match="'sped'\nhint: there are speed, until, now"):
        left.jog(**wrong)
    wrong = {"speed": "fast"}
    with pytest.raises(TypeError, match="argument 'speed'"):
        left.ptp(BENT, **wrong)
    wrong = {"limit": 1.0}
    with pytest.raises(TypeError, match="velocity, acceleration"):
        left.with_limits(**wrong)
    assert left.ptp(BENT, speed=None, blend=None, until=None, now=False).explain().net == left.ptp(BENT).explain().net


def test_interpreter_lock_held_releases_dead_man(left: takt.Arm) -> None:
    """Another thread would send all the while, but has no turn."""
    stop = threading.Event()
    held = 2.0

    def hold_key(jog: takt.LiveHandle[Twist]) -> None:
        while not stop.is_set():
            jog.send(UP)
            time.sleep(0.02)

    start = left.pose().position[2]
    with left.jog().begin() as jog:
        thread = threading.Thread(target=hold_key, args=(jog,))
        pressed = time.monotonic()
        thread.start()
        time.sleep(0.3)
        interval = sys.getswitchinterval()
        sys.setswitchinterval(60.0)
        try:
            pressed = time.monotonic() - pressed
            until = time.monotonic() + held
            while time.monotonic() < until:
                pass
            stop.set()
            # The first moment in which the other thread may have a turn.
            moved = left.pose().position[2] - start
        finally:
            sys.setswitchinterval(interval)
            stop.set()
            thread.join()
    # At 0.1 m/s; without the dead man it would have moved while the lock was held.
    assert 0.01 < moved < 0.1 * (pressed + held / 2), moved
    assert jog.outcome() == Outcome.Cancelled


JOGGING = """
import os, sys, threading, time, takt
cell = takt.connect(sys.argv[1])
jog = cell.arm("right").jog_joints().begin()
def hold_key():
    while True:
        jog.send([0.5, 0, 0, 0, 0, 0, 0])
        time.sleep(0.02)
threading.Thread(target=hold_key, daemon=True).start()
time.sleep(0.5)
print("moves", flush=True)
"""


@pytest.mark.parametrize("end", ["", "os._exit(3)", "os.kill(os.getpid(), 9)"])
def test_jogging_program_that_ends_brakes(cell: takt.Cell, address: str, end: str) -> None:
    right = cell.arm("right")
    assert right.ptp(BENT).run() == Outcome.Completed
    command = [sys.executable, "-c", JOGGING + end, address]
    ran = subprocess.run(command, timeout=60, check=False, capture_output=True, text=True)
    assert ran.stdout == "moves\n", ran.stderr
    wait_for_rest(right)
    assert 0.02 < right.commanded()[0] < 1.0, "it moved and did not go on"
    assert right.ptp(BENT).run() == Outcome.Completed


def test_thread_dead_in_jog_leaves_arm_at_rest(left: takt.Arm, monkeypatch: pytest.MonkeyPatch) -> None:
    def ignore(_: object) -> None: ...

    monkeypatch.setattr("threading.excepthook", ignore)
    handles: list[takt.LiveHandle[Any]] = []

    def jog_and_die() -> None:
        with left.jog().begin() as jog:
            handles.append(jog)
            send_for(0.3, jog)
            raise RuntimeError("in a thread")

    thread = threading.Thread(target=jog_and_die)
    thread.start()
    thread.join()
    assert handles[0].outcome() == Outcome.Cancelled
    rest = left.commanded()
    time.sleep(0.1)
    np.testing.assert_array_equal(left.commanded(), rest)
