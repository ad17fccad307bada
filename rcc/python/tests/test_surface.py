"""Net texts equal to those of Rust, and stubs equal to the native part."""

from __future__ import annotations

import ast
import inspect
import pathlib
import subprocess

import pytest
from conftest import program

import takt
from takt import Pose, _takt, deg


def test_net_text_equals_that_of_rust(cell: takt.Cell, address: str) -> None:
    left = cell.arm("left")
    goal = [0.1, deg(30), 0, deg(-70), 1e-7, deg(45), 1 / 3]
    pose = Pose.xyz(0.4, 0.1, 0.5).abc(0.1, -0.2, 3.0)
    via = Pose.quaternion([0.5, 0.0, 0.6], [0, 0, 1, 2])
    touch = abs(left.force.z) * 2 - 1 > 5
    bent = (left.joint(3) < 0.5).lasting(0.02)
    pushed = ~(touch & bent) | left.input(2)
    mean = left.joint(1).average(0.03) < 0.1
    angle = left.joint(2)
    waves = (angle.sin() + angle.cos() - angle.tan() > 0.1) | (angle.asin() * angle.acos() < angle.sqrt())
    activities = [
        left.ptp(goal),
        left.ptp(goal, speed=0.3, blend=0.8),
        left.lin(pose, speed=0.1, until={"touch": touch}),
        left.with_speed(0.7).circ(via, pose * via, until={"bent": bent, "pushed": pushed}),
        left.ptp_near(pose, goal),
        left.with_tool(Pose.xyz(0, 0.01, 0.1)).spline([via, pose], until={"mean": mean}),
        left.hold(until={"waves": waves.rises() | waves.falls()}),
        left.ptp_to(pose, now=True),
    ]
    nets = [activity.explain().net for activity in activities]
    nets += live(left, touch) + coupled_arms(cell) + devices(cell) + guided(cell)
    ours = "".join(net + "\n\n" for net in nets)
    rust = subprocess.run([program("explain"), address], capture_output=True, check=True)
    for ours_net, rust_net in zip(nets, rust.stdout.decode().split("\n\n")):
        assert ours_net == rust_net
    assert ours.encode() == rust.stdout


def live(left: takt.Arm, touch: takt.Condition) -> list[str]:
    """The nets of activities that follow what a program sends."""
    tool = Pose.xyz(0, 0, 0.1)
    return [
        left.with_limits(velocity=0.1, rot_jerk=20).with_tool(tool).jog().explain().net,
        left.jog_joints(speed=0.3, until={"touch": touch}).explain().net,
        left.stream(speed=0.5, now=True).explain().net,
        left.with_tool(tool).stream_poses().explain().net,
    ]


def coupled_arms(cell: takt.Cell) -> list[str]:
    """The nets of motions of an object that both arms hold."""
    arms = [cell.arm("left").with_base(Pose.xyz(0, 0.3, 0)), cell.arm("right").with_base(Pose.xyz(0, -0.3, 0))]
    held = takt.coupled(Pose.xyz(0.5, 0, 0.5), arms).with_speed(0.5)
    via, to = Pose.xyz(0.5, 0.1, 0.6), Pose.xyz(0.5, 0, 0.7)
    activities = [held.lin(to), held.circ(via, to), held.spline([via, to], speed=0.4)]
    return [activity.explain().net for activity in activities]


def devices(cell: takt.Cell) -> list[str]:
    """The nets of outputs, grippers and a mobile base."""
    plant, hand = cell.io("plant"), cell.gripper("hand")
    gripper, platform = cell.gripper("gripper"), cell.base("platform")
    full = (gripper.force > 10) & ~gripper.holds
    opened = (gripper.width > 0.04) & plant.input(1) | plant.output(2)
    level = plant.analogue_input(0) - plant.analogue_output(1) < 0.5
    turned = platform.wheel(3) > 1
    activities = [
        plant.set(3, True),
        plant.pulse(0, False, 0.25),
        plant.set_analogue(1, -2.5).until("level", level),
        hand.open(),
        hand.move_to(0.02, until={"open": hand.width > 0.01}),
        hand.with_timeout(0.25).close(),
        gripper.open(),
        gripper.with_speed(0.5).close(until={"open": opened}),
        gripper.grasp(0.05, 30, until={"full": full}),
        platform.go_to(Pose.xyz(0.3, -0.2, 0).abc(0.5, 0, 0)),
        platform.with_speed(0.5).drive([0.2, 0, -0.1], 0.25, speed=0.5, until={"turned": turned}, now=True),
    ]
    return [activity.explain().net for activity in activities]


