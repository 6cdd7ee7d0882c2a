"""An episode of two files is read as one; what is wrong with the pictures costs no signal."""

from __future__ import annotations

import random
import shutil
import tracemalloc
from collections.abc import Callable
from pathlib import Path

import pytest

from station.episode.quality.check import check
from station.episode.reading.frames import cameras, frames
from station.episode.reading.listing import list_episodes
from station.episode.reading.part import Part
from station.episode.reading.reader import open_episode
from station.episode.reading.show import show
from station.errors import EpisodeError
from tests.episode.filming import BODY, HEAD, Scene, film, jpeg
from tests.episode.reading.test_hostile_files import read_everything
from tests.episode.synthetic import EpisodeBuilder, walk

FLUSHES = 12


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder, scene = tmp_path_factory.mktemp("data") / "walk" / "2026-11-21-g1-walk-0001", Scene()
    film(folder, [[*scene.signals(20), scene.picture(), scene.picture()] for _ in range(FLUSHES)], scene.anchor)
    return folder


@pytest.fixture
def folder(made: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(made, tmp_path / "data" / "walk" / made.name))


def test_a_list_a_check_and_a_look_know_of_both_files(folder: Path) -> None:
    (row,) = list_episodes(folder.parent.parent)
    sizes = {name: (folder / name).stat().st_size for name in ("signals.mcap", "cameras.mcap")}
    assert (row.messages, row.size_bytes) == (FLUSHES * 22, sum(sizes.values()))
    facts = show(open_episode(folder))
    assert (facts.files, facts.messages) == (sizes, FLUSHES * 22)
    assert {stream.key: stream.file for stream in facts.streams} == {BODY: "signals.mcap", HEAD: "cameras.mcap"}
    quality = check(open_episode(folder))
    assert [(camera.name, camera.frames, camera.lost) for camera in quality.cameras] == [("head", FLUSHES * 2, 0)]
    assert {stream.key: stream.count for stream in quality.streams} == {BODY: FLUSHES * 20, HEAD: FLUSHES * 2}


def test_no_two_channels_of_an_episode_share_a_number(folder: Path) -> None:
    numbers = [stream.channel.id for stream in open_episode(folder).streams()]
    assert len(set(numbers)) == len(numbers) == 2


def test_no_more_than_a_chunk_of_each_file_is_in_memory(tmp_path: Path) -> None:
    scene, size = Scene(), 500_000
    film(tmp_path, [[*scene.signals(20), scene.picture(size=size)] for _ in range(30)], scene.anchor)
    reader = open_episode(tmp_path)
    for order in ("file", "log"):
        tracemalloc.start()
        try:
            assert sum(1 for _ in reader.messages(order=order)) == 30 * 21
            _, peak = tracemalloc.get_traced_memory()
        finally:
            tracemalloc.stop()
        assert peak < 8 * size, "a chunk: read, decoded, its picture taken out, beside the one before it"


def damage(folder: Path, name: str = "cameras.mcap") -> None:
    data = bytearray((folder / name).read_bytes())
    place = Part(folder / name).contents.chunks[FLUSHES // 2]
    data[place.offset + 100] ^= 1
    (folder / name).write_bytes(data)


def test_whoever_wants_signals_alone_reads_no_pictures(folder: Path) -> None:
    damage(folder)
    reader = open_episode(folder)
    assert len(reader.collect([BODY])[BODY]) == FLUSHES * 20
    assert len(list(reader.messages([BODY], stamps=True, order="log"))) == FLUSHES * 20
    for topics in ([HEAD], None):
        with pytest.raises(EpisodeError, match=r"cameras\.mcap: the chunk at byte \d+ is damaged"):
            list(reader.messages(topics))


def test_which_keys_and_cameras_there_are_is_told_without_reading_a_message(folder: Path) -> None:
    read = open_episode(folder).streams()
    for name in ("signals.mcap", "cameras.mcap"):
        damage(folder, name)
    reader = open_episode(folder)
    assert (reader.topics(), cameras(reader)) == (sorted([BODY, HEAD]), {"head": HEAD})
    assert reader.channels() == [stream.channel for stream in read]


@pytest.mark.parametrize("name", ["signals.mcap", "cameras.mcap"])
def test_a_file_without_a_summary_tells_by_its_messages(folder: Path, name: str) -> None:
    read, file = open_episode(folder).channels(), folder / name
    file.write_bytes(file.read_bytes()[: Part(file).contents.chunks[3].offset])
    assert open_episode(folder).channels() == read


def remove(cameras: Path) -> None:
    cameras.unlink()


def empty(cameras: Path) -> None:
    cameras.write_bytes(b"")


def cut(cameras: Path) -> None:
    cameras.write_bytes(cameras.read_bytes()[: cameras.stat().st_size // 2])


def exchange(cameras: Path) -> None:
    other, scene = cameras.parent / "other", Scene()
    film(other, [[scene.picture()]], scene.anchor)
    (other / "cameras.mcap").replace(cameras)
    shutil.rmtree(other)


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (remove, f"cameras.mcap is not there, with {FLUSHES * 2} pictures that the manifest lists; bring it back"),
        (empty, "cameras.mcap: not an MCAP file (0 bytes"),
        (cut, "cameras.mcap: cut off at byte"),
        (exchange, "cameras.mcap is of another recording; put its own in its place, or take it away"),
    ],
)
def test_pictures_that_are_missing_torn_or_of_another_episode_are_told_and_the_signals_read(
    folder: Path, spoil: Callable[[Path], None], words: str
) -> None:
    spoil(folder / "cameras.mcap")
    reader = open_episode(folder)
    assert words in str(reader.torn)
    assert "\n" not in str(reader.torn)
    assert len(reader.collect([BODY])[BODY]) == FLUSHES * 20
    quality = check(reader)
    assert (quality.verdict, "torn" in {reason.rule for reason in quality.reasons}) == ("reject", True)


def test_the_file_of_pictures_alone_can_be_read_too(folder: Path) -> None:
    reader = open_episode(folder / "cameras.mcap")
    assert [message.topic for message in reader.messages()] == [HEAD] * (FLUSHES * 2)
    assert (reader.torn, {stream.channel.file for stream in reader.streams()}) == (None, {"cameras.mcap"})


def test_pictures_of_older_episodes_which_are_among_the_signals_are_read_all_the_same(tmp_path: Path) -> None:
    builder = EpisodeBuilder(tmp_path)
    walk(builder, seconds=0.5)
    for number in range(10):
        builder.write({HEAD: jpeg(number)}, at_s=0.1 + number / 30, writer="camera")
    reader = open_episode(builder.finish())
    assert [frame.data for frame in frames(reader, HEAD)] == [jpeg(number) for number in range(10)]
    assert [camera.frames for camera in check(reader).cameras] == [10]
    assert {stream.file for stream in show(reader).streams} == {"signals.mcap"}


def test_pictures_that_are_spoilt_in_any_place_never_raise_anything_unforeseen(folder: Path) -> None:
    data, dice = (folder / "cameras.mcap").read_bytes(), random.Random(3)
    for _ in range(25):
        spoilt = bytearray(data)
        for _ in range(3):
            spoilt[dice.randrange(len(data))] = dice.randrange(256)
        (folder / "cameras.mcap").write_bytes(spoilt[: dice.choice([None, dice.randrange(len(data))])])
        read_everything(folder)
