"""A rig whose policy takes velocities: the robot's name, the trained range, what is published, and what it states."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from station.bus import codec, keys
from station.control.control import ControlStep
from station.control.rig import PolicyChoice, Rig, RigConfig, build, expect
from station.control.robot_server import RobotConfig, facts
from station.episode.replaying.gate_audit import GateSetting, setting
from station.errors import BadFile, ConfigError
from tests.adapters.policies.test_holosoma import FACTS
from tests.adapters.policies.velocity_inputs import onnx_file


@pytest.fixture
def walker(tmp_path: Path) -> str:
    return str(onnx_file(tmp_path / "walk.onnx", 100, 29, FACTS))


@pytest.fixture
def joystick(tmp_path: Path) -> str:
    return str(onnx_file(tmp_path / "joystick.onnx", 103, 29))


def rig_of(policy: str, checkpoint: str, **policies: PolicyChoice) -> Rig:
    return build(RigConfig(robot="g1-mujoco", policy=policy, checkpoint=checkpoint, policies=policies))


def test_the_robot_gives_the_command_its_name_and_the_policy_its_range(walker: str) -> None:
    rig = rig_of("holosoma", walker)
    assert (rig.command_format.robot, rig.command_format.key) == ("g1_29", "action_velocity_g1_29")
    np.testing.assert_array_equal(rig.command_format.upper, [1, 1, 1])
    described = rig.kind.describe(rig.command_format)
    contracts = {item.key: item for item in described.contracts()}
    assert [item.title for item in contracts["action_velocity_g1_29"].elements] == [
        "vx [m/s]",
        "vy [m/s]",
        "wz [rad/s]",
    ]
    assert contracts["command_used_g1_29"].names == ("vx", "vy", "wz")


def test_of_policies_that_hand_over_the_narrower_range_counts(walker: str, joystick: str) -> None:
    rig = rig_of("holosoma", walker, joystick=PolicyChoice(policy="playground-g1", checkpoint=joystick))
    np.testing.assert_array_equal(rig.command_format.upper, [1, 0.5, 1])
    np.testing.assert_array_equal(rig.command_format.lower, [-1, -0.5, -1])


def test_the_range_stands_in_what_the_server_states_and_an_audit_takes_it_from_there(walker: str) -> None:
    config = RobotConfig(robot="g1-mujoco", policy="holosoma", checkpoint=walker)
    stated = facts(config, "robot", build(config.rig))
    assert stated["command_range"] == {"lower": [-1.0] * 3, "upper": [1.0] * 3}
    of = setting(stated | {"command_range": {"lower": [-0.3] * 3, "upper": [0.4] * 3}}, "velocity")
    assert isinstance(of, GateSetting)
    assert of.command_format.key == "action_velocity_g1_29"
    np.testing.assert_array_equal(of.command_format.upper, [0.4] * 3)


@pytest.mark.parametrize("span", [{"lower": [1.0] * 3}, {"upper": ["a"]}, 5])
def test_a_range_that_cannot_be_is_no_setting_of_a_gate(walker: str, span: object) -> None:
    config = RobotConfig(robot="g1-mujoco", policy="holosoma", checkpoint=walker)
    stated = facts(config, "robot", build(config.rig))
    assert isinstance(setting(stated | {"command_range": span}, "velocity"), str)


def test_the_velocity_of_the_base_is_published_where_the_policy_needs_it(walker: str, joystick: str) -> None:
    other = PolicyChoice(policy="playground-g1", checkpoint=joystick)
    for policy, checkpoint, others, is_needed in (
        ("holosoma", walker, {}, False),
        ("playground-g1", joystick, {}, True),
        ("holosoma", walker, {"joystick": other}, True),
    ):
        rig = rig_of(policy, checkpoint, **others)
        ControlStep(rig.robot, rig.policy, rig.command_format)
        rig.robot.push(np.array([0.5, 0.2, 0.0]))  # type: ignore[attr-defined]
        values = rig.state_values(rig.robot.read())
        assert (keys.root_velocity("g1_29") in values) == is_needed
    np.testing.assert_allclose(codec.parse_f64(values[keys.root_velocity("g1_29")]), [0.5, 0.2, 0.0], atol=1e-12)


def test_a_policy_for_another_robot_is_refused_in_one_line(tmp_path: Path) -> None:
    go1 = str(onnx_file(tmp_path / "go1.onnx", 48, 12))
    rig = rig_of("playground-go1", go1)
    with pytest.raises(ConfigError, match=r"'playground-go1' drives 12 joints, the robot has 29; not in both: FL_calf"):
        ControlStep(rig.robot, rig.policy, rig.command_format)


@pytest.mark.parametrize("policy", ["holosoma", "playground-g1", "playground-go1", "pilla-go2", "rlgym-g1"])
def test_whoever_lacks_a_file_is_told_where_it_comes_from(policy: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"no default checkpoint; name its file with `checkpoint`; .* take it from"):
        expect(RigConfig(robot="g1-mujoco", policy=policy))
    with pytest.raises(BadFile, match=r"none\.onnx: no such file; .* take it from") as caught:
        expect(RigConfig(robot="g1-mujoco", policy=policy, checkpoint=str(tmp_path / "none.onnx")))
    assert "\n" not in str(caught.value)
