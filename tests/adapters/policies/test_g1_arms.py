"""Legs by a policy, arms by their commands: what the policy inside sees, what is sent, and what does not fit."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from adapters.commands.g1_parts import ARM, ARMS, HAND, HANDS, LEFT_ARM, LEFT_HAND, RIGHT_ARM, RIGHT_HAND
from adapters.policies.g1_arms import G1ArmsPolicy
from adapters.policies.holosoma import HolosomaPolicy
from adapters.policies.homie import HomiePolicy
from adapters.robots.g1.joints import G1_29
from adapters.robots.legged.unitree import G1_DEX3
from station import registry
from station.control.rig import RigConfig, build
from station.errors import BadFile, ConfigError, UnknownName
from station.parts import PartedCommand, parts_of
from station.protocols import ForAnyRobot
from tests.adapters.policies.restored import expect_goes_on

from .test_holosoma import FACTS
from .test_homie import steps
from .velocity_inputs import onnx_file


@pytest.fixture
def homie(tmp_path: Path) -> Path:
    return onnx_file(tmp_path / "homie.onnx", 456, 12)


def test_the_legs_are_those_of_the_policy_alone_and_the_arms_where_their_commands_say(homie: Path) -> None:
    whole, alone = G1ArmsPolicy(homie), HomiePolicy(homie)
    for state, command in steps(8, 4):
        arms = np.linspace(-0.5, 0.5, 14) + command[0]
        observation = whole.observe(state, np.concatenate([command, arms]))
        np.testing.assert_array_equal(observation, alone.observe(state, command))
        action = whole.act(observation)
        np.testing.assert_array_equal(action, alone.act(observation))
        sent, theirs = whole.targets(action, np.concatenate([command, arms])), alone.targets(action, command)
        np.testing.assert_array_equal(sent.q, [*theirs.q[:15], *arms])
        np.testing.assert_array_equal(sent.kp, theirs.kp)
    assert G1_29[15:] == ARMS


def test_a_policy_that_knows_fewer_joints_sees_those_and_the_waist_is_held(tmp_path: Path) -> None:
    """Of one that drives all 29, what it says of the arms is put aside."""
    file = onnx_file(tmp_path / "walk.onnx", 100, 29, FACTS)
    whole, alone = G1ArmsPolicy(file, legs="holosoma"), HolosomaPolicy(file)
    ((state, command),) = steps(1, 4)
    observation = whole.observe(state, np.concatenate([command[:3], np.ones(14)]))
    np.testing.assert_array_equal(observation, alone.observe(state, command[:3]))
    sent = whole.targets(whole.act(observation), np.concatenate([command[:3], np.ones(14)]))
    np.testing.assert_array_equal(sent.q[15:], np.ones(14))
    np.testing.assert_array_equal(sent.q[:15], alone.targets(alone.act(observation), command[:3]).q[:15])


@pytest.mark.parametrize("is_run", [True, False])
def test_a_restored_policy_goes_on_bit_for_bit(homie: Path, is_run: bool) -> None:
    made = [(state, np.concatenate([command, np.full(14, 0.1)])) for state, command in steps(12, 4)]
    expect_goes_on(G1ArmsPolicy(homie), G1ArmsPolicy(homie), made, is_run=is_run)


def test_each_part_has_a_key_of_its_own_and_the_legs_the_range_of_their_policy(homie: Path) -> None:
    rig = build(RigConfig(robot="g1-mujoco", policy="g1-arms", checkpoint=str(homie)))
    legs, left, right = parts_of(rig.command_format)
    assert [part.key for part in (legs, left, right)] == [
        "action_velocity-height_g1_29_legs", "action_joints_g1_29_left_arm", "action_joints_g1_29_right_arm",
    ]  # fmt: skip
    np.testing.assert_array_equal(legs.upper, [1.2, 0.5, 0.8, 0.74])
    np.testing.assert_array_equal(legs.lower, [-0.8, -0.5, -0.8, 0.24])
    assert (left.key, right.key) == (LEFT_ARM.key, RIGHT_ARM.key), "what `arm-joints` drives"
    contracts = {item.key: item for item in rig.kind.describe(rig.command_format).contracts()}
    assert contracts[left.key].names == tuple(f"{name}_pos" for name in ARM["left"])
    assert contracts[legs.key].names == ("vx", "vy", "wz", "root_height")
    assert contracts["command_timing_g1_29_left_arm"].names == (
        "tick", "command_seq", "command_written", "command_arrived", "decided",
    )  # fmt: skip


@pytest.mark.parametrize("name", ["velocity", "velocity-height", "velocity-posture"])
def test_each_joint_of_an_arm_is_in_one_part_and_no_other_is(name: str) -> None:
    found = registry.find("command", f"g1-arms-{name}")
    assert isinstance(found, ForAnyRobot)
    bound = found.for_robot("g1_29")
    assert isinstance(bound, PartedCommand)
    joints = [element.name.removesuffix("_pos") for element in bound.elements if element.name.endswith("_pos")]
    assert joints == list(ARMS)
    assert [part.holds_position for part in bound.parts[1:]] == [True, True]


@pytest.mark.parametrize(
    ("legs", "error", "words"),
    [
        ("homi", UnknownName, r"'homi' \(did you mean 'homie'\?\)"),
        ("twist2", BadFile, r"\[batch, 1432\]"),
    ],
)
def test_a_policy_that_cannot_be_inside_is_refused_in_one_line(
    tmp_path: Path, homie: Path, legs: str, error: type[Exception], words: str
) -> None:
    with pytest.raises(error, match=words) as caught:
        G1ArmsPolicy(homie, legs=legs)
    assert "\n" not in str(caught.value)


def test_a_policy_of_other_commands_or_of_another_robot_is_named(homie: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    inside = HomiePolicy(homie)
    monkeypatch.setattr(registry, "find", lambda kind, name: lambda checkpoint: inside)
    for change, words in (
        (
            {"command": "twist2"},
            "policy 'other' follows 'twist2' commands; expected one that follows velocity, velocity",
        ),
        ({"joint_names": ("FL_hip", *G1_29[1:])}, "policy 'other' drives another robot: a G1 has no joint FL_hip"),
    ):
        inside._spec, before = replace(inside._spec, **change), inside._spec
        with pytest.raises(ConfigError, match=words):
            G1ArmsPolicy(homie, legs="other")
        inside._spec = before


@pytest.mark.parametrize(
    ("legs", "file"), [("homie", None), pytest.param("asap", "asap_dec_loco_g1.onnx", marks=pytest.mark.assets)]
)
def test_with_hands_each_hand_is_where_its_command_says_and_the_rest_as_without(
    homie: Path, request: pytest.FixtureRequest, legs: str, file: str | None
) -> None:
    """Around a policy of legs, and around one that takes the arms' commands as well."""
    path = homie if file is None else request.getfixturevalue("assets") / f"zoo/policies/{file}"
    whole = G1ArmsPolicy(path, legs=legs, hands=True)
    alone = G1ArmsPolicy(path) if file is None else registry.find("policy", legs)(path)
    names, count = whole.spec.joint_names, len(alone.spec.joint_names)
    assert names == G1_DEX3.joint_names
    known = [names.index(name) for name in alone.spec.joint_names]
    for state, command in steps(8, 4):
        body = np.concatenate([command, np.linspace(-0.3, 0.3, 14)])
        hands = np.linspace(-0.5, 0.5, 14)
        q, dq = np.full((2, 43), 0.3)
        q[known], dq[known] = state.q[:count], state.dq[:count]
        observation = whole.observe(replace(state, q=q, dq=dq), np.concatenate([body, hands]))
        theirs = alone.observe(replace(state, q=state.q[:count], dq=state.dq[:count]), body)
        np.testing.assert_array_equal(observation, theirs)
        sent, expected = (
            whole.targets(whole.act(observation), np.concatenate([body, hands])),
            alone.targets(alone.act(theirs), body),
        )
        np.testing.assert_array_equal(sent.q[known], expected.q)
        np.testing.assert_array_equal(sent.q[[names.index(name) for name in HANDS]], hands)
        np.testing.assert_array_equal(sent.kp[known], expected.kp)
        assert set(sent.kp[[names.index(name) for name in HANDS]]) == {1.5}


