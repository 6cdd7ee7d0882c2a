"""An episode of two servers: every write of both is in it, in order, whatever is killed."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from station.bus import codec, keys
from station.bus.client import Bus
from station.bus.keeper import KeptServer
from station.bus.server_options import ServerOptions, bulk_options
from station.episode.quality.check import check
from station.episode.reading.reader import EpisodeReader, open_episode
from station.episode.recorder import both_taps, remote
from station.episode.recorder.tap_reader import TapReader
from station.life.server import read_health
from tests.episode.recorder.killed_recorder import Recorder
from tests.episode.recorder.tap_readers import Make, ask, tap_readers
from tests.waiting import wait_until

DEPTH, CLOUD, STATE = keys.camera_depth("head"), keys.lidar_cloud("top"), keys.robot_state("g1")


@pytest.fixture
def servers(tmp_path: Path, processes: None) -> Iterator[tuple[KeptServer, KeptServer]]:
    options = ServerOptions(folder=tmp_path, socket=tmp_path / "bus.sock")
    with KeptServer.start(options) as bus, KeptServer.start(bulk_options(options)) as bulk:
        yield bus, bulk


@pytest.fixture
def head(servers: tuple[KeptServer, KeptServer]) -> Iterator[Bus]:
    """Writes states over the bus and depth and clouds over the bulk bus."""
    with Bus(servers[0].address, name="head", timeout_s=5.0) as line:
        yield line


@pytest.fixture
def make(servers: tuple[KeptServer, KeptServer], tmp_path: Path) -> Iterator[Make]:
    with tap_readers(servers[0].address, tmp_path / "data") as build:
        yield build


def write(head: Bus, numbers: range) -> None:
    for number in numbers:
        head.publish({STATE: b"%d" % number, DEPTH: b"d%d" % number, CLOUD: b"c%d" % number})


def step_until(tap_reader: TapReader, condition: Callable[[], object]) -> None:
    def holds() -> object:
        tap_reader.step()
        tap_reader.recording.poll()
        return condition()

    wait_until(holds)


def numbers(reader: EpisodeReader, key: str) -> list[int]:
    return [int(message.data.lstrip(b"cd")) for message in reader.messages([key])]


def test_an_episode_has_every_write_of_both_up_to_its_end(make: Make, head: Bus, servers: Any) -> None:
    tap_reader = make()
    write(head, range(50))
    folder = ask(tap_reader, head, "start")
    write(head, range(50, 300))
    reader = open_episode(ask(tap_reader, head, "stop"))
    assert {key: numbers(reader, key) for key in (STATE, DEPTH, CLOUD)} == {
        key: list(range(300)) for key in (STATE, DEPTH, CLOUD)
    }
    assert {stream.key: stream.lost for stream in reader.manifest.streams if stream.lost} == {}
    assert reader.manifest.holes == []
    assert reader.manifest.recorder.is_lossless
    assert reader.manifest.recorder.bulk == str(servers[1].address)
    times = [message.log_ns for message in reader.messages([DEPTH, STATE, CLOUD])]
    assert times == sorted(times)
    assert {stream.key: stream.count for stream in check(open_episode(folder)).streams}[CLOUD] == 300


def test_what_was_written_over_a_slow_bulk_bus_before_the_stop_is_in(
    make: Make, head: Bus, servers: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    tap_reader = make()
    ask(tap_reader, head, "start")
    read = both_taps._BulkReader._read

    def slow(reader: Any, tap: Any) -> None:
        time.sleep(0.1)
        read(reader, tap)

    monkeypatch.setattr(both_taps._BulkReader, "_read", slow)
    write(head, range(100))
    reader = open_episode(ask(tap_reader, head, "stop"))
    assert numbers(reader, DEPTH) == list(range(100))


@pytest.mark.parametrize("is_bulk_killed", [False, True], ids=["recorder", "recorder-and-bulk-bus"])
def test_a_recorder_that_was_killed_goes_on_in_both(
    head: Bus, servers: tuple[KeptServer, KeptServer], tmp_path: Path, is_bulk_killed: bool
) -> None:
    first = Recorder(servers[0].address, tmp_path)
    wait_until(lambda: head.get(keys.RECORDER))
    folder = Path(remote.ask(head, "start", task="walk").path or "")
    write(head, range(100))
    resume = folder / "resume.json"
    wait_until(lambda: b'"messages":0' not in resume.read_bytes() and resume.stat().st_size)
    write(head, range(100, 200))
    first.end()
    if is_bulk_killed:
        os.kill(servers[1].pid, signal.SIGKILL)
        wait_until(lambda: servers[1].restarts == 1)
        line = head.open_bulk()
        wait_until(lambda: line.publish({CLOUD: b"c200"}))
    write(head, range(200, 300))
    second = Recorder(servers[0].address, tmp_path)
    wait_until(lambda: any(health.pid == second.pid and health.state == "active" for health in read_health(head)))
    write(head, range(300, 400))
    assert remote.ask(head, "stop").path == str(folder)
    second.end(signal.SIGTERM)
    reader = open_episode(folder)
    assert numbers(reader, STATE) == list(range(400))
    holes = [hole.reason for hole in reader.manifest.holes]
    if is_bulk_killed:
        assert holes == ["bulk bus: the bus was restarted, or is another server"]
        assert numbers(reader, DEPTH)[-100:] == list(range(300, 400))
        assert numbers(reader, DEPTH) == sorted(set(numbers(reader, DEPTH))), "nothing twice"
    else:
        assert holes == []
        assert [numbers(reader, key) for key in (DEPTH, CLOUD)] == [list(range(400))] * 2
        times = [message.log_ns for message in reader.messages([DEPTH, STATE, CLOUD])]
        assert times == sorted(times)
        assert max(abs(message.log_ns - message.publish_ns) for message in reader.messages([DEPTH])) < 1e9


def test_the_death_of_the_bulk_bus_is_a_hole_for_depth_and_none_for_the_robot(
    make: Make, head: Bus, servers: tuple[KeptServer, KeptServer]
) -> None:
    tap_reader = make()
    ask(tap_reader, head, "start")
    write(head, range(20))
    step_until(tap_reader, lambda: tap_reader.recording.state().messages >= 60)
    os.kill(servers[1].pid, signal.SIGKILL)
    wait_until(lambda: servers[1].restarts == 1)
    write(head, range(20, 40))  # some of it before the tap is there again
    events: list[str] = []
    step_until(tap_reader, lambda: "tap-hole" in told(head, events))
    line = head.open_bulk()
    wait_until(lambda: line.publish({CLOUD: b"c40"}))
    write(head, range(41, 60))
    reader = open_episode(ask(tap_reader, head, "stop"))
    assert numbers(reader, STATE) == [*range(40), *range(41, 60)]
    found = numbers(reader, DEPTH)
    assert found == sorted(found)
    assert (found[:20], found[-19:]) == ([*range(20)], [*range(41, 60)])
    (hole,) = reader.manifest.holes
    assert hole.reason == "bulk bus: the bus was restarted, or is another server"
    assert hole.from_s > 0
    assert reader.manifest.recorder.ended_by == "stop"
    assert "tap-lost" in events


def told(head: Bus, events: list[str]) -> list[str]:
    """Return the names of the events so far."""
    if (sample := head.read([keys.EVENT]).get(keys.EVENT)) is not None:
        name = str(codec.parse_facts(sample.value).get("name"))
        events += [name] if name not in events else []
    for health in (head.read([keys.server("recorder")]),):
        for sample in health.values():
            events += [str(event["name"]) for event in codec.parse_facts(sample.value).get("events", [])]
    return events


def test_an_episode_that_ends_without_the_bulk_bus_says_since_when_it_has_none(
    make: Make, head: Bus, servers: tuple[KeptServer, KeptServer]
) -> None:
    tap_reader = make()
    ask(tap_reader, head, "start")
    write(head, range(20))
    step_until(tap_reader, lambda: tap_reader.recording.state().messages >= 60)
    servers[1].stop()
    step_until(tap_reader, lambda: tap_reader.recording._bulk_lost is not None)
    reader = open_episode(ask(tap_reader, head, "stop"))
    (hole,) = reader.manifest.holes
    assert hole.reason.startswith("bulk bus: ")
    assert reader.manifest.timing.duration_s is not None
    assert hole.to_s is not None
    assert 0 < hole.from_s < hole.to_s <= reader.manifest.timing.duration_s + 0.001


def test_a_cut_of_the_bulk_bus_alone_loses_nothing(make: Make, head: Bus, servers: Any) -> None:
    tap_reader = make()
    ask(tap_reader, head, "start")
    done = threading.Event()

    def cut() -> None:
        with Bus(servers[1].address, name="test", timeout_s=5.0) as line:
            for _ in range(5):
                line.call("CLIENT", "KILL", "TYPE", "replica")
                time.sleep(0.05)
        done.set()

    thread = threading.Thread(target=cut)
    thread.start()
    count = 0
    while not done.is_set():
        write(head, range(count, count + 10))
        count += 10
        tap_reader.step()
    thread.join()
    step_until(tap_reader, lambda: tap_reader.recording._bulk_lost is None)
    reader = open_episode(ask(tap_reader, head, "stop"))
    assert {key: numbers(reader, key) for key in (STATE, DEPTH, CLOUD)} == {
        key: list(range(count)) for key in (STATE, DEPTH, CLOUD)
    }
    assert reader.manifest.holes == []


def test_the_death_of_the_bus_alone_leaves_no_hole_in_depth(make: Make, head: Bus, servers: Any) -> None:
    tap_reader = make()
    ask(tap_reader, head, "start")
    write(head, range(20))
    step_until(tap_reader, lambda: tap_reader.recording.state().messages >= 60)
    os.kill(servers[0].pid, signal.SIGKILL)
    line = head.open_bulk()
    for number in range(20, 60):
        line.publish({DEPTH: b"d%d" % number})
    wait_until(lambda: head.publish({STATE: b"60"}))
    step_until(tap_reader, lambda: tap_reader.recording._active is not None and "tap-hole" in told(head, []))
    reader = open_episode(ask(tap_reader, head, "stop"))
    assert numbers(reader, DEPTH) == list(range(60))
    assert [hole.reason.split(":")[0] for hole in reader.manifest.holes] == ["the tap could not go on where it was"]


def test_a_bulk_bus_that_is_frozen_at_the_end_is_told_and_not_waited_for(
    make: Make, head: Bus, servers: tuple[KeptServer, KeptServer]
) -> None:
    tap_reader = make()
    ask(tap_reader, head, "start")
    write(head, range(20))
    step_until(tap_reader, lambda: tap_reader.recording.state().messages >= 60)
    os.kill(servers[1].pid, signal.SIGSTOP)
    try:
        frozen_ns = time.monotonic_ns()
        head.publish({STATE: b"20"})
        reader = open_episode(ask(tap_reader, head, "stop"))
    finally:
        os.kill(servers[1].pid, signal.SIGCONT)
    assert numbers(reader, STATE) == list(range(21))
    (hole,) = reader.manifest.holes
    assert hole.reason.startswith("bulk bus: what was written over it had not come")
    anchor = reader.manifest.timing.anchor
    assert anchor is not None
    assert hole.from_s <= (frozen_ns - anchor.mono_ns) * 1e-9


def test_what_the_bulk_bus_was_late_with_does_not_move_the_times_of_the_robot(
    make: Make, head: Bus, servers: tuple[KeptServer, KeptServer]
) -> None:
    tap_reader = make()
    ask(tap_reader, head, "start")
    write(head, range(20))
    step_until(tap_reader, lambda: tap_reader.recording.state().messages >= 60)
    with Bus(servers[1].address, name="test", timeout_s=5.0) as line:
        line.call("CLIENT", "KILL", "TYPE", "replica")
    for number in range(20, 120):
        write(head, range(number, number + 1))
        tap_reader.step()
        tap_reader.recording.poll()
    step_until(tap_reader, lambda: tap_reader.recording._bulk_lost is None)
    reader = open_episode(ask(tap_reader, head, "stop"))
    assert numbers(reader, DEPTH) == list(range(120))
    written = {message.data: message.publish_ns for message in reader.messages([STATE])}
    for message, after in zip([*reader.messages([STATE])], [*reader.messages([STATE])][1:], strict=False):
        assert written[message.data] <= message.log_ns <= after.log_ns
    assert reader.manifest.holes == []
