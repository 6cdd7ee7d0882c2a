from __future__ import annotations

import itertools
import os
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from station.bus.tap import Write
from station.episode.recorder.disk_space import DiskSpace, Meter
from station.episode.recorder.options import Notice, RecordingOptions
from tests.virtual.clock import VirtualClock

MB = 1_000_000
Make = Callable[..., DiskSpace]


class FakeDisk:
    """Stands in for `os.statvfs`.

    Attributes:
        free: What it says is free [bytes].
        blocks: What it says is there at all.
        may_answer: Cleared, it hangs.
    """

    def __init__(self, clock: VirtualClock) -> None:
        self.free, self.blocks = 1000 * MB, 1 << 40
        self.may_answer = threading.Event()
        self.may_answer.set()
        self._clock = clock

    def __call__(self, _path: object) -> os.statvfs_result:
        self._clock.wait(self.may_answer)
        return os.statvfs_result((1, 1, self.blocks, self.free, self.free, 0, 0, 0, 0, 255))


@pytest.fixture
def clock() -> Iterator[VirtualClock]:
    with VirtualClock() as made:
        yield made


@pytest.fixture
def disk(clock: VirtualClock, monkeypatch: pytest.MonkeyPatch) -> FakeDisk:
    fake = FakeDisk(clock)
    monkeypatch.setattr(os, "statvfs", fake)
    return fake


@pytest.fixture
def make(clock: VirtualClock, tmp_path: Path, disk: FakeDisk) -> Iterator[Make]:
    made: list[DiskSpace] = []

    def build(**options: float) -> DiskSpace:
        made.append(DiskSpace(RecordingOptions(data=tmp_path, **options), clock))  # type: ignore[arg-type]
        return made[-1]

    yield build
    disk.may_answer.set()
    for one in made:
        one.close()


def written(count: int, size: int) -> list[Write]:
    return [Write("k", bytes(size), None, 0)] * count


def followed(clock: VirtualClock, one: DiskSpace, size: Callable[[], int | None], seconds: float) -> list[Notice]:
    """Follow an episode for so long; return what was said."""
    said, end_s = [], clock.monotonic_s() + seconds
    while clock.monotonic_s() < end_s:
        said += one.follow(size())
        clock.sleep(0.02)
    return said


def test_a_meter_shows_the_rate_of_its_span_and_forgets_what_was_before() -> None:
    meter = Meter(10.0)
    assert meter.bytes_per_s == 0
    for second in range(31):
        meter.update(float(second), 100 * min(second, 10) + 7 * second)
    assert meter.bytes_per_s == pytest.approx(7)
    assert meter.seconds <= 11


def test_what_came_within_less_than_a_second_is_not_blown_up_to_a_rate() -> None:
    meter = Meter(10.0)
    meter.update(0.0, 0)
    meter.update(0.01, 500)
    assert meter.bytes_per_s == 500


def test_an_episode_begins_where_its_planned_time_fits_beside_what_stays_free(make: Make, disk: FakeDisk) -> None:
    one = make(min_free_mb=500)
    assert one.refusal(3600) is None  # nothing is written, so nothing is needed
    one.count(written(10, 100_000 - 64))
    disk.free = 559 * MB
    reason = one.refusal(60)
    assert reason is not None
    assert "559 MB free, at least 560 MB wanted (60 s at 1.00 MB/s, and 500 MB that stay free); free some" in reason
    assert "\n" not in reason
    disk.free = 561 * MB
    assert one.refusal(60) is None
    assert one.refusal(62) is not None


def test_without_a_plan_a_minute_must_fit_and_a_lab_with_3_gb_and_no_camera_records(make: Make, disk: FakeDisk) -> None:
    one = make()
    disk.free = 3000 * MB
    one.count(written(1000, 300))
    assert one.refusal(None) is None
    one.count(written(1000, 60_000))
    assert "(60 s at " in (one.refusal(None) or "")
    other = make(planned_s=5)
    other.count(written(1000, 60_000))
    assert other.refusal(None) is None


def test_a_file_system_that_tells_no_size_refuses_nothing(make: Make, disk: FakeDisk) -> None:
    disk.blocks = disk.free = 0
    one = make()
    assert one.refusal(1e6) is None
    assert (one.free_mb, one.minutes_left, one.is_used_up) == (None, None, False)


def test_a_disk_that_hangs_refuses_a_start_and_never_holds_up_who_asks(
    make: Make, disk: FakeDisk, clock: VirtualClock
) -> None:
    one = make()
    disk.may_answer.clear()
    hung_s = clock.monotonic_s()
    said = followed(clock, one, lambda: None, 10.0)
    assert clock.monotonic_s() - hung_s == pytest.approx(10.0, abs=0.1), "it waits for no disk"
    assert [notice.name for notice in said] == ["disk-stuck"]
    began_s = clock.monotonic_s()
    assert "its disk is silent for 9 s" in (one.refusal(0) or "")
    assert clock.monotonic_s() - began_s < 0.1
    disk.may_answer.set()
    assert [notice.name for notice in followed(clock, one, lambda: None, 0.1)] == ["disk-answers"]
    assert one.refusal(0) is None


def test_it_warns_below_the_limit_and_at_each_half_and_says_when_all_is_well_again(
    make: Make, disk: FakeDisk, clock: VirtualClock
) -> None:
    one, began_s = make(min_free_mb=0, warn_minutes=10), clock.monotonic_s()

    def size() -> int:
        return int((clock.monotonic_s() - began_s) * MB)

    disk.free = 60 * 60 * MB  # an hour
    one.begin()
    assert followed(clock, one, size, 40.0) == []
    said: list[Notice] = []
    for _ in range(40):
        disk.free = int(disk.free * 0.8)
        said += followed(clock, one, size, 2.0)
    minutes = [notice.numbers["minutes_left"] for notice in said]
    assert {(notice.name, notice.severity) for notice in said} == {("disk-low", "warning")}
    assert minutes[0] <= 10
    assert all(later < earlier / 2 for earlier, later in itertools.pairwise(minutes))
    assert 4 < len(minutes) < 12
    disk.free = 60 * 60 * MB
    assert [notice.name for notice in followed(clock, one, size, 2.0)] == ["disk-ok"]


def test_an_episode_should_end_when_only_that_is_left_which_stays_free(
    make: Make, disk: FakeDisk, clock: VirtualClock
) -> None:
    one = make(min_free_mb=500)
    assert not one.is_used_up
    disk.free = 499 * MB
    clock.sleep(1.1)
    assert one.is_used_up
    assert "full but for the 500 MB that stay free" in one.used_up


def test_minutes_left_come_from_the_bus_until_the_file_has_grown_for_a_while(
    make: Make, disk: FakeDisk, clock: VirtualClock
) -> None:
    one = make(min_free_mb=400)
    one.count(written(10, MB - 64))
    assert one.refusal(0) is None  # which measures
    assert one.minutes_left == pytest.approx(600 / 10 / 60, rel=0.02)
    one.begin()
    began_s = clock.monotonic_s()
    followed(clock, one, lambda: int((clock.monotonic_s() - began_s) * MB), 4.0)
    assert one.minutes_left is not None
    assert one.minutes_left < 5, "it has not grown for long"
    followed(clock, one, lambda: int((clock.monotonic_s() - began_s) * MB), 4.0)
    assert one.minutes_left == pytest.approx(600 / 1 / 60, rel=0.05)
