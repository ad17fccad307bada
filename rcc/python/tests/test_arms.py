"""Arms from URDF files of ten makers against Pinocchio: forward kinematics, Jacobian and torques of random states."""

from __future__ import annotations

import json
import pathlib
import subprocess
from typing import Any

import numpy
import pytest

from conftest import program

pin: Any = pytest.importorskip("pinocchio", reason="needs the package pin")
data: Any = pytest.importorskip("cmeel", reason="needs the package example-robot-data")

STATES = 1000
"""Random states of each of the ten arms."""

ROBOTS = pathlib.Path(data.__file__).parent.parent / "cmeel.prefix/share/example-robot-data/robots"

ARMS = [
    # File, base and tip where they are not plain, and the structure that its axes have.
    ("panda_description/urdf/panda.urdf", "panda_link0", "panda_link8", "general"),
    ("ur_description/urdf/ur5_robot.urdf", None, None, "three parallel"),
    ("xarm_description/urdf/xarm7.urdf", None, None, "general"),
    ("z1_description/urdf/z1.urdf", None, None, "three parallel"),
    ("kinova_description/robots/kinova.urdf", None, None, "ortho-parallel"),
    ("so_arm_description/urdf/so100.urdf", None, None, "general"),
    ("baxter_description/urdf/baxter.urdf", "base", "left_hand_link", "general"),
    ("talos_data/robots/talos_left_arm.urdf", None, None, "general"),
    ("tiago_description/robots/tiago_no_hand.urdf", "torso_fixed_link", "arm_tool_link", "general"),
    ("pr2_description/urdf/pr2.urdf", "base_footprint", "r_gripper_tool_frame", "general"),
]


class Peer:
    """The same arm in Pinocchio: all joints but its own stay at 0."""

    def __init__(self, file: pathlib.Path, arm: dict[str, Any]) -> None:
        self.model = pin.buildModelFromUrdf(str(file))
        self.model.gravity.linear = numpy.array([0.0, 0.0, -9.80665])
        self.data = self.model.createData()
        self.joints = [self.model.getJointId(name) for name in arm["joints"]]
        self.base = self.model.getFrameId(arm["base"], pin.FrameType.BODY)
        self.tip = self.model.getFrameId(arm["tip"], pin.FrameType.BODY)

    def configuration(self, positions: Any) -> Any:
        """Its configuration: of a continuous joint, cosine and sine."""
        configuration = pin.neutral(self.model)
        for joint, position in zip(self.joints, positions, strict=True):
            model = self.model.joints[joint]
            value = [numpy.cos(position), numpy.sin(position)] if model.nq == 2 else [position]
            configuration[model.idx_q : model.idx_q + model.nq] = value
        return configuration

    def ordered(self, values: Any) -> Any:
        """Values by joint of the arm in its own order."""
        ordered = numpy.zeros(self.model.nv)
        for joint, value in zip(self.joints, values, strict=True):
            ordered[self.model.joints[joint].idx_v] = value
        return ordered

    def answer(self, state: Any) -> tuple[Any, Any, Any]:
        """Flange in the base, Jacobian and torques of a state."""
        configuration = self.configuration(state[0])
        pin.framesForwardKinematics(self.model, self.data, configuration)
        base, tip = self.data.oMf[self.base], self.data.oMf[self.tip]
        aligned = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        jacobian = pin.computeFrameJacobian(self.model, self.data, configuration, self.tip, aligned)
        turn = base.rotation.T
        jacobian = numpy.vstack([turn @ jacobian[:3], turn @ jacobian[3:]])
        speeds, rates = self.ordered(state[1]), self.ordered(state[2])
        torques = pin.rnea(self.model, self.data, configuration, speeds, rates)
        columns = [self.model.joints[joint].idx_v for joint in self.joints]
        return base.actInv(tip), jacobian[:, columns], torques[columns]


@pytest.mark.parametrize(("name", "base", "tip", "structure"), ARMS, ids=lambda it: str(it).split("/")[-1])
def test_urdf_matches_pinocchio(name: str, base: str | None, tip: str | None, structure: str) -> None:
    file = ROBOTS / name
    if not file.exists():
        pytest.skip(f"needs {name} of the package example-robot-data")
    links = [base or "", tip or ""] if base or tip else []
    command = [program("urdf"), str(file), *links]
    random = numpy.random.default_rng(1)
    described = subprocess.run(command, input="", capture_output=True, text=True, check=True)
    arm = json.loads(described.stdout)
    assert arm["structure"].startswith(structure)
    peer = Peer(file, arm)
    states = random.uniform(-1.5, 1.5, (STATES, 3, len(arm["joints"])))
    lines = "".join(" ".join(map(repr, map(float, state.ravel()))) + "\n" for state in states)
    answers = subprocess.run(command, input=lines, capture_output=True, text=True, check=True).stdout.splitlines()
    own = [json.loads(line) for line in answers[1:]]
    peers = [peer.answer(state) for state in states]

    def stacked(key: str) -> Any:
        return numpy.array([answer[key] for answer in own])

    assert len(own) == STATES
    places = numpy.array([flange.translation for flange, _, _ in peers])
    assert numpy.abs(stacked("position") - places).max() < 1e-9
    turns = numpy.array([pin.Quaternion(flange.rotation).coeffs() for flange, _, _ in peers])
    # A quaternion and its negative are the same rotation.
    apart = [numpy.abs(stacked("quaternion") - sign * turns).max(axis=1) for sign in (1, -1)]
    assert numpy.minimum(*apart).max() < 1e-9
    jacobians = numpy.array([jacobian for _, jacobian, _ in peers])
    assert numpy.abs(stacked("jacobian").transpose(0, 2, 1) - jacobians).max() < 1e-9
    if own[0]["torques"] is not None:
        torques = numpy.array([torques for _, _, torques in peers])
        assert numpy.allclose(stacked("torques"), torques, rtol=1e-9, atol=1e-9)
