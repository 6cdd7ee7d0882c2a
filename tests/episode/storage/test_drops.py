"""What was dropped stands in the file, in the manifest and beside a file that nobody finished, per key and exactly."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest

from adapters.robots.g1 import twist_keys
from station.bus.tap import Position, Write
from station.episode.quality.check import check
from station.episode.reading.reader import open_episode
from station.episode.reading.show import count_streams
from station.episode.recorder.options import RecordingOptions
from station.episode.recorder.resume import reopen, unfinished
from station.episode.recorder.writer import EpisodeWriter
from station.episode.storage import layout
from station.episode.storage.anchor import Anchor, read_anchor
from station.episode.storage.drops import DropPeriods, Drops
from station.episode.storage.manifest import Manifest, Task, Timing
from station.episode.storage.progress import WriterOptions, load_resume_point
from station.episode.writing.closing import close_manifest
from station.episode.writing.repair import repair
from tests.episode.writes import Native, foreign
from tests.waiting import wait_until

BODY = twist_keys.action_body()
BUS = "unix:///x"
IMAGE = bytes(100_000)
SMALL_QUEUE = WriterOptions(queue_bytes=1_000_000, flush_s=0.02)


def writer_in(folder: Path, options: WriterOptions = SMALL_QUEUE) -> tuple[EpisodeWriter, Manifest]:
    folder.mkdir(parents=True, exist_ok=True)
    anchor: Anchor = read_anchor()
    manifest = Manifest(episode_id=folder.name, task=Task(name="walk"), timing=Timing(anchor=anchor))
    manifest.recorder.bus, manifest.recorder.is_lossless = BUS, True
    return EpisodeWriter(folder, anchor=anchor, manifest=manifest, options=options, start_id="s"), manifest


def finish(writer: EpisodeWriter, manifest: Manifest) -> None:
    def closing(totals: object) -> Manifest:
        close_manifest(manifest, writer.anchor, totals)  # type: ignore[arg-type]
        return manifest

    writer.finish(closing)
    assert writer.wait(30.0)
    assert writer.state == "finished", writer.error


def burst(camera: Native, g1: Native, images: int) -> list[Write]:
    """Images with a command before each: more than a queue of 1 MB takes at once."""
    return [w for n in range(images) for w in (g1.write(BODY, b"[%d]" % n), camera.write("camera_left", IMAGE))]


def test_dropped_images_are_counted_per_key_in_file_and_manifest_and_are_not_called_lost(tmp_path: Path) -> None:
    writer, manifest = writer_in(tmp_path / "e")
    camera, g1 = Native("camera"), Native("g1")
    dropped = writer.put([*burst(camera, g1, 40), foreign("cloud", IMAGE), camera.write("camera_left", b"last")])
    finish(writer, manifest)
    reader = open_episode(tmp_path / "e")
    streams = {stream.key: stream for stream in reader.manifest.streams}
    assert 20 < dropped < 41
    assert reader.manifest.recorder.dropped == dropped == writer.dropped
    assert streams["camera_left"].count + streams["camera_left"].dropped == 41
    assert streams["camera_left"].lost == 0, "its numbers have a gap, and we know of every one"
    assert streams["camera_left"].dropped_bulky == streams["camera_left"].dropped
    assert (streams["cloud"].count, streams["cloud"].dropped, streams["cloud"].role) == (0, 1, "unknown")
    assert (streams[BODY].count, streams[BODY].lost, streams[BODY].dropped) == (40, 0, 0)
    (tmp_path / "e" / layout.MANIFEST).unlink()  # what follows is in the file alone
    in_file = open_episode(tmp_path / "e")
    assert in_file.drops().by_key(9) == {"camera_left": dropped - 1, "cloud": 1}
    assert in_file.drops().of("camera_left", camera.source) == (dropped - 1, dropped - 1)
    assert in_file.metadata()[layout.SUMMARY_RECORD]["dropped"] == str(dropped)
    assert {stream.key: stream.dropped for stream in count_streams(in_file)} == {
        BODY: 0,
        "camera_left": dropped - 1,
        "cloud": 1,
    }
    quality = check(in_file)
    (found,) = (stream for stream in quality.streams if stream.key == "camera_left")
    assert (found.lost, found.dropped) == (0, dropped - 1)
    said = {reason.rule: (reason.verdict, reason.text) for reason in quality.reasons}
    assert said["dropped-images"][0] == "usable"
    assert f"dropped {dropped} images" in said["dropped-images"][1]
    assert "lost" not in said


def test_a_dropped_signal_rejects_the_episode(tmp_path: Path) -> None:
    writer, manifest = writer_in(tmp_path / "e", WriterOptions(queue_writes=10))
    g1 = Native()
    writer.put([g1.write(BODY, b"[%d]" % n) for n in range(15)])
    finish(writer, manifest)
    quality = check(open_episode(tmp_path / "e"))
    (stream,) = quality.streams
    assert (stream.count, stream.dropped, stream.dropped_bulky, stream.lost) == (10, 5, 0, 0)
    assert {reason.rule: reason.verdict for reason in quality.reasons}["dropped"] == "reject"


def test_what_the_writer_lost_itself_stays_lost_beside_what_we_dropped(tmp_path: Path) -> None:
    writer, manifest = writer_in(tmp_path / "e")
    camera, g1 = Native("camera"), Native("g1")
    camera.write("camera_left", b"1")
    writes = [camera.write("camera_left", b"first")]
    for _ in range(7):
        camera.skip("camera_left")
    dropped = writer.put([*writes, *burst(camera, g1, 30), camera.write("camera_left", b"last")])
    finish(writer, manifest)
    (stream,) = (found for found in open_episode(tmp_path / "e").manifest.streams if found.key == "camera_left")
    assert (stream.lost, stream.dropped) == (7, dropped)


@pytest.mark.usefixtures("processes")
@pytest.mark.parametrize("is_exact", [True, False])
def test_after_a_kill_the_counts_go_on(tmp_path: Path, *, is_exact: bool) -> None:
    folder = tmp_path / "walk" / "2026-11-21-g1-walk-0001"
    camera, g1 = Native("camera"), Native("g1")
    before, after = burst(camera, g1, 30), burst(camera, g1, 30)
    if not (child := os.fork()):
        writer, _ = writer_in(folder)
        writer.put(before, position=Position("id", 7, 0))
        wait_until(lambda: (point := load_resume_point(folder)) is not None and point.drops)
        os.kill(os.getpid(), signal.SIGKILL)
    os.waitpid(child, 0)
    found = unfinished(folder, BUS)
    assert found is not None
    first = Drops(found.point.drops)
    assert found.point.dropped == first.total > 10
    options = RecordingOptions(data=tmp_path, writer=SMALL_QUEUE)
    taken = reopen(found, options, place=found.point.position, is_exact=is_exact)
    second = taken.take.writer.put(after)
    assert taken.take.writer.dropped == first.total + second
    finish(taken.take.writer, taken.take.manifest)
    reader = open_episode(folder)
    streams = {stream.key: stream for stream in reader.manifest.streams}
    assert (streams["camera_left"].dropped, streams["camera_left"].lost) == (first.total + second, 0)
    assert streams["camera_left"].count + streams["camera_left"].dropped == 60
    assert reader.drops().total == reader.manifest.recorder.dropped == first.total + second


@pytest.mark.parametrize("has_resume_point", [True, False])
def test_a_repair_keeps_the_counts(tmp_path: Path, *, has_resume_point: bool) -> None:
    folder = tmp_path / "e"
    writer, manifest = writer_in(folder)
    dropped = writer.put(burst(Native("camera"), Native("g1"), 30))
    wait_until(lambda: (point := load_resume_point(folder)) is not None and point.drops)
    torn = (folder / layout.ACTIVE).read_bytes()
    point = (folder / layout.RESUME).read_bytes()
    said = (folder / layout.MANIFEST).read_bytes()
    finish(writer, manifest)
    (folder / layout.SIGNALS).unlink()
    (folder / layout.ACTIVE).write_bytes(torn)
    (folder / layout.MANIFEST).write_bytes(said)
    if has_resume_point:
        (folder / layout.RESUME).write_bytes(point)
    assert repair(folder).state == "repaired"
    reader = open_episode(folder)
    (stream,) = (found for found in reader.manifest.streams if found.key == "camera_left")
    assert stream.dropped == reader.manifest.recorder.dropped == reader.drops().total == dropped


def test_that_writes_are_dropped_is_said_when_it_begins_and_when_it_has_ended() -> None:
    spell, said, image = DropPeriods("images-dropped", "warning"), [], Write("camera_left", IMAGE, None, 0)
    for tenth in range(100):
        drops = Drops()
        if 10 <= tenth < 50:
            drops.count(image, is_bulky=True)
        spell.add(drops, tenth / 10)
        said += [(tenth, name, numbers) for name, _, numbers in spell.poll(tenth / 10)]
    assert [(at, name) for at, name, _ in said] == [(10, "images-dropped"), (70, "images-dropped")]
    assert said[0][2] == {"dropped": 1, "keys": {"camera_left": 1}}
    assert said[1][2] == {"ended": True, "seconds": 3.9, "dropped": 40, "keys": {"camera_left": 40}}


def test_a_value_larger_than_the_queue_costs_itself_and_none_of_its_neighbours(tmp_path: Path) -> None:
    writer, manifest = writer_in(tmp_path / "e")
    g1 = Native()
    around = [g1.write(BODY, b"[1]"), foreign("huge", bytes(3_000_000)), g1.write(BODY, b"[2]")]
    assert writer.put(around) == 1
    finish(writer, manifest)
    reader = open_episode(tmp_path / "e")
    assert [message.data for message in reader.messages()] == [b"[1]", b"[2]"]
    assert reader.drops().by_key(9) == {"huge": 1}


def test_keys_beyond_the_most_that_a_file_takes_are_refused_counted_and_told_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("station.episode.writing.file.MAX_CHANNELS", 5)
    writer, manifest = writer_in(tmp_path / "e")
    writer.put([foreign(f"key{n}", b"1") for n in range(9)])
    wait_until(lambda: writer.messages == 5)
    wait_until(lambda: (point := load_resume_point(tmp_path / "e")) is not None and point.drops)
    ((name, severity, numbers),) = writer.news()
    assert (name, severity, numbers["dropped"]) == ("keys-refused", "error", 4)
    assert not list(writer.news())
    finish(writer, manifest)
    assert open_episode(tmp_path / "e").drops().by_key(9) == {f"key{n}": 1 for n in range(5, 9)}