def guided(cell: takt.Cell) -> list[str]:
    """The nets of motions under force, of frames that move and of control modes."""
    left, right = cell.arm("left"), cell.arm("right")
    gone = (left.force.z < 2).after(left.force.z > 10)
    world = cell.frame("world")
    pose = Pose.xyz(0.4, 0.1, 0.5).abc(0.1, -0.2, 3.0)
    firm = left.with_force_limits(travel=0.05, damping=1000)
    here, there = left.with_base(Pose.xyz(0, 0.3, 0)), right.with_base(Pose.xyz(0, -0.3, 0.1))
    numbers = takt.MovingFrame.of([right.joint(0), right.joint(1) * 0.5, 0.25], [0, right.joint(2), 0.5])
    activities = [
        left.press([0, 0, -1], 20),
        firm.press(takt.Direction.of_centre([0, 0, 0.5]), 10, until={"gone": gone}, speed=0.5),
        here.press_to(pose, world.direction([0, 1, -2]), 15),
        here.follow(there.centre().pose(pose)),
        here.follow(numbers.in_(world)),
        left.switch_to(takt.Control.position()),
        left.switch_to(takt.Control.joints([300] * 7, [0.7] * 7)),
        left.switch_to(takt.Control.cartesian([2000, 1000, 500, 200, 100, 50], [0.7] * 6)),
    ]
    return [activity.explain().net for activity in activities]


def test_methods_equal_keywords(cell: takt.Cell) -> None:
    left = cell.arm("left")
    far = left.joint(0) > 1
    by_keywords = left.ptp([0] * 7, speed=0.5, blend=0.2, until={"far": far}).explain().net
    assert left.ptp([0] * 7).speed(0.5).blend(0.2).until("far", far).explain().net == by_keywords


STUB = ast.parse(pathlib.Path(str(_takt.__file__)).with_name("_takt.pyi").read_text())
CLASSES = {node.name: node for node in STUB.body if isinstance(node, ast.ClassDef)}
NATIVE = [name for name, value in vars(_takt).items() if isinstance(value, type)]


def parameters(function: ast.FunctionDef) -> list[str]:
    """The names of a stub's parameters, in order."""
    given = function.args
    every = [*given.posonlyargs, *given.args, *([given.vararg] if given.vararg else []), *given.kwonlyargs]
    every += [given.kwarg] if given.kwarg else []
    return [argument.arg for argument in every]


def is_public(name: str) -> bool:
    """Whether a stub has to describe it."""
    return not name.startswith("_") or name in {"__await__", "__enter__", "__exit__", "__match_args__"}


def test_stub_functions_equal_native_ones() -> None:
    stubs = [node for node in STUB.body if isinstance(node, ast.FunctionDef)]
    for stub in stubs:
        native = inspect.signature(getattr(_takt, stub.name))
        assert list(native.parameters) == parameters(stub), stub.name
        assert ast.get_docstring(stub), f"{stub.name} has no documentation"
    natives = {name for name, value in vars(_takt).items() if is_public(name) and not isinstance(value, type)}
    assert natives <= {stub.name for stub in stubs}


@pytest.mark.parametrize("name", NATIVE)
def test_stub_class_equals_native_one(name: str) -> None:
    native: type = getattr(_takt, name)
    described: set[str] = set()
    for member in CLASSES[name].body:
        if isinstance(member, ast.AnnAssign) and isinstance(member.target, ast.Name):
            described.add(member.target.id)
            assert hasattr(native, member.target.id)
        if not isinstance(member, ast.FunctionDef):
            continue
        described.add(member.name)
        found = inspect.getattr_static(native, member.name)
        if member.name.startswith("_"):
            continue
        assert ast.get_docstring(member), f"{name}.{member.name} has no documentation"
        assert found.__doc__, f"{name}.{member.name} has no documentation at run time"
        if callable(getattr(native, member.name)):
            signature = inspect.signature(getattr(native, member.name))
            assert list(signature.parameters) == parameters(member), f"{name}.{member.name}"
    natives = {member for member in vars(native) if is_public(member)}
    assert natives <= described, natives - described


def test_package_exports_every_class() -> None:
    assert {name for name in CLASSES if not name.startswith("_")} <= set(takt.__all__)
    for name in takt.__all__:
        value = getattr(takt, name)
        assert value.__doc__, f"{name} has no documentation"
        assert not isinstance(value, type) or value.__module__ == "takt"
