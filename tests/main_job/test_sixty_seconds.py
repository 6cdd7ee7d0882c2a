"""A minute against the clock, with strangers on the bus: the recorder holds everything that anybody wrote."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import pytest
from mcap.reader import make_reader

from station.bus import keys, stamp
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.episode.reading.reader import EpisodeReader, open_episode
from station.episode.storage.request import RecorderState
from tests.lateness import TooLate, Waits, excuse
from tests.main_job.station_runs import Terminal, up
from tests.main_job.writers import FOREIGN_KEY, NATIVE_HZ, NATIVE_KEY, ForeignWriter, NativeWriter, running
from tests.waiting import wait_until

RUN_S = 60.0
SHARE = 0.9  # of the writes that are due in that time
MOTION = "motion.motion=builtin:tour"
BODY = keys.action_body()

pytestmark = pytest.mark.timeout(300)

Counters = dict[tuple[str, str], int]
"""Newest sequence number by key and source, as the writer stamped it on the bus."""


@dataclass
class Minute:
    """A recorded minute and what the writers say they wrote.

    Attributes:
        at_start, at_end: Counters of every native key while the recording ran, soon after its start and before its end.
        last: The same after everything had stopped.
        waited_s: How long those who wrote waited for a processor while the minute ran [s].
    """

    terminal: Terminal
    reader: EpisodeReader
    output: str
    foreign: list[bytes]
    sensor: str
    sensor_count: int
    at_start: Counters
    at_end: Counters
    waited_s: float
    last: Counters

    def expect_rate(self, count: int, hz: float) -> None:
        """Fail where fewer were written than were due, unless those who wrote waited for at least as long."""
        if (missing := SHARE * hz * RUN_S - count) >= 0:
            excuse(TooLate(f"{count} of {hz * RUN_S:.0f}", missing / hz, self.waited_s))


@pytest.fixture(scope="module")
def minute(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Minute]:
    terminal = Terminal(tmp_path_factory.mktemp("minute"))
    bus_process = terminal.start("bus", "start")
    try:
        yield record_a_minute(terminal)
    finally:
        bus_process.send_signal(signal.SIGINT)
        bus_process.communicate(timeout=30)


def record_a_minute(terminal: Terminal) -> Minute:
    address = BusAddress(socket=f"{terminal.environment['XDG_RUNTIME_DIR']}/station/bus.sock")
    wait_until(lambda: Path(str(address.socket)).exists())
    station = terminal.start(*up("minute", "motion.loop=true", MOTION))
    try:
        with Bus(address, name="witness", timeout_s=5.0) as bus:
            wait_until(lambda: is_recording(bus) and bus.get(BODY))
            at_start = counters(bus)
            foreign, sensor = ForeignWriter(address), NativeWriter(address)
            with Waits.watched() as waits, running(foreign), running(sensor):
                let_run(station, RUN_S)
                waited_s = waits.seconds()
            at_end = counters(bus)
            assert is_recording(bus)
            station.send_signal(signal.SIGINT)  # Ctrl-C: the motion blends out, then the episode is closed
            output, _ = station.communicate(timeout=60)
            assert station.returncode == 0, output
            last = counters(bus)
    finally:
        station.kill()
        station.communicate()
    reader = open_episode(terminal.episode("minute"))
    wrote = (foreign.written, sensor.source, sensor.count)
    return Minute(terminal, reader, output, *wrote, at_start, at_end, waited_s, last)


def let_run(station: subprocess.Popen[str], seconds: float) -> None:
    """Return after that time; fail at once when the station ends before."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        assert station.poll() is None, station.communicate()[0]
        time.sleep(0.1)


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


def test_every_number_that_a_native_writer_counted_is_in_the_file(minute: Minute) -> None:
    found = recorded_numbers(minute.reader)
    gaps = {key: numbers for key, numbers in found.items() if numbers != list(range(numbers[0], numbers[-1] + 1))}
    assert {key: (numbers[0], numbers[-1], len(numbers)) for key, numbers in gaps.items()} == {}
    written = {key: count for key, count in minute.at_end.items() if count > minute.at_start.get(key, 0)}
    assert len(written) > 20
    for key, counted in written.items():
        # All that it counted between our two looks; the looks were taken while the recording ran.
        assert found[key][0] <= minute.at_start.get(key, 0) + 1, key
        assert found[key][-1] >= counted, key


def test_a_writer_that_came_and_went_within_the_recording_is_there_from_its_first_write_to_its_last(
    minute: Minute,
) -> None:
    found = recorded_numbers(minute.reader)
    for key in (NATIVE_KEY, f"{NATIVE_KEY}/raw"):
        assert found[key, minute.sensor] == list(range(1, minute.sensor_count + 1))
    minute.expect_rate(minute.sensor_count, NATIVE_HZ)
    for key in (BODY, keys.T_ACTION, keys.command_source(keys.TWIST2_ROBOT)):
        ((source, counted),) = [(source, count) for (name, source), count in minute.last.items() if name == key]
        numbers = found[key, source]
        assert numbers == list(range(1, counted + 1)), key
    minute.expect_rate(len(numbers), 50.0)


def test_every_write_of_a_stranger_is_there_in_order_and_byte_for_byte(minute: Minute) -> None:
    messages = list(minute.reader.messages([FOREIGN_KEY]))
    assert [message.data for message in messages] == minute.foreign
    assert len(minute.foreign) > 1000
    assert {message.channel.writer for message in messages} == {"foreign"}
    assert [message.sequence for message in messages] == list(range(1, len(messages) + 1))


def test_native_values_are_what_was_written(minute: Minute) -> None:
    raw = [message.data for message in minute.reader.messages([f"{NATIVE_KEY}/raw"])]
    assert raw == [number.to_bytes(8, "big") for number in range(minute.sensor_count)]


def test_file_opens_with_the_mcap_reader(minute: Minute) -> None:
    with minute.reader.path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        by_topic: dict[str, int] = {}
        for _, channel, message in reader.iter_messages(log_time_order=False):
            by_topic[channel.topic] = by_topic.get(channel.topic, 0) + 1
            assert message.log_time > 0
        assert sum(by_topic.values()) == summary.statistics.message_count
    assert by_topic[FOREIGN_KEY] == len(minute.foreign)


def test_file_passes_reruns_own_check(minute: Minute) -> None:
    program = Path(sys.executable).with_name("rerun")  # the package rerun-sdk brings it
    done = subprocess.run(
        [program, "mcap", "check", str(minute.reader.path)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    rows = [line.split() for line in done.stdout.partition("───")[2].splitlines()[1:] if line.strip()]
    assert {row[0] for row in rows} == {"ok"}, done.stdout
    assert len(rows) == len(minute.reader.topics()) + 1, done.stdout  # and the topic of the stamps


def test_station_finds_nothing_lost_and_the_audit_no_difference(minute: Minute) -> None:
    check: dict[str, Any] = minute.terminal.json("check", str(minute.reader.folder))
    lost = {stream["key"]: stream["lost"] for stream in check["streams"] if stream["lost"]}
    assert (lost, check["dropped"], check["holes"], check["recorder_restarts"]) == ({}, 0, 0, 0)
    assert (check["falls"], check["duration_s"] > RUN_S) == (0, True), minute.output
    audit: dict[str, Any] = minute.terminal.json("audit", str(minute.reader.folder))
    minute.expect_rate(audit["steps"], 50.0)
    assert (audit["different"], audit["observations"]["different"], audit["incomplete"]) == (0, 0, 0)
    assert audit["max_abs_difference"] == 0.0
