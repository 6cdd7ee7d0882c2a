"""An episode of two files that is torn in either: what is whole of each becomes good, what was torn stays beside it."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader

from station.episode.quality.check import check
from station.episode.reading.part import Part
from station.episode.reading.reader import open_episode
from station.episode.storage.manifest import save_manifest
from station.episode.writing.repair import Repaired, close_whole, repair
from tests.episode.filming import BODY, HEAD, Scene, film
from tests.faults.test_repair import HEAD as RECORD
from tests.faults.test_repair import station
from tests.killed_at import killed_at

FLUSHES, SIGNALS, PICTURES = 5, 6, 3
NAMES = ("signals.mcap", "cameras.mcap")


class Film:
    """A small real episode: the bytes of its two files, and its writes."""

    def __init__(self, folder: Path) -> None:
        scene = Scene()
        batches = [
            [*scene.signals(SIGNALS), *(scene.picture() for _ in range(PICTURES))] for _ in range(FLUSHES)
        ]  # fmt: skip
        self.manifest = film(folder, batches, scene.anchor)
        self.data = {name: (folder / name).read_bytes() for name in NAMES}
        self.chunks = {name: Part(folder / name).contents.chunks for name in NAMES}
        self.values = {key: [w.value for batch in batches for w in batch if w.key == key] for key in (BODY, HEAD)}

    def whole_before(self, name: str, byte: int) -> int:
        """Messages of a file in the chunks that end at or before a byte."""
        each = SIGNALS if name == "signals.mcap" else PICTURES
        return each * sum(place.offset + place.length <= byte for place in self.chunks[name])

    def torn(self, folder: Path, signals: int | None, cameras: int | None) -> Path:
        """Put both files into a folder as a killed recorder leaves them, each cut at a byte (None: whole)."""
        folder.mkdir(parents=True, exist_ok=True)
        for file in folder.iterdir():
            file.unlink()
        for name, cut in zip(NAMES, (signals, cameras), strict=True):
            (folder / f"{name}.active").write_bytes(self.data[name][:cut])
        save_manifest(msgspec.structs.replace(self.manifest, episode_id=folder.name, state="recording"), folder)
        return folder


@pytest.fixture(scope="module")
def filmed(tmp_path_factory: pytest.TempPathFactory) -> Film:
    return Film(tmp_path_factory.mktemp("e"))


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("data") / "walk" / "2026-11-21-g1-walk-0001"


def assert_good(folder: Path, filmed: Film, signals: int, pictures: int) -> None:
    """Both files are whole for us and for the library, and hold exactly the first messages of each."""
    reader = open_episode(folder)
    assert (reader.torn, reader.is_active, reader.manifest.state) == (None, False, "finished")
    found = reader.collect([BODY, HEAD])
    assert [m.data for m in found[BODY]] == filmed.values[BODY][:signals]
    assert [m.data for m in found[HEAD]] == filmed.values[HEAD][:pictures]
    assert {stream.key: stream.count for stream in reader.manifest.streams} == {
        key: count for key, count in ((BODY, signals), (HEAD, pictures)) if count
    }
    assert reader.manifest.recorder.messages == signals + pictures
    assert reader.manifest.recorder.bytes == sum(file.stat().st_size for file in reader.files)
    assert (folder / "cameras.mcap").exists() is (pictures > 0)
    for file in reader.files:
        with file.open("rb") as stream:
            library = make_reader(stream, validate_crcs=True)
            assert sum(1 for _ in library.iter_messages(topics=[BODY, HEAD])) in (signals, pictures)


@settings(max_examples=25, deadline=None)
@given(cut=st.integers(0, 1 << 30))
def test_cameras_cut_at_any_byte_keep_their_whole_chunks_and_cost_no_signal(
    filmed: Film, bench: Path, cut: int
) -> None:
    cut %= len(filmed.data["cameras.mcap"])
    folder = filmed.torn(bench, -1, cut)
    done = repair(folder)
    kept = filmed.whole_before("cameras.mcap", cut)
    assert_good(folder, filmed, FLUSHES * SIGNALS, kept)
    torn = {one.file: Path(one.original) for one in done.cuts}
    assert torn["cameras.mcap"].name == "cameras.mcap.torn"
    assert torn["cameras.mcap"].read_bytes() == filmed.data["cameras.mcap"][:cut]
    assert done.messages + done.cut_messages == FLUSHES * (SIGNALS + PICTURES)
    assert [cut_.at + cut_.bytes for cut_ in done.cuts if cut_.file == "cameras.mcap"] == [cut]


@settings(max_examples=10, deadline=None)
@given(cut=st.integers(0, 1 << 30))
def test_signals_cut_at_any_byte_cost_no_picture(filmed: Film, bench: Path, cut: int) -> None:
    cut %= len(filmed.data["signals.mcap"])
    folder = filmed.torn(bench, cut, None)
    repair(folder)
    assert_good(folder, filmed, filmed.whole_before("signals.mcap", cut), FLUSHES * PICTURES)
    assert (folder / "cameras.mcap").read_bytes() == filmed.data["cameras.mcap"], "it was whole: nothing to do"
    assert not (folder / "cameras.mcap.torn").exists()


@settings(max_examples=25, deadline=None)
@given(bit=st.integers(0, 1 << 40))
def test_a_bit_that_flipped_in_the_cameras_costs_those_of_its_chunk_and_no_other(
    filmed: Film, bench: Path, bit: int
) -> None:
    data, first = bytearray(filmed.data["cameras.mcap"]), filmed.chunks["cameras.mcap"][0].offset
    place = first + bit // 8 % (len(data) - first)
    data[place] ^= 1 << bit % 8
    folder = filmed.torn(bench, None, None)
    (folder / "cameras.mcap.active").write_bytes(data)
    repair(folder)
    chunks = enumerate(filmed.chunks["cameras.mcap"])
    lost = next((n for n, one in chunks if one.offset - RECORD <= place < one.offset + one.length), None)
    expected = list(filmed.values[HEAD])
    if lost is not None:
        del expected[lost * PICTURES : (lost + 1) * PICTURES]
    reader = open_episode(folder)
    assert [m.data for m in reader.messages([HEAD])] == expected
    assert [m.data for m in reader.messages([BODY])] == filmed.values[BODY]
    assert len(reader.manifest.holes) == (lost is not None)


@pytest.mark.parametrize("is_named", [False, True])
def test_a_recorder_that_died_between_its_last_bytes_and_its_last_words_left_nothing_to_cut(
    filmed: Film, tmp_path: Path, is_named: bool
) -> None:
    folder = filmed.torn(tmp_path / "e", None, None)
    if is_named:
        (folder / "cameras.mcap.active").rename(folder / "cameras.mcap")
    done = close_whole(folder)
    assert done is not None
    assert (done.state, done.messages) == ("closed", FLUSHES * (SIGNALS + PICTURES))
    assert_good(folder, filmed, FLUSHES * SIGNALS, FLUSHES * PICTURES)
    assert sorted(file.name for file in folder.iterdir()) == ["cameras.mcap", "manifest.yaml", "signals.mcap"]


def test_cameras_that_were_damaged_later_are_found_by_a_check_and_repaired(filmed: Film, tmp_path: Path) -> None:
    folder = filmed.torn(tmp_path / "e", None, None)
    close_whole(folder)
    data = filmed.data["cameras.mcap"][: filmed.chunks["cameras.mcap"][3].offset + 20]
    (folder / "cameras.mcap").write_bytes(data)
    assert "cameras.mcap: cut off at byte" in str(open_episode(folder).torn)
    quality = check(open_episode(folder))
    assert (quality.verdict, "torn" in {reason.rule for reason in quality.reasons}) == ("reject", True)
    (cut,) = repair(folder).cuts
    assert (cut.file, cut.original) == ("cameras.mcap", str(folder / "cameras.mcap.torn"))
    assert_good(folder, filmed, FLUSHES * SIGNALS, 3 * PICTURES)
    assert (folder / "cameras.mcap.torn").read_bytes() == data
    assert not (folder / "signals.mcap.torn").exists(), "it was whole"
    assert repair(folder).state == "whole"


def test_without_its_cameras_an_episode_becomes_a_good_one_of_signals(filmed: Film, tmp_path: Path) -> None:
    folder = filmed.torn(tmp_path / "e", None, None)
    close_whole(folder)
    (folder / "cameras.mcap").unlink()
    done = repair(folder)
    assert (done.state, done.cut_messages, done.cuts) == ("repaired", FLUSHES * PICTURES, [])
    assert_good(folder, filmed, FLUSHES * SIGNALS, 0)
    assert repair(folder).state == "whole"


def test_cameras_that_are_no_file_of_messages_at_all_are_put_aside(filmed: Film, tmp_path: Path) -> None:
    folder = filmed.torn(tmp_path / "e", -1, None)
    (folder / "cameras.mcap.active").write_bytes(bytes(5000))
    assert {cut.file: cut.at for cut in repair(folder).cuts}["cameras.mcap"] == 0
    assert_good(folder, filmed, FLUSHES * SIGNALS, 0)
    assert (folder / "cameras.mcap.torn").read_bytes() == bytes(5000)


def test_out_makes_both_files_elsewhere_and_leaves_the_torn_ones(filmed: Film, tmp_path: Path) -> None:
    folder = filmed.torn(tmp_path / "e", -1, None)
    before = {file.name: file.read_bytes() for file in folder.iterdir()}
    done = repair(folder, out=tmp_path / "out")
    assert {file.name: file.read_bytes() for file in folder.iterdir()} == before
    assert_good(Path(done.path), filmed, FLUSHES * SIGNALS, FLUSHES * PICTURES)


@pytest.mark.usefixtures("processes")
def test_a_repair_of_both_that_is_killed_at_any_step_is_done_by_the_next_one(filmed: Film, tmp_path: Path) -> None:
    cuts = [filmed.chunks[name][2].offset + 30 for name in NAMES]
    step, was_killed = 0, True
    while was_killed:
        step += 1
        folder = filmed.torn(tmp_path / "e", *cuts)
        was_killed = killed_at(step, partial(repair, folder), within=folder)
        repair(folder)
        assert_good(folder, filmed, 2 * SIGNALS, 2 * PICTURES)
        for name, cut in zip(NAMES, cuts, strict=True):
            assert (folder / f"{name}.torn").read_bytes() == filmed.data[name][:cut]
        assert sorted(file.name for file in folder.iterdir() if not file.name.startswith(".")) == [
            "cameras.mcap", "cameras.mcap.torn", "manifest.yaml", "signals.mcap", "signals.mcap.torn",
        ]  # fmt: skip
    assert step > 12


@pytest.mark.usefixtures("processes")
def test_the_command_says_of_each_file_what_was_cut(filmed: Film, tmp_path: Path) -> None:
    name = "2026-11-21-g1-walk-0001"
    folder = filmed.torn(tmp_path / "walk" / name, -1, filmed.chunks["cameras.mcap"][4].offset)
    done = station("episodes", "repair", name, "--data", str(tmp_path))
    assert done.returncode == 0, done.stderr
    first, *files = done.stdout.splitlines()
    assert first.startswith(f"{name} repaired: kept {FLUSHES * SIGNALS + 4 * PICTURES} messages")
    assert [line.split()[0] for line in files] == ["signals.mcap:", "cameras.mcap:"]
    assert files[1].endswith(f"the torn file is {folder / 'cameras.mcap.torn'}")
    again = msgspec.json.decode(
        station("episodes", "repair", name, "--json", "--data", str(tmp_path)).stdout, type=list[Repaired]
    )
    assert [one.state for one in again] == ["whole"]


def test_a_damaged_chunk_of_pictures_costs_its_pictures_and_no_signal(filmed: Film, tmp_path: Path) -> None:
    folder = filmed.torn(tmp_path / "walk" / "2026-11-21-g1-walk-0001", None, None)
    for name in NAMES:
        (folder / f"{name}.active").rename(folder / name)
    save_manifest(filmed.manifest, folder)
    place = filmed.chunks["cameras.mcap"][0]
    data = bytearray(filmed.data["cameras.mcap"])
    data[place.offset + place.length // 2] ^= 1
    (folder / "cameras.mcap").write_bytes(data)
    done = repair(folder)
    assert [(cut.file, cut.original) for cut in done.cuts] == [("cameras.mcap", str(folder / "cameras.mcap.torn"))]
    assert (folder / "cameras.mcap.torn").read_bytes() == data
    reader = open_episode(folder)
    found = reader.collect([BODY, HEAD])
    assert [m.data for m in found[BODY]] == filmed.values[BODY]
    assert [m.data for m in found[HEAD]] == filmed.values[HEAD][PICTURES:]
    assert [hole.reason.split()[0] for hole in reader.manifest.holes] == ["cameras.mcap"]
    assert repair(folder).state == "whole"
    assert "holes" in {reason.rule for reason in check(reader).reasons}
