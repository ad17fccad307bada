"""Motions, their succession and outcomes, against simulated arms."""

from __future__ import annotations

import asyncio
import threading
import time

import numpy as np
import pytest
from conftest import BENT
from numpy.typing import NDArray

import takt
from takt import Outcome, Pose


def goal(first: float) -> NDArray[np.float64]:
    """The bent arm, turned about its base."""
    joints = np.array(BENT)
    joints[0] = first
    return joints


def test_ptp_array_reaches_goal(left: takt.Arm) -> None:
    assert left.ptp(goal(0.3), speed=0.5).run() == Outcome.Completed
    commanded = left.commanded()
    assert commanded.dtype == np.float64 and commanded.shape == (7,)
    np.testing.assert_allclose(commanded, goal(0.3), atol=1e-9)


def test_trajectory_passes_points_and_names_what_is_wrong(left: takt.Arm) -> None:
    positions = [goal(0.1), goal(0.2), np.array(BENT)]
    assert left.trajectory([0.5, 1.0, 2.0], positions, goal_tolerance=[0.01]).run() == Outcome.Completed
    np.testing.assert_allclose(left.commanded(), BENT, atol=1e-9)
    with pytest.raises(takt.Invalid, match="2 times, but 1 rows of positions"):
        left.trajectory([0.5, 1.0], [BENT])
    with pytest.raises(takt.Unplanned, match="joint 0 at "):
        left.trajectory([0.01], [goal(1.0)]).run()
    assert left.ptp(BENT).run() == Outcome.Completed


def test_home_moves_joints_to_zero(left: takt.Arm) -> None:
    assert left.home(speed=0.8).run() == Outcome.Completed
    np.testing.assert_allclose(left.commanded(), np.zeros(7), atol=1e-9)
    assert left.ptp(BENT).run() == Outcome.Completed


def test_limits_are_keywords_of_with_limits(left: takt.Arm) -> None:
    assert left.limits == {
        "velocity": 0.25,
        "acceleration": 1.0,
        "jerk": 10.0,
        "rot_velocity": 0.5,
        "rot_acceleration": 2.5,
        "rot_jerk": 25.0,
    }
    slower = left.with_limits(velocity=0.1)
    assert slower.limits.get("velocity") == 0.1
    assert left.with_limits(**slower.limits).limits == slower.limits


def test_lin_accepts_pose_matrix_and_pair(left: takt.Arm) -> None:
    start = left.pose()
    up = start.matrix()
    up[2, 3] += 0.03
    side = start.position + [0.0, 0.03, 0.0]
    assert left.lin(up).run() == Outcome.Completed
    assert left.lin((side, start.orientation)).run() == Outcome.Completed
    np.testing.assert_allclose(left.pose().position, side, atol=1e-4)
    via = start.position + [0.03, 0.015, 0.0]
    assert left.circ((via, start.orientation), start).run() == Outcome.Completed
    np.testing.assert_allclose(left.pose().position, start.position, atol=1e-4)


def test_motions_blend_one_ahead(left: takt.Arm) -> None:
    handles = [left.ptp(goal(0.3 if number % 2 else -0.3), blend=0.5).begin() for number in range(6)]
    outcomes = [handle.wait() for handle in handles]
    assert outcomes[-1] == Outcome.Completed
    assert outcomes.count(Outcome.TakenOver) >= 4, outcomes
    left.finish()


def test_motion_now_replaces_running_one(left: takt.Arm) -> None:
    first = left.ptp(goal(2.0), speed=0.3).begin()
    assert left.ptp(BENT, now=True).run() == Outcome.Completed
    assert first.wait() == Outcome.TakenOver


def test_condition_stops_motion_by_name(left: takt.Arm) -> None:
    turned = {"turned": left.joint(0) > 0.2}
    outcome = left.ptp(goal(1.0), speed=0.3, until=turned).run()
    assert outcome == Outcome.Stopped("turned") and outcome.is_stopped_by("turned")
    assert 0.2 < left.commanded()[0] < 0.9
    match outcome:
        case Outcome("stopped", name):
            assert name == "turned"
        case _:
            raise AssertionError(outcome)


