from __future__ import annotations

import copy
import itertools
from collections import Counter

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from adapters.robots.g1 import twist_keys
from station.bus import keys
from station.bus.tap import Position, Write
from station.episode.recorder.queue import Batch, WriteQueue
from station.episode.storage.drops import Drops, is_bulky
from tests.examples import examples

BODY = twist_keys.action_body()
KB, MB = 1000, 1_000_000
MOST_WRITES, MOST_BYTES = 60, 1_000 * KB
SMALL = st.tuples(st.sampled_from([BODY, "small"]), st.sampled_from([0, 10, 5 * KB, 16 * KB]))
LARGE = st.tuples(st.sampled_from(["camera_left", "camera_right"]), st.sampled_from([17 * KB, 60 * KB, 400 * KB]))
BATCHES = st.lists(st.one_of(SMALL, LARGE), max_size=30)
PUT, TAKE = st.tuples(st.just("put"), BATCHES), st.tuples(st.just("take"), st.integers(0, 800 * KB))
VALUES = {size: bytes(size) for size in (0, 10, 5 * KB, 16 * KB, 17 * KB, 60 * KB, 400 * KB)}


def write(key: str, size: int, number: int = 0) -> Write:
    return Write(key, VALUES.get(size) if size in VALUES else bytes(size), None, number)


def bulky(found: Write) -> bool:
    return is_bulky(found.key, len(found.value or b""))


def waiting(queue: WriteQueue) -> list[Write]:
    return [found for batch in copy.deepcopy(queue).pop(1 << 60) for found in batch.writes]


@settings(max_examples=examples(200), deadline=None)
@given(st.lists(st.one_of(PUT, TAKE), max_size=40))
def test_for_any_batches_and_any_pace_it_is_bounded_keeps_the_order_and_loses_count_of_nothing(
    steps: list[tuple[str, object]],
) -> None:
    queue, told, counted, number = WriteQueue(MOST_WRITES, MOST_BYTES), Drops(), Drops(), 0
    put: list[Write] = []
    written: list[Write] = []
    for what, argument in [*steps, ("take", 1 << 60)]:
        if what == "put":
            writes = [write(key, size, number + n) for n, (key, size) in enumerate(argument)]  # type: ignore[arg-type,var-annotated]
            number += len(writes)
            put += writes
            if (drops := queue.put(Batch(tuple(writes), position=Position("id", number)))) is not None:
                told.add(drops)
        else:
            for batch in queue.pop(argument):  # type: ignore[arg-type]
                written += batch.writes
                counted.add(batch.drops or Drops())
                queue.done(batch)
        assert 0 <= queue.size <= MOST_BYTES
        assert 0 <= queue.writes <= MOST_WRITES
        assert queue.size == sum(len(found.value or b"") for found in waiting(queue))
    numbers = [found.mono_ns for found in written]
    assert numbers == sorted(set(numbers))
    lost = Counter(found.key for found in put) - Counter(found.key for found in written)
    assert counted.by_key(99) == told.by_key(99) == dict(lost)
    assert counted.bulky == sum(map(bulky, put)) - sum(map(bulky, written))
    assert (queue.writes, queue.size, bool(queue)) == (0, 0, False)


@settings(max_examples=examples(200), deadline=None)
@given(st.lists(st.one_of(SMALL, LARGE), min_size=40, max_size=150))
def test_no_signal_is_dropped_while_an_image_waits(values: list[tuple[str, int]]) -> None:
    queue = WriteQueue(MOST_WRITES, MOST_BYTES)
    for key, size in values:
        drops = queue.put(Batch([write(key, size)]))
        if drops is not None and drops.total > drops.bulky:
            assert not any(map(bulky, waiting(queue)))


@given(st.lists(st.one_of(SMALL, LARGE), max_size=40))
def test_nothing_is_dropped_below_half_of_the_bytes(values: list[tuple[str, int]]) -> None:
    queue = WriteQueue(MOST_WRITES, 2 * sum(size for _, size in values))
    assert queue.put(Batch([write(key, size) for key, size in values])) is None


