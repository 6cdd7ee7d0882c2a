"""A station's session with real servers on a real bus; the test is the person who answers."""

from __future__ import annotations

import threading
import time
from contextlib import suppress
from pathlib import Path

import pytest

from adapters.robots.g1 import twist_keys
from station.bus import keys
from station.bus.client import Bus
from station.bus.redis_server import RedisServer, ServerOptions
from station.episode.storage.manifest import load_manifest
from station.errors import BusError, ConfigError, Refused
from station.life.stop_button import StopButton
from station.life.stop_file import StopFile
from station.supervision import runbook
from station.supervision.session import Session
from station.supervision.supervisor import Supervisor
from tests.dds_domains import domain
from tests.supervision.place import ASK, HEAD, MOTION, QUICK, RECORDER, Person, Place
from tests.waiting import wait_until


def test_a_confirmation_that_is_refused_ends_it_before_anything_is_active(place: Place) -> None:
    person = Person(answer=False)
    session = place.session(QUICK, person, record=True)
    assert session.run(place.stop) == 1
    assert person.heard("error failed: not confirmed: Nobody stands there.")
    assert not person.heard("done start")
    assert place.bus.get(twist_keys.action_body()) is None
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


def test_what_hears_a_twin_loads_once_the_twin_is_active(place: Place) -> None:
    pytest.importorskip("cyclonedds", reason="needs the extra 'g1'")
    person = Person()
    person.asked = lambda: person.told.append(f"running {sorted(place.supervisor.children)}")
    with domain() as number:
        twin = f"  - start: robot-twin\n    with: {{twin: g1, options: {{domain: {number}}}}}\n    ready_within: 60s\n"
        text = HEAD + "steps:\n" + ASK + RECORDER + twin + ASK + MOTION
        assert place.session(text, person).run(place.stop, for_s=0.1) == 0
    assert [line for line in person.told if line.startswith("running")] == [
        "running ['recorder', 'robot-twin']", "running ['motion', 'recorder', 'robot-twin']"
    ]  # fmt: skip


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
    assert person.heard("error failed: server 'gamepad' ended with code 2 while loading")
    assert person.heard("/nowhere: cannot be read")


def test_asked_to_stop_while_a_server_loads_it_stops(place: Place) -> None:
    person = Person()
    person.asked = place.stop.set
    assert place.session(QUICK, person).run(place.stop) == 130
    assert person.heard("info stopped: ")
    assert place.supervisor.children == {}


def test_under_a_latched_stop_nothing_starts_and_it_is_said_how_to_release_it(place: Place) -> None:
    StopFile(place.bus.address).latch("anna, smoke")
    person = Person()
    with pytest.raises(
        Refused, match=r"the emergency stop is latched since .* \(anna, smoke\); release it with `station "
    ):
        place.session(QUICK, person).run(place.stop)
    assert not person.told, "nothing began"
    StopFile(place.bus.address).release("anna")
    place.bus.publish({keys.ESTOP: b"1"})
    with pytest.raises(Refused, match=r"the emergency stop is latched since .* \(emergency stop\)"):
        place.session(QUICK, person).run(place.stop)


def test_a_stop_at_the_question_lets_no_answer_pass_where_nobody_can_release_it(place: Place) -> None:
    person = Person()
    person.asked = lambda: press(place)
    assert place.session(QUICK, person).run(place.stop) == 1
    assert person.heard("error failed: the emergency stop is latched since ")
    assert not person.heard("done start")
    assert StopFile(place.bus.address).read() is not None, "the next station knows"


def test_a_stop_at_the_question_is_waited_out_and_the_question_asked_again(place: Place) -> None:
    person = Person(is_attended=True)
    person.asked = lambda: press(place) if len(asked(person)) == 1 else None
    session = place.session(QUICK, person)
    thread = threading.Thread(target=session.run, args=(place.stop,), kwargs={"for_s": 0.1})
    thread.start()
    wait_until(lambda: person.heard("; until then nothing goes on"))
    assert place.bus.get(twist_keys.action_body()) is None
    with StopButton(place.bus.address) as button:
        button.release("all is well")
    thread.join()
    assert len(asked(person)) == 2
    assert [answer.answer for answer in session.answers] == ["yes"]
    assert person.heard("done start motion")


def test_a_stop_between_two_steps_ends_what_nobody_attends(place: Place) -> None:
    class Presses(Person):
        def done(self, step: str, result: str) -> None:
            super().done(step, result)
            press(place)

    person = Presses()
    text = HEAD + "steps:\n  - note: The left knee is warm.\n" + MOTION
    assert place.session(text, person, unattended=True).run(place.stop) == 1
    assert person.heard("done note: The left knee is warm.")
    assert person.heard("error failed: the emergency stop is latched")
    assert not person.heard("done start motion")


def press(place: Place) -> None:
    with StopButton(place.bus.address) as button:
        button.press("smoke")


def asked(person: Person) -> list[str]:
    return [line for line in person.told if line.startswith("asked ")]


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


@pytest.mark.usefixtures("processes")
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


def _is_written(bus: Bus) -> bool:
    with suppress(BusError):
        return bus.get(twist_keys.action_body()) is not None
    return False
