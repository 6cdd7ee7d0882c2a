from __future__ import annotations

from station.bus.tap import Write
from station.episode.ring import Ring

SECOND = 1_000_000_000


def at(second: float, value: bytes = b"x") -> Write:
    return Write("key", value, None, int(second * SECOND))


def test_the_ring_returns_the_last_seconds_in_order() -> None:
    ring = Ring(2.0)
    for n in range(10):
        ring.add([at(n), at(n + 0.5)])
    assert [write.mono_ns / SECOND for write in ring.since(int(9.5 * SECOND))] == [7.5, 8.0, 8.5, 9.0, 9.5]


def test_the_ring_is_bounded_by_bytes_too() -> None:
    ring = Ring(1000.0, max_bytes=1000)
    for n in range(100):
        ring.add([at(n, bytes(100))])
    assert ring.size == 1000
    assert len(ring.since(100 * SECOND)) == 10


def test_a_ring_of_no_seconds_keeps_nothing() -> None:
    ring = Ring(0.0)
    ring.add([at(1)])
    assert ring.since(SECOND) == []


def test_a_value_larger_than_the_whole_ring_does_not_stay() -> None:
    ring = Ring(10.0, max_bytes=10)
    ring.add([at(1, bytes(100))])
    assert ring.size == 0


def test_a_deletion_is_kept_and_clear_forgets_all() -> None:
    ring = Ring(10.0)
    ring.add([Write("key", None, None, SECOND)])
    assert ring.since(SECOND) == [Write("key", None, None, SECOND)]
    ring.clear()
    assert ring.since(SECOND) == []
