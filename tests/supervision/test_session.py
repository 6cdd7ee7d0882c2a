"""A station's session with real servers on a real bus; the test is the person who answers."""

from __future__ import annotations

import getpass
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path

import msgspec
import pytest

from station.bus import keys
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.bus.redis_server import RedisServer, ServerOptions
from station.episode.storage.manifest import load_manifest
from station.errors import BusError, ConfigError, Refused
from station.life import events
from station.life.event_feed import EventFeed
from station.life.events import Severity
from station.life.server import Health, Life, ServerKind, read_health
from station.supervision import runbook
from station.supervision.session import Recording, Session
from station.supervision.supervisor import Supervisor
from tests.waiting import wait_until

HEAD = "runbook: t\nrobot: unitree_g1_with_hands\n"
ASK = "  - confirm: Nobody stands there.\n"
RECORDER = "  - start: recorder\n"
MOTION = "  - start: motion\n    with: {motion: 'builtin:wave', loop: true, enter_s: 0.1, leave_s: 0.1}\n"
KIND = ServerKind(name="a", role="command", summary="", config=msgspec.Struct, main=lambda _config, _life: 0)
QUICK = HEAD + "steps:\n" + ASK + RECORDER + MOTION


@dataclass
class Person:
    """Answers as told, and remembers what was shown."""

    answer: bool = True
    asked: Callable[[], None] = lambda: None
    told: list[str] = field(default_factory=list)
    shown: list[list[Health]] = field(default_factory=list)
    is_attended: bool = False
    offered: str = ""
    wants_restart: bool = False

    def begin(self, step: str) -> None:
        self.told.append(f"begin {step}")

    def done(self, step: str, result: str) -> None:
        self.told.append(f"done {step}: {result}")

    def failed(self, step: str, reason: str) -> None:
        self.told.append(f"failed {step}: {reason}")

    def say(self, text: str, severity: Severity = "info") -> None:
        self.told.append(f"{severity} {text}")

    def confirm(self, sentence: str) -> bool:
        self.told.append(f"asked {sentence}")
        self.asked()
        return self.answer

    def offer(self, restart: str) -> None:
        self.offered = restart

    def take_restart(self) -> bool:
        wanted, self.wants_restart = self.wants_restart, False
        return wanted

    def show(self, health: list[Health]) -> None:
        self.shown.append(health)

    def heard(self, text: str) -> bool:
        return any(text in line for line in self.told)


class Place:
    """A bus, a supervisor and a data folder."""

    def __init__(self, bus: Bus, folder: Path) -> None:
        self.bus, self.folder, self.data = bus, folder, folder / "data"
        self.supervisor = Supervisor(bus, folder / "logs", {"STATION_DATA": str(self.data)})
        self.stop = threading.Event()

    def session(self, text: str, person: Person, *, record: bool = False, unattended: bool = False) -> Session:
        path = self.folder / "book.yaml"
        path.write_text(text)
        recording = Recording(task="t", operator={"id": "ada"}) if record else None
        return Session(runbook.load(path), self.bus, self.supervisor, person, data=self.data, recording=recording,
                       is_unattended=unattended)  # fmt: skip


@pytest.fixture
def place(bus_server: BusAddress, tmp_path: Path) -> Iterator[Place]:
    with Bus(bus_server, name="supervisor", timeout_s=1.0) as bus:
        made = Place(bus, tmp_path)
        try:
            yield made
        finally:
            made.supervisor.stop_all()


def test_a_confirmation_that_is_refused_ends_it_before_anything_is_active(place: Place) -> None:
    person = Person(answer=False)
    session = place.session(QUICK, person, record=True)
    assert session.run(place.stop) == 1
    assert person.heard("error failed: not confirmed: Nobody stands there.")
    assert not person.heard("done start")
    assert place.bus.get(keys.action_body()) is None
    assert place.supervisor.children == {}
    assert session.episode is None
    assert not list(place.data.glob("*/*"))


def test_a_real_robot_refuses_to_be_confirmed_by_nobody(place: Place) -> None:
    with pytest.raises(ConfigError, match=r"--yes is refused, because people stand beside a real robot"):
        place.session(HEAD + "robot_is_real: true\nsteps:\n" + ASK + MOTION, Person(), unattended=True)


def test_with_a_real_robot_nothing_starts_before_its_step(place: Place) -> None:
    person = Person()
    person.asked = lambda: person.told.append(f"running {sorted(place.supervisor.children)}")
    text = HEAD + "robot_is_real: true\nsteps:\n" + RECORDER + ASK + MOTION
    assert place.session(text, person).run(place.stop, for_s=0.1) == 0
    assert person.heard("running ['recorder']")


def test_in_a_simulation_all_load_at_once(place: Place) -> None:
    person = Person()
    person.asked = lambda: person.told.append(f"running {sorted(place.supervisor.children)}")
    assert place.session(QUICK, person).run(place.stop, for_s=0.1) == 0
    assert person.heard("running ['motion', 'recorder']")


