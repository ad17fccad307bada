"""Plans, events, conditions, held objects and present values, against simulated arms."""

from __future__ import annotations

import math
import pathlib
import time

import numpy as np
import pytest
from conftest import BENT

import takt
from takt import Event, Outcome, Pose


def turned(first: float) -> list[float]:
    """The bent arm, turned about its base."""
    return [first, *BENT[1:]]


def beside(arm: takt.Arm, x: float, y: float, z: float) -> Pose:
    """The pose of the flange, moved in the base."""
    return Pose(arm.pose().position + [x, y, z], arm.pose().orientation)


def test_plan_equals_motion(left: takt.Arm) -> None:
    motion = left.ptp(turned(0.5), speed=0.5)
    plan = motion.plan()
    assert plan.device == "left" and plan.duration > 0.2 and plan.partners == []
    np.testing.assert_allclose(plan.positions(0.0), BENT, atol=1e-3)
    np.testing.assert_allclose(plan.velocities(plan.duration), np.zeros(7), atol=1e-6)
    assert plan.progress(0.0) < 0.01 and plan.progress(plan.duration) == pytest.approx(1.0)
    times, progress, joints = plan.cycles()
    assert joints.shape == (len(times), 7) and progress.shape == times.shape
    assert motion.run() == Outcome.Completed
    np.testing.assert_allclose(left.commanded(), plan.end(), atol=1e-9)
    end = plan.pose(plan.duration)
    assert end is not None
    np.testing.assert_allclose(left.pose().position, end.position, atol=1e-3)


def test_plan_first_finds_time_or_raises(left: takt.Arm) -> None:
    plan = left.ptp(turned(0.5)).plan()
    found = plan.first(lambda _, joints: joints[0] > 0.25)
    assert found is not None and plan.positions(found)[0] > 0.25
    assert plan.first(lambda progress, _: progress > 2.0) is None
    with pytest.raises(ZeroDivisionError):
        plan.first(lambda _progress, _joints: 1 / 0)
    for bad in (-1.0, math.nan):
        with pytest.raises(takt.Invalid):
            plan.positions(bad)


def test_plan_out_of_reach_names_place(left: takt.Arm) -> None:
    with pytest.raises(takt.Error) as caught:
        left.lin(beside(left, 2.0, 0.0, 0.0)).plan()
    error = caught.value
    assert isinstance(error, takt.Unreachable | takt.TooFast)
    assert error.device == "left" and error.filename == __file__
    assert 0.0 <= error.progress <= 1.0


def test_ptp_to_pose_reaches_it(left: takt.Arm) -> None:
    goal = beside(left, 0.05, 0.05, 0.0)
    assert left.ptp_to(goal).run() == Outcome.Completed
    np.testing.assert_allclose(left.pose().position, goal.position, atol=1e-4)
    joints = left.commanded()
    assert left.ptp(BENT).run() == Outcome.Completed
    assert left.ptp_near(goal.matrix(), joints).run() == Outcome.Completed
    np.testing.assert_allclose(left.pose().position, goal.position, atol=1e-4)


def test_spline_ends_at_last_pose(left: takt.Arm) -> None:
    poses = [beside(left, 0.02, 0.03, 0.0), beside(left, 0.0, 0.06, 0.02)]
    assert left.spline(poses).run() == Outcome.Completed
    np.testing.assert_allclose(left.pose().position, poses[-1].position, atol=1e-4)
    with pytest.raises(takt.Invalid):
        left.spline([]).run()


def test_tool_leads_motion(left: takt.Arm) -> None:
    tool = Pose.xyz(0.0, 0.0, 0.1)
    goal = Pose.xyz(0.0, 0.04, 0.0) * left.pose() * tool
    assert left.with_tool(tool).lin(goal).run() == Outcome.Completed
    np.testing.assert_allclose((left.pose() * tool).position, goal.position, atol=1e-4)


