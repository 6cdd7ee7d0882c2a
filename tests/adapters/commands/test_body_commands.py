from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from adapters.commands import twist, twist2
from adapters.commands.body import BodyCommand
from adapters.motions.load import load
from adapters.robots.g1 import twist_keys
from adapters.robots.g1.joints import G1_29
from station import registry, rotations
from station.bus import contracts
from station.contract import positions
from station.errors import ConfigError
from station.protocols import CommandFormat, Reference

BOTH = [twist.FORMAT, twist2.FORMAT]
REFERENCE = Reference(
    root_pos=np.array([5.0, 6.0, 0.7]),
    root_quat_wxyz=rotations.multiply(
        rotations.from_rotation_vector([0.0, 0.0, 0.3]),
        rotations.multiply(rotations.from_rotation_vector([0, 0.2, 0]), rotations.from_rotation_vector([0.1, 0, 0])),
    ),
    root_lin_vel=np.array([1.0, 2.0, 3.0]),
    root_ang_vel=np.array([4.0, 5.0, 6.0]),
    q=np.arange(29) / 100,
)


def test_twist2_puts_the_root_into_six_numbers_and_the_29_joints_behind() -> None:
    vector = twist2.FORMAT.encode(REFERENCE, G1_29)
    np.testing.assert_allclose(vector[:6], [1.0, 2.0, 0.7, 0.1, 0.2, 6.0])
    np.testing.assert_array_equal(vector[6:], REFERENCE.q)


def test_twist_puts_the_root_into_eight_numbers_and_25_joints_behind() -> None:
    vector = twist.FORMAT.encode(REFERENCE, G1_29)
    np.testing.assert_allclose(vector[:8], [0.7, 0.1, 0.2, 0.3, 1.0, 2.0, 3.0, 6.0])
    np.testing.assert_allclose(vector[8:] * 100, [*range(20), *range(22, 27)])
    assert vector[27] == REFERENCE.q[19]  # left wrist roll, which bypasses the policy
    assert vector[32] == REFERENCE.q[26]


@pytest.mark.parametrize("command_format", BOTH, ids=lambda command_format: command_format.name)
def test_joints_are_picked_by_name_not_by_place(command_format: BodyCommand) -> None:
    order = np.random.default_rng(0).permutation(29)
    shuffled = Reference(REFERENCE.root_pos, REFERENCE.root_quat_wxyz, REFERENCE.root_lin_vel,
                         REFERENCE.root_ang_vel, REFERENCE.q[order])  # fmt: skip
    names = tuple(G1_29[index] for index in order)
    np.testing.assert_array_equal(command_format.encode(shuffled, names), command_format.encode(REFERENCE, G1_29))
    with pytest.raises(ConfigError, match="no joint"):
        command_format.encode(REFERENCE, names[:10])


def test_defaults_are_those_of_the_stock_servers() -> None:
    leg = [-0.2, 0, 0, 0.4, -0.2, 0]
    arm2 = [0, 0.4, 0, 1.2, 0, 0, 0]
    expected2 = [0, 0, 0.8, 0, 0, 0, *leg, *leg, 0, 0, 0, *arm2, 0, -0.4, *arm2[2:]]
    np.testing.assert_array_equal(twist2.FORMAT.default, expected2)
    arm1 = [0, 0.2, 0, 1.2, 0]
    expected1 = [0.793, 0, 0, 0, 0, 0, 0, 0, *leg, *leg, 0, 0, 0, *arm1, 0, -0.2, *arm1[2:]]
    np.testing.assert_array_equal(twist.FORMAT.default, expected1)


def test_companions_are_what_stock_readers_need_beside_the_vector() -> None:
    sizes = {key: value.tolist() for key, value in twist2.FORMAT.auxiliary.items()}
    suffix = "unitree_g1_with_hands"
    assert sizes == {
        f"action_hand_left_{suffix}": [0] * 7,
        f"action_hand_right_{suffix}": [0] * 7,
        f"action_neck_{suffix}": [0] * 2,
    }
    assert {key: value.tolist() for key, value in twist.FORMAT.auxiliary.items()} == {"action_hand_g1": [0] * 14}
    assert (twist.FORMAT.key, twist2.FORMAT.key) == ("action_mimic_g1", f"action_body_{suffix}")
    assert (twist.FORMAT.robot, twist2.FORMAT.robot) == (twist_keys.TWIST_ROBOT, twist_keys.TWIST2_ROBOT)


@pytest.mark.parametrize("command_format", BOTH, ids=lambda command_format: command_format.name)
def test_a_format_fits_its_contract_and_its_registration(command_format: BodyCommand) -> None:
    found: CommandFormat = registry.find("command", command_format.name)
    assert found is command_format
    described = contracts.contract(command_format.key)
    assert described is not None
    count = len(described.elements)
    assert [
        len(vector)
        for vector in (command_format.default, command_format.lower, command_format.upper, command_format.margin)
    ] == [count] * 4
    assert described.names[-len(command_format.joint_names) :] == positions(command_format.joint_names)


@pytest.mark.parametrize("command_format", BOTH, ids=lambda command_format: command_format.name)
def test_the_default_lies_within_the_range_and_nobody_can_change_it(command_format: BodyCommand) -> None:
    assert (command_format.lower < command_format.default).all()
    assert (command_format.default < command_format.upper).all()
    assert (command_format.margin > 0).all()
    with pytest.raises(ValueError, match="read-only"):
        command_format.default[0] = 9.0


@pytest.mark.assets
@pytest.mark.parametrize("command_format", BOTH, ids=lambda command_format: command_format.name)
def test_no_frame_of_the_six_example_motions_would_be_refused(assets: Path, command_format: BodyCommand) -> None:
    for number in range(1, 7):
        clip = load(f"twist2:motions/0807_yanjie_walk_{number:03}.pkl")
        for time_s in np.arange(0.0, clip.duration_s, 0.1):
            vector = command_format.encode(clip.at(time_s), clip.joint_names)
            beyond = np.maximum(command_format.lower - vector, vector - command_format.upper)
            assert (beyond < 1e-6).all(), (number, time_s, beyond.argmax())
