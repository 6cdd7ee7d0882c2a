"""The velocity command: one format for every robot on legs, and what becomes of it on its way to one."""

from __future__ import annotations

import math

import numpy as np
import pytest

from adapters.commands.velocity import FORMAT
from station import registry
from station.bus import codec, contracts
from station.command_formats import command_format, command_formats, expect_robot
from station.control.arming import Arming
from station.control.command_path import CommandPath
from station.control.command_validator import CommandSample
from station.control.gate import GateConfig
from station.errors import ConfigError
from station.protocols import CommandFormat, ForAnyRobot, Reference
from station.rotations import from_rotation_vector, multiply, rotate_inverse

DT = 0.02
GO2 = FORMAT.for_robot("go2", lower=np.array([-1.0, -0.5, -0.5]), upper=np.array([2.0, 0.5, 0.5]))


def path(of: CommandFormat = GO2) -> CommandPath:
    return CommandPath(of, GateConfig(), Arming(is_armed=True))


def drive(commanded: CommandPath, *values: float, ticks: int, start: int = 0) -> list[np.ndarray]:
    """Let through what a writer gives in each tick."""
    made = []
    for tick in range(start, start + ticks):
        sample = CommandSample(codec.json_vector(list(values)), tick * DT, seq=tick + 1)
        made.append(commanded.decide(sample, tick * DT).vector)
    return made


def test_a_robot_gives_the_format_its_name_and_its_key_and_no_other_robot_has_it() -> None:
    assert registry.find("command", "velocity") is FORMAT
    assert isinstance(FORMAT, ForAnyRobot)
    assert (FORMAT.robot, FORMAT.key) == ("", "")
    assert (GO2.robot, GO2.key) == ("go2", "action_velocity_go2")
    keys = [each.key for each in command_formats(["go2", "h1", "go2"])]
    assert [key for key in keys if "velocity" in key] == ["action_velocity_go2", "action_velocity_h1"]


@pytest.mark.parametrize("key", ["action_velocity_go2", "action_velocity_left_dog_of_two"])
def test_its_key_is_recorded_with_names_and_units_whatever_the_robot_is_called(key: str) -> None:
    described = contracts.contract(key)
    assert described is not None
    assert [element.title for element in described.elements] == ["vx [m/s]", "vy [m/s]", "wz [rad/s]"]
    assert (described.role, described.codec, described.family) == ("command", "json-vector", "velocity")
    assert "heading frame" in described.note
    assert all(item.key for item in contracts.contracts()), "a format for any robot has no key of its own"


def test_a_velocity_beyond_what_the_policy_was_trained_on_is_clamped_and_told_once() -> None:
    commanded = path()
    made = drive(commanded, 2.5, -0.3, 0.9, ticks=80)
    np.testing.assert_array_equal(made[-1], [2.0, -0.3, 0.5])
    assert max(np.abs(each - [0, 0, 0]).max() for each in made) == 2.0
    told = [each for each in commanded.taken() if each.name == "command-clamped"]
    assert [each.detail for each in told] == [
        {"elements": ["vx", "wz"], "allowed": {"vx": [-1.0, 2.0], "wz": [-0.5, 0.5]}}
    ]
    drive(commanded, 1.0, 0.0, 0.0, ticks=60, start=80)
    (ended,) = [each.detail for each in commanded.taken() if each.name == "command-clamped"]
    assert (ended["ended"], ended["elements"], ended["ticks"]) == (True, ["vx", "wz"], 80)


def test_a_velocity_that_no_robot_can_is_refused() -> None:
    commanded = path()
    drive(commanded, 40.0, 0.0, 0.0, ticks=5)
    assert commanded.state == "waiting"
    assert commanded.validator.refusal is not None
    assert commanded.validator.refusal.text == "vx is 40, allowed -4 to 5"


def test_where_commands_end_it_is_zero_within_300_ms_without_a_step() -> None:
    commanded = path()
    drive(commanded, 2.0, 0.5, -0.5, ticks=100)
    last = CommandSample(codec.json_vector([2.0, 0.5, -0.5]), 99 * DT, seq=100)
    silent = np.array([commanded.decide(last, (99 + tick) * DT).vector for tick in range(40)])
    ages_s = DT * np.arange(40)
    assert not silent[ages_s >= 0.3].any(), "exactly zero"
    assert np.abs(np.diff(silent, axis=0)).max() == pytest.approx(2.0 * DT / 0.2), "a tenth of it in each tick"


def test_a_script_steps_from_one_velocity_to_the_next_at_once() -> None:
    commanded = path()
    drive(commanded, 0.5, 0.0, 0.5, ticks=80)
    (after, *_) = drive(commanded, -0.5, 0.3, -0.5, ticks=1, start=80)
    np.testing.assert_array_equal(after, [-0.5, 0.3, -0.5])


def test_a_motion_gives_its_velocity_in_the_frame_of_the_heading_however_the_body_leans() -> None:
    heading, lean = from_rotation_vector([0, 0, 2.0]), from_rotation_vector([0.3, -0.2, 0])
    quat = multiply(heading, lean)
    along = np.array([math.cos(2.0), math.sin(2.0), 0.0])
    world = 0.7 * along + 0.2 * np.array([-along[1], along[0], 0.0])
    turn = rotate_inverse(quat, [0.0, 0.0, 0.4])
    asked = Reference(np.zeros(3), quat, rotate_inverse(quat, world), turn, np.zeros(0))
    made = GO2.encode(asked, ())
    yaw = math.atan2(2 * (quat[0] * quat[3] + quat[1] * quat[2]), 1 - 2 * (quat[2] ** 2 + quat[3] ** 2))
    expected = [
        world[0] * math.cos(yaw) + world[1] * math.sin(yaw),
        world[1] * math.cos(yaw) - world[0] * math.sin(yaw),
    ]
    np.testing.assert_allclose(made, [*expected, 0.4], atol=1e-12)


def test_what_needs_a_robot_says_so_in_one_line() -> None:
    with pytest.raises(ConfigError, match="'velocity' are for any robot, and none is named"):
        command_format("velocity", "")
    with pytest.raises(ValueError, match=r"robot: commands 'velocity' are for any robot; name the one"):
        expect_robot("velocity", "")
    with pytest.raises(ValueError, match="'twist2' are for one robot"):
        expect_robot("twist2", "go2")
    expect_robot("velocity", "go2")
    expect_robot("twist2", "")


@pytest.mark.parametrize(
    ("lower", "upper"), [([0.1, 0, 0], [1, 1, 1]), ([-1, -1], [1, 1]), ([-1, -1, -1], [1, 1, -0.5]), ([0] * 3, [1] * 4)]
)
def test_a_range_that_has_no_place_for_standing_is_refused(lower: list[float], upper: list[float]) -> None:
    with pytest.raises(ConfigError, match="zero between"):
        FORMAT.for_robot("go2", np.array(lower), np.array(upper))
