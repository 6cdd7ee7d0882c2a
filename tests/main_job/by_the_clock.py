"""The main job by the clock, with strangers on the bus: what has to hold of the episode however long it lasted."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
from mcap.reader import make_reader

from adapters.robots.g1 import twist_keys
from station.bus import keys, stamp
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.episode.reading.reader import EpisodeReader, open_episode
from station.episode.storage.request import RecorderState
from tests.main_job.station_runs import Terminal, up
from tests.main_job.writers import FOREIGN_KEY, NATIVE_KEY, ForeignWriter, NativeWriter, running
from tests.waiting import bus_answers, wait_until

MOTION = "motion.motion=builtin:tour"
BODY = twist_keys.action_body()
LONGEST_S = 180.0

Counters = dict[tuple[str, str], int]
"""Newest sequence number by key and source, as the writer stamped it on the bus."""


@dataclass
class Run:
    """A recorded run and what the writers say they wrote.

    Attributes:
        at_start, at_end: Counters of every native key while the recording ran, soon after its start and before its end.
        last: The same after everything had stopped.
    """

    terminal: Terminal
    reader: EpisodeReader
    output: str
    foreign: list[bytes]
    sensor: str
    sensor_count: int
    at_start: Counters
    at_end: Counters
    last: Counters


@contextmanager
def recorded_run(folder: Path, is_over: Callable[[ForeignWriter, NativeWriter], bool]) -> Iterator[Run]:
    """Give a run of the main job, by the clock, with two writers beside it, that lasts until something is so."""
    terminal = Terminal(folder)
    bus_process = terminal.start("bus", "start")
    try:
        yield record(terminal, is_over)
    finally:
        bus_process.send_signal(signal.SIGINT)
        bus_process.communicate(timeout=30)


def record(terminal: Terminal, is_over: Callable[[ForeignWriter, NativeWriter], bool]) -> Run:
    address = BusAddress(socket=f"{terminal.environment['XDG_RUNTIME_DIR']}/station/bus.sock")
    wait_until(lambda: bus_answers(address))
    station = terminal.start(*up("run", "motion.loop=true", MOTION))

    def has_come() -> bool:
        assert station.poll() is None, station.communicate()[0]
        return is_over(foreign, sensor)

    try:
        with Bus(address, name="witness", timeout_s=5.0) as bus:
            wait_until(lambda: is_recording(bus) and bus.get(BODY))
            at_start = counters(bus)
            foreign, sensor = ForeignWriter(address), NativeWriter(address)
            with running(foreign), running(sensor):
                wait_until(has_come, LONGEST_S)
            at_end = counters(bus)
            assert is_recording(bus)
            station.send_signal(signal.SIGINT)  # Ctrl-C: the motion blends out, then the episode is closed
            output, _ = station.communicate(timeout=60)
            assert station.returncode == 0, output
            last = counters(bus)
    finally:
        station.kill()
        station.communicate()
    reader = open_episode(terminal.episode("run"))
    return Run(terminal, reader, output, foreign.written, sensor.source, sensor.count, at_start, at_end, last)


def is_recording(bus: Bus) -> bool:
    value = bus.get(keys.RECORDER)
    return value is not None and msgspec.json.decode(value, type=RecorderState).state == "recording"


def counters(bus: Bus) -> Counters:
    """Return what every native writer has counted, in one look."""
    names = [name for name in bus.names() if name != keys.TAP_PROBE]
    found = bus.read(names)
    return {(key, item.stamp.source): item.stamp.seq for key, item in found.items() if item.stamp is not None}


def recorded_numbers(reader: EpisodeReader) -> dict[tuple[str, str], list[int]]:
    """Return the whole sequence numbers in the file, by key and source, from the exact stamps."""
    found: dict[tuple[str, str], list[int]] = {}
    for message in reader.messages(stamps=True):
        if message.channel.is_native:
            mark = stamp.decode(message.stamp or b"")
            assert mark is not None, f"{message.topic}: no stamp"
            assert mark.source == message.channel.source
            found.setdefault((message.topic, mark.source), []).append(mark.seq)
    return found


def check_every_number_that_a_native_writer_counted_is_in_the_file(run: Run) -> None:
    found = recorded_numbers(run.reader)
    gaps = {key: numbers for key, numbers in found.items() if numbers != list(range(numbers[0], numbers[-1] + 1))}
    assert {key: (numbers[0], numbers[-1], len(numbers)) for key, numbers in gaps.items()} == {}
    written = {key: count for key, count in run.at_end.items() if count > run.at_start.get(key, 0)}
    assert len(written) > 20
    for key, counted in written.items():
        # All that it counted between our two looks; the looks were taken while the recording ran.
        assert found[key][0] <= run.at_start.get(key, 0) + 1, key
        assert found[key][-1] >= counted, key


def check_a_writer_that_came_and_went_within_the_recording_is_there_from_its_first_write_to_its_last(
    run: Run,
) -> None:
    found = recorded_numbers(run.reader)
    for key in (NATIVE_KEY, f"{NATIVE_KEY}/raw"):
        assert found[key, run.sensor] == list(range(1, run.sensor_count + 1))
    for key in (BODY, twist_keys.T_ACTION, keys.command_source(twist_keys.TWIST2_ROBOT)):
        ((source, counted),) = [(source, count) for (name, source), count in run.last.items() if name == key]
        numbers = found[key, source]
        assert numbers == list(range(1, counted + 1)), key


def check_every_write_of_a_stranger_is_there_in_order_and_byte_for_byte(run: Run) -> None:
    messages = list(run.reader.messages([FOREIGN_KEY]))
    assert [message.data for message in messages] == run.foreign
    assert len(run.foreign) > 100
    assert {message.channel.writer for message in messages} == {"foreign"}
    assert [message.sequence for message in messages] == list(range(1, len(messages) + 1))


def check_native_values_are_what_was_written(run: Run) -> None:
    raw = [message.data for message in run.reader.messages([f"{NATIVE_KEY}/raw"])]
    assert raw == [number.to_bytes(8, "big") for number in range(run.sensor_count)]


def check_file_opens_with_the_mcap_reader(run: Run) -> None:
    with run.reader.path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        by_topic: dict[str, int] = {}
        for _, channel, message in reader.iter_messages(log_time_order=False):
            by_topic[channel.topic] = by_topic.get(channel.topic, 0) + 1
            assert message.log_time > 0
        assert sum(by_topic.values()) == summary.statistics.message_count
    assert by_topic[FOREIGN_KEY] == len(run.foreign)


def check_file_passes_reruns_own_check(run: Run) -> None:
    program = Path(sys.executable).with_name("rerun")  # the package rerun-sdk brings it
    done = subprocess.run([program, "mcap", "check", str(run.reader.path)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    rows = [line.split() for line in done.stdout.partition("───")[2].splitlines()[1:] if line.strip()]
    assert {row[0] for row in rows} == {"ok"}, done.stdout
    assert len(rows) == len(run.reader.topics()) + 1, done.stdout  # and the topic of the stamps


def check_station_finds_nothing_lost_and_the_audit_no_difference(run: Run) -> None:
    check: dict[str, Any] = run.terminal.json("check", str(run.reader.folder))
    lost = {stream["key"]: stream["lost"] for stream in check["streams"] if stream["lost"]}
    assert (lost, check["dropped"], check["holes"], check["recorder_restarts"]) == ({}, 0, 0, 0)
    assert check["falls"] == 0, run.output
    audit: dict[str, Any] = run.terminal.json("audit", str(run.reader.folder))
    assert audit["steps"] > 0
    assert (audit["different"], audit["observations"]["different"], audit["incomplete"]) == (0, 0, 0)
    assert audit["max_abs_difference"] == 0.0


CHECKS: tuple[Callable[[Run], None], ...] = (
    check_every_number_that_a_native_writer_counted_is_in_the_file,
    check_a_writer_that_came_and_went_within_the_recording_is_there_from_its_first_write_to_its_last,
    check_every_write_of_a_stranger_is_there_in_order_and_byte_for_byte,
    check_native_values_are_what_was_written,
    check_file_opens_with_the_mcap_reader,
    check_file_passes_reruns_own_check,
    check_station_finds_nothing_lost_and_the_audit_no_difference,
)
