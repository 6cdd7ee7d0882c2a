from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from itertools import count
from pathlib import Path
from typing import Any

import msgspec
import pytest
from mcap.reader import make_reader

from adapters.robots.g1 import twist_keys
from station.bus import keys
from station.bus.clocks import Offset
from station.bus.stamp import Stamp
from station.bus.tap import Position, Write
from station.contract import Contract
from station.episode.reading import frames
from station.episode.reading.reader import open_episode
from station.episode.recorder.writer import EpisodeWriter
from station.episode.storage.anchor import Anchor, read_anchor
from station.episode.storage.manifest import Manifest, Task, load_manifest
from station.episode.storage.progress import Totals, WriterOptions, load_resume_point
from station.episode.storage.records import MAGIC
from station.episode.writing import file as episode_file
from station.export.tracks import shares_clock
from tests.episode.writes import Native, foreign
from tests.export.pictured import jpeg
from tests.waiting import wait_until

BODY = twist_keys.action_body()
CAMERA = keys.camera_image("head")
CLOSING = (("sync", False), ("sync", True), ("rename", True))  # what is done, and whether the file has its end by then
ANCHOR = Anchor(wall_ns=1_795_000_000_000_000_000, mono_ns=time.monotonic_ns(), boot=read_anchor().boot)


def writer_in(folder: Path, **options: Any) -> EpisodeWriter:
    manifest = Manifest(episode_id=folder.name, task=Task(name="walk"))
    return EpisodeWriter(folder, anchor=ANCHOR, manifest=manifest, options=WriterOptions(**options))


def closed(writer: EpisodeWriter) -> Totals:
    totals: list[Totals] = []

    def closing(found: Totals) -> Manifest:
        totals.append(found)
        return Manifest(episode_id=writer.folder.name, state="finished", streams=found.streams)

    writer.finish(closing)
    assert writer.wait(30.0)
    assert writer.state == "finished", writer.error
    return totals[0]


def test_every_byte_every_number_and_every_stamp_is_in_the_file(tmp_path: Path) -> None:
    g1, binary = Native(), bytes(range(256)) * 240
    writes = [g1.write(BODY, json.dumps([n, 0.5]).encode(), capture_ns=n) for n in range(500)]
    writes += [g1.write(keys.robot_state("g1"), binary), foreign(BODY, b"[7]"), foreign("unknown\xff", b"\x00\xff")]
    writer = writer_in(tmp_path)
    writer.put(writes)
    totals = closed(writer)
    reader = open_episode(tmp_path)
    messages = list(reader.messages(stamps=True))
    assert [(m.topic, m.data) for m in messages] == [(w.key, w.value) for w in writes]
    assert [m.stamp for m in messages] == [w.stamp for w in writes]
    assert [m.sequence for m in messages] == [*range(1, 501), 1, 1, 1]
    assert totals.messages == 503
    assert totals.dropped == 0
    assert reader.torn is None
    assert not reader.is_active


def test_times_hang_on_the_anchor_of_the_episode(tmp_path: Path) -> None:
    g1 = Native()
    native = g1.write(BODY, b"[1]", written_ns=ANCHOR.mono_ns + 5_000_000)
    elsewhere = Stamp(9, 123, ANCHOR.wall_ns + 77, "pico.1.00000000.beef").encode()
    other_boot = Write(BODY, b"[2]", elsewhere, ANCHOR.mono_ns + 6_000_000)
    plain = Write("plain", b"1", None, ANCHOR.mono_ns - 2_000_000)
    writer = writer_in(tmp_path)
    writer.put([native, other_boot, plain])
    closed(writer)
    times = [(m.log_ns - ANCHOR.wall_ns, m.publish_ns - ANCHOR.wall_ns) for m in open_episode(tmp_path).messages()]
    assert times == [(5_100_000, 5_000_000), (6_000_000, 6_000_000), (-2_000_000, -2_000_000)], (
        "of another machine whose clock is not known, and of a writer without a stamp, the arrival"
    )


