"""The wire contract of each key, position by position, as stock TWIST and TWIST2 have it."""

from __future__ import annotations

import keyword
import sys
from collections import Counter
from pathlib import Path
from subprocess import run

import pytest

from adapters.robots.g1 import twist_keys
from adapters.robots.g1.joints import G1_23, G1_25, G1_29
from adapters.robots.kassow.names import KR810_ROBOT
from adapters.robots.legged import unitree
from station.bus import contracts, keys

TWIST2_LENGTHS = {
    "action_body_unitree_g1_with_hands": 35,
    "action_hand_left_unitree_g1_with_hands": 7,
    "action_hand_right_unitree_g1_with_hands": 7,
    "action_neck_unitree_g1_with_hands": 2,
    "state_body_unitree_g1_with_hands": 34,
    "state_hand_left_unitree_g1_with_hands": 7,
    "state_hand_right_unitree_g1_with_hands": 7,
    "state_neck_unitree_g1_with_hands": 2,
}
TWIST_LENGTHS = {"action_mimic_g1": 33, "action_hand_g1": 14, "state_body_g1": 74, "state_hand_g1": 14}


@pytest.mark.parametrize(("key", "length"), [*TWIST2_LENGTHS.items(), *TWIST_LENGTHS.items()])
def test_every_stock_vector_has_its_stock_length(key: str, length: int) -> None:
    found = contracts.contract(key)
    assert found is not None
    assert found.codec == "json-vector"
    assert len(found.elements) == length


@pytest.mark.parametrize("key", ["t_action", "t_state"])
def test_stock_times_are_whole_numbers(key: str) -> None:
    found = contracts.contract(key)
    assert found is not None
    assert found.codec == "integer"


@pytest.mark.parametrize("key", ["controller_data", "motion_start_signal", "motion_exit_signal"])
def test_the_other_stock_keys_have_a_contract(key: str) -> None:
    assert contracts.contract(key) is not None


def test_depth_says_what_a_step_is_and_pictures_in_colour_say_nothing_of_one() -> None:
    beside, colour = (contracts.contract(key) for key in (keys.camera_depth("head"), keys.camera_image("head")))
    assert beside is not None
    assert colour is not None
    assert (beside.codec, beside.step_m, beside.role, beside.rate_hz) == ("png", 0.001, "sensor", colour.rate_hz)
    assert (colour.codec, colour.step_m) == ("jpeg", None)
    assert contracts.contract(keys.stamp(keys.camera_depth("head"))) is None


def names(key: str) -> tuple[str, ...]:
    found = contracts.contract(key)
    assert found is not None
    return found.names


def test_twist2_command_positions() -> None:
    order = names(twist_keys.action_body())
    assert order[:6] == ("root_vel_x", "root_vel_y", "root_height", "root_roll", "root_pitch", "root_yaw_rate")
    expected = {6: "left_hip_pitch", 9: "left_knee", 12: "right_hip_pitch", 18: "waist_yaw", 21: "left_shoulder_pitch",
                24: "left_elbow", 25: "left_wrist_roll", 28: "right_shoulder_pitch", 34: "right_wrist_yaw"}  # fmt: skip
    assert {index: order[index] for index in expected} == {i: f"{name}_pos" for i, name in expected.items()}


def test_twist_command_positions() -> None:
    order = names(twist_keys.action_mimic())
    assert order[0] == "root_height"
    assert order[3] == "root_yaw"
    assert order[4:7] == ("root_vel_x", "root_vel_y", "root_vel_z")
    assert order[7] == "root_yaw_rate"
    assert order[27] == "left_wrist_roll_pos"
    assert order[32] == "right_wrist_roll_pos"
    assert order[28:32] == tuple(f"right_{n}_pos" for n in ("shoulder_pitch", "shoulder_roll", "shoulder_yaw", "elbow"))


def test_twist2_state_positions() -> None:
    order = names("state_body_unitree_g1_with_hands")
    assert order[:5] == ("gyro_x", "gyro_y", "gyro_z", "root_roll", "root_pitch")
    assert order[5:] == tuple(f"{name}_pos" for name in G1_29)


def test_twist_state_positions() -> None:
    order = names("state_body_g1")
    assert order[5] == "left_hip_pitch_pos_from_default"
    assert order[28] == "scaled_left_hip_pitch_vel"
    assert order[51] == "left_hip_pitch_previous_action"


def test_the_fingers_of_the_two_hands_stand_in_different_order() -> None:
    assert [n.split("_")[2] for n in names(twist_keys.state_hand("left"))] == ["thumb"] * 3 + ["middle"] * 2 + [
        "index"
    ] * 2
    assert [n.split("_")[2] for n in names(twist_keys.state_hand("right"))] == ["thumb"] * 3 + ["index"] * 2 + [
        "middle"
    ] * 2