def test_each_hand_is_a_part_with_a_key_of_its_own(homie: Path) -> None:
    rig = build(
        RigConfig(robot="g1-dex3-mujoco", policy="g1-arms", policy_options={"hands": True}, checkpoint=str(homie))
    )
    parts = parts_of(rig.command_format)
    assert [part.robot for part in parts] == [
        "g1_dex3_legs", "g1_dex3_left_arm", "g1_dex3_right_arm", "g1_dex3_left_hand", "g1_dex3_right_hand",
    ]  # fmt: skip
    np.testing.assert_array_equal(parts[0].upper, [1.2, 0.5, 0.8, 0.74])
    assert [part.key for part in parts[3:]] == [LEFT_HAND.key, RIGHT_HAND.key], "what the driver `glove` drives"
    contracts = {item.key: item for item in rig.kind.describe(rig.command_format).contracts()}
    assert contracts[LEFT_HAND.key].names == tuple(f"{name}_pos" for name in HAND["left"])


def test_a_robot_without_hands_takes_no_hands_and_one_with_hands_no_policy_without(homie: Path) -> None:
    for robot, hands in (("g1-mujoco", True), ("g1-dex3-mujoco", False)):
        with pytest.raises(ConfigError, match=r"drives \d+ joints, the robot has \d+"):
            build(
                RigConfig(robot=robot, policy="g1-arms", policy_options={"hands": hands}, checkpoint=str(homie))
            ).control()


@pytest.mark.assets
def test_a_policy_that_takes_the_arms_needs_no_other_that_does(assets: Path) -> None:
    with pytest.raises(
        ConfigError, match="'asap' follows 'g1-arms-velocity-height' commands; expected one that follows"
    ):
        G1ArmsPolicy(assets / "zoo/policies/asap_dec_loco_g1.onnx", legs="asap")
