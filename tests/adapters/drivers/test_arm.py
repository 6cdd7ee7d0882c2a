"""An arm by joints and by its tool: what each device and each mode moves, from where, and what is refused."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from adapters.drivers.arm import TOOL, ArmDriver
from adapters.drivers.arm_options import ArmOptions
from adapters.robots.kassow.kinematics import KR810, REACHING_DOWN
from station import config, rotations
from station.arms import JointCommand
from station.errors import ConfigError
from station.operator.buttons import Buttons, button_map
from station.operator.deadman import Snapshot
from station.operator.driving import Driving, DrivingStep
from station.operator.sample import OperatorSample, Pose
from station.parts import PartedCommand
from station.protocols import Floats
from tests import six_joints

BASE, WRIST = "joints 1-4", "joints 5-7"
TICK_S = 0.004
DOWN = np.array(REACHING_DOWN)
LEVEL = np.array([1.0, 0.0, 0.0, 0.0])
RIGHT = Pose(np.array([0.3, -0.2, 1.1]), LEVEL)


def joints(**options: object) -> ArmDriver:
    return made("arm-joints", ArmOptions(**options))


def tool(**options: object) -> ArmDriver:
    return made("arm-tcp", ArmOptions(**options))


def made(name: str, options: ArmOptions) -> ArmDriver:
    driver = ArmDriver(name, options, "tool" if name == "arm-tcp" else "joints")
    driver.resume_from(DOWN)
    return driver


def follow(driver: ArmDriver, readings: list[OperatorSample]) -> Floats:
    """Engage with the first sample and follow the others; return the commands, shape (n, 7)."""
    snapshot = Snapshot(driver.inspect(readings[0]).input, driver.target)
    return np.array([driver.step(reading, snapshot, TICK_S) for reading in readings])


def held(reading: OperatorSample, seconds: float) -> list[OperatorSample]:
    return [reading] * (round(seconds / TICK_S) + 1)


def twist(*axes: float) -> OperatorSample:
    return OperatorSample(twist=np.array([*axes, *[0.0] * (6 - len(axes))]))


def pressed(**controls: float) -> OperatorSample:
    return OperatorSample(controls={"key_x": 0.0} | controls)


def position(q: Floats) -> Floats:
    return KR810.posture(q).position


@pytest.mark.parametrize(
    ("mode", "axis", "joint", "way"),
    [(BASE, 5, 0, 1), (BASE, 0, 1, 1), (BASE, 3, 2, 1), (BASE, 2, 3, -1), (WRIST, 3, 4, 1), (WRIST, 4, 5, 1),
     (WRIST, 5, 6, 1)],
)  # fmt: skip
def test_each_axis_of_the_cap_turns_one_joint_at_three_tenths_of_a_radian_a_second(
    mode: str, axis: int, joint: int, way: int
) -> None:
    driver = joints()
    if mode == WRIST:
        driver.next_mode()
    assert driver.mode == mode
    moved = follow(driver, held(twist(*np.eye(6)[axis]), 1.0))[-1] - DOWN
    assert moved == pytest.approx(0.3 * way * np.eye(7)[joint], abs=1e-9)


@pytest.mark.parametrize("full", [-1.0, 1.0])
def test_a_joint_stops_three_degrees_before_its_end(full: float) -> None:
    driver = joints(speed_rad_s=3.0)
    commands = follow(driver, held(twist(full), 5.0))
    ends = (-math.radians(67.0), math.radians(177.0))
    assert commands[-1][1] == pytest.approx(ends[full > 0])


def test_a_base_may_turn_by_a_whole_turn_and_is_not_wrapped() -> None:
    driver = joints(speed_rad_s=3.0)
    assert follow(driver, held(twist(0, 0, 0, 0, 0, 1.0), 3.0))[-1][0] == pytest.approx(math.radians(357.0))


def test_a_digit_chooses_the_joint_that_arrows_turn_and_the_mode_goes_along() -> None:
    driver = joints()
    readings = [
        pressed(),
        pressed(key_6=1.0),
        pressed(),
        *held(pressed(key_up=1.0), 0.5),
        *held(pressed(key_down=1.0), 0.1),
    ]
    moved = follow(driver, readings)[-1] - DOWN
    assert driver.mode == WRIST
    assert np.flatnonzero(moved).tolist() == [5]
    assert moved[5] == pytest.approx(0.3 * 0.4, abs=0.003)


def test_a_stick_to_the_side_goes_to_the_next_joint_once_however_long_it_is_held() -> None:
    driver = joints()
    readings = [pressed(), *held(pressed(right_stick_x=1.0), 0.2), pressed(), *held(pressed(left_stick_y=1.0), 0.2)]
    moved = follow(driver, readings)[-1] - DOWN
    assert np.flatnonzero(moved).tolist() == [1]


def test_the_mode_button_goes_from_the_base_to_the_wrist_to_the_tool_and_round() -> None:
    driver = joints()
    assert [driver.mode, *(driver.next_mode() for _ in range(3))] == [BASE, WRIST, TOOL, BASE]
    assert tool().mode == TOOL


def test_changing_the_mode_while_driving_jumps_nowhere_and_what_moves_then_is_the_tool() -> None:
    driver = joints()
    snapshot = Snapshot(driver.inspect(twist()).input, driver.target)
    commands = []
    for tick in range(300):
        if tick in (100, 101):
            driver.next_mode()
        commands.append(driver.step(twist(0.0, 0.0, 1.0), snapshot, TICK_S))
    assert np.abs(np.diff(commands, axis=0)).max() <= 0.3 * TICK_S + 1e-12
    way = position(commands[-1]) - position(commands[101])
    assert way[:2] == pytest.approx([0.0, 0.0], abs=1e-4)
    assert way[2] > 0.08


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_the_tool_goes_straight_along_the_axes_of_the_base_and_keeps_its_orientation(axis: int) -> None:
    commands = follow(tool(tool_mps=0.05), held(twist(*np.eye(6)[axis]), 1.0))
    way = np.array([position(q) for q in commands]) - position(DOWN)
    assert way[-1] == pytest.approx(0.05 * np.eye(3)[axis], abs=1e-3)
    assert np.abs(np.delete(way, axis, axis=1)).max() < 1e-4
    assert KR810.posture(commands[-1]).rotation == pytest.approx(KR810.posture(DOWN).rotation, abs=1e-3)


def test_the_tool_turns_about_its_tip() -> None:
    driver = tool(tip=(0.0, 0.0, 0.15), tool_rad_s=0.2)
    commands = follow(driver, held(twist(0.0, 0.0, 0.0, 0.0, 1.0), 1.0))
    tip = KR810.with_tool((0.0, 0.0, 0.15))
    assert tip.posture(commands[-1]).position == pytest.approx(tip.posture(DOWN).position, abs=1e-3)
    turned = rotations.multiply(
        tip.posture(commands[-1]).pose.quat_wxyz, rotations.inverse(tip.posture(DOWN).pose.quat_wxyz)
    )
    assert rotations.rotation_vector(turned) == pytest.approx([0.0, 0.2, 0.0], abs=5e-3)


def test_an_operator_in_front_of_the_arm_pushes_it_towards_its_base() -> None:
    commands = follow(tool(facing_rad=math.pi, tool_mps=0.05), held(twist(1.0), 1.0))
    assert position(commands[-1]) - position(DOWN) == pytest.approx([-0.05, 0.0, 0.0], abs=1e-3)


def test_along_the_tool_s_own_axes_forward_is_where_it_points() -> None:
    commands = follow(tool(frame="tool", tool_mps=0.05), held(twist(0.0, 0.0, 1.0), 1.0))
    assert position(commands[-1]) - position(DOWN) == pytest.approx([0.0, 0.0, -0.05], abs=1e-3)


def test_the_tool_stays_in_its_box() -> None:
    floor = float(position(DOWN)[2]) - 0.03
    commands = follow(tool(box_lower=(-1.0, -1.0, floor)), held(twist(0.2, 0.0, -1.0), 2.0))
    heights = np.array([position(q)[2] for q in commands])
    assert heights.min() > floor - 1e-4
    assert position(commands[-1])[0] > position(DOWN)[0] + 0.03  # and slides along it


def test_a_cap_that_is_let_go_stops_the_tool_in_the_same_tick() -> None:
    driver = tool(tool_mps=1.0)  # faster than the joints allow: the goal leads
    commands = follow(driver, [*held(twist(1.0, 0.3), 0.5), *held(twist(), 0.1)])
    last = commands[-26]
    assert commands[-25:] == pytest.approx(np.tile(last, (25, 1)), abs=0.0)


def at_the_end_of_its_reach() -> tuple[ArmDriver, Snapshot]:
    driver = tool(tool_mps=0.3, speed_rad_s=1.0)
    snapshot = Snapshot(driver.inspect(twist()).input, driver.target)
    for _ in range(1000):
        driver.step(twist(1.0), snapshot, TICK_S)
    return driver, snapshot


def test_at_the_end_of_its_reach_the_tool_stops_on_its_line_and_turns_back_at_once() -> None:
    driver, snapshot = at_the_end_of_its_reach()
    far = position(driver.target)
    assert far[1:] == pytest.approx(position(DOWN)[1:], abs=0.005)
    for _ in range(250):
        driver.step(twist(1.0), snapshot, TICK_S)
    assert position(driver.target) == pytest.approx(far, abs=1e-4)
    for _ in range(25):
        driver.step(twist(-1.0), snapshot, TICK_S)
    assert position(driver.target)[0] < far[0] - 0.003


def test_what_one_axis_of_the_cap_cannot_do_does_not_keep_the_others_from_it() -> None:
    driver, snapshot = at_the_end_of_its_reach()
    far = position(driver.target)
    for _ in range(250):
        driver.step(twist(1.0, -0.3, -1.0), snapshot, TICK_S)
    assert position(driver.target)[2] < far[2] - 0.05


def test_a_tool_that_goes_round_and_round_brings_its_elbow_back() -> None:
    driver = tool(tool_mps=1.0, speed_rad_s=3.0)
    snapshot = Snapshot(driver.inspect(twist()).input, driver.target)
    for angle in np.linspace(0.0, 8.0 * math.pi, 801):
        cap = twist(-math.sin(2.0 * angle), math.cos(angle), -0.8 * math.sin(angle))
        q = driver.step(cap, snapshot, TICK_S)
    assert q == pytest.approx(DOWN, abs=0.03)  # 0.33 rad from there where nothing brings it back


def hand(*way: float, turn: tuple[float, float, float] = (0.0, 0.0, 0.0), head: Pose | None = None) -> OperatorSample:
    quat = rotations.from_rotation_vector(np.array(turn))
    return OperatorSample(
        capture_ns=1, controls={"right_grip": 1.0}, right=Pose(RIGHT.position + np.array(way), quat), head=head
    )


def test_the_tool_goes_where_the_hand_goes_and_turns_as_it_turns() -> None:
    readings = [hand(0.0, 0.0, 0.0), *held(hand(0.05, 0.02, 0.04, turn=(0.0, 0.0, 0.2)), 2.0)]
    after = KR810.posture(follow(tool(), readings)[-1]).pose
    assert after.position - position(DOWN) == pytest.approx([0.05, 0.02, 0.04], abs=1e-3)
    turned = rotations.multiply(after.quat_wxyz, rotations.inverse(KR810.posture(DOWN).pose.quat_wxyz))
    assert rotations.rotation_vector(turned) == pytest.approx([0.0, 0.0, 0.2], abs=5e-3)


def test_a_hand_that_was_faster_than_the_arm_and_turns_back_takes_the_tool_along_at_once() -> None:
    readings = [hand(0.0, 0.0, 0.0), *held(hand(0.25, 0.0, 0.0), 1.0), *held(hand(0.0, 0.0, 0.0), 0.2)]
    way = np.array([position(q)[0] for q in follow(tool(speed_rad_s=0.1, tool_mps=0.3), readings)])
    turned = way[-52]
    assert turned - way[0] > 0.03
    assert turned - way[-1] > 0.003


def test_what_is_forward_may_be_where_the_headset_looks() -> None:
    left = Pose(np.zeros(3), rotations.from_rotation_vector(np.array([0.0, 0.0, math.pi / 2])))
    readings = [hand(0.0, 0.0, 0.0, head=left), *held(hand(0.0, 0.06, 0.0, head=left), 2.0)]
    after = follow(tool(heading="head", scale=0.5), readings)[-1]
    assert position(after) - position(DOWN) == pytest.approx([0.03, 0.0, 0.0], abs=1e-3)


def test_a_leader_that_is_near_is_followed_no_faster_than_told() -> None:
    leader = DOWN + np.array([0.2, -0.1, 0.0, 0.3, 0.0, 0.0, -0.2])
    commands = follow(joints(), held(OperatorSample(joints=leader), 1.5))
    assert np.abs(np.diff(commands, axis=0)).max() <= 0.3 * TICK_S + 1e-12
    assert commands[-1] == pytest.approx(leader)


def test_a_leader_that_is_far_away_may_not_begin_and_is_told_what_to_move_where() -> None:
    look = joints().inspect(OperatorSample(joints=np.append(DOWN + 0.9 * np.eye(7)[3] - 1.0 * np.eye(7)[0], 0.5)))
    assert look.why_not_engage == "leader is too far from the arm; move it (rad): joint_1 by +1.00, joint_4 by -0.90"


@pytest.mark.parametrize(
    ("reading", "mode", "why_not"),
    [
        (OperatorSample(), BASE, "the device sends nothing that moves an arm"),
        (
            OperatorSample(joints=np.zeros(6)),
            BASE,
            "the leader sends 6 values, expected 7 joints, and a gripper or none",
        ),
        (OperatorSample(joints=np.full(7, np.nan)), BASE, "the leader sends 7 values, expected 7 joints"),
        (OperatorSample(joints=DOWN), TOOL, "a leader arm drives joints and not the tool; change the mode"),
        (OperatorSample(twist=np.full(6, np.nan)), BASE, "the device sends no numbers"),
        (OperatorSample(left=RIGHT), TOOL, "right is not tracked"),
        (OperatorSample(right=Pose(np.zeros(3), np.zeros(4))), TOOL, "right has no orientation yet"),
    ],
)
def test_what_does_not_fit_is_refused(reading: OperatorSample, mode: str, why_not: str) -> None:
    look = (tool() if mode == TOOL else joints()).inspect(reading)
    assert look.input is None
    assert look.why_not.startswith(why_not)


def test_what_jumps_or_is_lost_is_told() -> None:
    driver = tool()
    here, there = driver.inspect(hand(0.0, 0.0, 0.0)).input, driver.inspect(hand(0.5, 0.0, 0.0)).input
    assert driver.jump(here, there).startswith("right jumped 0.50 m")
    assert driver.jump(here, driver.inspect(pressed()).input) == "the device sends controls and no hand any more"
    leads = [joints().inspect(OperatorSample(joints=q)).input for q in (DOWN, DOWN + 2 * np.pi * np.eye(7)[2])]
    assert driver.jump(*leads) == "joint_3 of the leader jumped 6.28 rad between two samples (limit 0.8)"


def test_an_arm_that_stands_beyond_its_soft_limits_is_not_pulled_in_and_goes_no_farther_out() -> None:
    outside = DOWN.copy()
    outside[1] = math.radians(-69.0)
    driver = joints()
    driver.resume_from(outside)
    assert follow(driver, held(twist(-1.0), 0.2))[-1] == pytest.approx(outside, abs=0.0)
    assert follow(driver, held(twist(1.0), 0.2))[-1][1] > outside[1] + 0.05


class Seat:
    """An operator with a spacemouse, buttons and dead-man included."""

    def __init__(self, driver: ArmDriver) -> None:
        self.driving = Driving(driver, Buttons(button_map("spacemouse")))
        self.tick()

    def tick(self, reading: OperatorSample | None = None, **controls: float) -> DrivingStep:
        reading = replace(reading or twist(), controls={"button_1": 0.0} | controls)
        return self.driving.step(reading, TICK_S)

    def press(self, control: str, seconds: float = 0.1) -> list[DrivingStep]:
        ticks = [self.tick(**{control: 1.0}) for _ in range(round(seconds / TICK_S))]
        return ticks + [self.tick() for _ in range(5)]


def test_with_a_spacemouse_a_press_engages_a_hold_changes_the_mode_and_a_press_lets_go() -> None:
    seat = Seat(joints())
    told = seat.press("button_0")
    assert [tick.change.name for tick in told if tick.change] == ["operator-engaged"]
    assert told[-1].command == pytest.approx(DOWN, abs=1e-6)
    assert [tick.mode for tick in seat.press("button_0", 1.4) if tick.mode] == [WRIST]
    moving = [seat.tick(twist(0.0, 0.0, 0.0, 0.0, 1.0)).command for _ in range(20)]
    assert moving[-1][5] > DOWN[5] + 0.02
    told = seat.press("button_0")
    assert [tick.change.reason for tick in told if tick.change] == ["released"]
    assert seat.tick(twist(1.0, 1.0, 1.0, 1.0, 1.0, 1.0)).command == pytest.approx(told[-1].command, abs=0.0)


def test_a_hand_that_drives_the_tool_may_go_on_to_joints_by_sticks_and_back_without_letting_go() -> None:
    driving = Driving(tool(), Buttons(button_map("pico", {"engage": "right_grip"})))
    driving.step(replace(hand(0.0, 0.0, 0.0), controls={"left_menu": 0.0}), TICK_S)
    q, modes = DOWN, []
    for tick in range(90):
        pushed = {"right_stick_click": 1.0} if tick in (20, 21, 40, 41, 60, 61) else {"left_stick_y": 1.0}
        here = hand(0.002 * tick, 0.0, 0.0)
        driven = driving.step(replace(here, controls=dict(here.controls) | pushed), TICK_S)
        assert np.abs(driven.command - q).max() <= 0.3 * TICK_S + 1e-12
        assert driving.deadman.is_engaged
        q, modes = driven.command, [*modes, driven.mode]
    assert [mode for mode in modes if mode] == [BASE, WRIST, TOOL]


def test_a_mode_that_a_digit_changes_is_told_like_one_of_the_button() -> None:
    driving = Driving(joints(), Buttons(button_map("keyboard")))
    assert driving.step(pressed(), TICK_S).mode == ""
    assert driving.step(pressed(key_7=1.0), TICK_S).mode == WRIST


def test_only_the_joints_of_a_model_without_known_kinematics_are_driven(tmp_path: Path) -> None:
    names = [f"joint_{number}" for number in range(1, 8)]
    one = {"lower_rad": -3.0, "upper_rad": 3.0, "speed_rad_s": 2.0, "acceleration_rad_s2": 10.0}
    file = tmp_path / "kr1805.yaml"
    lines = [f"  - {{name: {name}, {', '.join(f'{key}: {value}' for key, value in one.items())}}}" for name in names]
    file.write_text("\n".join(["model: kr1805", "source: my data sheet", "joints:", *lines]))
    options = ArmOptions(model="kr1805", limits=file)
    driver = ArmDriver("arm-joints", options, "joints")
    assert [driver.next_mode(), driver.next_mode()] == [WRIST, BASE]
    assert driver.command_format.robot == "kassow_kr1805"
    with pytest.raises(ConfigError, match="kinematics are not known"):
        ArmDriver("arm-tcp", options, "tool")
    with pytest.raises(ConfigError, match="speed_rad_s is 3; the slowest joint does 2 rad/s"):
        ArmDriver("arm-joints", ArmOptions(model="kr1805", limits=file, speed_rad_s=3.0), "joints")


def test_a_model_whose_limits_nobody_has_vouched_for_is_refused() -> None:
    with pytest.raises(ConfigError, match="no limits of its joints ship"):
        ArmDriver("arm-joints", ArmOptions(model="kr1805"), "joints")


@pytest.mark.parametrize(
    ("values", "line"),
    [
        ({"speed_rad_s": 9.0}, "speed_rad_s is 9; expected 0.01 to 4"),
        ({"tool_mps": 0.0}, "tool_mps is 0; expected 0.01 to 1"),
        ({"scale": 0.0}, "scale is 0; expected 0.1 to 3"),
        ({"facing_rad": 180.0}, "facing_rad is 180; expected a direction in radians"),
        ({"box_upper": [1.0, 1.0, -0.1]}, "expected more than box_lower"),
        ({"frame": "world"}, "frame: expected base or tool, got 'world'"),
    ],
)
def test_options_that_cannot_be_are_refused_in_a_line(values: Mapping[str, object], line: str) -> None:
    with pytest.raises(ConfigError) as caught:
        config.build(ArmOptions, values, where="options")
    assert line in str(caught.value)


def test_facts_tell_options_modes_and_where_the_limits_come_from() -> None:
    facts = tool(tool_mps=0.2).facts()
    assert (facts["driver"], facts["tool_mps"], facts["modes"]) == ("arm-tcp", 0.2, [BASE, WRIST, TOOL])
    assert "kr810_description" in facts["limits"]["source"]


@pytest.fixture
def six(monkeypatch: pytest.MonkeyPatch) -> ArmDriver:
    """The driver of an arm of six joints, of somebody else's package."""
    six_joints.register(monkeypatch)
    return ArmDriver("arm-joints", ArmOptions(command="six"), "joints")


