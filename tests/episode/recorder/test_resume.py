"""Taking an episode up again, without bus or processes: what is on disk is all that a new recorder has."""

from __future__ import annotations

import os
import random
import signal
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import msgspec
import pytest

from adapters.robots.g1 import twist_keys
from station.bus import stamp as stamps
from station.bus.clocks import Offset, unknown
from station.bus.stamp import Stamp
from station.bus.tap import Position, Write
from station.episode.reading.reader import open_episode
from station.episode.recorder.options import RecordingOptions
from station.episode.recorder.resume import as_written, newest_written_ns, reopen, unfinished
from station.episode.recorder.writer import EpisodeWriter
from station.episode.storage import layout
from station.episode.storage.anchor import Anchor, read_anchor
from station.episode.storage.left_open import left_open
from station.episode.storage.manifest import Manifest, Task, Timing
from station.episode.storage.progress import WriterOptions, load_resume_point
from station.episode.writing.checkpoint import EVERY_S, load_checkpoint, save_checkpoints
from station.episode.writing.file import EpisodeFile
from tests.episode.writes import Native, foreign
from tests.waiting import wait_until

BODY = twist_keys.action_body()
BUS = "unix:///x"


def written(g1: Native, count: int) -> list[Write]:
    """Writes of every kind that a file tells apart."""
    found: list[Write] = []
    for n in range(count):
        found += [g1.write(BODY, b"[%d]" % n), foreign("stock", b"%d" % n), g1.write("odd\udcff", b"\xff")]
        if n % 10 == 0:
            found += [foreign("stock", None), g1.event("fall", n=n), g1.request("mark", f"m{n}", label=f"at {n}")]
        if n % 17 == 0:
            g1.skip(BODY)
    return found


def killed(folder: Path, writes: list[Write], servers: Mapping[str, Any] | None = None, **options: float) -> None:
    """Have a process write an episode in flushes and be killed in the middle of it."""
    folder.mkdir(parents=True)
    child = os.fork()
    if child:
        os.waitpid(child, 0)
        return
    clock, start_ns = read_anchor(), writes[0].mono_ns - 1_000_000_000
    anchor = Anchor(wall_ns=clock.at(start_ns), mono_ns=start_ns, boot=clock.boot)
    manifest = Manifest(episode_id=folder.name, task=Task(name="walk"), timing=Timing(anchor=anchor))
    manifest.recorder.bus, manifest.servers = BUS, dict(servers or {})
    writer = EpisodeWriter(
        folder, anchor=anchor, manifest=manifest, start_id="start",
        options=WriterOptions(flush_bytes=1, **options),  # type: ignore[arg-type]
    )  # fmt: skip
    for n in range(0, len(writes), 10):
        writer.put(writes[n : n + 10], position=Position("id", n + 10, 0))
        wait_until(lambda n=n: writer.messages >= min(n + 10, len(writes)))  # type: ignore[misc]
    wait_until(lambda: (point := load_resume_point(folder)) is not None and point.messages == len(writes))
    os.kill(os.getpid(), signal.SIGKILL)


@pytest.fixture
def data(tmp_path: Path) -> Path:
    return tmp_path / "data"


def finish(take_writer: EpisodeWriter) -> None:
    take_writer.finish(lambda totals: Manifest(episode_id="e", state="finished", streams=totals.streams))
    assert take_writer.wait(30.0)
    assert take_writer.state == "finished", take_writer.error