def test_the_answers_stand_in_the_manifest(place: Place) -> None:
    text = HEAD + "steps:\n  - note: The left knee is warm.\n  - check: bus\n" + ASK + RECORDER + MOTION
    session = place.session(text, Person(), record=True)
    assert session.run(place.stop, for_s=0.2) == 0
    assert session.episode is not None
    assert session.episode.path is not None
    manifest = load_manifest(Path(session.episode.path))
    answers = {answer["step"]: answer for answer in manifest.runbook["answers"]}
    assert answers["note: The left knee is warm."]["answer"] == "shown"
    assert "answers in" in answers["check bus"]["answer"]
    said = answers["confirm: Nobody stands there."]
    assert (said["answer"], said["is_unattended"]) == ("yes", False)
    assert abs(said["wall_ns"] - time.time_ns()) < 120e9
    assert manifest.runbook["text"] == text
    assert manifest.operator.id == "ada"


def test_an_answer_that_nobody_gave_is_recorded_as_such(place: Place) -> None:
    person = Person()
    session = place.session(QUICK, person, unattended=True)
    assert session.run(place.stop, for_s=0.1) == 0
    assert [(answer.answer, answer.who, answer.is_unattended) for answer in session.answers] == [
        ("yes (unattended)", "--yes", True)
    ]
    assert not person.heard("asked")


def test_a_check_that_fails_ends_it_with_what_to_do(place: Place) -> None:
    person = Person()
    text = HEAD + "steps:\n  - check: disk\n    min_free_gb: 1000000000\n" + MOTION
    assert place.session(text, person).run(place.stop) == 1
    assert person.heard("failed check disk min_free_gb=1000000000.0")
    assert person.heard("make room or record elsewhere with --data")


def test_what_is_called_failed_is_the_server_that_died_not_the_one_that_was_waited_for(place: Place) -> None:
    person = Person()
    text = HEAD + "steps:\n  - start: g1\n    with: {backend: mujoco}\n"  # which takes longer to load
    assert place.session(text + "  - start: gamepad\n    with: {fake: /nowhere}\n", person).run(place.stop) == 1
    (failed,) = [line for line in person.told if line.startswith("failed start")]
    assert failed.startswith("failed start gamepad ")
    assert person.heard("error failed: server 'gamepad' ended with code 2 before ")
    assert person.heard("/nowhere: cannot be read")


def test_asked_to_stop_while_a_server_loads_it_stops(place: Place) -> None:
    person = Person()
    person.asked = place.stop.set
    assert place.session(QUICK, person).run(place.stop) == 130
    assert person.heard("info stopped: ")
    assert place.supervisor.children == {}


def test_it_can_only_record_with_a_recorder(place: Place) -> None:
    with pytest.raises(ConfigError, match="starts no recorder"):
        place.session(HEAD + "steps:\n" + MOTION, Person(), record=True)


def test_a_second_session_on_a_bus_is_refused(place: Place, tmp_path: Path) -> None:
    first = threading.Thread(target=place.session(QUICK, Person()).run, args=(place.stop,))
    first.start()
    try:
        wait_until(lambda: place.bus.get(keys.server("motion")) is not None)
        second = Supervisor(place.bus, tmp_path / "second")
        path = tmp_path / "book.yaml"
        with pytest.raises(Refused, match="already runs on"):
            Session(runbook.load(path), place.bus, second, Person(), data=place.data).run(threading.Event())
    finally:
        place.stop.set()
        first.join()


def test_a_bus_that_comes_back_is_waited_for(tmp_path: Path) -> None:
    options = ServerOptions(folder=tmp_path, socket=tmp_path / "bus.sock")
    person = Person()
    first = RedisServer.start(options)
    with Bus(first.address, name="supervisor", timeout_s=1.0) as bus:
        place = Place(bus, tmp_path)
        session = place.session(HEAD + "steps:\n" + MOTION, person)
        codes: list[int] = []
        thread = threading.Thread(target=lambda: codes.append(session.run(place.stop)))
        thread.start()
        wait_until(lambda: person.shown)
        first.stop()
        wait_until(lambda: person.heard("waiting for it to come back"))
        with RedisServer.start(options):
            wait_until(lambda: person.heard("warning the bus is back after"))
            wait_until(lambda: _is_written(bus))
            place.stop.set()
            thread.join()
    assert codes == [0], person.told


