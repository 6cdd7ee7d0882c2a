"""Pictures go to a file of their own that viewers open; a reader of the episode gets the bytes that were on the bus."""

from __future__ import annotations

import struct
import subprocess
import sys
from pathlib import Path

import msgspec
import pyarrow
import pytest
import zstandard
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Chunk, MessageIndex
from mcap.stream_reader import StreamReader
from rerun.chunk import McapReader

from station.bus import keys
from station.bus.tap import Write
from station.contract import Contract
from station.episode.reading.frames import cameras, frames
from station.episode.reading.reader import open_episode
from station.episode.storage import layout
from station.episode.storage.channels import encoding_of
from station.episode.storage.manifest import Manifest
from tests.enrich.read_back import decoded
from tests.episode.filming import BODY, EXPOSED_NS, HEAD, WRIST, Scene, film


@pytest.fixture(scope="module")
def scene() -> Scene:
    return Scene()


@pytest.fixture(scope="module")
def writes(scene: Scene) -> list[Write]:
    """Signals and the pictures of two cameras, one of them without a stamp."""
    made: list[Write] = []
    for _ in range(20):
        made += [*scene.signals(3), scene.picture(HEAD), *scene.signals(1), scene.picture(WRIST)]
    values = (b"no JPEG at all", b"", None)
    return [*made, *(Write(WRIST, value, None, made[-1].mono_ns + 1_000_000) for value in values)]


@pytest.fixture(scope="module")
def episode(tmp_path_factory: pytest.TempPathFactory, scene: Scene, writes: list[Write]) -> Path:
    folder = tmp_path_factory.mktemp("data") / "e"
    film(folder, [writes[n : n + 12] for n in range(0, len(writes), 12)], scene.anchor)
    return folder


def test_a_picture_is_a_foxglove_image_around_its_exact_bytes(episode: Path, scene: Scene, writes: list[Write]) -> None:
    found = decoded(episode / "cameras.mcap", HEAD)
    sent = [write for write in writes if write.key == HEAD]
    assert {one.schema.name for one in found} == {"foxglove.CompressedImage"}
    assert [one.message.data for one in found] == [write.value for write in sent]
    assert {(one.message.format, one.message.frame_id) for one in found} == {("jpeg", "head")}
    for one, write in zip(found, sent, strict=True):
        taken_ns = one.message.timestamp.seconds * 10**9 + one.message.timestamp.nanos
        assert taken_ns == one.publish_ns - EXPOSED_NS
        assert one.publish_ns == scene.anchor.at(write.mono_ns - 100_000)
    assert [one.sequence for one in found] == list(range(1, 21))
    assert msgspec.json.decode(found[0].channel.metadata["contract"], type=Contract).codec == "jpeg"


def test_the_files_share_out_the_streams_and_the_manifest_says_which_is_where(episode: Path) -> None:
    assert sorted(file.name for file in episode.iterdir()) == ["cameras.mcap", "manifest.yaml", "signals.mcap"]
    with (episode / "signals.mcap").open("rb") as file:
        kept = make_reader(file).get_summary()
    assert kept is not None
    assert {channel.topic for channel in kept.channels.values()} == {BODY, WRIST, "station:recorder:stamps"}
    manifest = open_episode(episode).manifest
    assert {(s.key, s.writer, s.encoding, s.file, s.count) for s in manifest.streams} == {
        (BODY, "g1", "json", "signals.mcap", 80),
        (HEAD, "camera", "protobuf", "cameras.mcap", 20),
        (WRIST, "camera", "protobuf", "cameras.mcap", 20),
        (WRIST, "foreign", "protobuf", "cameras.mcap", 2),
        (WRIST, "foreign", "application/x-deleted", "signals.mcap", 1),
    }
    sizes = [(episode / name).stat().st_size for name in ("signals.mcap", "cameras.mcap")]
    assert (manifest.recorder.messages, manifest.recorder.bytes) == (123, sum(sizes))


def test_every_byte_stamp_and_place_comes_back(episode: Path, writes: list[Write]) -> None:
    reader = open_episode(episode)
    messages = list(reader.messages(stamps=True))
    assert [(m.topic, m.data, m.stamp) for m in messages] == [(w.key, w.value or b"", w.stamp) for w in writes]
    assert [m.data for m in reader.messages()] == [w.value or b"" for w in writes]
    assert [m.data for m in reader.messages(order="log")] == [w.value or b"" for w in writes]
    assert (reader.torn, reader.is_active) == (None, False)
    assert cameras(reader) == {"head": HEAD, "wrist": WRIST}
    assert [frame.captured_ns for frame in frames(reader, HEAD)] == [
        m.publish_ns - EXPOSED_NS for m in messages if m.topic == HEAD
    ]