def test_times_of_another_machine_whose_clock_is_known_are_on_the_episodes_clock(tmp_path: Path) -> None:
    far = "00c0ffee"
    offsets = {far: Offset(ANCHOR.mono_ns - 1_000_000_000, 2_000_000)}

    def write(written_ns: int, arrived_ns: int, key: str = BODY) -> Write:
        mark = Stamp(arrived_ns, 1_000_000_000 + written_ns, 77, f"pico.1.{far}.beef", 1_000_000_000 + written_ns - 9)
        value = b"[2]" if key == BODY else jpeg(1)
        return Write(key, value, mark.encode(), ANCHOR.mono_ns + arrived_ns)

    writer = writer_in(tmp_path, offset_of=offsets.get)
    writer.put([
        write(5_000_000, 9_000_000), write(10_000_000, 12_000_000), write(14_500_000, 14_000_000),
        write(20_000_000, 26_000_000, CAMERA),
    ])  # fmt: skip
    closed(writer)
    reader = open_episode(tmp_path)
    found = list(reader.messages(stamps=True))
    assert [m.publish_ns - ANCHOR.wall_ns for m in found] == [5_000_000, 10_000_000, 14_000_000, 20_000_000]
    assert [m.log_ns - ANCHOR.wall_ns for m in found] == [9_000_000, 12_000_000, 14_000_000, 26_000_000]
    assert all(shares_clock(m.channel, ANCHOR.boot) for m in found), "an export goes by when they were written"
    assert frames.captured_ns(found[-1]) - ANCHOR.wall_ns == 20_000_000 - 9


def test_all_values_of_one_write_have_one_instant_whatever_is_learnt_of_a_clock_meanwhile(tmp_path: Path) -> None:
    far, told = "00c0ffee", count()

    def offset_of(boot: str) -> Offset | None:
        return Offset(ANCHOR.mono_ns - 1_000_000_000 + next(told), 2_000_000) if boot == far else None

    def write(key: str, sequence: int) -> Write:
        mark = Stamp(sequence, 1_000_000_000 + sequence * 1000, 77, f"g1.1.{far}.beef")
        return Write(key, jpeg(1) if key == CAMERA else b"[2]", mark.encode(), ANCHOR.mono_ns + 9_000_000)

    writer = writer_in(tmp_path, offset_of=offset_of)
    writer.put([write(key, sequence) for sequence in (1, 2) for key in (BODY, "other", CAMERA)])
    closed(writer)
    instants = [m.publish_ns - ANCHOR.wall_ns for m in open_episode(tmp_path).messages()]
    assert sorted(instants) == [1000] * 3 + [2001] * 3


