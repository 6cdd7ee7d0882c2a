"""HOMIE's channels and the parts of a G1's command: each number has its place, both ways."""

from __future__ import annotations

import struct

import numpy as np
import pytest

from adapters.lcm.homie import (
    CHANNELS,
    TARGETS_CHANNEL,
    Legs,
    command_of,
    leg_command,
    low_level_of,
    low_level_routes,
    robot_messages,
    routes,
)
from adapters.policies.homie import HomiePolicy
from station.contract import names_of
from station.rotations import from_roll_pitch_yaw

SIDES = ("left", "right")
ARM = ("shoulder_pitch", "shoulder_roll", "shoulder_yaw", "elbow", "wrist_roll", "wrist_pitch", "wrist_yaw")


def names(robot: str, legs: Legs, *, hands: bool) -> dict[str, list[str]]:
    """Return the names of a channel's numbers, as far as a robot takes them."""
    found = routes(command_of(robot, legs, hands=hands))
    return {each.channel.name: [name for part in each.formats for name in names_of(part.elements)] for each in found}


def test_numbers_of_a_channel_are_in_homies_order() -> None:
    found = names("g1_dex3", "velocity-height", hands=True)
    assert list(found) == ["pedal_command", "arm_action", "hand_action"]
    assert found["pedal_command"] == ["vx", "vy", "wz", "root_height"]
    assert [name.removesuffix("_pos") for name in found["arm_action"]] == [f"{s}_{j}" for s in SIDES for j in ARM]
    # OpenHomie's table of the hands' limits is of a Dex3-1's motors: thumb 0 to 2, middle 0 and 1, index 0 and 1; the
    # right hand's fingers are the other way round in ours as well.
    left = [name for name in found["hand_action"] if name.startswith("left")]
    assert [name.removeprefix("left_hand_")[:5] for name in left] == ["thumb"] * 3 + ["middl"] * 2 + ["index"] * 2


def test_without_hands_the_channel_of_hands_is_none_of_the_robots() -> None:
    assert list(names("g1_29", "velocity-height", hands=False)) == ["pedal_command", "arm_action"]


def test_keys_are_those_that_the_robot_of_that_name_hears() -> None:
    keys = [each.key for route in routes(command_of("g1_29", "velocity", hands=False)) for each in route.formats]
    assert keys == ["action_velocity_g1_29_legs", "action_joints_g1_29_left_arm", "action_joints_g1_29_right_arm"]


@pytest.mark.parametrize("legs", ["velocity", "velocity-height"])
def test_numbers_come_back_as_they_went_and_a_height_that_legs_lack_is_that_of_a_stand(legs: Legs) -> None:
    for route in routes(command_of("g1_dex3", legs, hands=True)):
        numbers = [index / 10 for index in range(route.channel.kind.fields[0].length)]
        back = route.numbers(route.commands(numbers))
        if legs == "velocity" and route.channel is CHANNELS[0]:
            numbers[3] = 0.74
        assert back == numbers


def test_legs_are_kept_within_what_homies_policy_was_trained_on() -> None:
    legs = command_of("g1_29", "velocity-height", hands=False).parts[0]
    assert np.array_equal(np.stack([legs.lower, legs.upper], axis=1), HomiePolicy.RANGE)


# -- What passes between HOMIE's policy and a robot, byte by byte ------------------------------------------------------
RPY = [0.02, -0.05, 1.2]
GYRO = [0.1, -0.2, 0.3]
Q, DQ = [index / 100 for index in range(29)], [-index / 10 for index in range(29)]


def told(*, is_pressed: bool = False) -> dict[str, bytes]:
    return robot_messages(np.array([*Q, *DQ, *from_roll_pitch_yaw(RPY), *GYRO]), is_pressed=is_pressed)


def test_a_robot_tells_homies_policy_of_itself_on_three_channels() -> None:
    assert {channel: len(message) for channel, message in told().items()} == {
        "state_estimator_data": 144, "body_control_data": 248, "rc_command": 46,
    }  # fmt: skip


def test_joints_are_in_unitrees_order_positions_then_velocities_and_no_time() -> None:
    assert told()["body_control_data"] == struct.pack(">Q29f29fq", 0xF4F03934711BF8B5, *Q, *DQ, 0)


def test_the_state_is_roll_pitch_yaw_gyro_and_accelerometer_and_nothing_else() -> None:
    message = told()["state_estimator_data"]
    assert message[:8] == bytes.fromhex("08bc31f1b8da88f4")
    assert message[8:32] == struct.pack(">6f", *RPY, *GYRO)
    down = np.array(struct.unpack(">3f", message[32:44]))
    assert np.linalg.norm(down) == pytest.approx(9.81)
    assert down[2] > 9.7, "an accelerometer at rest feels what holds it up"
    assert message[44:] == bytes(100)


def test_of_the_remote_only_r2_is_ever_down() -> None:
    head = bytes.fromhex("8ee4d605d87cfbc5")
    assert told()["rc_command"] == head + bytes(38)
    assert told(is_pressed=True)["rc_command"] == head + bytes(36) + b"\0\1"


def test_of_the_policys_29_targets_the_first_12_are_the_legs() -> None:
    message = struct.pack(">Q29d29dq", 0x86DB34943194C221, *Q, *[0.0] * 29, 1_700_000_000_000_000)
    assert len(message) == 480
    numbers = TARGETS_CHANNEL.kind.decode(message)[TARGETS_CHANNEL.field]
    legs, arms = low_level_routes(low_level_of("g1_29"))
    (vector,) = legs.commands(leg_command(numbers))
    assert vector == [*Q[:12], 1.0]
    assert [each.key for each in (*legs.formats, *arms.formats)] == [
        "action_targets_g1_29_legs", "action_joints_g1_29_left_arm", "action_joints_g1_29_right_arm",
    ]  # fmt: skip
    joints = [name.removesuffix("_pos") for name in names_of(legs.formats[0].elements)]
    leg = ("hip_pitch", "hip_roll", "hip_yaw", "knee", "ankle_pitch", "ankle_roll")
    assert joints == [*(f"{side}_{joint}" for side in SIDES for joint in leg), "share"]