def test_an_arm_of_six_joints_is_driven_by_whatever_drives_one_of_seven(six: ArmDriver) -> None:
    assert (six.command_format.key, six.command_format.robot) == ("action_joints_six", "six")
    assert [six.mode, six.next_mode(), six.next_mode()] == ["joints 1-4", "joints 5-6", "joints 1-4"]
    turned = follow(six, held(twist(0.0, 0.0, 0.0, 0.0, 0.0, 1.0), 0.4))[-1]
    assert turned == pytest.approx([0.3 * 0.4, 0, 0, 0, 0, 0], abs=0.003)
    jogged = follow(six, [pressed(key_6=1.0), *held(pressed(key_up=1.0), 0.4)])[-1] - turned
    assert (np.flatnonzero(np.abs(jogged) > 1e-9).tolist(), six.mode) == ([5], "joints 5-6")


def test_a_leader_of_six_joints_and_a_gripper_leads_it_and_one_of_another_number_does_not(six: ArmDriver) -> None:
    leader = OperatorSample(joints=np.array([0.1, -0.1, 0.1, 0.0, 0.1, 0.0, 0.7]))
    assert follow(six, held(leader, 2.0))[-1] == pytest.approx([0.1, -0.1, 0.1, 0.0, 0.1, 0.0])
    assert (
        six.inspect(OperatorSample(joints=np.zeros(8))).why_not
        == "the leader sends 8 values, expected 6 joints, and a gripper or none"
    )
    far = six.inspect(OperatorSample(joints=np.array([0.1, -0.1, 0.1, 0.0, 0.1, 1.5])))
    assert far.why_not_engage == "leader is too far from the arm; move it (rad): flange by -1.50"
    jump = six.jump(
        six.inspect(leader).input, six.inspect(OperatorSample(joints=np.array([0.1, 0.9, 0.1, 0.0, 0.1, 0.0]))).input
    )
    assert jump.startswith("shoulder of the leader jumped 1.00 rad")


