"""A runbook on the bus: what it does, its question, and who answered first; with real servers on a real bus."""

from __future__ import annotations

import getpass
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import msgspec
import pytest

from station import Station
from station.bus import codec, keys
from station.bus.client import Bus
from station.bus.redis_server import RedisServer, ServerOptions
from station.episode.storage.manifest import load_manifest
from station.errors import NotReady, Refused
from station.life import runbook_request
from station.life.runbook_request import HOLD_S, AnswerRequest, Question, RunbookStatus
from station.life.stop_button import StopButton
from station.supervision import runbook, runbook_publisher
from station.supervision.runbook_publisher import GivenAnswer, RunbookPublisher
from station.supervision.session import Session
from tests.supervision.place import ASK, HEAD, MOTION, QUICK, Person, Place
from tests.waiting import DEADLINE_S, wait_until

WHICH = "  - ask: How is the arm?\n    answers: [limp, stiff]\n"


def book(folder: Path, text: str) -> runbook.Runbook:
    path = folder / "book.yaml"
    path.write_text(text)
    return runbook.load(path)


@contextmanager
def running(place: Place, session: Session) -> Iterator[list[int]]:
    codes: list[int] = []
    thread = threading.Thread(target=lambda: codes.append(session.run(place.stop)))
    thread.start()
    try:
        yield codes
    finally:
        place.stop.set()
        thread.join()


@contextmanager
def asked(publisher: RunbookPublisher, lab: Station) -> Iterator[tuple[Question, threading.Event, list[GivenAnswer]]]:
    """Have a question asked, whose terminal types yes once the event is set; what came of it is in the list."""
    typed, given = threading.Event(), list[GivenAnswer]()

    def prompt(is_answered: Callable[[], bool]) -> str:
        wait_until(lambda: is_answered() or typed.is_set())
        return "yes" if typed.is_set() else ""

    def ask() -> None:
        if (found := publisher.ask("Is it clear?", ("yes", "no"), prompt)) is not None:
            given.append(found)

    thread = threading.Thread(target=ask)
    thread.start()
    try:
        yield question(lab), typed, given
    finally:
        typed.set()
        thread.join()


def question(lab: Station, after: str = "") -> Question:
    """Wait for the question that is asked now."""

    def is_open() -> bool:
        status = lab.runbook()
        return status is not None and status.question is not None and status.question.id != after

    wait_until(is_open)
    status = lab.runbook()
    assert status is not None
    assert status.question is not None
    return status.question


def states(lab: Station) -> list[str]:
    status = lab.runbook()
    return [] if status is None else [step.state for step in status.steps]


def test_a_console_answers_and_the_manifest_says_who_and_from_where(place: Place) -> None:
    person = Person(is_elsewhere=True)
    session = place.session(HEAD + "steps:\n" + ASK + WHICH + "  - start: recorder\n" + MOTION, person, record=True)
    with Station(place.bus.address.url) as lab:
        assert lab.runbook() is None
        with running(place, session) as codes:
            first = question(lab)
            assert (first.sentence, first.answers, first.hold_s) == ("Nobody stands there.", ("yes", "no"), 0.0)
            assert states(lab) == ["now", "todo", "todo", "todo"]
            lab.answer(first.id, "yes", who="anna", where="console")
            second = question(lab, after=first.id)
            person.word = ""
            lab.answer(second.id, "limp", who="ben", where="console")
            wait_until(lambda: states(lab) == ["done"] * 4)
            status = lab.runbook()
            assert status is not None
            assert [step.result for step in status.steps][:2] == ["yes", "limp"]
            assert (status.name, status.robot, status.question) == ("t", "unitree_g1_with_hands", None)
        assert codes == [0]
        assert lab.runbook() is None, "it says that it is over"
    assert session.episode is not None
    assert session.episode.path is not None
    answers = load_manifest(Path(session.episode.path)).runbook["answers"]
    assert [(each["answer"], each["who"], each["where"]) for each in answers[:2]] == [
        ("yes", "anna", "console"), ("limp", "ben", "console"),
    ]  # fmt: skip
    assert not any(each["is_unattended"] for each in answers)
    assert person.heard("warning Nobody stands there.  yes, by anna (console)")


def test_a_no_from_a_console_ends_it_and_says_whose_it_was(place: Place) -> None:
    person = Person(is_elsewhere=True)
    with Station(place.bus.address.url) as lab, running(place, place.session(QUICK, person)) as codes:
        lab.answer(question(lab).id, "no", who="anna", where="console")
        wait_until(lambda: codes)
    assert codes == [1]
    assert person.heard("error failed: not confirmed by anna (console): Nobody stands there.")