def test_a_disk_of_20_mb_a_second_under_300_mb_of_images_keeps_every_signal_and_a_lower_frame_rate() -> None:
    queue, frames, signals, dropped_signals, number = WriteQueue(200_000, 128 * MB), [], 0, 0, 0
    image = bytes(66_000)
    for step in range(2000):  # of 10 ms
        cameras = [Write(f"camera_{n % 3}", image, None, number + n) for n in range(45)]
        number += 45
        drops = queue.put(Batch([Write(BODY, b"x" * 180, None, 0) for _ in range(100)] + cameras))
        dropped_signals += drops.total - drops.bulky if drops else 0
        if step % 40 == 39:  # a flush of 8 MB takes 0.4 s
            for batch in queue.pop(8 * MB):
                signals += sum(found.key == BODY for found in batch.writes)
                frames += [found.mono_ns for found in batch.writes if found.key == "camera_1"]
                queue.done(batch)
        assert queue.size <= 96 * MB + 100 * 180 * 2000
    assert dropped_signals == 0
    signals += sum(found.key == BODY for found in waiting(queue))
    assert signals == 200_000
    late = [frame for frame in frames if frame > frames[-1] // 2]
    longest = max(after - before for before, after in itertools.pairwise(late))
    assert longest < 45 * 10  # a tenth of a second; without thinning, half of one


def test_signals_alone_are_dropped_and_counted_beyond_the_bytes_of_the_queue() -> None:
    queue = WriteQueue(1000, 100 * KB)
    drops = queue.put(Batch([write(BODY, 5 * KB, n) for n in range(30)]))
    assert drops is not None
    assert (drops.by_key(9), drops.bulky) == ({BODY: 10}, 0)
    assert (queue.writes, queue.size) == (20, 100 * KB)


def test_a_single_value_as_large_as_the_queue_is_taken_when_nothing_else_waits() -> None:
    queue = WriteQueue(10, 100 * KB)
    assert queue.put(Batch([write("cloud", 100 * KB)])) is None or queue.writes == 1
    (batch,) = queue.pop(1)
    queue.done(batch)
    drops = queue.put(Batch([write("cloud", 101 * KB), write("small", 10)]))
    assert drops is not None
    assert drops.by_key(9) == {"cloud": 1}
    assert [found.key for found in waiting(queue)] == ["small"]


def test_what_the_preroll_holds_takes_no_room_and_is_never_dropped() -> None:
    queue = WriteQueue(5, 100 * KB)
    held = [write("camera_left", 60 * KB, n) for n in range(9)]
    assert queue.put(Batch(held, is_held=True)) is None
    assert queue.put(Batch([write("small", 10)] * 6)) is not None
    assert waiting(queue)[:9] == held
    assert queue.clear() == 14


def test_a_flood_that_is_dropped_leaves_no_batches_behind_only_their_counts_and_the_newest_position() -> None:
    queue = WriteQueue(1, 100 * KB)
    for number in range(10_000):
        queue.put(Batch([write(f"key{number}", 10)], position=Position("id", number)))
    (batch,) = queue.pop(1 << 60)
    assert (len(batch.writes), batch.position) == (1, Position("id", 9_999))
    assert batch.drops is not None
    assert batch.drops.total == 9_999
    assert len(list(batch.drops)) <= 1001
    assert batch.drops.of("(others)", "") == (8_999, 0)


@pytest.mark.parametrize(
    ("key", "size", "expected"),
    [
        (BODY, 100 * KB, False),
        (BODY, 2 * MB, True),
        (keys.server("g1"), 200 * KB, False),
        ("camera", 20 * KB, True),
        ("anything", 10 * KB, False),
    ],
)
def test_bulky_is_what_is_large_without_a_contract_or_too_large_for_any(key: str, size: int, expected: bool) -> None:
    assert is_bulky(key, size) is expected
