"""``station describe``: a robot's joints, limits and keys; a key with names, units, and what it holds now."""

from __future__ import annotations

import re
from collections.abc import Iterator

import pytest

from adapters.robots.legged import unitree
from station.bus import codec, keys
from station.bus.client import Bus
from tests import strider
from tests.cli.running import Home, new_home, one_line
from tests.strider import KNEES, NAME
from tests.waiting import wait_until


@pytest.fixture(scope="module")
def strolling(processes: None) -> Iterator[Home]:
    """A place where a robot that nothing of ours knows has described itself and written a state."""
    with new_home() as home, home.running("bus", "start"):
        wait_until(home.bus_is_there)
        with Bus(home.bus, name="walker", timeout_s=5.0) as bus:
            bus.publish({keys.server_config("walker"): codec.json_object(strider.facts())})
            bus.publish({strider.FEET: b"[12.5, 80.0]", keys.command_gate(NAME): b'{"state": "tracking"}'})
            bus.publish({"a_stranger_s": b"what", keys.command_used(NAME): b"\x00"})
            yield home


def rows(text: str) -> dict[str, list[str]]:
    """Rows of tables by their first cell."""
    cells = [re.split(r"\s{2,}", line.strip()) for line in text.splitlines()]
    return {row[0]: row[1:] for row in cells}


def test_a_robot_that_described_itself_is_shown_with_joints_limits_and_keys(strolling: Home) -> None:
    done = strolling.run("describe", NAME)
    assert done.stdout.startswith("strider: strider, 2 joints, stands on its own\n")
    found = rows(done.stdout)
    assert found["joint"] == ["limb", "lower [rad]", "upper [rad]", "speed [rad/s]", "torque [N m]"]
    assert found["left_knee"] == ["left leg", "-1", "1.5", "8", "–"]
    assert found[strider.FEET][:3] == ["state", "2", "50 Hz"]
    assert [joint["name"] for joint in strolling.json("describe", NAME)["joints"]] == list(KNEES)
    assert NAME in [robot["name"] for robot in strolling.json("describe")]
    assert strider.FEET in [item["key"] for item in strolling.json("keys")]


def test_a_key_shows_what_it_holds_now(strolling: Home) -> None:
    found = rows(strolling.run("describe", strider.FEET).stdout)
    assert found["written by walker, 12 bytes"] == []
    assert (found["0"], found["1"]) == (["left_force", "N", "12.5"], ["right_force", "N", "80"])
    plain = strolling.json("describe", strider.FEET)
    assert (plain["value"], plain["writer"], plain["elements"][0]["unit"]) == ([12.5, 80.0], "walker", "N")
    assert '{\n  "state": "tracking"\n}\n' in strolling.run("describe", keys.command_gate(NAME)).stdout


def test_what_does_not_fit_is_said(strolling: Home) -> None:
    done = strolling.run("describe", keys.command_used(NAME))
    assert done.returncode == 0
    assert "what it holds now does not fit: 0 numbers for 3 names" in done.stdout
    assert rows(done.stdout)["0"] == ["speed", "m/s"]
    assert "key 'a_stranger_s': it is there, 4 bytes, and nothing describes it" in one_line(
        strolling.run("describe", "a_stranger_s")
    )


def test_without_a_bus_it_shows_what_is_known_and_with_one_that_is_named_it_needs_it(home: Home) -> None:
    known = [robot["name"] for robot in home.json("describe")]
    assert known == ["unitree_g1_with_hands", "g1", "kassow_kr810", *unitree.ROBOTS]
    assert "torque" in home.run("describe", "kassow_kr810").stdout
    assert "Connection refused" in one_line(home.run("describe", "--bus", "redis://localhost:1"))
    home.environment["STATION_BUS"] = "redis://localhost:1"
    done = home.run("keys")
    assert done.returncode == 0
    assert "Connection refused" in done.stderr
    assert done.stderr.endswith("; this is what is known without it\n")