def test_at_a_real_robot_a_button_is_to_be_held(place: Place) -> None:
    with (
        Station(place.bus.address.url) as lab,
        RunbookPublisher(place.bus, book(place.folder, HEAD + "robot_is_real: true\nsteps:\n" + ASK + MOTION)) as real,
        asked(real, lab) as (open_now, _, _),
    ):
        assert open_now.hold_s == HOLD_S == 1.2


def test_the_first_answer_counts_and_later_old_and_unknown_ones_are_refused_with_the_reason(place: Place) -> None:
    me = getpass.getuser()
    with Station(place.bus.address.url) as lab, RunbookPublisher(place.bus, book(place.folder, QUICK)) as publisher:
        with pytest.raises(Refused, match="question 'abc': not open; open now: none"):
            lab.answer("abc", "yes")
        with asked(publisher, lab) as (first, typed, given):
            with pytest.raises(
                Refused, match=r"unknown answer 'yess' \(did you mean 'yes'\?\); expected one of yes, no"
            ):
                lab.answer(first.id, "yess")
            with pytest.raises(Refused, match="who: expected who answers, got nothing"):
                lab.answer(first.id, "yes", who=" ")
            with pytest.raises(Refused, match=r"runbook answer: .*length <= 64"):
                lab.answer(first.id, "y" * 65)
            assert question(lab) == first, "what is refused answers nothing"
            typed.set()
            wait_until(lambda: given)
            assert given == [GivenAnswer("yes", me, "terminal")]
            with pytest.raises(Refused, match=rf"question '{first.id}': answered: yes, by {me} \(terminal\); open now"):
                lab.answer(first.id, "no")
        with asked(publisher, lab) as (second, typed, given):
            with pytest.raises(Refused, match=rf"question '{first.id}': answered: .*; open now: {second.id}"):
                lab.answer(first.id, "yes")
            lab.answer(second.id, "no", who="anna", where="console")
            typed.set()  # a moment too late
            wait_until(lambda: given)
            assert given == [GivenAnswer("no", "anna", "console")]


def test_of_many_who_answer_at_once_one_wins_and_each_is_told_the_truth(place: Place) -> None:
    with Station(place.bus.address.url) as lab, RunbookPublisher(place.bus, book(place.folder, QUICK)) as publisher:
        for trial in range(5):
            won, lost = list[str](), list[str]()
            with asked(publisher, lab) as (open_now, typed, given):

                def answer(
                    who: str, open_now: Question = open_now, won: list[str] = won, lost: list[str] = lost
                ) -> None:
                    try:
                        lab.answer(open_now.id, "yes", who=who, where="console")
                    except Refused as refused:
                        lost.append(str(refused))
                    else:
                        won.append(who)

                threads = [threading.Thread(target=answer, args=(f"p{number}",)) for number in range(4)]
                for thread in threads:
                    thread.start()
                if trial % 2:
                    typed.set()
                for thread in threads:
                    thread.join()
            assert len(given) == 1
            assert won == ([given[0].who] if given[0].where == "console" else [])
            assert len(lost) == 4 - len(won)
            assert all(f"answered: yes, by {given[0].who} ({given[0].where})" in told for told in lost), lost


def test_an_answer_without_an_id_counts_and_bytes_that_are_none_are_passed_over(place: Place) -> None:
    with (
        Station(place.bus.address.url) as lab,
        RunbookPublisher(place.bus, book(place.folder, QUICK)) as publisher,
        asked(publisher, lab) as (open_now, _, given),
    ):
        for data in (
            b"",
            b"\xff",
            b"{}",
            b'{"question": 1}',
            b"[" * 1000,
            b'{"question":"a","answer":"b","who":"c","d":1}',
        ):
            place.bus.publish({keys.RUNBOOK_ANSWER: data})
        wanted = AnswerRequest(question=open_now.id, answer="yes", who="nc\x1b[2J", where="console")
        place.bus.publish({keys.RUNBOOK_ANSWER: codec.json_object(wanted)})
        wait_until(lambda: given)
        assert given == [GivenAnswer("yes", "nc\\x1b[2J", "console")]


def test_a_user_of_the_bus_who_may_not_answer_is_told(place: Place) -> None:
    with Station(place.bus.address.url) as lab, RunbookPublisher(place.bus, book(place.folder, QUICK)) as publisher:
        place.bus.call("ACL", "SETUSER", "viewer", "reset", "on", ">secret", "allchannels", "%R~*", "+@all")
        viewer = msgspec.structs.replace(place.bus.address, username="viewer", password="secret")
        with asked(publisher, lab) as (open_now, _, given), Station(viewer.url) as other:
            assert other.runbook() is not None
            with pytest.raises(Refused, match="user 'viewer' of the bus may not answer; expected operator or console"):
                other.answer(open_now.id, "yes")
            assert not given
        place.bus.call("ACL", "DELUSER", "viewer")


