"""The velocity command: one format for every robot on legs, and what becomes of it on its way to one."""

from __future__ import annotations

import math

import numpy as np
import pytest

from adapters.commands.velocity import FORMAT, WITH_HEIGHT, WITH_POSTURE
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
    assert [key for key in keys if "velocity_" in key] == ["action_velocity_go2", "action_velocity_h1"]
    assert "action_velocity-height_h1" in keys


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


HOMIE = WITH_HEIGHT.for_robot("g1", np.array([-0.8, -0.5, -0.8, 0.24]), np.array([1.2, 0.5, 0.8, 0.74]))


@pytest.mark.parametrize(("of", "count"), [(WITH_HEIGHT, 4), (WITH_POSTURE, 7)])
def test_a_sibling_has_further_elements_under_a_key_of_its_own(of: ForAnyRobot, count: int) -> None:
    bound = of.for_robot("g1")
    assert registry.find("command", bound.name) is of
    assert bound.key == f"action_{bound.name}_g1"
    described = contracts.contract(bound.key)
    assert described is not None
    assert [element.title for element in described.elements][:4] == [
        "vx [m/s]", "vy [m/s]", "wz [rad/s]", "root_height [m]",
    ]  # fmt: skip
    assert (len(described.elements), bound.velocities, bound.default[3]) == (count, (0, 1, 2), 0.74)


def test_a_height_is_clamped_and_told_and_one_that_no_g1_can_is_refused() -> None:
    commanded = path(HOMIE)
    made = drive(commanded, 0.0, 0.0, 0.0, 0.2, ticks=100)
    assert made[-1][3] == 0.24
    (told,) = [each.detail for each in commanded.taken() if each.name == "command-clamped"]
    assert told == {"elements": ["root_height"], "allowed": {"root_height": [0.24, 0.74]}}
    drive(commanded, 0.0, 0.0, 0.0, 1.5, ticks=3, start=100)
    assert commanded.validator.refusal is not None
    assert commanded.validator.refusal.text == "root_height is 1.5, allowed -0.06 to 1.04"


def test_where_commands_end_the_walk_ends_within_300_ms_and_the_height_stays_however_long_it_is_silent() -> None:
    commanded = path(HOMIE)
    assert drive(commanded, 0.5, 0.0, 0.2, 0.4, ticks=100)[-1].tolist() == [0.5, 0.0, 0.2, 0.4]
    last = CommandSample(codec.json_vector([0.5, 0.0, 0.2, 0.4]), 99 * DT, seq=100)
    silent = np.array([commanded.decide(last, (99 + tick) * DT).vector for tick in range(300)])
    assert not silent[15:, :3].any(), "0.3 s after the last one"
    assert (silent[:, 3] == 0.4).all()
    assert commanded.state == "waiting"
    assert drive(commanded, 0.0, 0.0, 0.0, 0.6, ticks=1, start=399)[0][3] == pytest.approx(0.41), (
        "from there, at its rate"
    )


def test_a_motion_gives_the_height_of_its_root_and_one_without_stands() -> None:
    root = np.array([1.0, 0.0, 0.0, 0.0])
    for height, expected in ((0.5, 0.5), (0.0, 0.74)):
        asked = Reference(np.array([0.0, 0.0, height]), root, np.array([0.3, 0, 0]), np.zeros(3), np.zeros(0))
        np.testing.assert_allclose(HOMIE.encode(asked, ()), [0.3, 0.0, 0.0, expected])


def test_a_range_without_the_height_of_standing_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"'velocity-height': .* expected 4 numbers each, 0, 0, 0, 0.74 between them"):
        WITH_HEIGHT.for_robot("g1", np.array([-1, -1, -1, 0.2]), np.array([1, 1, 1, 0.6]))
