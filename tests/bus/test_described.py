"""What follows from what a robot says of itself: contracts of its keys, whatever it is."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest

from adapters.robots.g1 import twist_keys
from adapters.robots.kassow.names import KR810_ROBOT
from adapters.robots.legged import unitree
from station.bus import contracts, keys
from station.bus.contracts import Contracts
from station.contract import Contract, Element
from station.description import Joint, RobotDescription, stated
from tests import strider
from tests.strider import DESCRIPTION, KNEES, NAME


def test_a_robot_that_describes_itself_has_named_keys() -> None:
    known = Contracts([{"server": "motion"}, strider.facts()])
    state = known.get(keys.robot_state(NAME))
    assert state is not None
    assert state.names == (
        "left_knee_pos", "right_knee_pos", "left_knee_vel", "right_knee_vel", "root_quat_w", "root_quat_x",
        "root_quat_y", "root_quat_z", "gyro_x", "gyro_y", "gyro_z",
    )  # fmt: skip
    used, feet = known.get(keys.command_used(NAME)), known.get(strider.FEET)
    assert used is not None
    assert used.elements == strider.COMMAND
    assert feet is not None
    assert (feet.elements[0], feet.role) == (Element("left_force", "N"), "state")
    assert contracts.contract(strider.FEET) is None, "another station knows nothing of it"


def test_names_of_a_description_are_those_of_its_robot_only() -> None:
    twin = msgspec.structs.replace(DESCRIPTION, name="strider_2", joints=(Joint("hip"),))
    known = Contracts([strider.facts(), strider.facts(description=msgspec.to_builtins(twin))])
    assert [known.get(keys.target(name)).names[0] for name in (NAME, "strider_2")] == ["left_knee_pos", "hip_pos"]  # type: ignore[union-attr]
    assert known.robots()[:2] == (NAME, "strider_2")


def test_what_is_stated_anew_takes_the_place_of_what_was_stated() -> None:
    known = Contracts([strider.facts()])
    known.describe(msgspec.structs.replace(DESCRIPTION, streams=DESCRIPTION.streams[2:]))
    assert known.get(strider.FEET) is None
    assert known.get(keys.robot_state(NAME)) is not None


HIP = (Element("{joint}_pos", "rad"),)
STREAM = {"key": "k", "family": "f", "role": "state", "codec": "f64"}


def test_a_description_goes_before_what_is_registered_but_not_before_the_stations_own_keys() -> None:
    g1 = RobotDescription(
        name=twist_keys.TWIST2_ROBOT, model="other", joints=(Joint("hip"),),
        streams=(
            Contract(key=keys.robot_state("{robot}"), family="x", role="state", codec="f64", elements=HIP),
            Contract(key=keys.ESTOP, family="x", role="state", codec="f64"),
            Contract(key=keys.camera_image("front"), family="x", role="state", codec="f64"),
        ),
    )  # fmt: skip
    known = Contracts()
    known.describe(g1)
    own = [known.get(key) for key in (keys.robot_state(g1.name), keys.ESTOP, keys.camera_image("front"))]
    assert [one.role for one in own if one is not None] == ["state", "control", "sensor"]
    assert own[0] is not None
    assert own[0].names == ("hip_pos",)


@pytest.mark.parametrize(
    "change",
    [
        {"name": "two words"},
        {"name": ""},
        {"joints": [{"name": "a b"}]},
        {"joints": [{"name": f"j{n}"} for n in range(257)]},
        {"streams": [STREAM | {"role": "king"}]},
        {"streams": [STREAM | {"elements": [{"name": "1x", "unit": ""}]}]},
        {"streams": [STREAM] * 65},
        {"joints": [{"name": f"j{n}"} for n in range(256)],
         "streams": [STREAM | {"elements": [{"name": f"{{joint}}_{n}", "unit": ""} for n in range(17)]}]},
        {"joints": [{"name": "knee"}, {"name": "knee"}]},
        {"streams": [STREAM | {"elements": [{"name": "x", "unit": ""}] * 2}]},
        {"groups": {"leg": "left_knee"}},
        {"parts": {"hand": ["one"]}},
    ],
)  # fmt: skip
def test_what_is_no_description_of_a_robot_says_nothing(change: dict[str, Any]) -> None:
    assert stated(strider.facts()) == DESCRIPTION
    assert stated(strider.facts(description=msgspec.to_builtins(DESCRIPTION) | change)) is None
    assert Contracts([strider.facts(description=msgspec.to_builtins(DESCRIPTION) | change)]).get(strider.FEET) is None


def test_who_invents_robots_fills_no_memory() -> None:
    known = Contracts(
        strider.facts(description=msgspec.to_builtins(DESCRIPTION) | {"name": f"r{n}"}) for n in range(100)
    )
    assert len([name for name in known.robots() if name.startswith("r")]) == contracts.MOST_ROBOTS
    for number in range(contracts._REMEMBERED + 100):
        assert known.get(f"somebody_elses_{number}") is None
    assert contracts._of_another.cache_info().currsize <= contracts._REMEMBERED


def test_robots_that_state_nothing_are_known_by_their_families() -> None:
    assert contracts.robots() == (twist_keys.TWIST2_ROBOT, twist_keys.TWIST_ROBOT, KR810_ROBOT, *unitree.ROBOTS)
    known = Contracts()
    described = known.robot(twist_keys.TWIST2_ROBOT)
    assert described is not None
    assert (len(described.joints), described.short, described.has_base) == (29, "g1", True)
    assert {item.key for item in known.of(twist_keys.TWIST2_ROBOT)} > {
        twist_keys.action_body(),
        twist_keys.state_hand("left"),
    }
    assert known.robot(NAME) is None
    assert known.of(NAME) == ()


def test_the_body_is_told_of_by_the_key_with_most_of_its_joints() -> None:
    known = Contracts()
    every, described = known.of(twist_keys.TWIST2_ROBOT), known.robot(twist_keys.TWIST2_ROBOT)
    assert contracts.of_joints(twist_keys.TWIST2_ROBOT, "command", every, described) == [twist_keys.action_body()]
    assert contracts.of_joints(twist_keys.TWIST2_ROBOT, "state", every, described)[-1] == twist_keys.state_body(
        twist_keys.TWIST2_ROBOT
    )
    walking = Contracts([strider.facts()])
    assert contracts.of_joints(NAME, "command", walking.of(NAME), None) == ["action_walk_strider"]
    assert walking.robot(NAME) == DESCRIPTION
    assert [joint.name for joint in DESCRIPTION.joints] == list(KNEES)
