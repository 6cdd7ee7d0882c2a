"""Servers of a station on another machine: whatever ends there or here, the other side knows, and nothing is left."""

from __future__ import annotations

import os
import re
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest

from station.bus import codec, keys, stamp
from station.bus.client import Bus
from station.supervision.hosts import LEASE_S, Wanted, WantedServer
from tests.cli.running import COMMANDS_ONLY, SHORT, Home, Running, are_gone, new_home, one_line
from tests.faults.stops import LIGHT_G1
from tests.waiting import wait_until

BOTH = ("--on", "recorder=robot", "--on", "motion=robot", "--set", "motion.loop=true", *SHORT)


class Site(NamedTuple):
    """Two homes on one bus: where an agent runs, and where a person sits."""

    robot: Home
    desk: Home
    agent: Running

    def up(self, *arguments: str) -> tuple[str, ...]:
        return ("up", COMMANDS_ONLY, *arguments)

    def pids(self) -> list[int]:
        return [pid for name, pid in self.robot.pids().items() if name in ("recorder", "motion")]


@pytest.fixture
def site(processes: None) -> Iterator[Site]:
    with new_home() as robot, new_home() as desk, robot.running("bus", "start"):
        wait_until(robot.bus_is_there)
        desk.environment["STATION_BUS"] = robot.bus.url
        with robot.running("host", "join", "--name", "robot") as agent:
            agent.wait_for("host-robot is active")
            yield Site(robot, desk, agent)


def test_a_station_on_another_machine_is_recorded_there_and_ends_in_order(site: Site) -> None:
    with Bus(site.robot.bus, name="test") as bus:
        wait_until(lambda: bus.get(keys.clock(stamp.boot_id())), 10.0)
    with site.desk.running(
        *site.up("--on", "recorder=robot", "--record", "--task", "t", "--for", "2s", *SHORT)
    ) as station:
        code, out = station.finish()
    assert code == 0, station.text
    steps = ["✓ start recorder on robot", "· recording", "✓ start motion", "· 2 s are over", "✓ stop recorder"]
    places = [station.text.find(step) for step in steps]
    assert -1 not in places
    assert places == sorted(places)
    assert out.strip() == f"robot:{site.robot.episode('t')}"
    assert not site.desk.data.exists()
    assert site.robot.run("check", "latest").returncode == 0
    assert "record-stop" in site.desk.run("logs", "recorder").stdout, "its lines came over the bus"
    assert "runs nothing" in site.desk.run("host", "list").stdout


def test_past_a_frozen_bus_a_stop_reaches_the_robot_on_whose_machine_it_is_pressed(site: Site) -> None:
    with site.desk.running("up", "g1-sim-motion", "--yes", "--on", "g1=robot", "--on", "recorder=robot",
                           *LIGHT_G1) as station:  # fmt: skip
        station.wait_for("to=tracking")
        with Bus(site.robot.bus, name="test", timeout_s=5.0) as bus:
            pid = int(bus.call("INFO", "server").decode().split("process_id:")[1].split()[0])
        os.kill(pid, signal.SIGSTOP)
        try:
            here = one_line(site.desk.run("estop"))
            assert here.startswith("NO robot was stopped (")
            assert "; NOT told: g1 (on another machine, or dead); the stop is latched" in here
            assert one_line(site.robot.run("estop")).startswith(
                "stopped past the bus: g1; the bus did not take the stop"
            )
            (log,) = Path(site.robot.environment["XDG_RUNTIME_DIR"]).rglob("g1.log")
            wait_until(lambda: "to=stopped" in log.read_text())
        finally:
            os.kill(pid, signal.SIGCONT)
        station.interrupt()
        station.finish()


def test_a_machine_that_has_not_joined_is_named_with_what_to_do(site: Site) -> None:
    said = one_line(site.desk.run(*site.up("--on", "motion=robto")))
    assert "host 'robto' (did you mean 'robot'?) has not joined" in said
    assert "run `station host join --name robto`; joined: robot" in said
    for wrong, hint in (("mtion=robot", " (did you mean 'motion'?)"), ("motion", "")):
        expected = f"--on {wrong}{hint}: expected SERVER=HOST, with a server that the runbook starts: recorder, motion"
        assert expected in one_line(site.desk.run(*site.up("--on", wrong)))
    said = one_line(site.robot.run("host", "join", "--name", "a b"))
    assert said.endswith("expected a name of letters, digits, - and _, got 'a b'")


def test_a_machine_serves_one_station_at_a_time(site: Site) -> None:
    with site.desk.running(*site.up(*BOTH)) as station:
        station.wait_for("✓ start motion on robot")
        other = site.desk.run("up", COMMANDS_ONLY, "--on", "recorder=robot", "--dry-run")
        assert "start recorder on robot" in other.stdout
        with Bus(site.robot.bus, name="stranger") as bus:
            wanted = Wanted(station="x", who="a stranger", servers={"g1": _wanted("g1")})
            bus.publish({keys.host("robot"): codec.json_object(wanted)})
        site.agent.wait_for("host-refused reason=a stranger wants servers here")
        station.interrupt()
        assert station.finish()[0] == 0, station.text
    assert "✓ stop motion" in station.text


