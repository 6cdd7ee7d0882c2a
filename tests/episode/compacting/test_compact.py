"""JPEG pictures become video: the same times, pictures that are as good, the old or the new file at every instant."""

from __future__ import annotations

import io
import shutil
import sys
from collections.abc import Sequence
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import av
import numpy as np
import pytest
from av.video.frame import PictureType
from mcap.reader import make_reader
from mcap.records import Chunk
from mcap.stream_reader import StreamReader
from PIL import Image

from station import depth
from station.bus.tap import Write
from station.episode.compacting.compact import compact, compared
from station.episode.quality.check import check, write_measured
from station.episode.quality.standing import stands
from station.episode.reading.frames import frames
from station.episode.reading.part import Part
from station.episode.reading.reader import Message, open_episode
from station.episode.reading.show import count_streams
from station.episode.storage.file_hashes import changes, measure
from station.episode.storage.manifest import Compacted, load_manifest, save_manifest
from station.episode.storage.records import walk
from station.episode.writing.repair import repair
from station.errors import EpisodeError, StationError
from tests.enrich.read_back import decoded
from tests.episode.compacting.two_files import in_two_files
from tests.episode.depth_scenes import DEPTH, steps
from tests.episode.filming import HEAD, WRIST, Scene, film
from tests.episode.scenes import Shot, file_of, filmed, noise, noisy, scene
from tests.killed_at import killed_at

GOP = 10
IDR, SPS, PPS = 5, 7, 8  # types of NAL units
RNG = np.random.default_rng(5)


def jpeg(number: int, *, width: int = 96, height: int = 64, grain: float = 0.0, quality: int = 95) -> bytes:
    """A smooth picture in which something moves."""
    grey = np.tile(np.linspace(40.0, 200.0, width), (height, 1))
    grey[10:40, 5 + number % 40 : 35 + number % 40] = 230.0
    return file_of(grey + RNG.normal(0.0, grain, grey.shape) if grain else grey, quality=quality)


def record(data: Path, pictures: Sequence[bytes], *, number: int = 1) -> Path:
    """Record an episode with a camera that shows these, in flushes that fall between any two of them."""
    shots = Scene()
    batches = [[*shots.signals(2), *(shots.picture(data=one) for one in pictures[at : at + 7])]
               for at in range(0, len(pictures), 7)]  # fmt: skip
    folder = data / "walk" / f"2026-11-21-g1-walk-{number:04d}"
    film(folder, batches, shots.anchor)
    return folder


class Episode(NamedTuple):
    folder: Path
    data: Path


@pytest.fixture(scope="module")
def two_cameras(tmp_path_factory: pytest.TempPathFactory) -> Episode:
    """A camera, another of half its rate, and a picture by somebody who stamps nothing."""
    data, shots = tmp_path_factory.mktemp("data"), Scene()
    batches: list[list[Write]] = []
    for number in range(34):
        batch = [*shots.signals(1), shots.picture(HEAD, data=jpeg(number))]
        if number % 2 == 0:
            batch.append(shots.picture(WRIST, data=jpeg(2 * number, width=64, height=48)))
        batches.append(batch)
    plain = shots.picture(HEAD, data=jpeg(99))
    batches.append([plain._replace(stamp=None)])
    folder = data / "walk" / "2026-11-21-g1-walk-0001"
    film(folder, batches, shots.anchor)
    return Episode(folder, data)


@pytest.fixture
def episode(two_cameras: Episode, tmp_path: Path) -> Episode:
    """A copy of it."""
    folder = tmp_path / "walk" / two_cameras.folder.name
    shutil.copytree(two_cameras.folder, folder)
    return Episode(folder, tmp_path)


def rgb(file: bytes) -> Any:
    with Image.open(io.BytesIO(file)) as picture:
        return np.asarray(picture.convert("RGB"), dtype=float)


def psnr(one: bytes, other: bytes) -> float:
    return float(10 * np.log10(255**2 / max(1e-9, ((rgb(one) - rgb(other)) ** 2).mean())))


def messages(folder: Path) -> list[Message]:
    return list(open_episode(folder).messages(stamps=True))


def note_of(folder: Path) -> Compacted:
    note = load_manifest(folder).compacted
    assert note is not None
    return note


def units(packet: bytes) -> list[int]:
    """Types of the NAL units of an Annex B packet."""
    return [part[0] & 31 for part in packet.split(b"\x00\x00\x01")[1:]]


