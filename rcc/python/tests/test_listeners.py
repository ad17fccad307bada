"""Listeners and prepared activities: callbacks that sleep, raise or hold the lock, and motions that no longer fit."""

from __future__ import annotations

import ctypes
import queue
import sys
import threading
import time
from typing import Any

import pytest
from conftest import BENT, Controller, wait_for_rest

import takt
from takt import Outcome, Pose

LONG = 20.0
"""Longer than anything takes that a test waits for, s."""

ASIDE = [0.2, *BENT[1:]]


def hold_lock(seconds: float) -> None:
    """Holds the interpreter's lock, as an extension module that computes does."""
    ctypes.PyDLL(None).usleep(int(seconds * 1e6))


def error_of(listener: takt.Listener) -> takt.Error:
    """Why a listener has ended by itself."""
    until = time.monotonic() + LONG
    while time.monotonic() < until:
        if listener.error:
            return listener.error
        time.sleep(0.005)
    raise AssertionError("no error")


def test_listener_reports_number_and_condition(cell: takt.Cell, left: takt.Arm) -> None:
    numbers: queue.Queue[float | None] = queue.Queue()
    states: queue.Queue[bool] = queue.Queue()
    joint = left.joint(0)
    with cell.on_change(joint, numbers.put), cell.on_change(joint > 0.1, states.put) as far:
        assert numbers.get(timeout=LONG) == pytest.approx(0, abs=1e-3)
        assert states.get(timeout=LONG) is False
        assert left.ptp(ASIDE).run() == Outcome.Completed
        assert states.get(timeout=LONG) is True
        assert far.error is None
    time.sleep(0.1)
    count = numbers.qsize()
    assert count > 2
    assert left.ptp(BENT).run() == Outcome.Completed
    assert numbers.qsize() == count and states.empty(), "closed listeners are not called"


def test_callback_that_raises_is_reported_once(
    cell: takt.Cell, left: takt.Arm, monkeypatch: pytest.MonkeyPatch
) -> None:
    reported: list[Any] = []
    monkeypatch.setattr(sys, "unraisablehook", reported.append)

    def wrong(_value: float | None) -> None:
        raise KeyError("tool")

    other: queue.Queue[float | None] = queue.Queue()
    with cell.on_change(left.joint(0), wrong) as listener, cell.on_change(left.joint(0), other.put):
        error = error_of(listener)
        assert isinstance(error, takt.Callback) and "KeyError: 'tool'" in str(error)
        assert error.filename == __file__
        assert left.ptp(ASIDE).run() == Outcome.Completed, "the connection goes on"
        assert other.qsize() > 1
    assert [args.exc_type for args in reported] == [KeyError]
    assert isinstance(listener.error, takt.Callback), "also once it is closed"


def test_slow_callback_misses_values_and_gets_the_last(cell: takt.Cell, left: takt.Arm) -> None:
    seen: list[float | None] = []

    def slow(value: float | None) -> None:
        time.sleep(0.3)
        seen.append(value)

    with cell.on_change(left.joint(0), slow) as listener:
        assert left.ptp(ASIDE, speed=0.5).run() == Outcome.Completed
        until = time.monotonic() + LONG
        while not (seen and seen[-1] == pytest.approx(ASIDE[0], abs=1e-3)):
            assert time.monotonic() < until, seen
            time.sleep(0.01)
        assert listener.missed > 0


def test_interpreter_lock_held_delays_callbacks_only(cell: takt.Cell, left: takt.Arm) -> None:
    seen: list[float | None] = []
    with cell.on_change(left.joint(0), seen.append) as listener:
        motion = left.ptp(ASIDE, speed=0.5).begin()
        hold_lock(2.0)
        assert motion.wait(timeout=LONG) == Outcome.Completed
        assert listener.error is None and listener.missed > 0
        until = time.monotonic() + LONG
        while seen[-1] != pytest.approx(ASIDE[0], abs=1e-3):
            assert time.monotonic() < until, seen[-3:]
            time.sleep(0.01)


def test_listener_of_anything_else_is_type_error(cell: takt.Cell) -> None:
    listen: Any = cell.on_change
    with pytest.raises(TypeError, match="float is no number or condition"):
        listen(1.0, print)
    with pytest.raises(TypeError, match="str cannot be called"):
        listen(cell.arm("left").joint(0), "print")


def test_listener_of_lost_connection_has_error() -> None:
    controller = Controller()
    cell = takt.connect(controller.address)
    listener = cell.on_change(cell.arm("left").joint(0) > 9, print)
    controller.stop()
    assert isinstance(error_of(listener), takt.Lost)
    listener.close()


def test_prepared_motion_begins_once(left: takt.Arm) -> None:
    prepared = left.ptp(ASIDE).prepare()
    assert left.commanded()[0] == pytest.approx(0, abs=1e-6)
    assert prepared.run() == Outcome.Completed
    with pytest.raises(takt.Invalid, match="begun or discarded"):
        prepared.begin()
    with left.ptp(BENT).then(left.ptp(ASIDE)).prepare() as both:
        pass
    with pytest.raises(takt.Invalid):
        both.run()
    assert left.ptp(BENT).prepare().begin().wait(timeout=LONG) == Outcome.Completed


def test_prepared_line_from_elsewhere_is_stale(left: takt.Arm) -> None:
    line = left.lin(Pose.xyz(0, 0, 0.02) * left.pose()).prepare()
    assert left.ptp(ASIDE).run() == Outcome.Completed
    with pytest.raises(takt.Stale) as caught:
        line.begin()
    assert caught.value.device == "left" and caught.value.filename == __file__
    wait_for_rest(left)
    assert left.commanded()[0] == pytest.approx(ASIDE[0], abs=1e-3)


def test_prepared_by_threads_begin_each(left: takt.Arm) -> None:
    outcomes: list[Outcome] = []

    def work() -> None:
        outcomes.append(left.ptp(BENT).prepare().run())

    threads = [threading.Thread(target=work) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(LONG)
    assert outcomes == [Outcome.Completed] * 4


def test_explanation_names_rules_cost_and_plan(left: takt.Arm) -> None:
    touch = left.joint(0) > 9
    explained = left.ptp(ASIDE, speed=0.5, blend=0.8, until={"touch": touch}).explain()
    rules = "\n".join(explained.rules)
    for part in ["It begins at once", "From 80 % of its path on", "When `touch` holds", "does not begin, if of left: "]:
        assert part in rules, rules
    cost = explained.cost
    assert 0 < cost.cycle < cost.budget < cost.period and cost.share == pytest.approx(cost.cycle / cost.period)
    assert cost.primitives > 10
    assert explained.plan and explained.plan.duration > 0.1
    svg = explained.svg()
    assert svg and svg.count("<polyline") == 14 and "nan" not in svg.lower()
    assert str(explained).endswith(explained.net)
    assert left.hold().explain().svg() is None
    running = left.ptp(ASIDE, speed=0.2, blend=0.5).begin()
    assert "far enough on its path to blend" in left.ptp(BENT).explain().rules[0]
    assert "in place of what left does" in left.ptp(BENT, now=True).explain().rules[0]
    running.cancel()
    running.wait(timeout=LONG)