def test_what_a_machine_lacks_or_does_not_allow_is_told_where_the_station_runs(site: Site) -> None:
    site.agent.interrupt()
    assert site.agent.finish()[0] == 0
    with site.robot.running("host", "join", "--name", "robot", "--allow", "motion") as agent:
        agent.wait_for("host-robot is active")
        refused = site.desk.run(*site.up("--on", "recorder=robot"))
        assert refused.returncode == 1
        assert "host 'robot' may start motion alone (--allow), not recorder" in refused.stderr
        lacking = site.desk.run(*site.up("--on", "motion=robot", "--set", "motion.motion=nowhere/walk.pkl"))
        assert lacking.returncode == 1
        assert "server 'motion' ended with code" in lacking.stderr
        assert "nowhere/walk.pkl" in lacking.stderr


def test_a_server_that_is_killed_there_is_told_with_its_end_and_a_recorder_goes_on(site: Site) -> None:
    with site.desk.running(*site.up(*BOTH)) as station:
        station.wait_for("✓ start motion on robot")
        before = site.robot.pids()
        os.kill(before["recorder"], signal.SIGKILL)
        station.wait_for("server-restarted server=recorder")
        wait_until(lambda: site.robot.pids().get("recorder") not in (None, before["recorder"]))
        os.kill(before["motion"], signal.SIGKILL)
        code, _ = station.finish()
    assert code == 1
    assert "server 'motion' was killed by SIGKILL" in station.text
    wait_until(lambda: not site.pids())


def test_the_servers_of_an_agent_that_is_killed_finish_and_a_new_agent_starts_none(site: Site) -> None:
    with site.desk.running(*site.up(*BOTH)) as station:
        station.wait_for("✓ start motion on robot")
        pids = site.pids()
        site.agent.process.kill()
        site.agent.process.wait()
        with site.robot.running("host", "join", "--name", "robot") as agent:
            agent.wait_for("host-robot is active")
            code, _ = station.finish()
            assert code == 1
            assert "the agent of host 'robot' was started anew, and its servers have ended" in station.text
            wait_until(lambda: are_gone(pids))
            assert site.pids() == []


def test_an_agent_that_ends_lets_its_servers_finish_and_the_station_is_told(site: Site) -> None:
    with site.desk.running(*site.up(*BOTH, "--record", "--task", "t")) as station:
        station.wait_for("✓ start motion on robot")
        pids = site.pids()
        site.agent.interrupt()
        assert site.agent.finish()[0] == 0
        assert are_gone(pids)
        code, _ = station.finish()
    assert code == 1
    assert re.search(r"server '(motion|recorder)' ended with code 0", station.text), station.text
    assert site.robot.json("episodes", "show", "latest")["manifest"]["state"] == "finished"


@pytest.mark.timeout(120)
def test_the_servers_of_a_station_that_is_killed_are_let_go_and_finish(site: Site) -> None:
    with site.desk.running(*site.up(*BOTH)) as station:
        station.wait_for("✓ start motion on robot")
        pids = site.pids()
        station.process.kill()
        site.agent.wait_for("host-let-go who=")
        assert f"silent_s={LEASE_S:g}" in site.agent.text
        wait_until(lambda: are_gone(pids))
    assert "runs nothing" in site.desk.run("host", "list").stdout
    with site.desk.running(*site.up(*BOTH)) as station:
        station.wait_for("✓ start motion on robot")
        station.interrupt()
        assert station.finish()[0] == 0, station.text


def test_what_a_stranger_writes_starts_nothing_that_is_no_server(site: Site) -> None:
    with Bus(site.robot.bus, name="stranger") as bus:
        agent = site.robot.health()["host-robot"].started_wall_ns
        for data in (b"", b"[]", b'{"station": 1}'):
            bus.publish({keys.host("robot"): data})
            site.agent.wait_for("host-refused reason=not what a station wants")
        servers = {
            "../evil": _wanted("motion", agent),
            "a": _wanted("no-such", agent),
            "b": _wanted("motion", agent - 1),
        }
        wanted = Wanted(station="x", who="a stranger", servers=servers)
        bus.publish({keys.host("robot"): codec.json_object(wanted)})
        said: dict[str, dict[str, object]] = {}
        wait_until(lambda: said.update(site.robot.health()["host-robot"].detail["servers"]) or len(said) > 1)
        assert set(said) == {"../evil", "a"}, "what an earlier agent ran is not started again"
        assert "expected a name of letters" in str(said["../evil"]["last_words"])
        assert "unknown server 'no-such'" in str(said["a"]["last_words"])


def _wanted(kind: str, agent: int = 0) -> WantedServer:
    return WantedServer(kind=kind, config={}, agent=agent, process=1, stage="run")
