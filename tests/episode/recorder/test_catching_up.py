"""How long what waits at the bus is read at the pace of the disk: as long as it gets younger."""

from __future__ import annotations

import pytest

from station.bus.tap import Position, Write
from station.bus.tap.base import Backend
from station.episode.recorder.catching_up import CatchingUp

FULL, EMPTY = 1.0, 0.0
AWAY_S, LONGEST_S = 30.0, 20.0


class LateTap:
    """A tap of a bus that keeps whatever comes."""

    backend: Backend = "replication"
    is_lossless = True
    resumed = True
    unseen_keys = 0

    def __init__(self) -> None:
        self.is_catching_up = True

    def read(self, timeout_s: float) -> list[Write]:
        return []

    def may_wait(self) -> bool:
        return True

    def position(self) -> Position | None:
        return None

    def close(self) -> None:
        pass


def waits_for(speed: float, until_s: float) -> tuple[float, list[float]]:
    """Return how long a recorder waits for its disk that reads so many seconds of writes in a second, and how far
    behind it says that it is when it waits no longer [s]."""
    told: list[float] = []
    pace, now_s = CatchingUp(LateTap(), 0.0, lambda name, *, severity, behind_s: told.append(behind_s)), 0.0
    while now_s < until_s and pace.must_wait(FULL, now_s, now_s * speed - AWAY_S):
        now_s += 0.5
    assert not pace.must_wait(FULL, now_s, now_s * speed - AWAY_S) or now_s == until_s
    return now_s, told


@pytest.mark.parametrize("speed", [1.5, 1.6, 3.0])
def test_a_slow_machine_takes_its_time_while_it_gets_nearer(speed: float) -> None:
    assert waits_for(speed, until_s=60.0) == (60.0, [])


@pytest.mark.parametrize("speed", [0.0, 0.9, 1.0, 1.4])
def test_an_asker_is_not_kept_waiting_for_a_disk_that_is_too_slow(speed: float) -> None:
    behind_s = AWAY_S + LONGEST_S * (1 - speed)
    assert waits_for(speed, until_s=60.0) == (LONGEST_S, [pytest.approx(behind_s)])


def test_it_has_caught_up_once_the_queue_has_drained_and_nothing_waits_at_the_bus() -> None:
    tap = LateTap()
    pace = CatchingUp(tap, 0.0, pytest.fail)
    assert not pace.must_wait(EMPTY, 1.0, 0.0)
    assert pace.is_late
    tap.is_catching_up = False
    assert pace.must_wait(FULL, 2.0, 1.0)
    assert not pace.must_wait(EMPTY, 3.0, 2.0)
    assert not pace.must_wait(FULL, 4.0, 3.0)
    assert not pace.is_late
