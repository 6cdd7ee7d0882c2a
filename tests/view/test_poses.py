"""Where the robot was and where it was asked to be."""

from __future__ import annotations

import numpy as np
import pytest

from adapters.robots.g1 import twist_keys
from adapters.robots.kassow.names import ARM_7
from station import rotations
from station.bus import contracts, keys
from station.protocols import Floats
from station.view import poses
from station.view.poses import Numbers, Posture
from tests.episode.synthetic import ROBOT, STANDING, command
from tests.view import arms

YAW = 0.7


def numbers(key: str, values: Floats, times: tuple[int, ...] = (0,)) -> Numbers:
    contract = contracts.contract(key)
    assert contract is not None
    return Numbers(np.array(times), np.atleast_2d(values), contract)


def qpos(x: float) -> Floats:
    turned = rotations.from_rotation_vector([0.0, 0.0, YAW])
    return np.concatenate([[x, 2.0, 0.75], turned, STANDING])


def found(*items: Numbers) -> poses.Find:
    return {item.contract.key: item for item in items}.get


def measured(robot: str, *items: Numbers) -> Posture | None:
    description = contracts.description(robot)
    states = poses.state_keys(robot, [item.contract for item in items], description)
    return poses.measured(found(*items), states, description)


def asked(robot: str, where: Posture, *items: Numbers) -> Posture | None:
    commands = poses.command_keys(robot, [item.contract for item in items], contracts.description(robot))
    return poses.asked(found(*items), commands, where)


def test_ground_truth_is_preferred() -> None:
    state = np.concatenate([STANDING + 1, np.zeros(29), [1.0, 0, 0, 0], np.zeros(3)])
    where = measured(ROBOT, numbers(keys.robot_state(ROBOT), state), numbers(keys.sim_qpos(ROBOT), qpos(1.0)))
    assert where is not None
    assert where.root[0, :3] == pytest.approx([1.0, 2.0, 0.75])
    assert where.q[0] == pytest.approx(STANDING)
    assert where.joints[0] == "left_hip_pitch"


def test_robot_that_does_not_know_its_place_stays_in_it() -> None:
    state = np.concatenate([STANDING, np.zeros(29), [1.0, 0, 0, 0], np.zeros(3)])
    where = measured(ROBOT, numbers(keys.robot_state(ROBOT), state))
    assert where is not None
    assert where.root[0] == pytest.approx([0, 0, poses.STANDING_M, 1, 0, 0, 0])
    assert where.q.shape == (1, 29)


def test_state_of_a_stock_server_poses_the_robot_too() -> None:
    values = np.concatenate([np.zeros(3), [0.1, 0.2], STANDING])
    where = measured(ROBOT, numbers(twist_keys.state_body(ROBOT), values))
    assert where is not None
    assert rotations.roll_pitch_yaw(where.root[0, 3:]) == pytest.approx([0.1, 0.2, 0.0])


def test_robot_of_which_nothing_is_known_is_not_posed() -> None:
    assert measured(ROBOT) is None


def test_reference_has_height_roll_and_pitch_of_the_command_and_place_and_heading_of_the_robot() -> None:
    values = command(STANDING + 0.1, height=0.6)
    values[3:5] = (0.1, -0.2)
    truth = numbers(keys.sim_qpos(ROBOT), np.stack([qpos(1.0), qpos(3.0)]), times=(0, 100))
    where = measured(ROBOT, truth)
    assert where is not None
    ghost = asked(ROBOT, where, numbers(keys.command_used(ROBOT), np.stack([values, values]), times=(50, 150)))
    assert isinstance(ghost, Posture)
    assert ghost.root[:, :3] == pytest.approx(np.array([[1.0, 2.0, 0.6], [3.0, 2.0, 0.6]]))
    assert rotations.roll_pitch_yaw(ghost.root[0, 3:]) == pytest.approx([0.1, -0.2, YAW])
    assert ghost.q[0] == pytest.approx(STANDING + 0.1)


def test_without_a_gate_the_command_on_the_bus_is_the_reference() -> None:
    where = measured(ROBOT, numbers(keys.sim_qpos(ROBOT), qpos(0.0)))
    assert where is not None
    hand = numbers(twist_keys.action_hand("left"), np.ones(7))
    ghost = asked(ROBOT, where, hand, numbers(twist_keys.action_body(), command(height=0.5)))
    assert ghost is not None
    assert ghost.root[0, 2] == 0.5


def test_an_arm_stands_at_the_origin_and_is_asked_for_what_its_gate_let_through() -> None:
    at = numbers(keys.state_joints(arms.ROBOT), np.concatenate([arms.START, np.zeros(14)]))
    bus = numbers(keys.action_joints(arms.ROBOT), arms.START + 0.2)
    where = measured(arms.ROBOT, at)
    assert where is not None
    assert where.root[0] == pytest.approx([0, 0, 0, 1, 0, 0, 0])
    assert where.joints == ARM_7
    assert where.q[0] == pytest.approx(arms.START)
    used = numbers(keys.command_used(arms.ROBOT), arms.START + 0.1)
    for told, q in (((at, bus), arms.START + 0.2), ((at, bus, used), arms.START + 0.1)):
        ghost = asked(arms.ROBOT, where, *told)
        assert ghost is not None
        assert ghost.q[0] == pytest.approx(q)
        assert ghost.root == pytest.approx(where.root)
