"""What the doctor says of a robot that checks itself, and what a runbook's check of it does."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import Any

import pytest

from station.bus import codec, keys
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.errors import NotReady
from station.life.server import Health
from station.supervision import doctor
from station.supervision.checks import RobotReadyCheck
from tests.fuzz.parsers import health


def _health(**detail: Any) -> Health:
    return codec.parse_struct(codec.json_object(codec.parse_facts(health("robot")) | {"detail": detail}), Health)


def _said(**detail: Any) -> list[tuple[str, str]]:
    return [(each.level, each.found) for each in doctor._against_arming(_health(**detail))]


def test_the_doctor_says_what_is_against_arming_a_robot_and_whether_a_guard_owns_its_motors():
    assert _said(why_not_arm="no state", guard="none") == [
        ("broken", "its robot is not to be armed: no state"),
        ("warning", "no guard owns the motors: who damps the robot when this server dies, or its cable is cut?"),
    ]
    assert _said(why_not_arm="", guard="1.2.3.4:5") == [("ok", "nothing is against arming its robot")]
    (_, found) = _said(why_not_arm="", guard="127.0.0.1:5", guard_is_beside_us=True)
    assert found[0] == "warning"
    assert "not when the robot's cable is cut" in found[1]
    assert len(_said(why_not_arm="", guard="1.2.3.4:5", guard_is_beside_us=False)) == 1
    assert _said() == [], "a simulated one says nothing of it"


@pytest.mark.parametrize(("detail", "words"), [
    ({"why_not_arm": "the remote is off"}, "robot: the remote is off"),
    ({}, "does not check itself; this check is for real robots"),
])  # fmt: skip
def test_a_runbook_waits_for_a_robot_and_says_why_it_does_not_go_on(bus_server: BusAddress, detail, words):
    with Bus(bus_server, name="test") as bus:
        with pytest.raises(NotReady, match="no server 'robot' runs"):
            RobotReadyCheck(server="robot").run(bus, Path(), threading.Event())
        bus.publish({keys.server("robot"): codec.json_object(_health(**detail))})
        with pytest.raises(NotReady, match=words):
            RobotReadyCheck(server="robot", within_s=0.2).run(bus, Path(), threading.Event())
        bus.publish({keys.server("robot"): codec.json_object(_health(why_not_arm=""))})
        found = RobotReadyCheck(server="robot").run(bus, Path(), threading.Event())
        assert found == "robot finds nothing against arming"