def test_element_names_are_unique_and_valid_anywhere() -> None:
    every = [(item.key, name) for item in contracts.contracts() for name in item.names]
    assert [pair for pair, count in Counter(every).items() if count > 1] == []
    assert [(key, name) for key, name in every if not name.isidentifier() or keyword.iskeyword(name)] == []


def test_joint_orders() -> None:
    assert len(G1_29) == 29
    assert G1_29.index("left_ankle_roll") == 5
    assert G1_29.index("waist_yaw") == 12
    assert G1_29.index("left_wrist_yaw") == 21
    assert G1_25.index("left_wrist_roll") == 19
    assert G1_25.index("right_wrist_roll") == 24
    assert len(G1_23) == 23


def test_an_unknown_key_has_no_contract() -> None:
    assert contracts.contract("somebody_elses_key") is None
    assert contracts.contract("station:server:anything") is not None


def test_an_arm_of_any_model_has_the_contracts_of_an_arm() -> None:
    for robot in (KR810_ROBOT, "kassow_kr1018", "kassow_kr810_left"):
        lengths = {
            keys.action_joints: 7,
            keys.state_joints: 21,
            keys.state_tcp: 7,
            keys.command_used: 7,
            keys.target: 7,
        }
        for family, length in lengths.items():
            found = contracts.contract(family(robot))
            assert found is not None
            assert (found.key, len(found.elements)) == (family(robot), length)
        assert names(keys.action_joints(robot)) == tuple(f"joint_{number}_pos" for number in range(1, 8))
        assert names(keys.state_counters(robot))[:2] == ("tick", "stream_j_sends")


def test_what_is_no_key_of_an_arm_has_no_contract() -> None:
    for key in ("action_joints_kassow_", "kassow_kr810", "action_body_kassow_kr810",
                keys.stamp(keys.state_joints("kassow_kr1018"))):  # fmt: skip
        assert contracts.contract(key) is None, key


OTHERS = """
import numpy as np

from station.bus.robot_streams import driven_by_policy
from station.contract import elements
from station.description import Joint, RobotDescription, RobotFamily

class WithoutElements:
    name, robot, key, note = "broken", "unitree_g1_with_hands", "action_broken", ""

class Another(WithoutElements):
    name, key, elements = "another", "action_another", elements((("speed",), "m/s"))

STRIDER = RobotDescription(name="strider", model="strider", joints=(Joint("knee"),), streams=driven_by_policy())
GOOD = RobotFamily(("strider",), {"strider": STRIDER}.get)
BAD = RobotFamily(("broken",), lambda name: 1)
CURIOUS = RobotFamily((), lambda name: name.robot)
"""
ENTRIES = """
[station.commands]
aaa = others:Another
broken = others:WithoutElements
gone = not_here:FORMAT
[station.families]
bad = others:BAD
curious = others:CURIOUS
good = others:GOOD
lost = not_here:FAMILY
"""
ASK = f"""
import sys; sys.path.insert(0, {{folder!r}})
from station.bus import contracts, keys
print(contracts.contract("action_another").names, contracts.contract("action_broken"))
print(len(contracts.contract(keys.command_used({twist_keys.TWIST2_ROBOT!r})).names))
print(contracts.contract(keys.robot_state("strider")).names[0], contracts.contract(keys.robot_state("stranger")))
print(*contracts.robots())
"""


@pytest.mark.usefixtures("processes")
def test_what_others_register_takes_no_key_from_ours_and_what_is_broken_of_it_ends_nobody(tmp_path: Path) -> None:
    metadata = tmp_path / "others-1.0.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: others\nVersion: 1.0\n")
    (metadata / "entry_points.txt").write_text(ENTRIES)
    (tmp_path / "others.py").write_text(OTHERS)
    done = run(
        [sys.executable, "-B", "-c", ASK.format(folder=str(tmp_path))], capture_output=True, text=True, check=False
    )
    assert done.stdout.splitlines() == [
        "('speed',) None", "35", "knee_pos None",
        " ".join(["unitree_g1_with_hands", "g1", "kassow_kr810", *unitree.ROBOTS, "strider"]),
    ], done.stderr  # fmt: skip
    for trouble, named in (
        ("its key has no contract", ["broken", "gone"]),
        ("its robots have no contracts", ["bad", "lost"]),
        ("cannot say whether", ["curious"]),
    ):
        told = [line for line in done.stderr.splitlines() if trouble in line]
        assert list(dict.fromkeys(line.split("'")[1] for line in told)) == named
