"""Another policy takes over while a real G1's server runs: asked for at the command line, by a script, and in vain."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Event
from typing import NamedTuple

import pytest

from station.api.live import Station
from station.bus import codec, keys
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.errors import Refused
from station.life.policy_request import PolicyRequest
from station.supervision.runbook import TakingOver
from tests.servers.g1_station import PATIENT, ROBOT, G1Process, Log, StockCommander, logged
from tests.waiting import wait_until

STIFF = ("policies.stiff.policy=tracker", "policies.stiff.policy_options.wrist_gains=training")


class Driven(NamedTuple):
    """A G1 that follows a commander, everything that is written, and a line to it."""

    address: BusAddress
    log: Log
    station: Station


@contextmanager
def driven(address: BusAddress, *settings: str) -> Iterator[Driven]:
    with logged(address) as log, G1Process(address, *PATIENT, *settings), StockCommander(address):
        wait_until(lambda: log.gate()["state"] == "tracking")
        with Station(address.url) as station:
            yield Driven(address, log, station)


def station(address: BusAddress, *words: str) -> tuple[int, str, str]:
    done = subprocess.run(
        [sys.executable, "-m", "station", *words, "--bus", address.url], capture_output=True, text=True, check=False
    )
    return done.returncode, done.stdout, done.stderr


def test_another_policy_takes_over_while_the_robot_is_driven_and_back(bus_server: BusAddress) -> None:
    with driven(bus_server, *STIFF, "blend_s=0.1") as robot:
        assert station(bus_server, "policy", "list") == (0, f"{ROBOT}: tracker (drives), stiff\n", "")
        assert station(bus_server, "policy", "switch", "stiff") == (0, f"{ROBOT}: stiff drives\n", "")
        wait_until(lambda: robot.log.gate()["policy"] == "stiff")  # the log may be behind
        assert station(bus_server, "policy", "list")[1] == f"{ROBOT}: tracker, stiff (drives)\n"
        event = robot.log.wait_for("policy-switched")
        assert (event.detail["before"], event.detail["policy"], event.detail["blend_s"]) == ("tracker", "stiff", 0.1)
        assert event.detail["who"]

        def stated() -> dict[str, object]:
            return dict(codec.parse_json(robot.log.last(keys.server_config("g1")))["policy"])

        wait_until(lambda: stated().get("called") == "stiff")
        assert stated()["options"] == {"wrist_gains": "training"}
        wait_until(lambda: codec.parse_f64(robot.log.last(keys.target(ROBOT)))[-1] == 5.0)  # damping of its wrists
        assert robot.station.switch_policy("tracker") == ROBOT
        assert set(robot.log.states()[-20:]) == {"tracking"}
        assert not robot.log.events("fall")
        assert [each.driving for each in robot.station.policies()] == ["tracker"]


def test_a_step_of_a_runbook_has_another_policy_take_over(bus_server: BusAddress, tmp_path: Path) -> None:
    with driven(bus_server, *STIFF) as robot, Bus(bus_server, name="up", timeout_s=5.0) as line:
        assert TakingOver(policy="stiff").run(line, tmp_path, Event()) == f"{ROBOT}: stiff drives"
        wait_until(lambda: robot.log.gate()["policy"] == "stiff")
        with pytest.raises(Refused, match="'stiff' drives already"):
            TakingOver(policy="stiff", robot="g1").run(line, tmp_path, Event())


def test_what_cannot_take_over_is_refused_in_a_line(bus_server: BusAddress) -> None:
    with driven(bus_server, *STIFF) as robot:
        code, out, err = station(bus_server, "policy", "switch", "stif")
        assert (code, out) == (1, "")
        assert err == (
            f"station: {ROBOT}: unknown policy of this robot 'stif' (did you mean 'stiff'?); known: stiff, tracker\n"
        )
        with pytest.raises(Refused, match="'tracker' drives already"):
            robot.station.switch_policy("tracker", "g1")
        robot.log.wait_for("policy-switch-refused", 2)
        assert [event.detail["policy"] for event in robot.log.events("policy-switch-refused")] == ["stif", "tracker"]
        assert robot.log.gate()["policy"] == "tracker"
        code, _, err = station(bus_server, "policy", "switch", "stiff", "--robot", "h1")
        assert code != 0
        assert err.startswith("station: no low-level server h1 runs")


def test_a_robot_with_one_policy_says_how_to_have_more(bus_server: BusAddress) -> None:
    with driven(bus_server) as robot:
        assert station(bus_server, "policy", "list") == (0, f"{ROBOT}: tracker (drives)\n", "")
        code, _, err = station(bus_server, "policy", "switch", "stiff")
        assert code == 1
        assert "no other policy can take over" in err
        assert "name others in its server's settings, `policies`" in err
        with Bus(bus_server, name="foreign") as bus:
            for request in (b"hello", codec.json_object(PolicyRequest(policy="stiff", id="a", robot=ROBOT))):
                bus.publish({keys.POLICY: request})
                told = "request-refused" if request == b"hello" else "policy-switch-refused"
                robot.log.wait_for(told)
        assert robot.log.gate()["switch"]["refused"].startswith("this robot's server has one policy alone")


def test_a_request_that_is_written_again_is_done_once(bus_server: BusAddress) -> None:
    with driven(bus_server, *STIFF, "blend_s=0.1") as robot, Bus(bus_server, name="asker") as bus:
        request = PolicyRequest(policy="stiff", id="a", robot=ROBOT)
        for late_s in (0.0, 0.001, 0.002):
            bus.publish(
                {keys.POLICY: codec.json_object(PolicyRequest(policy="stiff", id="a", robot=ROBOT, late_s=late_s))}
            )
        robot.log.wait_for("policy-switched")
        wait_until(lambda: robot.log.gate().get("switch", {}).get("id") == "a")
        bus.publish({keys.POLICY: codec.json_object(request)})
        bus.publish({keys.POLICY: codec.json_object(PolicyRequest(policy="tracker", id="b", robot="h1"))})
        robot.station.switch_policy("tracker")
        robot.log.wait_for("policy-switched", 2)
        assert [event.detail["policy"] for event in robot.log.events("policy-switched")] == ["stiff", "tracker"]
        assert not robot.log.events("policy-switch-refused")


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        (
            ("policies.tracker.policy=tracker",),
            "policies: 'tracker' is the name of the policy that drives at the start",
        ),
        (("policies.trakcer.policy_options.wrist_gains=real",), "unknown policy 'trakcer' (did you mean 'tracker'?)"),
        ((STIFF[0], "policies.stiff.wrist_gains=real"), "policies.stiff: unknown key 'wrist_gains'; known: checkpoint"),
        (("policies.stiff=tracker",), "policies.stiff: expected a mapping, got 'tracker'"),
        ((STIFF[0], "policies.stiff.checkpoint=nowhere.onnx"), "nowhere.onnx"),
        ((STIFF[0], "policies.stiff.policy_options.wrist=real"), "has no option 'wrist'"),
        (("blend_s=-1",), "blend_s"),
        (("blend_s=6",), "blend_s"),  # whoever asks would not wait for so long
    ],
)
def test_settings_that_cannot_work_are_refused_before_the_robot_moves(
    bus_server: BusAddress, settings: tuple[str, ...], words: str
) -> None:
    with G1Process(bus_server, *settings) as server:
        code, out, err = server.result()
    assert code != 0, out
    assert words in err
    assert len([line for line in err.splitlines() if line.startswith("station:")]) == 1
    assert "Traceback" not in err