def test_where_a_person_attends_a_server_that_dies_ends_nothing_and_starts_again_when_told(place: Place) -> None:
    person = Person(is_attended=True)
    with _running(place, HEAD + "steps:\n" + MOTION, person) as codes:
        pid = _active(place, "motion")
        os.kill(pid, signal.SIGKILL)
        wait_until(lambda: person.heard("error server 'motion' was killed by SIGKILL; its last words: "))
        assert person.heard("; r starts it again, Ctrl-C takes the station down")
        wait_until(lambda: person.offered == "motion")
        assert not codes, "the station is up"
        person.wants_restart = True
        assert _active(place, "motion", before=pid) != pid
        wait_until(lambda: person.heard("info supervisor: server-active server=motion"))
        assert person.offered == ""
        assert person.heard(
            f"warning supervisor: server-restarted server=motion reason=was killed by SIGKILL who={_me()}"
        )
    assert codes == [0], "whoever died was started again"


def test_one_that_stays_dead_makes_the_end_a_failure(place: Place) -> None:
    person = Person(is_attended=True)
    with _running(place, HEAD + "steps:\n" + MOTION, person) as codes:
        os.kill(_active(place, "motion"), signal.SIGKILL)
        wait_until(lambda: person.offered == "motion")
    assert codes == [1]


@pytest.mark.parametrize(("is_attended", "unattended", "rule"), [(False, False, ""), (True, True, ""),
                                                                 (True, False, "    if_it_dies: end\n")])  # fmt: skip
def test_where_nobody_is_to_be_asked_it_ends(place: Place, *, is_attended: bool, unattended: bool, rule: str) -> None:
    person = Person(is_attended=is_attended)
    with _running(place, HEAD + "steps:\n" + MOTION + rule, person, unattended=unattended) as codes:
        os.kill(_active(place, "motion"), signal.SIGKILL)
        wait_until(lambda: codes)
    assert codes == [1]
    assert person.heard("error server 'motion' was killed by SIGKILL; its last words: ")
    assert not person.heard("starts it again")


def test_what_the_runbook_wants_started_again_is_whoever_attends(place: Place) -> None:
    person = Person()
    with _running(place, HEAD + "steps:\n" + MOTION + "    if_it_dies: restart\n", person) as codes:
        pid = _active(place, "motion")
        os.kill(pid, signal.SIGKILL)
        assert _active(place, "motion", before=pid) != pid
    assert codes == [0]
    assert person.heard("warning supervisor: server-restarted server=motion reason=was killed by SIGKILL restarts=1")


@contextmanager
def _running(place: Place, text: str, person: Person, *, unattended: bool = False) -> Iterator[list[int]]:
    """Run a session in a thread; its exit code is in the list once it has ended, at the latest after the block."""
    codes: list[int] = []
    session = place.session(text, person, unattended=unattended)
    thread = threading.Thread(target=lambda: codes.append(session.run(place.stop)))
    thread.start()
    try:
        yield codes
    finally:
        place.stop.set()
        thread.join()


def _active(place: Place, name: str, before: int = 0) -> int:
    """Wait until a server is active that is not the one before; return its process id."""

    def health() -> Health | None:
        return next((h for h in read_health(place.bus) if (h.name, h.state) == (name, "active")), None)

    wait_until(lambda: (found := health()) is not None and found.pid != before and found.is_alive)
    found = health()
    assert found is not None
    return found.pid


def _me() -> str:
    return getpass.getuser()


def _is_written(bus: Bus) -> bool:
    with suppress(BusError):
        return bus.get(keys.action_body()) is not None
    return False


def test_a_feed_misses_no_event_however_fast_several_servers_speak(bus_server: BusAddress) -> None:
    with ExitStack() as stack:
        lines = {name: stack.enter_context(Bus(bus_server, name=name)) for name in ("a", "b", "c", "d")}
        lives = {name: Life(KIND, name, line, "") for name, line in lines.items()}
        lives["a"].event("from before")
        wait_until(lambda: any(health.events for health in read_health(lines["a"])))
        feed = stack.enter_context(EventFeed(lines["a"]))
        said = [(name, f"{name}-{number}") for number in range(20) for name in lives]
        for name, event in said:
            lives[name].event(event)
        found: list[tuple[str, str]] = []
        wait_until(lambda: found.extend((event.source, event.name) for event in feed.take()) or len(found) >= len(said))
        for life in lives.values():
            life.end("over")
        wait_until(lambda: all(health.state == "finalized" for health in read_health(lines["a"])))
        found.extend((event.source, event.name) for event in feed.take())
        assert sorted(found) == sorted(said)


def test_a_feed_yields_each_event_once_and_survives_junk(bus_server: BusAddress) -> None:
    with Bus(bus_server, name="a", timeout_s=5.0) as bus, EventFeed(bus) as feed:
        found: list[str] = []
        for name in ("one", "two", "three"):
            bus.call("SET", keys.EVENT, b'{"name": "\xff"}')
            bus.publish({keys.EVENT: events.make("a", name).encode()})
            wait_until(lambda: found.extend(event.name for event in feed.take()) or len(found) > 0)
            assert found.pop() == name
        assert list(feed.take()) == []