@pytest.mark.parametrize(
    ("options", "begins", "line"),
    [
        ({"command": "six"}, "tool", "the kinematics behind 'six' are not known; take the driver arm-joints"),
        ({"command": "twist2"}, "joints", "command 'twist2' has other elements than positions of an arm's joints"),
        ({"command": "six", "speed_rad_s": 1.5}, "joints", "speed_rad_s is 1.5; the slowest joint does 1 rad/s"),
    ],
)
def test_a_command_that_cannot_be_driven_is_refused_in_a_line(
    monkeypatch: pytest.MonkeyPatch, options: Mapping[str, object], begins: Any, line: str
) -> None:
    six_joints.register(monkeypatch)
    with pytest.raises(ConfigError, match=line):
        ArmDriver("arm", ArmOptions(**options), begins)


def test_a_command_that_is_made_of_parts_is_refused_with_their_names(monkeypatch: pytest.MonkeyPatch) -> None:
    two = [
        JointCommand.within(name, f"six_{name}", joints, lower=-np.ones(3), upper=np.ones(3), margin=np.ones(3),
                            rate=np.ones(3))
        for name, joints in (("upper", six_joints.JOINTS[:3]), ("wrist", six_joints.JOINTS[3:]))
    ]  # fmt: skip
    monkeypatch.setattr(six_joints, "COMMAND", PartedCommand("six", "six", two))
    six_joints.register(monkeypatch)
    with pytest.raises(ConfigError, match="is made of parts, which are driven apart: upper, wrist"):
        ArmDriver("arm-joints", ArmOptions(command="six"), "joints")


