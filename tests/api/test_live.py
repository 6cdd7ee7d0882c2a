"""What a script asks of a station that runs is done, or refused with the reason; what it reads has names and units."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from itertools import islice
from pathlib import Path

import pytest

from adapters.robots.g1 import twist_keys
from station import Station, StationError
from station.api import live
from station.api.live import RobotStatus
from station.bus import keys
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.errors import BusError, NotReady, Refused, UsageError
from station.life.stop_file import StopFile
from station.motion import playback_requests
from tests import strider
from tests.cli.running import Home, new_home
from tests.waiting import DEADLINE_S, wait_until

ROBOT = twist_keys.TWIST2_ROBOT


@pytest.fixture
def lab(shared: Home) -> Iterator[Station]:
    with Station() as station:
        station.wait_for_robot(within_s=DEADLINE_S)
        yield station


@pytest.fixture
def alone(bus_server: BusAddress) -> Iterator[Station]:
    """A line to a bus on which nothing runs."""
    with Station(bus_server.url) as station:
        yield station


def test_servers_and_robots_tell_of_themselves(lab: Station) -> None:
    wait_until(lambda: {"g1", "recorder", "motion"} <= {server.name for server in lab.servers()})
    robot = lab.wait_for_robot(within_s=DEADLINE_S)
    assert {there.name for there in lab.robots()} <= {ROBOT}
    assert (robot.name, robot.server, robot.state, robot.arming) == (ROBOT, "g1", "active", "armed")
    assert {lab.wait_for_robot(name, within_s=DEADLINE_S).name for name in ("", "g1", ROBOT)} == {ROBOT}
    described = lab.description(ROBOT)
    assert described is not None
    assert len(described.joints) == 29
    assert keys.robot_state(ROBOT) in lab.keys("robot_state_*")
    assert not list(filter(keys.is_stamp, lab.keys("*")))


def test_a_value_has_the_names_of_its_contract(lab: Station) -> None:
    value = lab.read(keys.robot_state(ROBOT))
    assert value is not None
    contract = lab.describe(value.key)
    assert contract is not None
    assert list(value.named()) == list(contract.names)
    assert value.vector().tolist() == list(value.named().values())
    assert (value.writer, value.written_ns is not None) == ("g1", True)
    with pytest.raises(UsageError, match="not JSON"):
        value.json()
    gate = lab.read(keys.command_gate(ROBOT))
    assert gate is not None
    assert gate.json()["arming"] == "armed"
    with pytest.raises(UsageError, match="no vector, it holds json"):
        gate.vector()
    assert lab.read("nothing_of_the_kind") is None


def test_a_followed_key_gives_one_new_value_after_another(lab: Station) -> None:
    seen = list(islice(lab.follow(keys.policy_timing(ROBOT)), 5))
    ticks = [value.named()["tick"] for value in seen]
    assert ticks == sorted(set(ticks))
    assert list(lab.follow("nobody_writes_this", silent_s=0.2)) == []


def test_a_motion_obeys_or_says_why_not(lab: Station) -> None:
    with pytest.raises(Refused, match="motion resume: resume does not apply while waiting"):
        lab.motion.resume()
    lab.motion.start()
    events = lab.events(silent_s=DEADLINE_S)
    wait_until(lambda: phase(lab) == "playing")
    lab.motion.pause()
    assert any(event.name == "motion-control" and event.detail["action"] == "pause" for event in events)
    lab.motion.resume()
    with pytest.raises(Refused, match="seek needs time_s"):
        lab.motion._ask("seek")


def phase(lab: Station) -> object:
    return next((server.detail.get("phase") for server in lab.servers() if server.name == "motion"), None)


def test_an_episode_is_recorded_marked_and_flagged(lab: Station, shared: Home) -> None:
    with pytest.raises(Refused, match="record stop: nothing to stop: no episode is being recorded"):
        lab.record.stop()
    begun = lab.record.start("from-a-script", operator="ada")
    assert begun.path is not None
    assert Path(begun.path).parent == shared.data / "from-a-script"
    wait_until(lambda: (status := lab.record.status()) is not None and status.state == "recording")
    lab.record.mark("half way")
    done = lab.record.stop(success=True)
    assert done.episode_id == begun.episode_id
    assert done.summary["messages"] > 0
    assert lab.record.discard("only a trial").episode_id == begun.episode_id


@pytest.mark.usefixtures("processes", "patient_stop")
def test_a_robot_is_disarmed_armed_stopped_and_released_by_its_name() -> None:
    # No motion beside it: a stop ends that, and with it a station that nobody attends.
    with new_home() as home, home.running("bus", "start"):
        wait_until(home.bus_is_there)
        with home.running("serve", "g1"), Station(home.bus.url) as lab:

            def robot() -> RobotStatus:
                return lab.wait_for_robot(ROBOT, within_s=DEADLINE_S)

            robot()
            assert list(lab.disarm(ROBOT)) == ["g1"]
            assert robot().arming == "disarmed"
            assert lab.arm(ROBOT)["g1"][-1] == "armed"
            assert lab.estop("somebody came close") == ["g1"]
            assert robot().gate == "stopped"
            assert "somebody came close" in robot().reason
            with pytest.raises(Refused, match="the emergency stop is latched"):
                lab.arm("g1")
            lab.release("all clear")
            assert robot().gate != "stopped"
            with pytest.raises(NotReady, match="no low-level server h1 runs"):
                lab.arm("h1")


def test_an_object_may_be_shared_between_threads(lab: Station) -> None:
    found: list[int] = []

    def read() -> None:
        for _ in range(50):
            value = lab.read(keys.robot_state(ROBOT))
            assert value is not None
            found.append(len(value.vector()))

    threads = [threading.Thread(target=read) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert found == [65] * 200


def test_what_is_published_is_encoded_by_its_contract(alone: Station) -> None:
    key = keys.robot_state(ROBOT)
    alone.publish({key: [0.5] * 65, "state_mood": {"is": "good"}, "note": "text", "blob": b"\x00"})
    value = alone.read(key)
    assert value is not None
    assert value.named()["left_knee_pos"] == 0.5
    assert value.writer == "script"
    assert [(alone.read(name) or value).data for name in ("state_mood", "note", "blob")] == [
        b'{"is":"good"}', b"text", b"\x00",
    ]  # fmt: skip
    with pytest.raises(UsageError, match=r"2 numbers, expected 65: left_hip_pitch_pos, .*, …"):
        alone.publish({key: [1.0, 2.0]})
    with pytest.raises(UsageError, match="state_mood: numbers, but the key holds no vector that is known"):
        alone.publish({"state_mood": [1.0]})
    alone.publish({key: b"\x01"})
    bad = alone.read(key)
    assert bad is not None
    with pytest.raises(UsageError, match=f"{key}: 1 bytes, expected a multiple of 8"):
        bad.vector()


def test_where_nobody_is_there_a_line_says_what_is(alone: Station) -> None:
    assert (alone.robots(), alone.servers(), alone.record.status()) == ([], [], None)
    asked: list[tuple[Callable[[], object], str]] = [
        (lambda: alone.wait_for_robot("left_arm", within_s=0.1), "left_arm: not driven within 0.1 s"),
        (alone.arm, "no low-level server runs on"),
    ]
    for act, said in asked:
        with pytest.raises(NotReady, match=said) as caught:
            act()
        assert "\n" not in str(caught.value)


def test_nobody_who_plays_a_motion_is_told(bus_server: BusAddress) -> None:
    with Bus(bus_server, name="test") as bus, pytest.raises(NotReady, match=r"motion start: nobody answered in 0\.1 s"):
        playback_requests.ask(bus, "start", within_s=0.1)


@pytest.mark.usefixtures("processes")
def test_a_stop_that_no_bus_takes_is_kept_for_the_next_start(monkeypatch: pytest.MonkeyPatch) -> None:
    with new_home() as home, home.running("bus", "start") as bus:
        monkeypatch.setenv("XDG_STATE_HOME", home.environment["XDG_STATE_HOME"])
        wait_until(home.bus_is_there)
        with Station(home.bus.url) as lab:
            bus.interrupt()
            bus.finish()
            with pytest.raises(BusError, match=r"NO robot was stopped \(.*the stop is latched for the next start"):
                lab.estop("it smokes")
        latched = StopFile(home.bus).read()
        assert latched is not None
        assert "it smokes" in latched.reason


def test_what_listens_ends_with_the_line_to_the_bus(bus_server: BusAddress) -> None:
    lab = Station(bus_server.url)
    followed, events = lab.follow("a"), lab.events()
    unused = lab.follow("b")
    before = threading.active_count()
    threading.Timer(0.2, lab.close).start()
    assert list(followed) == []
    assert list(events) == []
    assert list(unused) == []
    wait_until(lambda: threading.active_count() <= before - 3)


def test_what_servers_state_is_not_read_again_for_every_value(alone: Station, monkeypatch: pytest.MonkeyPatch) -> None:
    read: list[object] = []
    monkeypatch.setattr(live, "read_configurations", lambda bus: read.append(bus) or [])
    for _ in range(100):
        alone.publish({keys.robot_state(ROBOT): [0.5] * 65})
    assert 1 <= len(read) < 50
    alone.publish({keys.server_config("walker"): strider.facts()})
    monkeypatch.undo()
    wait_until(lambda: alone.describe(strider.FEET) is not None)


def test_a_bus_that_is_not_there_is_an_error_of_the_station(tmp_path: Path) -> None:
    with pytest.raises(BusError, match="No such file"):
        Station(f"unix://{tmp_path}/none.sock")
    with pytest.raises(StationError, match="bus address"):
        Station("http://localhost")