def test_where_no_runbook_is_run_an_answer_says_so(place: Place) -> None:
    with Station(place.bus.address.url) as lab, pytest.raises(NotReady, match=r"no runbook is run on .*`station up"):
        lab.answer("abc", "yes")


def test_a_server_that_died_is_started_again_from_a_console_but_not_under_a_stop(place: Place) -> None:
    person = Person(is_attended=True)
    session = place.session(HEAD + "steps:\n" + MOTION, person)
    with Station(place.bus.address.url) as lab, running(place, session) as codes:
        wait_until(lambda: person.heard("done start motion"))
        pid = next(server.pid for server in lab.servers() if server.name == "motion")
        os.kill(pid, signal.SIGKILL)
        offered = question(lab)
        assert offered.sentence == "server 'motion' was killed by SIGKILL: start motion again?"
        assert offered.answers == ("restart",)
        with StopButton(place.bus.address) as button:
            button.press("smoke")
            with pytest.raises(Refused, match=r"the emergency stop is latched .*; until then nothing starts"):
                lab.answer(offered.id, "restart", who="anna", where="console")
            button.release("all is well")
        lab.answer(offered.id, "restart", who="anna", where="console")
        wait_until(lambda: person.heard("info supervisor: server-active server=motion"))
        assert person.heard("server-restarted server=motion reason=was killed by SIGKILL who=anna")
        status = lab.runbook()
        assert status is not None
        assert status.question is None
    assert codes == [0]
    assert [(each.step, each.answer, each.who, each.where) for each in session.answers] == [
        ("restart motion", "restart", "anna", "console")
    ]


KILLED = """
import sys
from pathlib import Path
from station.bus import address
from station.bus.client import Bus
from station.supervision import runbook
from station.supervision.runbook_publisher import RunbookPublisher
with Bus(address.parse(sys.argv[1]), name="supervisor") as bus:
    with RunbookPublisher(bus, runbook.load(Path(sys.argv[2]))):
        print("there", flush=True)
        sys.stdin.read()
"""


def test_a_station_that_was_killed_runs_nothing_and_the_next_one_speaks(place: Place) -> None:
    path = place.folder / "killed.yaml"
    path.write_text(HEAD.replace("runbook: t", "runbook: killed") + "steps:\n" + MOTION)
    with (
        subprocess.Popen(
            [sys.executable, "-c", KILLED, place.bus.address.url, str(path)],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        ) as other,
        Station(place.bus.address.url) as lab,
    ):  # fmt: skip
        assert other.stdout is not None
        assert other.stdout.readline() == "there\n"
        assert named(lab) == "killed"
        with RunbookPublisher(place.bus, book(place.folder, QUICK)):
            wait_until(lambda: named(lab) == "killed")
            other.kill()
            wait_until(lambda: named(lab) == "t")
        assert named(lab) == ""
        assert place.bus.get(keys.RUNBOOK) is not None


def named(lab: Station) -> str:
    status = lab.runbook()
    return "" if status is None else status.name


def test_what_nobody_says_any_more_is_old_after_two_seconds(place: Place, monkeypatch: pytest.MonkeyPatch) -> None:
    status = RunbookStatus(name="t", robot="", robot_is_real=False, steps=())
    place.bus.publish({keys.RUNBOOK: codec.json_object(status)})
    assert runbook_request.status(place.bus) == status
    monkeypatch.setattr(runbook_request, "DEAD_AFTER_S", 0.0)
    assert runbook_request.status(place.bus) is None
    monkeypatch.undo()
    for data in (b"", b"{}", b"\xff", codec.json_object(msgspec.structs.replace(status, is_over=True))):
        place.bus.publish({keys.RUNBOOK: data})
        assert runbook_request.status(place.bus) is None
    place.bus.call("DEL", keys.stamp(keys.RUNBOOK))
    place.bus.call("SET", keys.RUNBOOK, codec.json_object(status))
    assert runbook_request.status(place.bus) is None, "who wrote it, and when, is not known"


@pytest.mark.usefixtures("processes")
def test_a_restarted_bus_is_told_again_at_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(runbook_publisher, "HEARTBEAT_S", DEADLINE_S)
    options = ServerOptions(folder=tmp_path, socket=tmp_path / "bus.sock")
    first = RedisServer.start(options)
    with Bus(first.address, name="supervisor", timeout_s=1.0) as bus, RunbookPublisher(bus, book(tmp_path, QUICK)):
        first.stop()
        with RedisServer.start(options) as again, Station(again.address.url) as lab:
            wait_until(lambda: named(lab) == "t")
