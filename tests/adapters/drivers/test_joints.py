"""A leader arm: no engaging from afar, gently to it, and then as fast as it is."""

from __future__ import annotations

import numpy as np
import pytest

from adapters.commands.twist2 import FORMAT
from adapters.drivers.joints import APART_RAD, GENTLE_RAD_S, JointsDriver, JointsOptions
from adapters.retarget.arm_ik import ARMS
from adapters.robots.g1 import twist_keys
from station.operator.deadman import Snapshot
from station.operator.sample import OperatorSample
from station.protocols import Floats

from .operators import TICK_S

STANDING = np.array(FORMAT.default[21:28])
LEFT_ARM = slice(21, 28)


def engaged(leader: Floats, options: JointsOptions | None = None) -> tuple[JointsDriver, Snapshot]:
    driver = JointsDriver(options)
    snapshot = Snapshot(leader, driver.target)
    driver.step(OperatorSample(joints=leader), snapshot, TICK_S)
    return driver, snapshot


def test_a_leader_that_is_far_away_may_not_begin_and_is_told_what_to_move_where() -> None:
    leader = STANDING.copy()
    leader[3] += APART_RAD + 0.1
    leader[0] -= 1.0
    look = JointsDriver().inspect(OperatorSample(joints=leader))
    assert look.why_not_engage == (
        "leader is too far from the robot; move it (rad): left_shoulder_pitch by +1.00, left_elbow by -0.90"
    )
    table = JointsDriver().differences(leader)
    assert [row.joint for row in table] == list(ARMS[:7])
    assert table[3].move == pytest.approx(-0.9)


def test_a_leader_that_is_near_may_begin() -> None:
    assert JointsDriver().inspect(OperatorSample(joints=STANDING + 0.7)).why_not_engage == ""


def test_the_robot_goes_gently_to_its_leader_and_then_follows_at_once() -> None:
    leader = STANDING + 0.5 * np.array([1, 0, 0, -1, 0, 0, 0])
    driver, snapshot = engaged(leader)
    before = driver.target
    for _ in range(50):
        driver.step(OperatorSample(joints=leader), snapshot, TICK_S)
        assert (np.abs(driver.target - before) <= GENTLE_RAD_S * TICK_S + 1e-9).all()
        before = driver.target
    for _ in range(100):
        driver.step(OperatorSample(joints=leader), snapshot, TICK_S)
    assert driver.target == pytest.approx(leader)
    leader = leader + 0.05
    driver.step(OperatorSample(joints=leader), snapshot, TICK_S)
    assert driver.target == pytest.approx(leader)


def test_the_command_carries_the_joints_and_stays_in_their_ranges() -> None:
    driver, snapshot = engaged(STANDING)
    for step in range(400):
        leader = STANDING + 0.02 * step * np.array([0, 1, 0, 0, 0, 1, 0])
        command = driver.step(OperatorSample(joints=leader), snapshot, TICK_S)
    assert command[LEFT_ARM][[1, 5]] == pytest.approx(FORMAT.upper[LEFT_ARM][[1, 5]])


def test_values_after_the_joints_close_the_hands() -> None:
    options = JointsOptions(grippers=("left",))
    driver, snapshot = engaged(np.append(STANDING, 0.0), options)
    for _ in range(30):
        driver.step(OperatorSample(joints=np.append(STANDING, 1.0)), snapshot, TICK_S)
    assert driver.auxiliary[twist_keys.action_hand("left")][1] == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("joints", "why_not"),
    [
        (None, "the leader sends no joints"),
        (np.zeros(6), "the leader sends 6 values, expected 7 numbers"),
        (np.full(7, np.nan), "the leader sends 7 values, expected 7 numbers"),
    ],
)
def test_a_leader_that_does_not_fit_is_refused(joints: Floats | None, why_not: str) -> None:
    assert JointsDriver().inspect(OperatorSample(joints=joints)).why_not == why_not


def test_a_joint_that_comes_back_a_turn_off_is_a_jump() -> None:
    now = STANDING + 2 * np.pi * np.eye(7)[3]
    assert JointsDriver().jump(STANDING, now) == "left_elbow jumped 6.28 rad between two samples (limit 0.8)"


@pytest.mark.parametrize("joints", [("left_knee",), (), ("left_elbow", "left_elbow"), ("left_elbo",)])
def test_joints_that_cannot_be_led_are_refused(joints: tuple[str, ...]) -> None:
    with pytest.raises(ValueError, match="expected"):
        JointsOptions(joints=joints)