def test_what_arrived_in_one_instant_keeps_its_order(tmp_path: Path) -> None:
    scene = Scene()
    at_once = [*scene.signals(2), scene.picture(), scene.picture(WRIST), *scene.signals(2), scene.picture()]
    instant_ns = at_once[0].mono_ns
    batches = [[write._replace(mono_ns=instant_ns + 50 * n) for write in at_once] for n in range(4)]
    film(tmp_path / "e", batches, scene.anchor)
    reader = open_episode(tmp_path / "e")
    assert [m.data for m in reader.messages()] == [write.value for batch in batches for write in batch]
    assert [m.data for m in reader.messages(order="log")] == [write.value for batch in batches for write in batch]
    logged = [m.log_ns for m in reader.messages()]
    assert 0 <= max(logged) - scene.anchor.at(instant_ns) < 200


def test_pictures_are_not_compressed_and_signals_are(episode: Path) -> None:
    for name, compression in (("signals.mcap", "zstd"), ("cameras.mcap", "")):
        with (episode / name).open("rb") as file:
            chunks = [r for r in StreamReader(file, emit_chunks=True).records if isinstance(r, Chunk)]
        assert {chunk.compression for chunk in chunks} == {compression}


def test_the_index_of_each_chunk_leads_to_its_messages(episode: Path) -> None:
    wrong, found = [], 0
    for name in ("signals.mcap", "cameras.mcap"):
        with (episode / name).open("rb") as file:
            records = list(StreamReader(file, emit_chunks=True).records)
        data = b""
        for record in records:
            if isinstance(record, Chunk):
                data = zstandard.decompress(record.data) if record.compression else record.data
            elif isinstance(record, MessageIndex):
                for log_ns, at in record.records:
                    opcode, _, channel, _, logged_ns, _ = struct.unpack_from("<BQHIQQ", data, at)
                    found += 1
                    if (opcode, channel, logged_ns) != (Opcode.MESSAGE, record.channel_id, log_ns):
                        wrong.append((name, record.channel_id, log_ns))
    assert wrong == []
    assert found >= 123


def test_without_pictures_there_is_no_file_of_them(tmp_path: Path) -> None:
    scene = Scene()
    manifest: Manifest = film(tmp_path / "e", [scene.signals(3)], scene.anchor)
    assert sorted(file.name for file in (tmp_path / "e").iterdir()) == ["manifest.yaml", "signals.mcap"]
    assert [stream.file for stream in manifest.streams] == ["signals.mcap"]


LOADED = """
import sys, time
from pathlib import Path
from servers import recorder
from station.bus.tap import Write
from station.episode.recorder.writer import EpisodeWriter
from station.episode.storage.anchor import read_anchor
from station.episode.storage.manifest import Manifest
writer = EpisodeWriter(Path(sys.argv[1]), anchor=read_anchor(), manifest=Manifest(episode_id="e"))
writer.put([Write(sys.argv[2], b"1", None, time.monotonic_ns())])
writer.finish(lambda totals: Manifest(episode_id="e", state="finished"))
assert writer.wait(30.0)
print(writer.state, "google.protobuf" in sys.modules)
"""


@pytest.mark.parametrize(("key", "is_loaded"), [(BODY, False), (HEAD, True)])
@pytest.mark.usefixtures("processes")
def test_a_recorder_loads_protobuf_for_pictures_alone(tmp_path: Path, key: str, is_loaded: bool) -> None:
    command = [sys.executable, "-c", LOADED, str(tmp_path), key]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout.split() == ["finished", str(is_loaded)]


@pytest.mark.usefixtures("processes")
def test_rerun_shows_the_pictures_with_no_word_from_us(episode: Path, writes: list[Write]) -> None:
    command = [sys.executable, "-m", "rerun", "mcap", "check", "--full", str(episode / "cameras.mcap")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    blobs = []
    for chunk in McapReader(episode / "cameras.mcap").stream():
        batch = pyarrow.record_batch(chunk.to_record_batch())
        if str(chunk.entity_path) == f"/{HEAD}" and "EncodedImage:blob" in batch.schema.names:
            blobs += [bytes(value[0]) for value in batch.column("EncodedImage:blob").to_pylist()]
    assert blobs == [write.value for write in writes if write.key == HEAD]


@pytest.mark.parametrize(
    ("value", "is_json"),
    [(b"[1, 2]", True), (b"7", True), (b"7\0\0\0", False), ("[1]".encode("utf-16"), False), (b"\xff", False)],
)
def test_what_nothing_describes_is_json_where_it_is_that_in_utf_8(value: bytes, is_json: bool) -> None:
    assert encoding_of(value) == (layout.JSON if is_json else layout.BYTES)


def test_the_manifest_of_a_closed_episode_names_its_cameras(tmp_path: Path) -> None:
    scene = Scene()
    stated = {"key": HEAD, "width": 640, "height": 480, "fps": 30.0, "source": "uvc", "role": "sensor"}
    silent = {"key": keys.camera_image("left"), "fps": 30.0}
    batches = [[*scene.signals(2), scene.picture(HEAD), scene.picture(WRIST)], [scene.picture(HEAD)]]
    manifest = film(tmp_path / "walk-0001", batches, scene.anchor, servers={"head": stated, "left": silent})
    assert manifest.cameras == [
        {"name": "head", "key": HEAD, "pictures": 2, "width": 640, "height": 480, "fps": 30.0},
        {"name": "wrist", "key": WRIST, "pictures": 1},
    ]
