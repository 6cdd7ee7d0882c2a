"""HOMIE's channels and the parts of a G1's command: each number has its place, both ways."""

from __future__ import annotations

import numpy as np
import pytest

from adapters.lcm.homie import CHANNELS, Legs, command_of, routes
from adapters.policies.homie import HomiePolicy
from station.contract import names_of

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
