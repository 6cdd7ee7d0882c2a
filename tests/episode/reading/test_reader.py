from __future__ import annotations

import random
import time
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import Writer

from adapters.robots.g1 import twist_keys
from station.bus import codec, keys
from station.bus.tap import Write
from station.episode.reading.reader import EpisodeReader, open_episode
from station.episode.recorder.writer import EpisodeWriter
from station.episode.storage.anchor import read_anchor
from station.episode.storage.manifest import Manifest, dump_manifest
from station.episode.storage.progress import WriterOptions
from station.errors import EpisodeError
from tests.episode.writes import Native, foreign
from tests.waiting import wait_until

BODY = twist_keys.action_body()
STATE = keys.robot_state(twist_keys.TWIST2_ROBOT)
FLUSHES, PER_FLUSH = 20, 25


def record(folder: Path, *batches: list[Write], finish: bool = True) -> Path:
    """Write batches, one flush each, and return the file."""
    folder.mkdir(parents=True, exist_ok=True)
    writer = EpisodeWriter(
        folder, anchor=read_anchor(), manifest=Manifest(episode_id=folder.name), options=WriterOptions(flush_bytes=1)
    )
    written = 0
    for batch in batches:
        writer.put(batch)
        written += len(batch)
        wait_until(lambda n=written: writer.messages == n and writer.size > 0)  # type: ignore[misc]
    writer.finish(lambda totals: Manifest(episode_id=folder.name, state="finished", streams=totals.streams))
    assert writer.wait(30.0)
    if finish:
        return folder / "signals.mcap"
    return (folder / "signals.mcap").rename(folder / "signals.mcap.active")


def numbered(count: int) -> list[Write]:
    g1 = Native()
    return [g1.write(BODY if n % 2 else "own", codec.json_vector([float(n)] * 35)) for n in range(count)]


@pytest.fixture(scope="module")
def many_flushes(tmp_path_factory: pytest.TempPathFactory) -> tuple[bytes, list[bytes]]:
    """A whole file of many flushes, and the values in it."""
    writes = numbered(FLUSHES * PER_FLUSH)
    batches = [writes[n : n + PER_FLUSH] for n in range(0, len(writes), PER_FLUSH)]
    file = record(tmp_path_factory.mktemp("data") / "e", *batches)
    return file.read_bytes(), [write.value or b"" for write in writes]


def test_a_file_cut_anywhere_yields_its_whole_chunks_and_nothing_wrong(
    tmp_path: Path, many_flushes: tuple[bytes, list[bytes]]
) -> None:
    data, values = many_flushes
    file = tmp_path / "signals.mcap.active"
    seed = random.Random(7)
    found_counts = set()
    for cut in [len(data) - 1, *(seed.randrange(2_000, len(data)) for _ in range(150))]:
        file.write_bytes(data[:cut])
        reader = open_episode(file)
        found = [message.data for message in reader.messages()]
        assert found == values[: len(found)]
        assert reader.is_active
        assert reader.torn is not None
        assert f"of {cut}" in reader.torn or "not finished" in reader.torn
        found_counts.add(len(found))
    assert len(found_counts) > 10