def test_together_moves_both_arms(cell: takt.Cell) -> None:
    left, right = cell.arm("left"), cell.arm("right")
    assert takt.together(left.ptp(BENT), right.ptp(BENT)).run() == Outcome.Completed
    np.testing.assert_allclose(right.commanded(), BENT, atol=1e-9)


def test_sequence_and_alternative_run(left: takt.Arm) -> None:
    first = takt.either(left.ptp([9.0] * 7), left.ptp(goal(0.2)))
    assert first.then(left.ptp(goal(0.4))).then(left.ptp(BENT)).run() == Outcome.Completed
    np.testing.assert_allclose(left.commanded(), BENT, atol=1e-9)
    assert left.ptp(goal(0.1)).then(takt.together(left.ptp(BENT))).run() == Outcome.Completed


def test_wait_timeout_leaves_motion(left: takt.Arm) -> None:
    handle = left.ptp(goal(2.0), speed=0.2).begin()
    with pytest.raises(takt.Timeout) as caught:
        handle.wait(timeout=0.1)
    assert isinstance(caught.value, TimeoutError) and caught.value.filename == __file__
    assert handle.outcome() is None and 0.0 <= handle.progress() < 1.0
    handle.cancel()
    assert handle.wait() == Outcome.Cancelled


def test_callback_that_raises_stops_nothing(left: takt.Arm, monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[Outcome | None] = []
    raised = threading.Event()

    def hook(_: object) -> None:
        raised.set()

    monkeypatch.setattr("sys.unraisablehook", hook)
    handle = left.ptp(goal(0.1)).begin()

    def fails(ended: takt.Handle) -> None:
        seen.append(ended.outcome())
        raise RuntimeError("in a callback")

    handle.on_end(fails)
    assert handle.wait() == Outcome.Completed
    assert raised.wait(5.0) and seen == [Outcome.Completed]
    again = threading.Event()
    handle.on_end(lambda _: again.set())
    assert again.wait(5.0), "the thread of the callbacks ended"


async def test_await_returns_outcome(left: takt.Arm) -> None:
    ticks = 0

    async def tick() -> None:
        nonlocal ticks
        while True:
            ticks += 1
            await asyncio.sleep(0.01)

    task = asyncio.create_task(tick())
    assert await left.ptp(goal(0.4), speed=0.5) == Outcome.Completed
    task.cancel()
    assert ticks > 10, "the loop was blocked"


async def test_await_cancelled_task_rests(left: takt.Arm) -> None:
    handle = left.ptp(goal(2.0), speed=0.2).begin()

    async def move() -> Outcome:
        return await handle

    task = asyncio.create_task(move())
    await asyncio.sleep(0.2)
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task
    assert handle.outcome() == Outcome.Cancelled


def test_interpreter_lock_is_free_while_waiting(left: takt.Arm) -> None:
    counted = 0
    stop = threading.Event()

    def count() -> None:
        nonlocal counted
        while not stop.is_set():
            counted += 1
            time.sleep(0.001)

    thread = threading.Thread(target=count)
    thread.start()
    left.ptp(goal(0.5), speed=0.5).run()
    stop.set()
    thread.join()
    assert counted > 20


def test_pose_reads_back() -> None:
    pose = Pose.xyz(0.1, 0.2, 0.3).abc(takt.deg(30), -0.2, 0.5)
    for again in (Pose(pose), Pose(pose.matrix()), Pose(pose.position, pose.orientation)):
        np.testing.assert_allclose(again.matrix(), pose.matrix(), atol=1e-12)
    np.testing.assert_allclose((pose * pose.inverse()).matrix(), np.eye(4), atol=1e-12)
    assert np.asarray(pose).shape == (4, 4)


def test_pose_reads_scipy_rotation() -> None:
    from scipy.spatial.transform import Rotation

    turned = Pose(([0.1, 0.2, 0.3], Rotation.from_euler("Z", 0.5)))
    expected = Pose.xyz(0.1, 0.2, 0.3).abc(0.5, 0, 0)
    np.testing.assert_allclose(turned.matrix(), expected.matrix(), atol=1e-12)
