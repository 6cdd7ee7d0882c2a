"""Each joint is led alone, softly, and all that the policy remembers stands in its observation."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from adapters.policies.default_pose import DefaultPosePolicy
from adapters.policies.joint_by_joint import JointByJointPolicy
from station import assets
from station.errors import ConfigError
from station.protocols import Floats, RobotState
from tests.adapters.policies.restored import expect_forgets, expect_goes_on

STATE = RobotState(mono_ns=0, q=np.zeros(29), dq=np.zeros(29), quat_wxyz=np.array([1.0, 0, 0, 0]), gyro=np.zeros(3))
COMMAND = np.zeros(0)


def made(**options: Any) -> JointByJointPolicy:
    return JointByJointPolicy(assets.resolve("builtin:tracker.onnx"), **options)


def led(policy: JointByJointPolicy, seconds: float) -> Floats:
    """Return how far each joint is led from the pose, shape (steps, 29) [rad]."""
    rows = [
        policy.targets(policy.act(policy.observe(STATE, COMMAND)), COMMAND).q - policy.spec.default_q
        for _ in range(round(seconds * policy.spec.rate_hz))
    ]
    return np.array(rows)


def test_one_joint_after_the_other_is_led_to_both_sides_and_back_and_no_two_at_once() -> None:
    policy = made(joint_s=0.4, lead_rad=0.05)
    rows = led(policy, policy.sweep_s)
    assert np.allclose(rows.max(axis=0), 0.05, atol=0.002)
    assert np.allclose(rows.min(axis=0), -0.05, atol=0.002)
    is_led = np.abs(rows) > 1e-6
    assert is_led.sum(axis=1).max() == 1
    firsts = is_led.argmax(axis=0)
    assert (np.diff(firsts) > 0).all(), "in the order of the joints"
    assert firsts[0] >= policy.spec.rate_hz, "nothing while it takes over"
    assert np.abs(np.diff(rows, axis=0)).max() < 0.02, "rad in a control period"
    assert (policy.spec.kp == 10.0).all()


def test_it_begins_anew_behind_the_last_joint_and_leads_those_that_were_named() -> None:
    policy = made(joint_s=0.4, joints=["left_knee", "*_elbow"])
    names = np.array(policy.spec.joint_names)
    rows = led(policy, 2 * policy.sweep_s)
    assert sorted(names[np.abs(rows).max(axis=0) > 0.01]) == ["left_elbow", "left_knee", "right_elbow"]
    knee = np.flatnonzero(np.abs(rows[:, 3]) > 1e-6)
    assert (np.diff(knee) > 1).sum() >= 2, "twice, with the others between"


def test_its_observation_is_all_that_it_remembers() -> None:
    steps = [(STATE, COMMAND)] * 120
    expect_goes_on(made(), made(), steps, is_run=False)
    expect_goes_on(made(), made(), steps, is_run=True)
    expect_forgets(made(), steps)


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"kp": 0.0}, "joint-by-joint: kp is 0.0; expected more than 0, and 50 at most"),
        ({"kp": "soft"}, "joint-by-joint: kp is 'soft'"),
        ({"lead_rad": 1.0}, "joint-by-joint: lead_rad is 1.0; expected more than 0, and 0.2 at most"),
        ({"joint_s": float("nan")}, "joint-by-joint: joint_s is nan"),
        ({"joints": ["left_kne"]}, "joint-by-joint: joints: 'left_kne' is none of left_hip_pitch, "),
    ],
)
def test_what_no_joint_should_be_moved_with_is_refused(options: dict[str, Any], told: str) -> None:
    with pytest.raises(ConfigError) as refused:
        made(**options)
    assert str(refused.value).startswith(told)


def test_a_default_pose_may_be_held_softly() -> None:
    checkpoint = assets.resolve("builtin:tracker.onnx")
    soft = DefaultPosePolicy(checkpoint, kp=10.0)
    assert (soft.spec.kp == 10.0).all()
    assert (soft.spec.default_q == DefaultPosePolicy(checkpoint).spec.default_q).all()
    with pytest.raises(ConfigError, match=r"^default-pose: kp is -1; expected more than 0 N m/rad$"):
        DefaultPosePolicy(checkpoint, kp=-1)