def test_a_file_whose_end_is_zeros_or_rubbish_yields_what_is_whole(
    tmp_path: Path, many_flushes: tuple[bytes, list[bytes]]
) -> None:
    data, values = many_flushes
    length = len(data) // 4
    for tail in (bytes(length), random.Random(1).randbytes(length)):
        (tmp_path / "signals.mcap.active").write_bytes(data[: len(data) // 2] + tail)
        found = [message.data for message in open_episode(tmp_path / "signals.mcap.active").messages()]
        assert 100 < len(found) < len(values)
        assert found == values[: len(found)]


def test_damage_in_the_middle_of_a_finished_file_is_an_error_that_says_where(
    tmp_path: Path, many_flushes: tuple[bytes, list[bytes]]
) -> None:
    data = bytearray(many_flushes[0])
    file = tmp_path / "signals.mcap"
    file.write_bytes(data)
    place = EpisodeReader(file).parts[0].contents.chunks[FLUSHES // 2]
    data[place.offset + place.length - 5] ^= 0xFF
    file.write_bytes(data)
    reader = open_episode(tmp_path)
    with pytest.raises(EpisodeError, match=rf"chunk at byte {place.offset} is damaged: .*copy the file"):
        list(reader.messages())


def test_from_an_instant_on_nothing_before_it_is_read(tmp_path: Path, many_flushes: tuple[bytes, list[bytes]]) -> None:
    data, values = bytearray(many_flushes[0]), many_flushes[1]
    file = tmp_path / "signals.mcap"
    file.write_bytes(data)
    chunks = EpisodeReader(file).parts[0].contents.chunks
    for place in chunks[: FLUSHES // 2]:
        data[place.offset + place.length - 5] ^= 0xFF
    file.write_bytes(data)
    found = [
        message.data for message in open_episode(tmp_path).messages_from([BODY, "own"], chunks[FLUSHES // 2].end_ns)
    ]
    assert found == values[FLUSHES // 2 * PER_FLUSH :]


def test_a_file_without_manifest_yaml_tells_its_own(tmp_path: Path, many_flushes: tuple[bytes, list[bytes]]) -> None:
    (tmp_path / "signals.mcap").write_bytes(many_flushes[0])
    reader = open_episode(tmp_path)
    assert reader.episode_id == "e"
    assert reader.manifest.state == "finished"
    assert reader.anchor is not None
    assert set(reader.metadata()) == {"station.anchor", "station.episode", "station.summary"}


def test_vectors_come_as_arrays_and_what_does_not_fit_is_counted(tmp_path: Path) -> None:
    g1 = Native()
    good = np.arange(35, dtype=float)
    state = np.linspace(-1, 1, 65)
    batch = [
        g1.write(BODY, codec.json_vector(good)),
        g1.write(BODY, b"[1, 2]"),
        g1.write(BODY, b"broken"),
        foreign(BODY, codec.json_vector(good + 1)),
        g1.write(STATE, codec.f64(state)),
        g1.write(STATE, b"odd"),
        foreign(STATE, None),
        g1.write(keys.policy_obs("g1"), codec.f32([1, 2, 3])),
        g1.write(twist_keys.T_ACTION, b"1795000000000"),
        g1.write(keys.EVENT, b'{"name": "fall"}'),
        g1.write("unknown", b"[1]"),
    ]
    record(tmp_path, batch)
    reader = open_episode(tmp_path)
    body = reader.vectors(BODY)
    assert np.array_equal(body.values, [good, good + 1])
    assert body.values.dtype == np.float64
    assert body.log_ns.shape == body.publish_ns.shape == (2,)
    assert np.array_equal(reader.vectors(BODY, source="").values, [good + 1])
    assert np.array_equal(reader.vectors(STATE).values, [state])
    assert (reader.vectors(keys.policy_obs("g1")).values == np.float32([[1, 2, 3]])).all()
    assert reader.vectors(twist_keys.T_ACTION).values.tolist() == [[1_795_000_000_000]]
    assert reader.vectors("absent").values.shape[0] == 0
    reader.vectors(BODY)
    assert reader.skipped == {BODY: 2, STATE: 1, keys.policy_obs("g1"): 0, twist_keys.T_ACTION: 0, "absent": 0}
    assert [value for _, value in reader.json(keys.EVENT)] == [{"name": "fall"}]
    for topic, words in (("unknown", "no contract"), (keys.EVENT, "kind json")):
        with pytest.raises(EpisodeError, match=words):
            reader.vectors(topic)


def test_streams_tell_writers_apart_and_leave_out_the_bookkeeping(tmp_path: Path) -> None:
    one, two = Native("motion"), Native("pico")
    record(tmp_path, [one.write(BODY, b"[1]"), two.write(BODY, b"[2]"), two.write(BODY, b"[3]"), foreign(BODY, None)])
    streams = open_episode(tmp_path).streams()
    assert [(s.channel.topic, s.channel.writer, s.count, s.channel.is_deletion) for s in streams] == [
        (BODY, "motion", 1, False), (BODY, "pico", 2, False), (BODY, "foreign", 1, True),
    ]  # fmt: skip
    assert streams[0].channel.source == one.source
    assert streams[0].channel.contract is not None


def test_a_channel_whose_messages_are_none_is_no_key_of_an_episode(tmp_path: Path) -> None:
    with (tmp_path / "signals.mcap").open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="teleop-station")
        for topic in ("silent", "spoken"):
            number = writer.register_channel(topic, "json", 0)
        writer.add_message(number, 1, b"{}", 1)
        writer.finish()
    (tmp_path / "manifest.yaml").write_bytes(dump_manifest(Manifest(episode_id="e")))
    assert open_episode(tmp_path).topics() == ["spoken"]


def test_log_order_sorts_across_chunks_and_file_order_keeps_arrival(tmp_path: Path) -> None:
    now = time.monotonic_ns()
    offsets = [[5, 1], [3, 9], [2, 8], [12, 11]]
    batches = [[Write("k", b"%d" % ms, None, now + ms * 1_000_000) for ms in chunk] for chunk in offsets]
    record(tmp_path, *batches)
    reader = open_episode(tmp_path)
    assert [int(m.data) for m in reader.messages()] == [5, 1, 3, 9, 2, 8, 12, 11]
    assert [int(m.data) for m in reader.messages(order="log")] == [1, 2, 3, 5, 8, 9, 11, 12]
    assert [int(m.data) for m in reader.messages(["k"], order="log", stamps=True)] == [1, 2, 3, 5, 8, 9, 11, 12]


def test_stamps_are_joined_in_a_torn_file_too(tmp_path: Path) -> None:
    writes = numbered(100)
    file = record(tmp_path, writes[:50], writes[50:], finish=False)
    data = file.read_bytes()
    last_chunk = EpisodeReader(file).parts[0].contents.chunks[-1].offset
    file.write_bytes(data[: last_chunk + 20])
    found = list(open_episode(file).messages(stamps=True))
    assert [m.stamp for m in found] == [write.stamp for write in writes[:50]]


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "not an MCAP file"),
        (b"hello" * 100, "not an MCAP file"),
        (None, "profile 'ros2', expected 'teleop-station'"),
    ],
)
def test_what_is_no_episode_is_refused_in_one_line(tmp_path: Path, content: bytes | None, words: str) -> None:
    file = tmp_path / "signals.mcap"
    if content is None:
        with file.open("wb") as stream:
            writer = Writer(stream)
            writer.start(profile="ros2")
            writer.finish()
    else:
        file.write_bytes(content)
    with pytest.raises(EpisodeError, match=words) as caught:
        open_episode(tmp_path)
    assert str(file) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_folder_with_a_manifest_but_no_signals_is_refused(tmp_path: Path) -> None:
    (tmp_path / "manifest.yaml").write_bytes(dump_manifest(Manifest(episode_id="e")))
    with pytest.raises(EpisodeError, match="no signals in it"):
        open_episode(tmp_path)


def test_reading_is_far_faster_than_real_time(tmp_path: Path) -> None:
    g1 = Native()
    vector = codec.json_vector(np.linspace(-1, 1, 35))
    record(tmp_path, [g1.write(BODY, vector) for _ in range(30_000)])
    reader = open_episode(tmp_path)
    begun = time.process_time()
    assert sum(1 for _ in reader.messages()) == 30_000
    assert 30_000 / (time.process_time() - begun) > 60_000  # messages a second; measured 470 000