@pytest.mark.usefixtures("processes")
def test_the_library_and_rerun_read_the_file_and_channels_tell_contract_and_writer(tmp_path: Path) -> None:
    g1 = Native()
    writer = writer_in(tmp_path)
    writer.put(
        [g1.write(BODY, b"[1, 2]"), foreign(BODY, b"[3]"), foreign("mystery", b"\x80"), foreign("mystery", None)]
    )
    closed(writer)
    with (tmp_path / "signals.mcap").open("rb") as file:
        reader = make_reader(file)
        summary = reader.get_summary()
        found = {
            (c.topic, c.message_encoding, c.metadata["writer"], c.metadata["source"]): c.metadata["contract"]
            for c in summary.channels.values()
        }
        assert reader.get_header().profile == "teleop-station"
        assert sum(1 for _ in reader.iter_messages(topics=[BODY])) == 2
        assert {record.name for record in reader.iter_metadata()} == {
            "station.anchor", "station.episode", "station.summary",
        }  # fmt: skip
        assert [attachment.name for attachment in reader.iter_attachments()] == [
            "manifest.start.yaml", "manifest.yaml",
        ]  # fmt: skip
    assert msgspec.json.decode(found[BODY, "json", "g1", g1.source], type=Contract).key == BODY
    assert found[BODY, "json", "foreign", ""] == found[BODY, "json", "g1", g1.source]
    assert found["mystery", "application/octet-stream", "foreign", ""] == "none"
    assert found["mystery", "application/x-deleted", "foreign", ""] == "none"
    checked = subprocess.run(
        [Path(sys.executable).with_name("rerun"), "mcap", "check", tmp_path / "signals.mcap"],
        capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    assert checked.returncode == 0, checked.stdout + checked.stderr


def test_gaps_in_sequence_numbers_count_as_lost(tmp_path: Path) -> None:
    g1 = Native()
    writes = [g1.write(BODY, b"[0]")]
    for missing in (1, 2):
        for _ in range(missing):
            g1.skip(BODY)
        writes.append(g1.write(BODY, b"[0]"))
    writer = writer_in(tmp_path)
    writer.put([*writes, writes[-1]])
    (stream,) = closed(writer).streams
    assert (stream.count, stream.lost, stream.repeated) == (4, 3, 1)


def test_what_only_looks_like_a_stamp_is_kept_beside_the_value(tmp_path: Path) -> None:
    writer = writer_in(tmp_path)
    odd = [b"1 2", b"1 2 3 a.1.b.c\n5 6 7 b.1.b.c", b"-1 99999999999999999999999 3 x.1.b.c", b"x y z w"]
    writer.put([Write("k", b"v%d" % n, stamp, time.monotonic_ns()) for n, stamp in enumerate(odd)])
    closed(writer)
    found = open_episode(tmp_path).collect(["k", "k@"])
    assert [m.data for m in found["k"]] == [b"v0", b"v1", b"v2", b"v3"]
    kept = {m.data for m in found["k@"]}
    assert {odd[0], odd[1], odd[3]} <= kept


def test_the_place_of_the_tap_is_saved_with_every_flush_and_gone_at_the_end(tmp_path: Path) -> None:
    writer = writer_in(tmp_path, flush_s=0.02)
    writer.put([foreign("a", b"1")], position=Position("id", 100, 0))
    wait_until(lambda: load_resume_point(tmp_path) is not None)
    writer.put([foreign("a", b"2")], position=Position("id", 250, 0))
    wait_until(lambda: (point := load_resume_point(tmp_path)) is not None and point.position == Position("id", 250, 0))
    point = load_resume_point(tmp_path)
    assert point is not None
    assert (point.messages, point.size) == (2, (tmp_path / "signals.mcap.active").stat().st_size)
    closed(writer)
    assert load_resume_point(tmp_path) is None


def test_a_full_queue_drops_and_counts(tmp_path: Path) -> None:
    writer = writer_in(tmp_path, queue_writes=10)
    assert writer.put([foreign("a", b"1")] * 11) == 1
    totals = closed(writer)
    assert (totals.messages, totals.dropped, totals.streams[0].dropped) == (10, 1, 1)
    assert writer.put([foreign("a", b"1")]) == 1


def test_a_folder_that_vanishes_makes_the_writer_fail_with_a_reason_and_no_exception(tmp_path: Path) -> None:
    folder = tmp_path / "episode"
    folder.mkdir()
    writer = writer_in(folder, flush_s=0.01)
    writer.put([foreign("a", b"1")])
    wait_until(lambda: writer.state == "open")
    for file in folder.iterdir():
        file.unlink()
    folder.rmdir()
    writer.put([foreign("a", b"2")])
    assert writer.wait(30.0)
    assert writer.state == "failed"
    assert "No such file" in writer.error
    assert "\n" not in writer.error
    assert writer.put([foreign("a", b"3")]) == 1
    assert writer.dropped >= 1


FULL_DISK = """
import resource, signal, sys, time
from pathlib import Path
from station.episode.storage.records import MAGIC
from station.episode.writing import file as episode_file
from station.export.tracks import shares_clock
from station.episode.storage.anchor import read_anchor
from station.episode.storage.manifest import Manifest
from station.episode.storage.progress import WriterOptions
from station.episode.recorder.writer import EpisodeWriter
from station.bus.tap import Write
import os
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (60_000, 60_000))
writer = EpisodeWriter(Path(sys.argv[1]), anchor=read_anchor(), manifest=Manifest(episode_id="e"),
                       options=WriterOptions(flush_s=0.01))
put = 0
while writer.state in ("opening", "open"):
    now_ns = time.monotonic_ns()
    writer.put([Write("small", b"%d" % put, None, now_ns), Write(sys.argv[2], os.urandom(5000), None, now_ns)])
    put += 2
    while writer.state == "opening":  # the first flush is safe before the disk can be full
        time.sleep(0.001)
    time.sleep(0.005)
writer.wait(10.0)
print(writer.state, put - writer.dropped, writer.error)
"""


@pytest.mark.parametrize("key", ["large", keys.camera_image("head")])
@pytest.mark.usefixtures("processes")
def test_a_full_disk_ends_the_episode_and_keeps_every_whole_flush_of_each_file(tmp_path: Path, key: str) -> None:
    result = subprocess.run(
        [sys.executable, "-c", FULL_DISK, str(tmp_path), key], capture_output=True, text=True, timeout=60, check=True
    )
    state, kept, *reason = result.stdout.split()
    assert state == "failed"
    assert "File too large" in " ".join(reason)
    reader = open_episode(tmp_path)
    assert reader.is_active
    found = reader.collect(["small", key])
    assert len(found["small"]) + len(found[key]) == int(kept) > 0
    assert [int(m.data) for m in found["small"]] == list(range(0, 2 * len(found["small"]), 2))
    is_apart = key != "large"
    assert (len(found["small"]) > len(found[key])) is is_apart, "a flush of pictures that fails costs no signal"
    assert load_manifest(tmp_path).state == "failed"


def test_a_disk_that_is_full_from_the_start_leaves_nothing_behind(tmp_path: Path) -> None:
    folder = tmp_path / "episode"
    folder.mkdir()
    (folder / "manifest.yaml").mkdir()  # stands for whatever makes the first write impossible
    writer = writer_in(folder)
    assert writer.wait(30.0)
    assert writer.state == "failed"
    assert os.listdir(folder) == ["manifest.yaml"]


def test_a_client_that_invents_keys_does_not_break_the_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(episode_file, "MAX_CHANNELS", 5)
    writer = writer_in(tmp_path)
    writer.put([foreign(f"key{n}", b"1") for n in range(9)])
    totals = closed(writer)
    assert (totals.messages, totals.dropped) == (5, 4)
    assert len(open_episode(tmp_path).topics()) == 5


@pytest.mark.parametrize("is_dropping", [False, True])
def test_closing_waits_for_the_messages_of_each_file_then_for_its_end_and_then_names_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, is_dropping: bool
) -> None:
    seen: list[tuple[str, str, bool]] = []

    def look(what: str, file: Path) -> None:
        seen.append((what, file.name.removesuffix(".active"), file.read_bytes().endswith(MAGIC)))

    def fdatasync(descriptor: int) -> None:
        look("sync", Path(os.readlink(f"/proc/self/fd/{descriptor}")))

    sound = os.rename
    g1, writer = Native(), writer_in(tmp_path, flush_s=60.0, queue_writes=3 if is_dropping else 100)
    writer.put([g1.write(BODY, b"[1]"), g1.write(CAMERA, b"\xff\xd8")])
    wait_until(lambda: writer.state == "open" and writer.size > 0 and writer.queued == 0)
    with monkeypatch.context() as patch:
        patch.setattr(os, "fdatasync", fdatasync)
        patch.setattr(os, "rename", lambda file, target: (look("rename", Path(file)), sound(file, target)))
        writer.put([g1.write(BODY, b"[2]"), *[g1.write(CAMERA, b"\xff\xd8") for _ in range(5)]])
        totals = closed(writer)
    assert (totals.dropped > 0) == is_dropping
    both = ("cameras.mcap", "signals.mcap")
    assert seen == [(what, name, has_end) for what, has_end in CLOSING for name in both]
