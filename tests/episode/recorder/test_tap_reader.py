"""What a recorder takes in, on a real bus and without its process: what came before it, and what it has missed."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from adapters.robots.g1 import twist_keys
from station.bus import codec, keys
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.bus.connection import Connection
from station.bus.tap import Tap, open_tap
from station.episode.quality.check import check
from station.episode.reading import steps
from station.episode.reading.reader import open_episode
from station.episode.recorder import remote
from station.episode.recorder import tap_reader as intake_module
from station.episode.recorder.both_taps import open_taps
from station.episode.recorder.latched import latched, not_among
from station.episode.recorder.tap_reader import TapReader
from station.episode.recorder.writer import Ledger
from station.episode.storage.anchor import Anchor, read_anchor
from station.episode.storage.left_open import left_open
from station.episode.storage.manifest import Hole, Manifest, Timing, load_manifest, save_manifest
from station.episode.storage.progress import load_resume_point
from tests.episode.recorder.tap_readers import LONG_S, Make, ask, tap_readers
from tests.episode.writes import Native
from tests.waiting import wait_until

ROBOT = twist_keys.TWIST2_ROBOT
STATE = keys.robot_state(ROBOT)
STARTED_S = 5.0  # ago
BLOCK = b"x" * 100_000
BLOCKS = 60  # more than a read takes and a socket holds


@pytest.fixture
def g1(bus_server: BusAddress) -> Iterator[Bus]:
    with Bus(bus_server, name="g1", timeout_s=5.0) as line:
        yield line


@pytest.fixture
def make(bus_server: BusAddress, tmp_path: Path) -> Iterator[Make]:
    with tap_readers(bus_server, tmp_path) as build:
        yield build


def stepped(g1: Bus, tick: int) -> None:
    """Write what a step of the policy leaves behind."""
    g1.publish({keys.policy_timing(ROBOT): b"[%d,1,2,3,4,5,6,7]" % tick, keys.command_gate(ROBOT): b"{}"})


def test_the_first_step_has_its_state_also_where_that_was_written_before_the_recorder_was_there(
    make: Make, g1: Bus
) -> None:
    state, later = codec.f64([1.0] * 65), codec.f64([2.0] * 65)
    g1.publish({STATE: b"of a step that nobody recorded", twist_keys.T_STATE: b"1"})
    g1.publish({STATE: state, twist_keys.T_STATE: b"2"})  # and now it waits for a command
    tap_reader = make()
    folder = ask(tap_reader, g1, "start")
    stepped(g1, 1)
    g1.publish({STATE: later, twist_keys.T_STATE: b"3"})
    stepped(g1, 2)
    ask(tap_reader, g1, "stop")
    reader = open_episode(folder)
    found = list(steps.iterate(reader, ROBOT))
    assert [(step.values[STATE], step.state_number) for step in found] == [(state, 2), (later, 3)]
    assert [message.sequence for message in reader.messages([STATE])] == [2, 3]
    first = next(iter(reader.messages([STATE], stamps=True)))
    assert first.stamp is not None
    assert first.log_ns == pytest.approx(first.publish_ns, abs=1e6), "when it was written"
    assert {stream.key: stream.lost for stream in reader.manifest.streams if stream.lost} == {}
    assert reader.manifest.timing.preroll_s > 0


def test_only_states_of_this_machine_that_are_not_old_are_looked_back_for(g1: Bus) -> None:
    now_ns = time.monotonic_ns()
    old = Native().write(twist_keys.state_body(ROBOT), b"[]", written_ns=now_ns - 10_000_000_000)
    g1.publish({STATE: b"new", twist_keys.action_body(): b"[]", keys.policy_action(ROBOT): b"", "own": b""})
    g1.call("SET", twist_keys.T_STATE, b"5")
    g1.call("MSET", old.key, old.value or b"", keys.stamp(old.key), old.stamp or b"")
    g1.call("MSET", keys.sim_qpos(ROBOT), b"", keys.stamp(keys.sim_qpos(ROBOT)), b"1 5 5 g1.1.00000000.ab")
    assert [(write.key, write.value) for write in latched(g1, 5.0)] == [(STATE, b"new")]
    assert [write.key for write in latched(g1, LONG_S)] == [old.key, STATE], "oldest first"


def test_a_state_that_the_tap_brings_too_is_taken_once(g1: Bus, bus_server: BusAddress) -> None:
    g1.publish({STATE: b"before", keys.sim_qpos(ROBOT): b"before"})
    tap = open_tap(bus_server)
    try:
        g1.publish({STATE: b"after"})
        states = latched(g1, LONG_S)
        brought = tap.read(5.0)
    finally:
        tap.close()
    assert [write.value for write in brought] == [b"after"]
    assert [(write.key, write.value) for write in not_among(states, brought)] == [(keys.sim_qpos(ROBOT), b"before")]


def test_a_state_that_a_stock_script_goes_on_writing_over_is_not_taken_for_that_of_its_native_writer(
    make: Make, g1: Bus
) -> None:
    body, other = twist_keys.state_body(ROBOT), keys.sim_qpos(ROBOT)
    g1.publish({body: b"[1]", STATE: b"", other: b""})
    g1.call("SET", body, b"[2]")  # beside the stamp of [1]
    tap_reader = make()
    g1.call("SET", body, b"[3]")
    g1.call("DEL", other)  # which says nothing of who wrote it
    g1.publish({STATE: b"later"})
    folder = ask(tap_reader, g1, "start")
    ask(tap_reader, g1, "stop")
    found = [(m.topic, m.data, m.channel.is_native) for m in open_episode(folder).messages([body, STATE, other])]
    assert found == [
        (STATE, b"", True),
        (other, b"", True),
        (body, b"[3]", False),
        (other, b"", False),
        (STATE, b"later", True),
    ]


def test_what_a_robot_says_while_the_recorder_looks_back_is_recorded_once_and_without_a_hole(
    make: Make, g1: Bus
) -> None:
    is_open = threading.Event()

    def write() -> None:
        while not is_open.is_set():
            g1.publish({STATE: b""})

    robot = threading.Thread(target=write)
    robot.start()
    try:
        tap_reader = make()
    finally:
        is_open.set()
        robot.join()
    folder = ask(tap_reader, g1, "start")
    ask(tap_reader, g1, "stop")
    numbers = [message.sequence for message in open_episode(folder).messages([STATE])]
    assert len(numbers) > 1
    assert numbers == list(range(numbers[0], numbers[-1] + 1))


def test_without_a_preroll_nobody_looks_back(make: Make, g1: Bus) -> None:
    g1.publish({STATE: b""})
    tap_reader = make(preroll_s=0.0)
    folder = ask(tap_reader, g1, "start")
    ask(tap_reader, g1, "stop")
    assert STATE not in open_episode(folder).topics()


def test_an_episode_that_begins_with_the_recorder_has_the_state_that_stood_on_the_bus(make: Make, g1: Bus) -> None:
    state = codec.f64([1.0] * 65)
    g1.publish({keys.RECORDER: b"of a recorder that was killed"})
    g1.publish({STATE: state, twist_keys.T_STATE: b"1"})  # and now it waits for a command
    g1.publish({keys.RECORD: codec.json_object({"id": "start", "action": "start", "task": "walk"})})
    tap_reader = make()
    assert tap_reader.recording.is_recording, "nobody need ask again"
    stepped(g1, 1)
    folder = ask(tap_reader, g1, "stop", but="start")
    (step,) = steps.iterate(open_episode(folder), ROBOT)
    assert (step.values[STATE], step.state_number) == (state, 1)


def test_an_episode_that_was_asked_for_in_a_hole_has_the_state_that_stands_on_the_bus(
    make: Make, g1: Bus, bus_server: BusAddress
) -> None:
    state = codec.f64([1.0] * 65)
    tap_reader = make()
    step_until(tap_reader, lambda: True)
    overrun(bus_server, lambda: g1.publish({STATE: state}))
    g1.publish({keys.RECORD: codec.json_object({"id": "start", "action": "start", "task": "walk"})})
    step_until(tap_reader, lambda: tap_reader.recording.is_recording)
    stepped(g1, 1)
    folder = ask(tap_reader, g1, "stop", but="start")
    (step,) = steps.iterate(open_episode(folder), ROBOT)
    assert step.values[STATE] == state


@pytest.mark.parametrize("stands", [True, False])
def test_a_request_that_comes_as_soon_as_the_tap_is_open_is_done_once(
    make: Make, g1: Bus, monkeypatch: pytest.MonkeyPatch, stands: bool
) -> None:
    def open_and_ask(*where: Any, **how: Any) -> Tap:
        tap = open_taps(*where, **how)
        g1.publish({keys.RECORD: codec.json_object({"id": "start", "action": "start", "task": "walk"})})
        return tap

    monkeypatch.setattr(intake_module, "open_taps", open_and_ask)
    if stands:
        g1.publish({STATE: b""})
    tap_reader = make()
    step_until(tap_reader, lambda: tap_reader.recording.is_recording)
    folder = ask(tap_reader, g1, "stop", but="start")
    assert [message.sequence for message in open_episode(folder).messages([keys.RECORD])] == [1, 2]


def test_a_hole_that_cuts_off_what_was_waiting_reaches_back_to_the_newest_write_in_the_file(
    make: Make, g1: Bus, bus_server: BusAddress, tmp_path: Path
) -> None:
    folder = killed_recorder(g1, bus_server, tmp_path)
    publish_blocks(g1)
    tap_reader = make()
    opened_ns = time.monotonic_ns()
    assert tap_reader.tap.is_catching_up
    tap_reader.step()
    overrun(bus_server)
    step_until(tap_reader, lambda: manifest_of(tap_reader).holes)
    ask(tap_reader, g1, "stop")
    (hole,) = load_manifest(folder).holes
    assert_begins_behind_the_newest_block(folder, hole)
    anchor = open_episode(folder).anchor
    assert anchor is not None
    assert hole.from_s < (opened_ns - anchor.mono_ns) * 1e-9, "all that waited was written before"
    assert "backlog is too small" in hole.reason


def test_a_hole_before_the_start_has_come_once_more_reaches_back_to_the_start(
    make: Make, g1: Bus, bus_server: BusAddress, tmp_path: Path
) -> None:
    folder = begun_recording(bus_server, tmp_path)
    for _ in range(BLOCKS):  # by one who does not say when
        g1.call("SET", "own", BLOCK)
    g1.publish({keys.RECORD: codec.json_object({"id": "start", "action": "start"})})
    tap_reader = make()
    assert tap_reader.tap.is_catching_up
    overrun(bus_server)
    step_until(tap_reader, lambda: manifest_of(tap_reader).holes)
    ask(tap_reader, g1, "stop", but="start")
    (hole,) = load_manifest(folder).holes
    assert hole.from_s == 0.0
    assert hole.to_s is not None
    assert hole.to_s >= STARTED_S


def test_a_tap_that_is_lost_at_the_end_leaves_a_hole_from_the_newest_write_that_came(
    make: Make, g1: Bus, bus_server: BusAddress
) -> None:
    tap_reader = make(preroll_s=0.0)
    folder = Path(ask(tap_reader, g1, "start"))
    publish_blocks(g1)
    admin = Connection(bus_server, timeout_s=5.0)
    assert admin.call("CLIENT", "KILL", "TYPE", "replica") == 1
    admin.close()
    tap_reader.drain()
    assert tap_reader.recording.close()
    (hole,) = load_manifest(folder).holes
    assert "lost while the recorder stopped" in hole.reason
    assert_begins_behind_the_newest_block(folder, hole)


def test_writes_that_the_tap_cannot_know_are_counted_across_a_kill_of_the_recorder_and_a_cut_of_its_link(
    make: Make, g1: Bus, bus_server: BusAddress, tmp_path: Path
) -> None:
    body = twist_keys.action_body()

    def write_in_part() -> None:
        g1.call("BITFIELD", body, "INCRBY", "u8", 0, 1)

    folder = killed_recorder(g1, bus_server, tmp_path, write_in_part)
    write_in_part()
    tap_reader = make()
    admin = Connection(bus_server, timeout_s=5.0)
    assert admin.call("CLIENT", "KILL", "TYPE", "replica") == 1
    admin.close()
    write_in_part()
    g1.call("SET", "x", "[1]")
    g1.call("COPY", "x", body, "REPLACE")
    ask(tap_reader, g1, "stop")
    recorder = load_manifest(folder).recorder
    assert (recorder.not_mirrored, recorder.not_mirrored_by) == (3, {f"BITFIELD {body}": 3})
    reader = open_episode(folder)
    assert [message.data for message in reader.messages([body])] == [b"[1]"], "what the tap can know is in the file"
    (reason,) = [reason for reason in check(reader).reasons if reason.rule == "not-mirrored"]
    assert reason.verdict == "reject"
    assert f"{body} by BITFIELD 3" in reason.text


def killed_recorder(g1: Bus, address: BusAddress, data: Path, meanwhile: Callable[[], None] = lambda: None) -> Path:
    """Have a recorder's process begin an episode and be killed in the middle of it; return the folder."""
    serve = [sys.executable, "-m", "station", "serve", "recorder", "--bus", address.url]
    settings = [word for value in (f"data={data}", "min_free_mb=0") for word in ("--set", value)]
    recorder = subprocess.Popen([*serve, *settings], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        wait_until(lambda: g1.get(keys.RECORDER) or recorder.poll() is not None)
        folder = Path(remote.ask(g1, "start", task="walk", timeout_s=60.0).path or "")
        meanwhile()
        g1.publish({"own": b"first"})
        written = offset(g1)
        wait_until(lambda: (point := load_resume_point(folder)) and point.position and point.position.offset >= written)
    finally:
        os.kill(recorder.pid, signal.SIGKILL)
        recorder.wait()
    wait_until(lambda: left_open(data) == [folder])
    return folder


def offset(g1: Bus) -> int:
    """Return how many bytes of its stream of writes the server has."""
    found = re.search(rb"master_repl_offset:(\d+)", g1.call("INFO", "replication"))
    assert found is not None
    return int(found[1])


def begun_recording(address: BusAddress, data: Path) -> Path:
    """Leave what a recorder leaves that was killed when the first manifest was written, and not one message."""
    folder = data / "walk" / "2026-11-21-g1-walk-0001"
    folder.mkdir(parents=True)
    tap, clock = open_tap(address), read_anchor()
    start_ns = clock.mono_ns - int(STARTED_S * 1e9)
    anchor = Anchor(wall_ns=clock.at(start_ns), mono_ns=start_ns, boot=clock.boot)
    Ledger(folder, folder.name, anchor, "start").record(tap.position(), None)
    tap.close()
    manifest = Manifest(episode_id=folder.name, timing=Timing(anchor=anchor))
    manifest.recorder.bus = str(address)
    save_manifest(manifest, folder)
    return folder


def publish_blocks(g1: Bus) -> None:
    for _ in range(BLOCKS):
        assert g1.publish({"own": BLOCK})


def overrun(address: BusAddress, meanwhile: Callable[[], object] = lambda: None) -> None:
    """Cut the recorder off and have the bus forget what it has not read, nor what is written meanwhile."""
    admin = Connection(address, timeout_s=5.0)
    admin.call("CONFIG", "SET", "repl-backlog-size", 16384)
    assert admin.call("CLIENT", "KILL", "TYPE", "replica") == 1
    meanwhile()
    admin.call("SET", "bulk", BLOCK)
    admin.close()


def step_until(tap_reader: TapReader, condition: Callable[[], object]) -> None:
    def holds() -> object:
        tap_reader.step()
        tap_reader.recording.poll()
        return condition()

    wait_until(holds)


def manifest_of(tap_reader: TapReader) -> Manifest:
    state = tap_reader.recording.state()
    assert state.path
    return load_manifest(Path(state.path))


def assert_begins_behind_the_newest_block(folder: Path, hole: Hole) -> None:
    """A hole is to begin where the newest stamped write was made that came before it, while blocks are missing."""
    reader = open_episode(folder)
    assert reader.anchor is not None
    assert hole.to_s is not None
    start_ns, end_ns = reader.anchor.wall_ns, reader.anchor.wall_ns + hole.to_s * 1e9
    stamped = [message for message in reader.messages() if message.channel.is_native and message.publish_ns < end_ns]
    blocks = [message for message in stamped if message.data == BLOCK]
    assert 0 < len(blocks) < BLOCKS
    newest_s = [(max(message.publish_ns for message in some) - start_ns) * 1e-9 for some in (blocks, stamped)]
    assert newest_s[0] - 1e-5 <= hole.from_s <= newest_s[1] + 1e-5