def test_every_message_keeps_its_times_and_stamps_and_every_picture_its_looks(episode: Episode) -> None:
    before, size = messages(episode.folder), (episode.folder / "cameras.mcap").stat().st_size
    taken = {key: [frame.captured_ns for frame in frames(open_episode(episode.folder), key)] for key in (HEAD, WRIST)}
    done = compact(episode.folder, episode.data)
    after = messages(episode.folder)
    assert (done.state, done.pictures, done.bytes_before) == ("compacted", 34 + 17 + 1, size)
    assert done.bytes_after == (episode.folder / "cameras.mcap").stat().st_size < size / 3
    assert len(after) == len(before)
    for one, other in zip(before, after, strict=True):
        assert other[2:5] == one[2:5]  # log time, publish time, sequence
        assert (other.topic, other.stamp, other.channel.source) == (one.topic, one.stamp, one.channel.source)
        if one.topic in (HEAD, WRIST):
            assert other.data != one.data
            assert psnr(one.data, other.data) > 33.0
        else:
            assert other.data == one.data
    assert {key: [frame.captured_ns for frame in frames(open_episode(episode.folder), key)] for key in taken} == taken


@pytest.mark.parametrize("kind", ["4:2:0", "4:2:2", "4:4:4", "grey"])
def test_colours_and_brightness_stay_however_a_camera_samples_them(tmp_path: Path, kind: str) -> None:
    rows, columns = np.mgrid[0:64, 0:96]
    shade = np.stack([255 * columns / 95, 255 * rows / 63, 255 - 255 * columns / 95], axis=-1).astype(np.uint8)
    stream = io.BytesIO()
    picture = Image.fromarray(shade).convert("L" if kind == "grey" else "RGB")
    picture.save(stream, "JPEG", quality=95, **({} if kind == "grey" else {"subsampling": kind}))
    folder = record(tmp_path, [stream.getvalue()] * 12)
    assert compact(folder, tmp_path, crf=16).state == "compacted"
    (shown, *_) = [frame.data for frame in frames(open_episode(folder), HEAD)]
    assert psnr(stream.getvalue(), shown) > 36.0
    assert np.abs((rgb(shown) - rgb(stream.getvalue())).mean(axis=(0, 1))).max() < 1.0


def test_any_reader_of_mcap_finds_foxgloves_type_in_annex_b_without_pictures_out_of_order(episode: Episode) -> None:
    was = {
        key: [one.message.timestamp for one in decoded(episode.folder / "cameras.mcap", key)] for key in (HEAD, WRIST)
    }
    compact(episode.folder, episode.data, gop=GOP)
    for key, name in ((HEAD, "head"), (WRIST, "wrist")):
        found = decoded(episode.folder / "cameras.mcap", key)
        assert {one.schema.name for one in found} == {"foxglove.CompressedVideo"}
        assert {(one.message.format, one.message.frame_id) for one in found} == {("h264", name)}
        assert [(t.timestamp.seconds, t.timestamp.nanos) for t in [one.message for one in found]] == [
            (stamp.seconds, stamp.nanos) for stamp in was[key]
        ]
        packets = [one.message.data for one in found if one.channel.metadata["source"]]
        assert all(packet.startswith((b"\x00\x00\x01", b"\x00\x00\x00\x01")) for packet in packets)
        decoder = av.CodecContext.create("h264", "r")
        kinds = [[picture.pict_type for picture in decoder.decode(av.Packet(packet))] for packet in packets]
        assert all(kind in ([PictureType.I], [PictureType.P]) for kind in kinds)


def test_a_key_frame_with_its_headers_comes_every_so_many_pictures(tmp_path: Path) -> None:
    folder = record(tmp_path, [jpeg(number) for number in range(25)])
    compact(folder, tmp_path, gop=GOP)
    packets = [one.message.data for one in decoded(folder / "cameras.mcap", HEAD)]
    keys = [number for number, packet in enumerate(packets) if IDR in units(packet)]
    assert keys == [0, 10, 20]
    assert all({SPS, PPS, IDR} <= {*units(packets[number])} for number in keys)
    assert note_of(folder).encoder["gop"] == GOP


def test_what_stands_beside_the_pictures_is_packed(tmp_path: Path) -> None:
    """Where a robot moves little, stamps and headers were a fifth of the file."""
    folder = record(tmp_path, [jpeg(3)] * 200)
    compact(folder, tmp_path, gop=30)
    with (folder / "cameras.mcap").open("rb") as file:
        chunks = [record for record in StreamReader(file, emit_chunks=True).records if isinstance(record, Chunk)]
    assert sum(len(chunk.data) for chunk in chunks) < 0.6 * sum(chunk.uncompressed_size for chunk in chunks)
    assert len(chunks) == 7