def test_hold_maintains_until_next_motion(left: takt.Arm) -> None:
    first = left.ptp(turned(2.0), speed=0.2).begin()
    hold = left.hold(now=True).begin()
    assert hold.wait(timeout=20.0) == Outcome.Maintaining
    assert first.wait(timeout=20.0) == Outcome.TakenOver
    assert left.ptp(BENT).run() == Outcome.Completed


def test_event_stopped_starts_next(left: takt.Arm) -> None:
    condition = left.joint(0) > 0.2
    stopped = left.ptp(turned(1.0), speed=0.3, until={"turned": condition})
    both = stopped.on(Event.Stopped("turned"), left.ptp(BENT))
    assert both.run() == Outcome.Completed
    np.testing.assert_allclose(left.commanded(), BENT, atol=1e-9)
    assert Event.Stopped("a") == Event.Stopped("a") != Event.Completed
    assert repr(Event.Progress(0.5)) == "Event.Progress(0.5)"


def test_event_progress_starts_other_arm(cell: takt.Cell, left: takt.Arm) -> None:
    right = cell.arm("right")
    assert right.ptp(BENT).run() == Outcome.Completed
    outcome = left.ptp(turned(0.4)).on(Event.Progress(0.3), right.ptp(turned(0.2))).run()
    assert outcome == Outcome.Completed
    np.testing.assert_allclose(right.commanded(), turned(0.2), atol=1e-9)


def test_when_starts_and_chooses(left: takt.Arm) -> None:
    is_bent = left.joint(3) < -1.0
    assert takt.when(is_bent).start(left.ptp(turned(0.1))).run() == Outcome.Completed
    choice = takt.when(~is_bent).choose(left.ptp(turned(0.5)), left.ptp(turned(-0.2)))
    assert choice.run() == Outcome.Completed
    np.testing.assert_allclose(left.commanded(), turned(-0.2), atol=1e-9)


def test_after_failure_follows_failed_motion(left: takt.Arm) -> None:
    far = left.lin(beside(left, 1.0, 0.0, 0.0)).unchecked().queue()
    waiting = left.ptp(BENT).after_failure().queue()
    with pytest.raises(takt.Error):
        far.wait(timeout=30.0)
    assert waiting.wait(timeout=30.0) == Outcome.Completed


def test_override_stops_and_continues(cell: takt.Cell, left: takt.Arm) -> None:
    handle = left.ptp(turned(1.5), speed=0.3).begin()
    cell.set_override(0.0)
    assert cell.override_factor() == 0.0
    time.sleep(1.0)
    before = left.commanded()
    time.sleep(0.5)
    np.testing.assert_array_equal(left.commanded(), before)
    assert handle.outcome() is None
    cell.set_override(1.0)
    assert handle.wait(timeout=30.0) == Outcome.Completed
    for bad in (-0.1, 1.1, math.nan):
        with pytest.raises(takt.Invalid):
            cell.set_override(bad)


def test_value_is_that_of_expression(cell: takt.Cell, left: takt.Arm) -> None:
    joint = left.joint(1)
    angle = cell.value(joint)
    assert angle == pytest.approx(BENT[1], abs=1e-3)
    expected = [
        (joint.sin(), math.sin(BENT[1])),
        (joint.cos(), math.cos(BENT[1])),
        (joint.tan(), math.tan(BENT[1])),
        (joint.asin(), math.asin(BENT[1])),
        (joint.acos(), math.acos(BENT[1])),
        (joint.sqrt(), math.sqrt(BENT[1])),
        (joint.average(0.01), BENT[1]),
    ]
    for number, value in expected:
        assert cell.value(number) == pytest.approx(value, abs=5e-3), number
    assert cell.holds(joint > 0.1) and not cell.holds(joint > 1.0)
    assert cell.holds((joint > 0.1).rises()) and not cell.holds((joint > 1.0).rises())
    assert cell.holds((joint > 1.0).falls())
    with pytest.raises(takt.Invalid):
        joint.average(-1.0)