def test_a_command_that_nobody_registered_is_named_with_the_nearest(six: ArmDriver) -> None:
    with pytest.raises(ValueError, match="unknown command 'sixx'"):
        ArmOptions(command="sixx")
    assert six.facts()["limits"]["rate"] == [1.0] * 6


def test_a_part_of_another_robot_takes_the_same_command_under_its_own_keys() -> None:
    own, other = (
        ArmDriver("arm-joints", ArmOptions(command="g1-left-arm", robot=robot, speed_rad_s=1.5), "joints")
        for robot in ("", "g1_dex3_left_arm")
    )
    assert own.command_format.key == "action_joints_g1_29_left_arm"
    assert other.command_format.key == "action_joints_g1_dex3_left_arm"
    np.testing.assert_array_equal(own.command_format.upper, other.command_format.upper)
    with pytest.raises(ValueError, match="robot is 'x'; expected none without a command"):
        ArmOptions(robot="x")


def test_a_command_that_is_for_one_robot_alone_is_driven_under_no_other_keys(monkeypatch: pytest.MonkeyPatch) -> None:
    class Bound:
        """A format of somebody else's, which is no `JointCommand`."""

        def __getattr__(self, name: str) -> object:
            return getattr(made, name)

    made = six_joints.COMMAND
    monkeypatch.setattr(six_joints, "COMMAND", Bound())
    six_joints.register(monkeypatch)
    with pytest.raises(ConfigError, match=f"robot is 'x'; command 'six' is for {made.robot} alone"):
        ArmDriver("arm-joints", ArmOptions(command="six", robot="x"), "joints")
