"""The built-in policies that follow velocities: what they see, what they ask of the motors, and that they walk."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from adapters.commands import twist2
from adapters.policies.walk.policy import G1WalkPolicy, Go2WalkPolicy, WalkPolicy
from adapters.robots.g1.joints import G1_29
from adapters.robots.legged.unitree import GO2
from station import assets as files
from station.control.parted_path import samples_of
from station.control.rig import Rig, RigConfig, build
from station.control.tracking import VelocityFound, VelocityTracking
from station.errors import BadFile
from station.protocols import Floats
from tests.adapters.policies.restored import expect_forgets, expect_goes_on
from tests.adapters.policies.velocity_inputs import gravity, inputs

POLICIES = [Go2WalkPolicy, G1WalkPolicy]
ROBOTS = {Go2WalkPolicy: "go2-mujoco", G1WalkPolicy: "g1-mujoco"}


def built_in(kind: type[WalkPolicy]) -> WalkPolicy:
    return kind(files.resolve(kind.CHECKPOINT))


@pytest.fixture(params=POLICIES, ids=lambda kind: kind.NAME)
def kind(request: pytest.FixtureRequest) -> type[WalkPolicy]:
    return request.param


def test_it_sees_five_frames_oldest_first_zero_at_the_start(kind: type[WalkPolicy]) -> None:
    policy, steps = built_in(kind), inputs(7, len(kind.JOINTS))
    frames, previous = [np.zeros(kind.FRAME, np.float32)] * 5, np.zeros(kind.ACTIONS, np.float32)
    for state, command in steps:
        whole = [state.gyro, gravity(state.quat_wxyz), command, state.q - kind.DEFAULT_Q, state.dq * 0.05, previous]
        frames = [*frames[1:], np.concatenate(whole).astype(np.float32)]
        observation = policy.observe(state, command)
        np.testing.assert_allclose(observation, np.concatenate(frames), atol=1e-6)
        previous = policy.act(observation)


def test_targets_are_offsets_of_the_joints_that_it_drives_and_the_others_are_held(kind: type[WalkPolicy]) -> None:
    policy = built_in(kind)
    action = np.linspace(-1, 1, kind.ACTIONS).astype(np.float32)
    made = policy.targets(action, np.zeros(3))
    expected = policy.spec.default_q.copy()
    expected[: kind.ACTIONS] += kind.SCALE * action.astype(np.float64)
    np.testing.assert_array_equal(made.q, expected)


def test_joints_are_those_of_the_robots_table() -> None:
    assert GO2.joint_names == Go2WalkPolicy.JOINTS
    assert G1WalkPolicy.JOINTS == G1_29
    np.testing.assert_array_equal(built_in(G1WalkPolicy).spec.default_q[15:], twist2.FORMAT.default[-14:])


@pytest.mark.parametrize("is_run", [False, True])
def test_it_goes_on_from_a_recorded_observation(kind: type[WalkPolicy], is_run: bool) -> None:
    expect_goes_on(built_in(kind), built_in(kind), inputs(6, len(kind.JOINTS)), is_run=is_run)


def test_reset_forgets_everything(kind: type[WalkPolicy]) -> None:
    expect_forgets(built_in(kind), inputs(5, len(kind.JOINTS)))


def test_the_file_of_another_robot_is_refused() -> None:
    with pytest.raises(BadFile, match=r"go2-walk.onnx: expected one float input \[batch, 410\]"):
        G1WalkPolicy(files.resolve("builtin:go2-walk.onnx"))


@pytest.mark.parametrize(
    ("kind", "command", "within"),
    [
        (Go2WalkPolicy, (0.0, 0.0, 0.0), 0.02), (Go2WalkPolicy, (0.8, 0.0, 0.4), 0.12),
        (G1WalkPolicy, (0.0, 0.0, 0.0), 0.05), (G1WalkPolicy, (0.5, 0.0, 0.4), 0.12),
    ],
)  # fmt: skip
def test_it_stands_and_walks_as_it_is_asked(kind: type[WalkPolicy], command: Floats, within: float) -> None:
    rig = build(RigConfig(robot=ROBOTS[kind], policy=kind.NAME, robot_options={"physics_dt_s": 0.002}))
    (stretch,) = follow(rig, command, seconds=6.0).stretches
    np.testing.assert_allclose(stretch.measured, command, atol=within)


def follow(rig: Rig, command: Floats, seconds: float) -> VelocityFound:
    """Ask for a velocity from a stand on; fail at a fall."""
    control, tracking = rig.control(), VelocityTracking(("vx", "vy", "wz"), rig.period_s)
    for tick in range(round(seconds / rig.period_s)):
        now_s = tick * rig.period_s
        record = control.step(control.sense(), samples_of(rig.command_format, np.array(command), now_s), now_s)
        assert record.fall is None, f"fell at {now_s:.2f} s"
        place = rig.robot.qpos  # type: ignore[attr-defined]
        tracking.add(tick, now_s, np.array(command), place[:3], place[3:7])
    found = tracking.found()
    assert found is not None
    return found


def test_nothing_is_left_of_how_it_was_made_in_what_is_installed() -> None:
    folder = Path(files.resolve("builtin:go2-walk.onnx")).parent
    assert {path.name for path in folder.iterdir() if path.name != "__pycache__"} == {
        "__init__.py", "policy.py", "MODEL_CARD.md", "g1-walk.onnx", "go2-walk.onnx", "go2-walk.envelope.yaml",
    }  # fmt: skip
