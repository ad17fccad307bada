"""Inputs and outputs, grippers and mobile bases, against simulated devices."""

from __future__ import annotations

import math
import time
from typing import Any

import numpy as np
import pytest

import takt
from takt import Outcome, Pose


def test_outputs_are_set_and_inputs_follow(cell: takt.Cell) -> None:
    plant = cell.io("plant")
    assert plant.set(3, True).run() == Outcome.Completed
    # Inputs of the simulated device are connected with its outputs.
    assert cell.holds(plant.output(3)) and cell.holds(plant.input(3))
    assert plant.set(3, False).run() == Outcome.Completed
    assert not cell.holds(plant.input(3))
    assert plant.set_analogue(1, -2.5).run() == Outcome.Completed
    assert cell.value(plant.analogue_input(1)) == -2.5 == cell.value(plant.analogue_output(1))


def test_devices_are_listed_with_kind_and_state(cell: takt.Cell) -> None:
    plant = cell.io("plant")
    assert plant.name in [io.name for io in cell.ios()] and plant.kind
    assert plant.set(5, True).run() == Outcome.Completed
    state = plant.state()
    assert state.digital_outputs[5] is True and state.digital_inputs[5] is True and state == plant.state()
    assert plant.set(5, False).run() == Outcome.Completed
    assert plant.state().digital_outputs[5] is False
    grippers = {gripper.name: gripper for gripper in cell.grippers()}
    assert set(grippers) == {"gripper", "hand"}
    assert grippers["hand"].width_max == pytest.approx(0.023) and grippers["gripper"].width_max is None
    assert grippers["gripper"].kind


def test_pulse_ends_by_time_and_cancel(cell: takt.Cell) -> None:
    plant = cell.io("plant")
    pulse = plant.pulse(0, True, 0.2).begin()
    # It has begun; the device has the output one cycle later.
    while not cell.holds(plant.output(0)):
        assert pulse.outcome() is None
    assert pulse.wait(timeout=10.0) == Outcome.Completed
    assert not cell.holds(plant.output(0))
    pulse = plant.pulse(0, True, 600).begin()
    pulse.cancel()
    assert pulse.wait(timeout=10.0) == Outcome.Cancelled
    assert not cell.holds(plant.output(0))


def test_port_unknown_or_value_wrong_is_named(cell: takt.Cell) -> None:
    plant = cell.io("plant")
    with pytest.raises(takt.NoPort) as caught:
        plant.input(8)
    assert caught.value.device == "plant" and caught.value.port == 8 and caught.value.filename == __file__
    with pytest.raises(takt.NoPort):
        plant.set(8, True).run()
    for wrong in (plant.set_analogue(0, math.nan), plant.pulse(0, True, 0.0), plant.pulse(0, True, 3601)):
        with pytest.raises(takt.Invalid):
            wrong.run()
    for duration in (-1.0, math.nan):
        with pytest.raises(takt.Invalid):
            plant.pulse(0, True, duration)
    bad: Any = "on"
    with pytest.raises(TypeError):
        plant.set(0, bad)
    with pytest.raises(OverflowError):
        plant.set(-1, True)


@pytest.mark.parametrize(("kind", "known"), [("io", "plant"), ("gripper", "gripper, hand"), ("base", "platform")])
def test_device_of_other_kind_lists_known(cell: takt.Cell, kind: str, known: str) -> None:
    with pytest.raises(takt.NoDevice) as caught:
        getattr(cell, kind)("nothing")
    assert caught.value.name == "nothing" and known in str(caught.value), caught.value


def test_fingers_open_close_and_stop(cell: takt.Cell) -> None:
    hand = cell.gripper("hand")
    assert hand.name == "hand" and repr(hand) == "Gripper('hand')"
    assert hand.open().run() == Outcome.Completed
    assert cell.value(hand.width) == pytest.approx(0.023)
    assert hand.move_to(0.02).run() == Outcome.Completed
    closing = hand.close().begin()
    hand.cancel()
    assert closing.wait(timeout=10.0) == Outcome.Cancelled
    with pytest.raises(takt.DeviceFailed, match="after 0.05 s") as caught:
        hand.with_timeout(0.05).close().run()
    assert caught.value.device == "hand"
    for wrong in (hand.move_to(0.03), hand.move_to(math.nan), hand.grasp(0.01, 20)):
        with pytest.raises(takt.Invalid):
            wrong.run()
    with pytest.raises(takt.Invalid, match="force"):
        _ = hand.force
    with pytest.raises(takt.Invalid):
        _ = hand.holds


def test_servo_gripper_grips_part_with_force(cell: takt.Cell) -> None:
    gripper = cell.gripper("gripper")
    assert gripper.open().run() == Outcome.Completed
    assert gripper.grasp(0.05, 30).run() == Outcome.Completed
    assert cell.value(gripper.force) == pytest.approx(30) and cell.holds(gripper.holds)
    assert cell.value(gripper.width) == pytest.approx(0.05, abs=1e-3)
    assert gripper.move_to(0.1).run() == Outcome.Completed
    assert not cell.holds(gripper.holds)
    with pytest.raises(takt.DeviceFailed, match="blocked"):
        gripper.with_speed(0.5).close().run()
    assert gripper.open().run() == Outcome.Completed
    for force in (0.0, -1.0, math.nan):
        with pytest.raises(takt.Invalid):
            gripper.grasp(0.05, force).run()


def test_base_moves_drives_and_rests(cell: takt.Cell) -> None:
    platform = cell.base("platform")
    assert platform.name == "platform" and platform.limits == (0.8, 0.8)
    to = platform.pose() * Pose.xyz(0.2, -0.1, 0).abc(0.4, 0, 0)
    assert platform.go_to(to).run() == Outcome.Completed
    np.testing.assert_allclose(platform.pose().position, to.position, atol=0.015)
    wheel = cell.value(platform.wheel(0))
    before = platform.pose()
    first = platform.drive([0.2, 0, 0], 0.3).begin()
    # Renewed before it ends.
    last = platform.drive(np.array([0.2, 0, 0]), 0.3, now=True).begin()
    assert first.wait(timeout=10.0) in (Outcome.TakenOver, Outcome.Completed)
    assert last.wait(timeout=10.0) == Outcome.Completed
    moved = (before.inverse() * platform.pose()).position
    assert 0.03 < moved[0] < 0.3 and abs(moved[1]) < 0.01, moved
    assert wheel is not None and cell.value(platform.wheel(0)) != pytest.approx(wheel)
    away = platform.with_speed(0.5).go_to(Pose.xyz(5, 0, 0)).begin()
    time.sleep(0.3)
    platform.cancel()
    assert away.wait(timeout=10.0) == Outcome.Cancelled
    for velocity in ([0.9, 0, 0], [math.nan, 0, 0], [0, 0, 0.9]):
        with pytest.raises(takt.Invalid):
            platform.drive(velocity, 0.3).run()
    with pytest.raises(ValueError):
        platform.drive([0.1, 0.0], 0.3)
    with pytest.raises(takt.Invalid):
        platform.go_to(Pose.xyz(math.nan, 0, 0)).run()
