from __future__ import annotations

from station.life.restarts import Restarts

KILLED = -9


def lived(restarts: Restarts, *lives_s: float) -> list[float]:
    """Let a server die after each of some lives; return how long each next start is put off."""
    delays = []
    for life_s in lives_s:
        restarts.record(1000 + restarts.count, life_s)
        delays.append(restarts.delay_s)
    return delays


def armed() -> Restarts:
    restarts = Restarts()
    restarts.is_armed = True
    return restarts


def test_a_server_that_lived_is_started_again_at_once_however_often() -> None:
    restarts = armed()
    assert lived(restarts, *[60.0] * 50) == [0.0] * 50
    assert restarts.allow(KILLED)
    assert restarts.count == 50


def test_one_that_dies_young_waits_longer_each_time_and_is_given_up_at_last() -> None:
    restarts = armed()
    assert lived(restarts, *[0.5] * 5) == [0.0, 0.25, 0.5, 1.0, 2.0]
    assert restarts.allow(KILLED)
    lived(restarts, 0.5)
    assert not restarts.allow(KILLED)
    assert restarts.why("it was killed") == "it was killed; started again 5 times, and it dies within 3 s each time"


def test_a_long_life_wipes_the_slate() -> None:
    restarts = armed()
    lived(restarts, *[0.5] * 5, 10.0)
    assert lived(restarts, *[0.5] * 2) == [0.0, 0.25]
    assert restarts.allow(KILLED)


def test_one_that_was_given_up_has_a_clean_slate_when_a_person_starts_it_again() -> None:
    restarts = armed()
    lived(restarts, *[0.5] * 6)
    assert not restarts.allow(KILLED)
    restarts.pardon()
    assert restarts.allow(KILLED)
    assert restarts.delay_s == 0.0


def test_what_a_restart_does_not_mend_is_not_started_again() -> None:
    assert not Restarts().allow(KILLED), "it was never active"
    assert not armed().allow(0), "it ended by itself"
    assert not armed().allow(2), "its configuration is wrong"
    assert armed().allow(1)
