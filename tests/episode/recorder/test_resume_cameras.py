"""Taking an episode of two files up again: each goes on behind what was safe of it, and neither gets ahead."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import msgspec
import pytest

from station.bus.tap import Position, Write
from station.episode.reading.reader import open_episode
from station.episode.recorder.options import RecordingOptions
from station.episode.recorder.resume import reopen, unfinished
from station.episode.recorder.writer import EpisodeWriter
from station.episode.storage import layout
from station.episode.storage.left_open import left_open
from station.episode.storage.manifest import Manifest, Timing
from station.episode.storage.progress import WriterOptions, load_resume_point
from station.episode.writing.checkpoint import load_checkpoint, save_checkpoints
from station.episode.writing.file import EpisodeFile
from tests.episode.filming import BODY, HEAD, Scene
from tests.waiting import DEADLINE_S, wait_until

BUS = "unix:///x"


def killed(folder: Path, scene: Scene, batches: list[list[Write]]) -> None:
    """Have a process write an episode, a flush for each batch, and be killed right behind the last of them."""
    folder.mkdir(parents=True)
    if child := os.fork():
        os.waitpid(child, 0)
        return
    manifest = Manifest(episode_id=folder.name, timing=Timing(anchor=scene.anchor))
    manifest.recorder.bus = BUS
    writer = EpisodeWriter(
        folder, anchor=scene.anchor, manifest=manifest, start_id="s", options=WriterOptions(flush_bytes=1)
    )
    written = 0
    for batch in batches:
        written += len(batch)
        writer.put(batch, position=Position("id", written, 0))
        wait_until(
            lambda n=written: (point := load_resume_point(folder)) is not None and point.messages == n  # type: ignore[misc]
        )
    os.kill(os.getpid(), signal.SIGKILL)


def go_on(folder: Path, later: list[Write], *, is_exact: bool) -> None:
    """Take an episode up, write more, and close it."""
    found = unfinished(folder, BUS)
    assert found is not None
    taken = reopen(found, RecordingOptions(data=folder.parent), place=found.point.position, is_exact=is_exact)
    assert left_open(folder.parent.parent) == []
    taken.take.writer.put(later, position=Position("id", 10_000, 0))
    taken.take.finish("stop", later[-1].mono_ns)
    assert taken.take.writer.wait(DEADLINE_S)
    assert taken.take.writer.state == "finished", taken.take.writer.error


def scenes(scene: Scene, count: int) -> list[list[Write]]:
    return [[*scene.signals(5), scene.picture(), *scene.signals(1), scene.picture()] for _ in range(count)]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return tmp_path / "walk" / "2026-11-21-g1-walk-0001"


@pytest.mark.usefixtures("processes")
@pytest.mark.parametrize("has_checkpoint", [True, False])
def test_both_files_go_on_behind_what_was_safe(folder: Path, has_checkpoint: bool) -> None:
    scene = Scene()
    batches = scenes(scene, 6)
    killed(folder, scene, batches)
    for name in (layout.ACTIVE, layout.CAMERAS_ACTIVE):
        with (folder / name).open("ab") as file:
            file.write(b"half a flush")
    point = load_resume_point(folder)
    assert point is not None
    assert point.cameras_size + 12 == (folder / layout.CAMERAS_ACTIVE).stat().st_size
    if has_checkpoint:
        known = {}
        for names, size in ((layout.SIGNALS_NAMES, point.size), (layout.CAMERAS_NAMES, point.cameras_size)):
            opened = EpisodeFile.reopen(folder / names.active, scene.anchor, size=size, names=names)
            checkpoint = opened.checkpoint()
            opened.close()
            assert checkpoint is not None
            known[names.final] = checkpoint
        save_checkpoints(known, folder)
        assert load_checkpoint(folder, layout.CAMERAS, point.cameras_size) == known[layout.CAMERAS]
        assert load_checkpoint(folder, layout.CAMERAS, point.cameras_size - 1) is None
    later = scenes(scene, 2)
    go_on(folder, [write for batch in later for write in batch], is_exact=True)
    reader = open_episode(folder)
    writes = [write for batch in (*batches, *later) for write in batch]
    assert [(m.data, m.stamp) for m in reader.messages(stamps=True)] == [(w.value, w.stamp) for w in writes]
    assert {s.key: (s.count, s.lost, s.repeated, s.file) for s in reader.manifest.streams} == {
        BODY: (48, 0, 0, "signals.mcap"), HEAD: (16, 0, 0, "cameras.mcap"),
    }  # fmt: skip
    assert sorted(file.name for file in folder.iterdir()) == [layout.CAMERAS, layout.MANIFEST, layout.SIGNALS]


@pytest.mark.usefixtures("processes")
def test_pictures_that_were_not_safe_yet_come_once_more_and_are_not_twice(folder: Path) -> None:
    scene = Scene()
    (first, second), later = scenes(scene, 2), scenes(scene, 1)[0]
    killed(folder, scene, [first[:5], [*first[5:], *second]])
    point = load_resume_point(folder)
    assert point is not None
    size = open_episode(folder).parts[0].contents.chunks[1].offset - 9
    (folder / layout.RESUME).write_bytes(  # as if killed between the flush of both files and the word of it
        msgspec.json.encode(msgspec.structs.replace(point, size=size, cameras_size=0, messages=5))
    )
    again = [*first[5:], *second, *later]
    go_on(folder, again, is_exact=True)
    assert [m.data for m in open_episode(folder).messages()] == [w.value for w in (*first[:5], *again)]


@pytest.mark.usefixtures("processes")
def test_without_the_server_every_whole_chunk_of_both_is_kept_and_the_hole_begins_where_the_signals_end(
    folder: Path,
) -> None:
    scene = Scene()
    batches, _missed, later = scenes(scene, 4), scenes(scene, 1), scenes(scene, 1)[0]
    killed(folder, scene, batches)
    chunk = open_episode(folder).parts[0].contents.chunks[-1]
    with (folder / layout.ACTIVE).open("r+b") as file:  # killed when the pictures were flushed, and the signals not
        file.truncate(chunk.offset + 20)
    go_on(folder, later, is_exact=False)
    reader = open_episode(folder)
    found = reader.collect([BODY, HEAD])
    assert [m.data for m in found[HEAD]] == [w.value for b in (*batches, later) for w in b if w.key == HEAD]
    assert [m.data for m in found[BODY]] == [w.value for b in (*batches[:3], later) for w in b if w.key == BODY]
    (hole,) = reader.manifest.holes
    assert hole.from_s == pytest.approx((found[BODY][17].log_ns - scene.anchor.wall_ns) * 1e-9, abs=1e-6)
    assert hole.lost == 6 + 6 + 2


@pytest.mark.usefixtures("processes")
def test_the_first_pictures_of_a_hole_are_kept_though_nothing_said_that_they_were_safe(folder: Path) -> None:
    scene = Scene()
    (first,), later = scenes(scene, 1), scenes(scene, 1)[0]
    killed(folder, scene, [first])
    point = load_resume_point(folder)
    assert point is not None
    (folder / layout.RESUME).write_bytes(msgspec.json.encode(msgspec.structs.replace(point, cameras_size=0)))
    go_on(folder, later, is_exact=False)
    assert [m.data for m in open_episode(folder).messages([HEAD])] == [
        w.value for w in (*first, *later) if w.key == HEAD
    ]
