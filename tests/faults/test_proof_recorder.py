"""A recorder that is killed over and over loses nothing, is soon back, and holds up nobody."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from random import Random
from tempfile import mkdtemp

import numpy as np
import pytest

from station.bus.address import BusAddress
from station.episode.reading.reader import open_episode
from station.protocols import Floats
from tests.faults.bus_station import frozen
from tests.faults.disks import BadDisk
from tests.faults.heavy_cameras import FLUSH_TAKES_S, catch_up, kill_under_images
from tests.faults.killed_recorder import (
    be_away,
    kill_while_it_closes,
    kill_while_it_recovers,
    kill_while_it_starts,
)
from tests.faults.recorded_station import BODY, Writers, recorded_station
from tests.faults.slow_disk import robot_beside_a_recorder, ticks_made
from tests.faults.soak_recorder import soak
from tests.figures import Figures
from tests.lateness import TooLate, Waits, in_time

MINUTES, KILL_EVERY_S = 3.0, 5.0
TRIALS = 25
LATE_S = 0.02
PERIOD_S, STEPS = 0.02, 500
KILLS = 6


@pytest.mark.timeout(900)
@pytest.mark.usefixtures("processes")
def test_of_every_write_and_picture_of_some_minutes_none_is_lost_and_none_twice(proof: Figures) -> None:
    found = soak(MINUTES, kill_every_s=KILL_EVERY_S, period_s=0.0007, seed=1)
    done = f"{found['kills']:.0f} kills in {MINUTES:.0f} min, {found['written']:.0f} writes"
    proof.figure("recorder `kill -9` at random moments, images at 30 Hz", done)
    proof.figure("recorder `kill -9` at random moments: lost, twice", f"{found['lost']:.0f}, {found['duplicated']:.0f}",
                 limit="0, 0")  # fmt: skip
    proof.figure("time without a recorder that was killed, longest", found["longest_away_s"], "s")
    assert (found["lost"], found["duplicated"], found["holes"]) == (0, 0, 0)
    assert found["kills"] > 10


@pytest.mark.timeout(1200)
@pytest.mark.parametrize(
    ("kill", "when"),
    [
        (kill_while_it_starts, "starts"),
        (kill_while_it_closes, "closes"),
        (lambda address, place, random: kill_while_it_recovers(address, place, random, kills=3), "recovers"),
    ],
    ids=["starts", "closes", "recovers"],
)
def test_killed_at_moments_that_matter_it_recovers_and_answers(
    kill: Callable[[BusAddress, Path, Random], Path], when: str, bus_server: BusAddress, tmp_path: Path, proof: Figures
) -> None:
    for seed in range(TRIALS):
        kill(bus_server, Path(mkdtemp(dir=tmp_path)), Random(seed))
    proof.figure(f"recorder killed while it {when}: trials, all recovered", TRIALS)


def test_what_was_written_while_it_was_away_is_not_late(bus_server: BusAddress, tmp_path: Path, proof: Figures) -> None:
    def once() -> None:
        with Waits.watched() as waits:
            folder = be_away(bus_server, Path(mkdtemp(dir=tmp_path)))
        reader = open_episode(folder)
        (note,) = reader.manifest.recovery
        back_ns = reader.start_ns + note["at_s"] * 1e9
        late_s = np.array(
            [(m.log_ns - m.publish_ns) * 1e-9 for m in reader.messages([BODY])
             if 0 < back_ns - m.publish_ns < note["away_s"] * 1e9]
        )  # fmt: skip
        if (usual_s := float(np.percentile(late_s, 90))) >= LATE_S:
            raise TooLate("nine of ten messages", usual_s - LATE_S, waits.longest_s)
        assert note["away_s"] > 2 * LATE_S, "who logged what waited when it arrives would be too late"
        proof.figure("from write to log time while a killed recorder was away, p90", usual_s * 1e3, "ms", "20 ms")

    in_time(once)


def test_a_killed_recorder_has_all_but_the_last_moment_on_the_disk(
    bus_server: BusAddress, tmp_path: Path, proof: Figures
) -> None:
    """Frozen instead of killed: the file is the same."""
    unsafe_s: list[float] = []
    with recorded_station(bus_server, tmp_path) as station:
        folder = Path(station.ask("start", task="walk").path or "")
        writers = Writers(bus_server, 0.003)
        for number in range(KILLS):
            station.wait_until_it_records(messages=1000 * (number + 1))
            with frozen(station.pid):
                at_ns = time.monotonic_ns()
                *_, last = open_episode(folder).messages([BODY], stamps=True)
            unsafe_s.append((at_ns - int((last.stamp or b"").split()[1])) * 1e-9)
        writers.stop()
        station.ask("stop")
    proof.figure(f"what a killed recorder had not flushed, most of {KILLS}", max(unsafe_s), "s", limit="1 s")
    assert max(unsafe_s) < 1.0, "a flush every half a second, and its time"


def lateness_ms(read_s: Floats) -> tuple[float, int]:
    """Return p99 of how far steps read the robot's state from a period after each other [ms], and missed periods."""
    late_s = np.abs(np.diff(read_s) - PERIOD_S)
    return float(np.percentile(late_s, 99)) * 1e3, round((read_s[-1] - read_s[0]) / PERIOD_S) - len(read_s) + 1


