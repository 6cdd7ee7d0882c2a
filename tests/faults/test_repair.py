"""Everything killed at once: what is torn becomes good, what was torn stays beside it, and it is said what was cut."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.opcode import Opcode
from mcap.reader import make_reader

from adapters.robots.g1 import twist_keys
from station.bus import codec
from station.bus.tap import Write
from station.episode.reading.reader import EpisodeReader, open_episode
from station.episode.recorder.writer import EpisodeWriter
from station.episode.storage.anchor import read_anchor
from station.episode.storage.left_open import left_open, offer
from station.episode.storage.manifest import Manifest, Task, Timing, load_manifest, save_manifest
from station.episode.storage.progress import WriterOptions
from station.episode.storage.records import ChunkPlace
from station.episode.writing.repair import repair
from station.errors import EpisodeError
from tests.episode.writes import Native, foreign
from tests.examples import examples
from tests.killed_at import killed_at
from tests.waiting import wait_until

BODY = twist_keys.action_body()
FLUSHES, PER_FLUSH = 6, 12
HEAD = 9  # bytes of a record before what `ChunkPlace` names


class Episode:
    """A small real episode: the bytes of its file, where its chunks lie, and what each message holds."""

    def __init__(self, folder: Path) -> None:
        self.anchor = read_anchor()
        timing = Timing(anchor=self.anchor, started="2026-11-21T10:00:00+00:00")
        self.manifest = Manifest(episode_id=folder.name, task=Task(name="walk"), timing=timing)
        writer = EpisodeWriter(
            folder, anchor=self.anchor, manifest=self.manifest, options=WriterOptions(flush_bytes=1), start_id="s"
        )
        g1, written = Native(), 0
        for _ in range(FLUSHES):
            batch = [g1.write(BODY, codec.json_vector([float(n)] * 35)) for n in range(PER_FLUSH)]
            batch += [foreign("stock", b"%d" % written), foreign("stock", None), g1.event("fall")]
            writer.put(batch)
            written += len(batch)
            wait_until(lambda n=written: writer.messages == n and (folder / "resume.json").exists())  # type: ignore[misc]
        writer.finish(lambda totals: self.manifest)
        assert writer.wait(30.0)
        self.data = (folder / "signals.mcap").read_bytes()
        reader = EpisodeReader(folder / "signals.mcap")
        self.chunks: list[ChunkPlace] = reader.parts[0].contents.chunks
        self.messages = [(m.topic, m.data, m.sequence, m.log_ns, m.stamp) for m in reader.messages(stamps=True)]
        self.per_chunk = len(self.messages) // len(self.chunks)

    def whole_before(self, byte: int) -> int:
        """Messages in the chunks that end at or before a byte."""
        return self.per_chunk * sum(place.offset + place.length <= byte for place in self.chunks)

    def torn(self, folder: Path, data: bytes) -> Path:
        """Put a torn file with its manifest into a folder."""
        folder.mkdir(parents=True, exist_ok=True)
        for file in folder.iterdir():
            file.unlink()
        (folder / "signals.mcap.active").write_bytes(data)
        save_manifest(msgspec.structs.replace(self.manifest, episode_id=folder.name, state="recording"), folder)
        return folder


@pytest.fixture(scope="module")
def episode(tmp_path_factory: pytest.TempPathFactory) -> Episode:
    return Episode(tmp_path_factory.mktemp("e"))


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("data") / "walk" / "2026-11-21-g1-walk-0001"


def assert_good(folder: Path, episode: Episode, kept: int, *, lost: int | None = None) -> None:
    """The file is whole for us and for the library, and holds exactly the first messages, without those of a chunk."""
    expected = episode.messages[:kept]
    if lost is not None:
        del expected[lost * episode.per_chunk : (lost + 1) * episode.per_chunk]
        kept -= episode.per_chunk
    reader = open_episode(folder)
    assert (reader.torn, reader.is_active, reader.manifest.state) == (None, False, "finished")
    found = [(m.topic, m.data, m.sequence, m.log_ns, m.stamp) for m in reader.messages(stamps=True)]
    assert found == expected
    assert reader.manifest.recorder.messages == kept == sum(stream.count for stream in reader.manifest.streams)
    assert reader.manifest.quality_flags.falls == kept // episode.per_chunk
    with reader.path.open("rb") as file:
        library = make_reader(file, validate_crcs=True)
        assert library.get_summary().statistics.message_count == kept + kept // episode.per_chunk
        assert sum(1 for _ in library.iter_messages(log_time_order=False)) == kept + kept // episode.per_chunk
        assert sum(1 for _ in library.iter_messages(topics=[BODY])) == kept // episode.per_chunk * PER_FLUSH


@settings(max_examples=examples(40), deadline=None)
@given(cut=st.integers(0, 1 << 30))
def test_a_file_cut_at_any_byte_becomes_one_that_holds_exactly_the_whole_chunks_before_it(
    episode: Episode, bench: Path, cut: int
) -> None:
    torn = episode.data[: cut % len(episode.data)]
    folder = episode.torn(bench, torn)
    done = repair(folder)
    kept = episode.whole_before(len(torn))
    assert_good(folder, episode, kept)
    assert (folder / "signals.mcap.torn").read_bytes() == torn
    ((cut_file, at, cut_bytes, original),) = [(one.file, one.at, one.bytes, one.original) for one in done.cuts]
    assert (done.state, done.messages, original) == ("repaired", kept, str(folder / "signals.mcap.torn"))
    assert (cut_file, at + cut_bytes) == ("signals.mcap", len(torn))


@settings(max_examples=examples(40), deadline=None)
@given(bit=st.integers(0, 1 << 40))
def test_a_bit_that_flipped_in_a_finished_file_costs_its_chunk_and_nothing_else(
    episode: Episode, bench: Path, bit: int
) -> None:
    first = episode.chunks[0].offset - HEAD
    data = bytearray(episode.data)
    place = first + bit // 8 % (len(data) - first)
    data[place] ^= 1 << bit % 8
    folder = episode.torn(bench, bytes(data))
    done = repair(folder)
    damaged = (n for n, one in enumerate(episode.chunks) if one.offset - HEAD <= place < one.offset + one.length)
    lost = next(damaged, None)
    assert len(load_manifest(folder).holes) == (lost is not None)
    if done.state == "repaired":
        assert_good(folder, episode, len(episode.messages), lost=lost)
        assert (folder / "signals.mcap.torn").read_bytes() == data
    else:  # the flipped bit is of no consequence: that of a time of creation, say
        assert lost is None


@settings(max_examples=examples(40), deadline=None)
@given(bit=st.integers(0, 1 << 40), cut=st.integers(0, 1 << 30))
def test_a_bit_that_flipped_in_a_torn_file_costs_nothing_before_it_and_mixes_nothing_up(
    episode: Episode, bench: Path, bit: int, cut: int
) -> None:
    end = episode.chunks[-1].offset + cut % episode.chunks[-1].length
    first = episode.chunks[0].offset
    data = bytearray(episode.data[:end])
    place = first + bit // 8 % (end - first)
    data[place] ^= 1 << bit % 8
    folder = episode.torn(bench, bytes(data))
    repair(folder)
    found = [(m.topic, m.data, m.sequence, m.log_ns, m.stamp) for m in open_episode(folder).messages(stamps=True)]
    whole = episode.whole_before(place)
    assert found[:whole] == episode.messages[:whole]
    rest = iter(episode.messages)
    assert all(message in rest for message in found), "in their order, each at most once"
    assert (folder / "signals.mcap.torn").read_bytes() == data


@pytest.mark.usefixtures("processes")
def test_what_a_lost_chunk_defined_is_defined_again_and_its_time_is_a_hole_that_check_rejects(
    episode: Episode, tmp_path: Path
) -> None:
    data = bytearray(episode.data)
    data[episode.chunks[0].offset + 60] ^= 1
    folder = episode.torn(tmp_path / "walk" / "2026-11-21-g1-walk-0001", bytes(data))
    (folder / "signals.mcap.active").rename(folder / "signals.mcap")
    save_manifest(episode.manifest, folder)
    with pytest.raises(EpisodeError, match="keep all but what is damaged: station episodes repair"):
        list(open_episode(folder).messages())
    said = station("episodes", "repair", str(folder))
    assert said.returncode == 0, said.stderr
    assert "damaged bytes left out after byte" in said.stdout
    assert_good(folder, episode, len(episode.messages), lost=0)
    (hole,) = load_manifest(folder).holes
    assert hole.reason.startswith("signals.mcap was damaged at byte")
    assert (hole.from_s, hole.lost) == (0.0, 0), "nobody numbers what comes before the first"
    (note,) = load_manifest(folder).recovery
    assert note["cuts"][0]["from_s"] == 0.0
    checked = station("check", str(folder))
    assert (checked.returncode, "1 hole(s)" in checked.stdout) == (1, True)


def test_a_length_that_is_damaged_hides_no_chunk(episode: Episode, tmp_path: Path) -> None:
    data = bytearray(episode.data)
    index = episode.chunks[1].offset + episode.chunks[1].length
    behind = episode.chunks[3].offset - HEAD
    assert data[index] == Opcode.MESSAGE_INDEX
    data[index + 1 : index + HEAD] = (behind - index - HEAD).to_bytes(8, "little")
    folder = episode.torn(tmp_path / "e", bytes(data))
    done = repair(folder)
    assert_good(folder, episode, len(episode.messages))
    assert (load_manifest(folder).holes, [cut.from_s for cut in done.cuts]) == ([], [None])


@pytest.mark.parametrize("begin", [8, 60, 200])
def test_a_head_that_is_damaged_is_made_anew_and_costs_no_message(episode: Episode, tmp_path: Path, begin: int) -> None:
    data = bytearray(episode.data)
    end = episode.chunks[0].offset - HEAD - 10
    data[begin:end] = bytes(end - begin)
    folder = episode.torn(tmp_path / "e", bytes(data))
    done = repair(folder)
    assert_good(folder, episode, len(episode.messages))
    assert (load_manifest(folder).holes, len(done.cuts)) == ([], 1)
    assert open_episode(folder).anchor == episode.anchor
    assert repair(folder).state == "whole"


def test_several_damages_are_several_holes_with_what_is_missing_in_each(episode: Episode, tmp_path: Path) -> None:
    data = bytearray(episode.data)
    for number in (1, 3, 4):
        start = episode.chunks[number].offset
        data[start - HEAD : start + 100] = bytes(HEAD + 100)  # as a bad sector, head and all
    folder = episode.torn(tmp_path / "e", bytes(data))
    done = repair(folder)
    assert (done.messages, done.cut_messages) == (3 * episode.per_chunk, 0)
    times = [message[3] for message in episode.messages]
    edges = [((times[n * episode.per_chunk - 1]), times[m * episode.per_chunk]) for n, m in ((1, 2), (3, 5))]
    expected = [tuple(round((ns - episode.anchor.wall_ns) * 1e-9, 6) for ns in edge) for edge in edges]
    holes = load_manifest(folder).holes
    assert [(hole.from_s, hole.to_s) for hole in holes] == expected
    numbered = PER_FLUSH + 1 + 2  # of the robot, its events, and what we count of a foreign writer
    assert sum(hole.lost or 0 for hole in holes) == 3 * numbered
    assert [cut.from_s for cut in done.cuts] == [hole.from_s for hole in holes]
    assert repair(folder).state == "whole"


def test_a_second_repair_changes_nothing(episode: Episode, tmp_path: Path) -> None:
    folder = episode.torn(tmp_path / "e", episode.data[: episode.chunks[3].offset + 9])
    assert repair(folder).state == "repaired"
    before = {file.name: file.read_bytes() for file in folder.iterdir()}
    assert repair(folder).state == "whole"
    assert {file.name: file.read_bytes() for file in folder.iterdir()} == before
    assert set(before) == {"manifest.yaml", "signals.mcap", "signals.mcap.torn"}


def test_out_leaves_the_torn_episode_as_it_is(episode: Episode, tmp_path: Path) -> None:
    folder = episode.torn(tmp_path / "e", episode.data[: episode.chunks[3].offset])
    before = {file.name: file.read_bytes() for file in folder.iterdir()}
    done = repair(folder, out=tmp_path / "out")
    assert {file.name: file.read_bytes() for file in folder.iterdir()} == before
    assert done.path == str(tmp_path / "out" / "e")
    assert [one.original for one in done.cuts] == [str(folder / "signals.mcap.active")]
    assert_good(Path(done.path), episode, 3 * episode.per_chunk)


def test_a_finished_file_that_was_damaged_later_is_repaired_too(episode: Episode, tmp_path: Path) -> None:
    folder = episode.torn(tmp_path / "e", episode.data[:-5])
    (folder / "signals.mcap.active").rename(folder / "signals.mcap")
    assert [one.original for one in repair(folder).cuts] == [str(folder / "signals.mcap.torn")]
    assert_good(folder, episode, len(episode.messages))


def test_without_a_manifest_the_one_at_the_head_of_the_file_will_do(episode: Episode, tmp_path: Path) -> None:
    folder = episode.torn(tmp_path / "e", episode.data[: episode.chunks[3].offset])
    (folder / "manifest.yaml").unlink()
    repair(folder)
    assert_good(folder, episode, 3 * episode.per_chunk)
    assert load_manifest(folder).task.name == "walk"


def test_what_is_no_recording_is_refused_and_left_alone(tmp_path: Path) -> None:
    (tmp_path / "signals.mcap.active").write_bytes(b"something else entirely")
    save_manifest(Manifest(episode_id="e", timing=Timing(anchor=read_anchor())), tmp_path)
    with pytest.raises(EpisodeError, match="not an MCAP file"):
        repair(tmp_path)
    assert sorted(file.name for file in tmp_path.iterdir()) == ["manifest.yaml", "signals.mcap.active"]


def test_an_episode_that_is_being_written_is_left_alone(tmp_path: Path) -> None:
    folder = tmp_path / "walk" / "e"
    folder.mkdir(parents=True)
    writer = EpisodeWriter(folder, anchor=read_anchor(), manifest=Manifest(episode_id="e"))
    writer.put([Write("k", b"1", None, time.monotonic_ns())])
    wait_until(lambda: writer.state == "open")
    assert left_open(tmp_path) == []
    with pytest.raises(EpisodeError, match="being written just now"):
        repair(folder)
    writer.finish(lambda totals: Manifest(episode_id="e", state="finished"))
    assert writer.wait(30.0)


@pytest.mark.usefixtures("processes")
def test_a_repair_that_is_killed_at_any_step_is_done_by_the_next_one(episode: Episode, tmp_path: Path) -> None:
    torn = episode.data[: episode.chunks[4].offset + 100]
    step, was_killed = 0, True
    while was_killed:
        step += 1
        folder = episode.torn(tmp_path / "e", torn)
        was_killed = killed_at(step, partial(repair, folder), within=folder)
        repair(folder)
        assert_good(folder, episode, 4 * episode.per_chunk)
        assert (folder / "signals.mcap.torn").read_bytes() == torn
        assert sorted(file.name for file in folder.iterdir() if not file.name.startswith(".")) == [
            "manifest.yaml", "signals.mcap", "signals.mcap.torn",
        ]  # fmt: skip
    assert step > 8


@pytest.mark.usefixtures("processes")
def test_the_command_repairs_all_and_says_what_was_cut(episode: Episode, tmp_path: Path) -> None:
    names = [f"2026-11-21-g1-walk-000{n}" for n in (1, 2)]
    for number, name in enumerate(names):
        episode.torn(tmp_path / "walk" / name, episode.data[: episode.chunks[2 + number].offset + 50])
    line = offer(tmp_path)
    assert line is not None
    assert "2 episodes" in line
    assert line.endswith(f"station episodes repair --all --data {tmp_path}")
    listed = station("episodes", "list", "--data", str(tmp_path))
    assert line in listed.stderr
    done = station("episodes", "repair", "--all", "--data", str(tmp_path))
    assert done.returncode == 0
    assert f"{names[0]} repaired: kept {2 * episode.per_chunk} messages" in done.stdout
    assert f"the torn file is {tmp_path / 'walk' / names[1] / 'signals.mcap.torn'}" in done.stdout
    again = station("episodes", "repair", "--all", "--data", str(tmp_path))
    assert (again.returncode, "nothing to repair" in again.stdout) == (0, True)
    one = station("episodes", "repair", names[0], "--data", str(tmp_path), "--json")
    assert [found["state"] for found in json.loads(one.stdout)] == ["whole"]
    finished = tmp_path / "walk" / names[1] / "signals.mcap"
    finished.write_bytes(finished.read_bytes()[:-20])  # as a copy that goes on, or was broken off
    still = station("episodes", "repair", "--all", "--data", str(tmp_path))
    assert (still.returncode, still.stdout) == (1, "")
    assert still.stderr.startswith(
        f"station: {names[1]}: its file changed less than 10 s ago and lacks its end: perhaps"
    )
    os.utime(finished, (0.0, 0.0))
    cut = station("episodes", "repair", "--all", "--data", str(tmp_path))
    assert (cut.returncode, len(cut.stdout.splitlines())) == (0, 2)
    assert cut.stdout.startswith(f"{names[1]} repaired: kept ")
    (tmp_path / "walk" / names[0] / "signals.mcap").write_bytes(b"ruined")
    assert station("episodes", "repair", names[0], "--data", str(tmp_path)).returncode == 1
    assert station("episodes", "repair", "--data", str(tmp_path)).returncode == 2


def station(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "station", *arguments], capture_output=True, text=True, timeout=60, check=False
    )