@pytest.mark.usefixtures("processes")
def test_what_goes_on_behind_the_last_flush_is_one_episode(data: Path) -> None:
    g1 = Native()
    writes, later = written(g1, 40), written(g1, 15)
    folder = data / "walk" / "2026-11-21-g1-walk-0001"
    killed(folder, writes)
    with (folder / layout.ACTIVE).open("ab") as file:
        file.write(b"half a flush")
    assert left_open(data) == [folder]
    found = unfinished(folder, BUS)
    assert found is not None
    assert found.point.position == Position("id", (len(writes) + 9) // 10 * 10, 0)
    taken = reopen(found, RecordingOptions(data=data), place=found.point.position, is_exact=True)
    manifest = taken.take.manifest
    assert taken.requests == [*(f"m{n}" for n in range(0, 40, 10)), "start"]
    assert [mark.label for mark in manifest.marks] == [f"at {n}" for n in range(0, 40, 10)]
    assert (manifest.quality_flags.falls, len(manifest.events), manifest.recorder.restarts) == (4, 4, 1)
    assert manifest.recovery[0]["read_again_bytes"] == len(b"half a flush")
    assert left_open(data) == [], "it is being written again"
    taken.take.writer.put(later, position=Position("id", 10_000, 0))
    finish(taken.take.writer)
    reader = open_episode(folder)
    messages = list(reader.messages(stamps=True))
    assert [(m.data, m.stamp) for m in messages] == [(w.value or b"", w.stamp) for w in [*writes, *later]]
    assert [m.sequence for m in messages if m.topic == "stock" and not m.channel.is_deletion] == list(range(1, 56))
    body = next(stream for stream in reader.manifest.streams if stream.key == BODY)
    assert (body.count, body.lost, body.repeated) == (55, 4, 0)
    assert sorted(file.name for file in folder.iterdir()) == [layout.MANIFEST, layout.SIGNALS]


@pytest.mark.usefixtures("processes")
def test_without_the_server_every_whole_chunk_is_kept_and_the_hole_is_written(data: Path) -> None:
    g1 = Native()
    writes = written(g1, 20)
    folder = data / "walk" / "e"
    killed(folder, writes)
    point = load_resume_point(folder)
    assert point is not None
    earlier = msgspec.structs.replace(point, size=point.size // 2, messages=point.messages // 2)
    (folder / layout.RESUME).write_bytes(msgspec.json.encode(earlier))  # as if killed before it was written again
    found = unfinished(folder, BUS)
    assert found is not None
    taken = reopen(found, RecordingOptions(data=data), place=Position("other", 5, 0), is_exact=False)
    (hole,) = taken.take.manifest.holes
    assert hole.to_s is not None
    assert hole.from_s < hole.to_s
    taken.take.writer.save_manifest(taken.take.manifest)
    finish(taken.take.writer)
    assert len(list(open_episode(folder).messages())) == len(writes)


@pytest.mark.usefixtures("processes")
@pytest.mark.parametrize("seed", range(3))
def test_a_checkpoint_tells_the_same_as_the_file(data: Path, seed: int) -> None:
    g1 = Native()
    writes = written(g1, 60)
    folder = data / "walk" / "e"
    killed(folder, writes)
    active, point = folder / layout.ACTIVE, load_resume_point(folder)
    assert point is not None
    copy = data / "copy"
    chunks = open_episode(folder).parts[0].contents.chunks
    place = random.Random(seed).choice(chunks)
    copy.write_bytes(active.read_bytes()[: place.offset - 9])
    half = EpisodeFile.reopen(copy, point.anchor)
    checkpoint = half.checkpoint()
    half.close()
    assert checkpoint is not None
    save_checkpoints({layout.SIGNALS: checkpoint}, folder)
    loaded = load_checkpoint(folder, layout.SIGNALS, point.size)
    assert loaded == checkpoint
    assert load_checkpoint(folder, layout.SIGNALS, checkpoint.size - 1) is None
    quick = EpisodeFile.reopen(active, point.anchor, size=point.size, checkpoint=loaded)
    found = (quick.messages, quick.gaps, quick.episode_summary.told, quick.checkpoint())
    quick.close()
    whole = EpisodeFile.reopen(active, point.anchor, size=point.size)
    assert found == (whole.messages, whole.gaps, whole.episode_summary.told, whole.checkpoint())
    whole.close()


def test_a_checkpoint_is_saved_now_and_then(data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = data / "walk" / "e"
    folder.mkdir(parents=True)
    assert EVERY_S <= 10.0
    monkeypatch.setattr("station.episode.recorder.writer.EVERY_S", 0.0)
    writer = EpisodeWriter(folder, anchor=read_anchor(), manifest=Manifest(episode_id="e"))
    writer.put(written(Native(), 3))
    wait_until((folder / layout.CHECKPOINT).exists)
    finish(writer)
    assert not (folder / layout.CHECKPOINT).exists()


def spoilt(change: Callable[[Path], object], folder: Path) -> bool:
    """Whether a changed episode may still be taken up."""
    change(folder)
    return unfinished(folder, BUS) is not None


@pytest.mark.parametrize(
    ("change", "may"),
    [
        (lambda folder: None, True),
        (lambda folder: (folder / layout.RESUME).unlink(), False),
        (lambda folder: (folder / layout.RESUME).write_bytes(b"{"), False),
        (lambda folder: (folder / layout.MANIFEST).unlink(), True),  # there is one at the head of the signals
        (lambda folder: _replace(folder / layout.MANIFEST, "state: recording", "state: failed"), False),
        (lambda folder: _replace(folder / layout.MANIFEST, BUS, "unix:///elsewhere"), False),
        (lambda folder: _replace(folder / layout.RESUME, read_anchor().boot, "00000000"), False),
    ],
)
@pytest.mark.usefixtures("processes")
def test_only_what_fits_this_boot_and_bus_is_taken_up(data: Path, change: Callable[[Path], object], may: bool) -> None:
    folder = data / "walk" / "e"
    killed(folder, written(Native(), 2))
    assert spoilt(change, folder) is may


def _replace(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))


def test_writes_that_waited_get_the_time_at_which_they_were_written() -> None:
    g1, now = Native(), time.monotonic_ns()
    late = now + 2_000_000_000
    writes = [
        Write("stock", b"1", None, late),
        g1.write(BODY, b"1", written_ns=now)._replace(mono_ns=late),
        Write("stock", b"2", None, late),
        g1.write(BODY, b"2", written_ns=now + 1000)._replace(mono_ns=late),
        Write(BODY, b"3", b"9 1 1 far.1.00000000.beef", late),
    ]
    assert [write.mono_ns - now for write in as_written(writes, 0, unknown)] == [0, 0, 0, 1000, 1000]
    assert [write.mono_ns - now for write in as_written(writes, now + 500, unknown)] == [500, 500, 500, 1000, 1000]
    assert as_written([writes[0]], 0, unknown) == [writes[0]], "nothing tells its time"
    ahead = g1.write(BODY, b"1", written_ns=late + 10**12)._replace(mono_ns=late)
    assert as_written([ahead], now, unknown)[0].mono_ns == late, "a clock that runs ahead is not followed"


def test_writes_of_another_machine_that_waited_get_their_time_where_its_clock_is_known() -> None:
    now, far = time.monotonic_ns(), "00c0ffee"
    writes = [
        Write(BODY, b"1", Stamp(number, 5_000 + number * 20, 1, f"g1.1.{far}.beef").encode(), now + 2_000_000_000)
        for number in range(3)
    ]
    told = as_written(writes, now, {far: Offset(now - 5_000, 100)}.get)
    assert [write.mono_ns - now for write in told] == [0, 20, 40]
    assert [write.mono_ns - now for write in as_written(writes, now, unknown)] == [0, 0, 0]


def test_the_newest_of_our_own_writes_tells_up_to_when_all_is_known() -> None:
    g1, other = Native(), Native()
    other.source = "g1.1.00000000.ab"
    theirs = [other.write(BODY, b"", written_ns=n) for n in (10**15, 10**15 + 1)]
    writes = [g1.write(BODY, b"", written_ns=5), g1.write(BODY, b"", written_ns=7), *theirs, foreign("stock", b"1")]
    odd = Write("odd", b"", f"no number .{stamps.boot_id()}. at all".encode(), 9)
    assert newest_written_ns([*writes, odd]) == 7
    assert newest_written_ns(theirs) == newest_written_ns([]) == 0