def test_the_control_loop_is_undisturbed_by_kills_of_the_recorder(
    bus_server: BusAddress, tmp_path: Path, proof: Figures
) -> None:
    with robot_beside_a_recorder(bus_server, tmp_path) as (log, station):
        station.ask("start", task="walk")
        quiet_ms, quiet_missed = lateness_ms(ticks_made(log, STEPS))
        parts = []
        for _ in range(KILLS):
            station.wait_until_it_records()
            pid = station.kill()
            parts.append(ticks_made(log, STEPS // KILLS))
            station.wait_for_another(pid)
        station.wait_until_it_records()
        station.ask("stop")
    found = [lateness_ms(part) for part in parts]
    killed_ms, killed_missed = max(p99_ms for p99_ms, _ in found), sum(missed for _, missed in found)
    both = f"{quiet_ms:.3g} / {killed_ms:.3g}"
    proof.figure(f"control loop: jitter p99, recorder alive / with {KILLS} kills", both, "ms")
    proof.figure(f"control loop: missed periods of {STEPS}, alive / with {KILLS} kills",
                 f"{quiet_missed} / {killed_missed}")  # fmt: skip
    assert killed_missed <= quiet_missed + STEPS // 20


def test_control_keeps_its_timing_while_every_sync_of_the_disk_takes_200_ms(
    bus_server: BusAddress, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, proof: Figures
) -> None:
    disk = BadDisk(tmp_path, tmp_path / "data", monkeypatch)

    def once() -> None:
        with Waits.watched() as waits:
            fast_ms, fast_missed = lateness_ms(ticks_made(log, STEPS))
            disk.order("wait 0.2", "fdatasync", "fsync")
            slow_ms, slow_missed = lateness_ms(ticks_made(log, STEPS))
            disk.heal()
        if slow_missed > fast_missed + STEPS // 20:
            raise TooLate("control", (slow_missed - fast_missed) * PERIOD_S, waits.seconds())
        both = f"{fast_ms:.3g} / {slow_ms:.3g}"
        proof.figure("control loop: jitter p99, fast disk / each sync takes 200 ms", both, "ms")

    with robot_beside_a_recorder(bus_server, tmp_path) as (log, station):
        station.ask("start", task="walk")
        in_time(once)
        station.ask("stop")


def test_with_30_mb_of_images_a_second_a_killed_recorder_loses_none(
    bus_server: BusAddress, tmp_path: Path, proof: Figures
) -> None:
    images, dropped = kill_under_images(bus_server, tmp_path, mb_per_s=30.0, kills=5)
    proof.figure("recorder `kill -9` five times at 30 MB/s of images: dropped", f"{dropped} of {images}", limit="0")
    assert dropped == 0


def test_what_waits_for_a_killed_recorder_is_read_at_the_pace_of_the_disk(
    bus_server: BusAddress, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, proof: Figures
) -> None:
    BadDisk(tmp_path, tmp_path / "data", monkeypatch).order(f"wait {FLUSH_TAKES_S}", "fdatasync")
    dropped, _ = catch_up(bus_server, tmp_path, 300)
    proof.figure("catching up, 30 MB waiting and a disk of 10 MB/s: images dropped", dropped, limit="0")
    assert dropped == 0
