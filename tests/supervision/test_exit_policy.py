"""What becomes of a station when one of its servers dies, with real servers on a real bus."""

from __future__ import annotations

import getpass
import json
import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from station.bus import keys
from station.bus.tap import open_tap
from station.life.server import Health, read_health
from tests.supervision.place import HEAD, MOTION, Person, Place
from tests.waiting import wait_until


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
    person, tap = Person(is_attended=is_attended), open_tap(place.bus.address)
    with _running(place, HEAD + "steps:\n" + MOTION + rule, person, unattended=unattended) as codes:
        os.kill(_active(place, "motion"), signal.SIGKILL)
        wait_until(lambda: codes)
    deaths: list[dict[str, Any]] = []

    def is_told() -> bool:
        """Whether it is among what was written; a read holds what came at once."""
        events = [json.loads(write.value or b"{}") for write in tap.read(0.05) if write.key == keys.EVENT]
        deaths.extend(event["detail"] for event in events if event["name"] == "server-died")
        return bool(deaths)

    wait_until(is_told)
    tap.close()
    assert codes == [1]
    (died,) = deaths
    assert died["server"] == "motion"
    assert died["reason"].startswith("was killed by SIGKILL; its last words: ")
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
    """Run a session in a thread, from its last step on; its exit code is in the list once it has ended.

    A server that dies before the step that starts it is done has failed to start, which is another matter.
    """
    codes: list[int] = []
    session = place.session(text, person, unattended=unattended)
    thread = threading.Thread(target=lambda: codes.append(session.run(place.stop)))
    thread.start()
    try:
        wait_until(lambda: person.heard("done start motion"))
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