def test_the_manifest_says_what_was_done_and_the_files_are_those_that_it_names(episode: Episode) -> None:
    old = {file.name: file for file in measure(episode.folder)}
    done = compact(episode.folder, episode.data, crf=20)
    manifest = load_manifest(episode.folder)
    note = note_of(episode.folder)
    assert (note.made_of, note.bytes) == (old["cameras.mcap"], done.bytes_after)
    assert (note.encoder["name"], note.encoder["crf"]) == ("libx264", 20)
    assert {key: camera.pictures for key, camera in note.cameras.items()} == {HEAD: 35, WRIST: 17}
    assert done.psnr_db == min(camera.psnr_db for camera in note.cameras.values()) > 35.0
    assert done.psnr_worst_db == min(camera.psnr_worst_db for camera in note.cameras.values()) <= done.psnr_db
    assert note.software["version"] or note.software["revision"]
    assert changes(manifest.files, measure(episode.folder)) == []
    assert manifest.recorder.bytes == sum(file.bytes for file in manifest.files)
    assert compact(episode.folder, episode.data).state == "current"
    assert load_manifest(episode.folder).compacted == note


@pytest.mark.parametrize(
    ("pictures", "why"),
    [
        ([jpeg(1, grain=40.0)] * 3, "PSNR"),
        ([jpeg(1), jpeg(2)[:-300], jpeg(3)], "no whole JPEG"),
        ([jpeg(1), jpeg(2, width=64)], "64x64 pixels, those before it 96x64"),
        ([jpeg(1, width=95)], "both must be even"),
    ],
)
def test_what_would_not_be_as_good_stays_as_it_is(tmp_path: Path, pictures: list[bytes], why: str) -> None:
    folder = record(tmp_path, pictures)
    before = {file.name: file.read_bytes() for file in folder.iterdir()}
    done = compact(folder, tmp_path, crf=40)
    assert (done.state, done.bytes_after) == ("left", 0)
    assert why in done.why
    assert HEAD in done.why
    assert {file.name: file.read_bytes() for file in folder.iterdir()} == before


def test_a_lower_crf_keeps_what_a_high_one_would_not(tmp_path: Path) -> None:
    folder = record(tmp_path, [jpeg(number, grain=10.0, quality=98) for number in range(6)])
    assert compact(folder, tmp_path, crf=36).state == "left"
    assert compact(folder, tmp_path, crf=16).state == "compacted"


def test_nothing_is_done_where_there_is_nothing_to_do(tmp_path: Path) -> None:
    shots = Scene()
    folder = tmp_path / "walk" / "2026-11-21-g1-walk-0001"
    film(folder, [shots.signals(3)], shots.anchor)
    assert compact(folder, tmp_path).state == "no-pictures"


def test_an_episode_that_is_open_torn_or_changed_is_refused_and_left_alone(episode: Episode) -> None:
    cameras = episode.folder / "cameras.mcap"
    whole = cameras.read_bytes()
    cameras.write_bytes(whole[:-100])
    with pytest.raises(EpisodeError, match="station episodes repair"):
        compact(episode.folder, episode.data)
    cameras.write_bytes(whole)
    manifest = load_manifest(episode.folder)
    manifest.files[0].sha256 = "0" * 64
    save_manifest(manifest, episode.folder)
    with pytest.raises(EpisodeError, match="changed after it was closed"):
        compact(episode.folder, episode.data)
    assert cameras.read_bytes() == whole


def test_one_that_was_left_open_is_to_be_repaired_first(episode: Episode) -> None:
    for name in ("signals.mcap", "cameras.mcap"):
        (episode.folder / name).rename(episode.folder / f"{name}.active")
    with pytest.raises(EpisodeError, match="first: station episodes repair"):
        compact(episode.folder, episode.data)