def test_coupled_arms_lift_object(cell: takt.Cell) -> None:
    bases = [Pose.xyz(0.0, 0.3, 0.0).abc(-0.2, 0.0, 0.0), Pose.xyz(0.0, -0.3, 0.0).abc(0.2, 0.0, 0.0)]
    arms = [cell.arm(name).with_base(base) for name, base in zip(("left", "right"), bases)]
    assert takt.together(*(arm.ptp([0, 0.6, 0, -1.1, 0, 0.7, 0]) for arm in arms)).run() == Outcome.Completed
    np.testing.assert_allclose(arms[0].base.matrix(), bases[0].matrix())

    def flanges() -> list[Pose]:
        return [arm.base * arm.pose() for arm in arms]

    start = flanges()
    object = Pose.xyz(*np.mean([flange.position for flange in start], axis=0))
    box = takt.coupled(object, arms).with_speed(0.5).with_limits(velocity=0.2)
    lift = box.lin(Pose.xyz(0.0, 0.0, 0.1) * object)
    plan = lift.plan()
    assert len(plan.partners) == 1 and plan.partners[0].duration == plan.duration
    assert lift.run() == Outcome.Completed
    for before, after in zip(start, flanges()):
        np.testing.assert_allclose(after.position, before.position + [0, 0, 0.1], atol=1e-4)
    via, down = Pose.xyz(0.03, 0.0, 0.05) * object, object
    assert box.circ(via, down).then(box.spline([via, down])).run() == Outcome.Completed
    with pytest.raises(takt.Invalid, match="only one arm"):
        takt.coupled(object, arms[:1]).lin(object).begin()
    with pytest.raises(takt.Invalid):
        takt.coupled(object, [])


def test_embedded_cell_file_starts_controller(tmp_path: pathlib.Path) -> None:
    path = tmp_path / "cell.toml"
    path.write_text('[[device]]\nname = "left"\ntype = "kuka_lwr_fri"\nlisten = "127.0.0.1:0"\n')
    with takt.embed(path) as cell:
        assert [arm.name for arm in cell.arms()] == ["left"]
        assert cell.arm("left").model == "kuka_lwr4"
        address = cell.embedded_address()
        assert address is not None and address.startswith("127.0.0.1:")
    with pytest.raises(takt.Invalid):
        takt.embed(tmp_path / "missing.toml")


FRAMES = """
[[device]]
name = "left"
type = "kuka_lwr_fri"
listen = "127.0.0.1:0"
[[frame]]
name = "table"
position = [1, 0, 0.7]
rotation = [90, 0, 0]
[[base]]
device = "left"
parent = "table"
position = [0.5, 0, 0]
"""


def test_goal_in_frame_is_that_in_base(tmp_path: pathlib.Path) -> None:
    path = tmp_path / "cell.toml"
    path.write_text(FRAMES)
    with takt.embed(path) as cell:
        left, table = cell.arm("left"), cell.frame("table")
        assert (table.name, table.root) == ("table", "world") and left.base_frame == cell.frame("left.base")
        assert {"world", "table", "left.base", "left.flange"} <= {frame.name for frame in cell.frames()}
        in_base = table.within(left.base_frame)
        np.testing.assert_allclose(in_base.position, [-0.5, 0, 0], atol=1e-12)
        pose = Pose.xyz(1.0, 0.1, 0.5).abc(0.1, 0.2, 0.3)
        goals = pose.in_(table), table.pose(pose.matrix())
        assert goals[0].__class__ is takt.Goal
        for goal in goals:
            net = left.ptp_near(goal, BENT).explain().net
            assert net == left.ptp_near(in_base * pose, BENT).explain().net
        with pytest.raises(takt.NotConnected) as caught:
            left.lin(pose.in_(cell.frame("left.flange"))).begin()
        assert caught.value.frames == [("left.flange", "left.flange"), ("left.base", "world")]
        assert caught.value.filename == __file__
        with pytest.raises(takt.NoDevice, match="table"):
            cell.frame("chair")
