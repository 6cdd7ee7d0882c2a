"""A manifest that cannot be read costs its text: the copy inside the signals serves, and a line says so."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from station.cli.main import cli
from station.episode.quality.check import check, write_measured
from station.episode.reading.listing import list_episodes
from station.episode.reading.reader import open_episode
from station.episode.recorder.options import RecordingOptions
from station.episode.recorder.recording import Recording
from station.episode.storage import layout
from station.episode.storage.left_open import left_open
from station.episode.storage.manifest import load_manifest
from station.episode.writing.checkpoint import load_checkpoint
from station.episode.writing.repair import repair
from station.errors import EpisodeError
from station.export.select import sources
from tests.episode.recorded import recorded
from tests.episode.synthetic import EpisodeBuilder
from tests.episode.writes import Native, foreign

BREAK: dict[str, Callable[[Path], object]] = {
    "no YAML": lambda file: file.write_text("task: [walk"),
    "an older bug": lambda file: file.write_text(f"note: {'1' * 300}\n" + file.read_text()),
    "empty": lambda file: file.write_bytes(b""),
    "wrong types": lambda file: file.write_text("task: 3"),
    "no text": lambda file: file.write_bytes(b"\xff\xfe\x00"),
    "too large": lambda file: file.write_bytes(b"a: " + b"x" * 9_000_000),
    "a pipe": lambda file: (file.unlink(), os.mkfifo(file)),
    "a folder": lambda file: (file.unlink(), file.mkdir()),
}


def within_a_minute(call: Callable[[], object]) -> None:
    """Fail when a call has not returned after a minute, as one that opened a pipe never does."""
    thread = threading.Thread(target=call, daemon=True)
    thread.start()
    thread.join(60.0)
    assert not thread.is_alive(), "it waits for somebody to write"


def run(*words: str) -> Result:
    """Run a verb in this process."""
    return CliRunner().invoke(cli, [*words], terminal_width=120)


@pytest.mark.parametrize("how", BREAK)
def test_the_copy_inside_the_signals_serves(how: str, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    folder = recorded(tmp_path, [foreign("own", b"1")])
    whole = load_manifest(folder)
    BREAK[how](folder / layout.MANIFEST)
    within_a_minute(lambda: list_episodes(tmp_path))
    (row,) = list_episodes(tmp_path)
    assert (row.state, row.task, row.messages, row.episode_id) == ("finished", "walk", 3, folder.name)
    assert "manifest.yaml" in row.problem
    assert "the copy inside signals.mcap serves" in row.problem
    reader = open_episode(folder)
    assert reader.manifest.recorder.messages == whole.recorder.messages
    assert [record.getMessage() for record in caplog.records] == [row.problem]
    assert [source.episode_id for source in sources([], tmp_path, tasks=["walk"])] == [folder.name]


@pytest.mark.parametrize("how", BREAK)
def test_a_check_keeps_the_broken_text_and_writes_a_good_one(how: str, tmp_path: Path) -> None:
    folder = recorded(tmp_path, [foreign("own", b"1")])
    BREAK[how](folder / layout.MANIFEST)
    write_measured(folder, check(open_episode(folder)))
    assert load_manifest(folder).quality["messages"] == 3
    assert (folder / "manifest.yaml.broken").exists()
    assert list_episodes(tmp_path)[0].problem == ""


def test_a_repair_and_a_discard_do_the_same(tmp_path: Path) -> None:
    folder = recorded(tmp_path)
    for number in range(2):
        (folder / layout.MANIFEST).write_text(f"task: {number}")
        assert repair(folder).state == "closed"
        assert load_manifest(folder).task.name == "walk"
    broken = ["manifest.yaml.broken", "manifest.yaml.broken.2"]
    assert [(folder / name).read_text() for name in broken] == ["task: 0", "task: 1"]
    recording = Recording(RecordingOptions(data=tmp_path, min_free_mb=0.0), backend="replication", is_lossless=True)
    recording.feed([Native("record").request("start", task="walk"), Native("record").request("stop")])
    assert recording.close(60.0)
    last = Path(recording.answers.pop()[-1].path or "")
    (last / layout.MANIFEST).write_text("task: 3")
    recording.feed([Native("record").request("discard")])
    assert load_manifest(last).quality_flags.discarded
    assert (last / "manifest.yaml.broken").exists()


def test_that_of_a_later_station_is_refused_and_left_alone_though_a_copy_could_be_read(tmp_path: Path) -> None:
    folder = recorded(tmp_path, [foreign("own", b"1")])
    file = folder / layout.MANIFEST
    later = file.read_text().replace("manifest_version: 1", "manifest_version: 2")
    file.write_text(later)
    (row,) = list_episodes(tmp_path)
    assert "of version 2, by a later station" in row.problem
    for words in (
        ["check", str(folder)],
        ["episodes", "repair", str(folder)],
        ["export", "csv", str(folder), "--out", "x"],
    ):
        done = run(*words)
        assert "of version 2, by a later station" in f"{done.output}{done.exception}"
    assert file.read_text() == later
    assert not (folder / "manifest.yaml.broken").exists()


def test_where_there_is_no_copy_either_the_episode_is_broken_and_the_signals_say_why(tmp_path: Path) -> None:
    builder = EpisodeBuilder(tmp_path)
    builder.write({"own": b"[1]"}, at_s=0.5)
    folder = builder.finish()
    (folder / layout.MANIFEST).write_text("task: 3")
    (row,) = list_episodes(tmp_path)
    assert (row.state, row.size_bytes > 0) == ("broken", True)
    with pytest.raises(EpisodeError, match=r"manifest\.yaml: .*task"):
        open_episode(folder)
    assert (folder / layout.MANIFEST).read_text() == "task: 3", "it was only read"


def test_one_broken_manifest_leaves_the_table_of_the_others_as_it_is(tmp_path: Path) -> None:
    whole = recorded(tmp_path, task="stand")
    before = run("episodes", "list", "--data", str(tmp_path)).output.splitlines()
    for number in (2, 3):
        builder = EpisodeBuilder(tmp_path, number=number)
        builder.write({"own": b"[1]"}, at_s=0.5)
        (builder.finish() / layout.MANIFEST).write_text("task: 3")
    lines = run("episodes", "list", "--data", str(tmp_path)).output.splitlines()
    assert lines[0] == before[0]
    assert next(line for line in lines if line.startswith(whole.name)).split() == before[1].split()
    assert sum(" broken " in line and " – " in line for line in lines) == 2
    assert [line.split(":")[0] for line in lines[-2:]] == ["2026-11-21-g1-walk-0002", "2026-11-21-g1-walk-0003"]
    assert max(len(line) for line in lines[:4]) < 140, "the reasons stand below the table"


@pytest.mark.parametrize("name", [layout.MANIFEST, layout.RESUME, layout.CHECKPOINT, layout.ACTIVE])
def test_a_pipe_in_the_place_of_any_file_of_an_episode_holds_nobody_up(name: str, tmp_path: Path) -> None:
    builder = EpisodeBuilder(tmp_path)
    builder.write({"own": b"[1]"}, at_s=0.5)
    folder = builder.finish(torn=name != layout.ACTIVE)
    (folder / name).unlink(missing_ok=True)
    os.mkfifo(folder / name)
    within_a_minute(lambda: list_episodes(tmp_path))
    within_a_minute(lambda: left_open(tmp_path))
    within_a_minute(lambda: load_checkpoint(folder, layout.SIGNALS, 1000))
    assert [row.episode_id for row in list_episodes(tmp_path)] == [folder.name]


def test_what_did_not_fit_is_said_by_check_and_show(tmp_path: Path) -> None:
    folder = recorded(tmp_path, [foreign("station:event", b'{"name": "%s"}' % (b"x" * 100_000))])
    told = "cut or left out of the manifest as too long or too many, whole in the signals: 2 of events"
    for verb in ("show", "check"):
        assert told in run("episodes", verb, str(folder)).output
