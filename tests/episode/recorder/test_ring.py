from __future__ import annotations

from station.bus.tap import Write
from station.episode.recorder.controller import Ring

SECOND = 1_000_000_000


def at(second: float, value: bytes = b"x") -> Write:
    return Write("key", value, None, int(second * SECOND))


def test_the_ring_returns_the_last_seconds_in_order() -> None:
    ring = Ring(2.0)
    for n in range(10):
        ring.add([at(n), at(n + 0.5)])
    assert [write.mono_ns / SECOND for write in ring.since(int(9.5 * SECOND))] == [7.5, 8.0, 8.5, 9.0, 9.5]


def test_the_ring_is_bounded_by_bytes_too() -> None:
    ring = Ring(1000.0, max_bytes=4000)
    for n in range(100):
        ring.add([at(n, bytes(100))])
    assert ring.size == 4000
    assert len(ring.since(100 * SECOND)) == 10


def test_a_ring_of_no_seconds_keeps_nothing() -> None:
    ring = Ring(0.0)
    ring.add([at(1)])
    assert ring.since(SECOND) == []


def test_a_value_that_would_cost_all_others_does_not_stay_and_costs_none() -> None:
    ring = Ring(10.0, max_bytes=10_000)
    ring.add([at(1, b"before")])
    ring.add([at(2, b"beside"), at(2, bytes(2_501)), at(2, b"beside")])
    ring.add([at(3, bytes(20_000))])
    assert [write.value for write in ring.since(3 * SECOND)] == [b"before", b"beside", b"beside"]


def test_a_flood_of_empty_values_is_bounded_as_well() -> None:
    ring = Ring(1000.0, max_bytes=30_000)
    for n in range(1000):
        ring.add([at(n / 100, b"")])
    assert len(ring.since(10 * SECOND)) == 100


def test_a_deletion_is_kept_and_clear_forgets_all() -> None:
    ring = Ring(10.0)
    ring.add([Write("key", None, None, SECOND)])
    assert ring.since(SECOND) == [Write("key", None, None, SECOND)]
    ring.clear()
    assert ring.since(SECOND) == []