def test_a_damaged_chunk_of_pictures_is_refused(episode: Episode) -> None:
    cameras = episode.folder / "cameras.mcap"
    place, data = walk(cameras).chunks[3], bytearray(cameras.read_bytes())
    data[place.offset + place.length // 2] ^= 1
    cameras.write_bytes(data)
    with pytest.raises(EpisodeError, match="damaged"):
        compact(episode.folder, episode.data)
    assert cameras.read_bytes() == data


def test_room_for_the_new_file_is_asked_for_first(episode: Episode, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda _: shutil._ntuple_diskusage(10**9, 10**9 - 1000, 1000))
    with pytest.raises(EpisodeError, match="make room"):
        compact(episode.folder, episode.data)


def test_files_are_not_the_same_when_a_time_a_stamp_or_a_picture_differs(tmp_path: Path) -> None:
    shown = [jpeg(number) for number in range(4)]
    compact(folder := record(tmp_path, shown), tmp_path)
    made = Part(folder / "cameras.mcap")
    for number, other in enumerate((shown, shown[:-1]), start=2):  # recorded at another time; one picture less
        old = Part(record(tmp_path, other, number=number) / "cameras.mcap")
        with pytest.raises(EpisodeError, match="is not that of"):
            compared(old, made)


@pytest.mark.usefixtures("processes")
def test_killed_at_any_operation_it_has_the_jpeg_files_or_the_video_and_the_next_call_finishes(tmp_path: Path) -> None:
    source = record(tmp_path / "source", [jpeg(number) for number in range(8)])
    before, data = messages(source), tmp_path / "data"
    folder = data / "walk" / source.name
    step, states, was_killed = 0, set(), True
    while was_killed:
        step += 1
        shutil.rmtree(data, ignore_errors=True)
        shutil.copytree(source, folder)
        was_killed = killed_at(step, partial(compact, folder, data), within=folder)
        found = messages(folder)
        states.add(any(message.channel.video for message in found))
        assert [message[2:5] for message in found] == [message[2:5] for message in before]
        assert all(psnr(a.data, b.data) > 33 for a, b in zip(before, found, strict=True) if a.topic == HEAD)
        compact(folder, data)
        manifest = load_manifest(folder)
        assert note_of(folder).made_of == load_manifest(source).files[1]
        assert changes(manifest.files, measure(folder)) == []
        assert sorted(file.name for file in folder.iterdir() if not file.name.startswith(".manifest")) == [
            "cameras.mcap", "manifest.yaml", "signals.mcap",
        ]  # fmt: skip
    assert step > 10
    assert states == {False, True}


def test_a_compacted_file_that_was_damaged_loses_one_chunk_and_keeps_the_stamps_of_the_rest(tmp_path: Path) -> None:
    folder = record(tmp_path, [jpeg(number) for number in range(40)])
    taken = [frame.captured_ns for frame in frames(open_episode(folder), HEAD)]
    compact(folder, tmp_path, gop=GOP)
    cameras = folder / "cameras.mcap"
    shown = [frame.data for frame in frames(open_episode(folder), HEAD)]
    data = bytearray(cameras.read_bytes())
    place = walk(cameras).chunks[1]
    data[place.offset + place.length // 2] ^= 1
    cameras.write_bytes(data)
    repair(folder)
    kept = [*range(GOP), *range(2 * GOP, 40)]
    found = list(frames(open_episode(folder), HEAD))
    assert [frame.captured_ns for frame in found] == [taken[number] for number in kept]
    assert [frame.data for frame in found] == [shown[number] for number in kept]
    assert compact(folder, tmp_path).state == "current"


def test_a_compacted_file_that_was_cut_off_keeps_its_whole_chunks_and_is_known_as_compacted(tmp_path: Path) -> None:
    folder = record(tmp_path, [jpeg(number) for number in range(40)])
    compact(folder, tmp_path, gop=GOP)
    cameras = folder / "cameras.mcap"
    shown = [frame.data for frame in frames(open_episode(folder), HEAD)]
    cameras.write_bytes(cameras.read_bytes()[: walk(cameras).chunks[2].offset + 30])
    repair(folder)
    assert [frame.data for frame in frames(open_episode(folder), HEAD)] == shown[: 2 * GOP]
    assert compact(folder, tmp_path).state == "current"
    manifest = load_manifest(folder)
    manifest.compacted = None  # of somebody who wrote it anew
    save_manifest(manifest, folder)
    assert compact(folder, tmp_path).state == "current"


def standing_still(shot: Shot) -> bytes:
    """The noise of a good sensor in front of a scene in which nothing moves: a video of it repeats itself."""
    return file_of(scene(0) + 0.15 * noise(shot.number), quality=95)


@pytest.mark.parametrize(("shots", "repeats"), [(standing_still, 0), (lambda _: noisy(0), 59)])
def test_a_check_of_the_video_says_of_repeats_what_one_of_the_jpeg_files_said(
    tmp_path: Path, shots: Any, repeats: int
) -> None:
    folder = in_two_files(filmed(tmp_path / "source", shots, length_s=4.0), tmp_path)
    (before,) = check(open_episode(folder)).pictures
    assert compact(folder, tmp_path, crf=30).state == "compacted"
    reader = open_episode(folder)
    pixels = [rgb(frame.data).tobytes() for frame in frames(reader, HEAD)]
    assert sum(one == other for one, other in pairwise(pixels)) > 20
    (after,) = check(reader).pictures
    assert (before.repeats, after.repeats) == (repeats, repeats)
    assert (after.frozen_s, after.still_s, after.pictures) == (before.frozen_s, before.still_s, before.pictures)


def test_the_verdict_on_the_jpeg_files_stands_for_the_video(episode: Episode) -> None:
    write_measured(episode.folder, check(open_episode(episode.folder)))
    verdict = load_manifest(episode.folder).quality["verdict"]
    compact(episode.folder, episode.data)
    standing = stands(open_episode(episode.folder))
    assert standing is not None
    assert standing.verdict == verdict == note_of(episode.folder).verdict
    assert "changed" not in {reason.rule for reason in check(open_episode(episode.folder)).reasons}


@pytest.mark.parametrize("files", [[{"name": "cameras.mcap", "bytes": 1}], "none of ours"])
def test_a_verdict_on_other_files_stands_no_more_than_before(episode: Episode, files: object) -> None:
    write_measured(episode.folder, check(open_episode(episode.folder)))
    manifest = load_manifest(episode.folder)
    manifest.quality["files"] = files
    save_manifest(manifest, episode.folder)
    compact(episode.folder, episode.data)
    assert stands(open_episode(episode.folder)) is None
    assert note_of(episode.folder).verdict == ""


def test_depth_stays_as_it_was_byte_for_byte_and_says_so(tmp_path: Path) -> None:
    shots, folder = Scene(), tmp_path / "walk" / "2026-11-21-g1-walk-0001"
    batches: list[list[Write]] = []
    for number in range(3 * GOP):
        picture = shots.picture(data=jpeg(number))
        batches.append([picture, picture._replace(key=DEPTH, value=depth.encoded(steps(number)))])
    film(folder, batches, shots.anchor)
    before = [message for message in messages(folder) if message.topic == DEPTH]
    done = compact(folder, tmp_path, gop=GOP)
    assert (done.state, done.kept, done.pictures) == ("compacted", [DEPTH], 3 * GOP)
    assert set(note_of(folder).cameras) == {HEAD}
    after = [message for message in messages(folder) if message.topic == DEPTH]
    assert [message[1:5] for message in after] == [message[1:5] for message in before]
    assert [message.stamp for message in after] == [message.stamp for message in before]
    assert {message.channel.video for message in after} == {""}
    with (folder / "cameras.mcap").open("rb") as file:
        kinds = {channel.topic: kind.name for kind, channel, _ in make_reader(file).iter_messages() if kind is not None}
    assert kinds == {HEAD: "foxglove.CompressedVideo", DEPTH: "foxglove.CompressedImage"}
    assert compact(folder, tmp_path).state == "current"
    assert check(open_episode(folder)).pictures[1].torn.count == 0


def test_an_episode_with_depth_alone_is_left_as_it_is(tmp_path: Path) -> None:
    shots, folder = Scene(), tmp_path / "walk" / "2026-11-21-g1-walk-0001"
    film(folder, [[shots.picture(key=DEPTH, data=depth.encoded(steps(n)))] for n in range(5)], shots.anchor)
    before = (folder / "cameras.mcap").read_bytes()
    done = compact(folder, tmp_path)
    assert (done.state, done.kept) == ("no-pictures", [DEPTH])
    assert (folder / "cameras.mcap").read_bytes() == before


def test_without_pyav_a_compacted_episode_is_counted_and_whoever_looks_is_told_what_to_install(
    episode: Episode, monkeypatch: pytest.MonkeyPatch
) -> None:
    compact(episode.folder, episode.data)
    monkeypatch.setitem(sys.modules, "av", None)
    counts = {stream.key: stream.count for stream in count_streams(open_episode(episode.folder)) if stream.source}
    assert (counts[HEAD], counts[WRIST]) == (34, 17)
    with pytest.raises(StationError, match=r"teleop-station\[video\]"):
        next(frames(open_episode(episode.folder), HEAD))
