"""Episodes that are damaged, cut short or made by somebody hostile: a clear error or a report, never anything else."""

from __future__ import annotations

import shutil
import struct
import tracemalloc
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
import zstandard
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from adapters.robots.g1 import twist_keys
from station.bus import codec, keys
from station.episode.quality.check import check, write_measured
from station.episode.reading.listing import list_episodes
from station.episode.reading.reader import EpisodeReader, open_episode
from station.episode.reading.show import show
from station.episode.replaying.audit import audit
from station.episode.replaying.replay import Replay, moments
from station.episode.storage import layout
from station.episode.storage.manifest import dump_manifest, load_manifest
from station.episode.storage.records import MAGIC, read_chunk
from station.episode.storage.records import walk as records_of
from station.errors import StationError
from tests.episode.crafted import channel, chunk, frame_that_claims, record, silent_bomb, text
from tests.episode.linear_policy import LinearPolicy
from tests.episode.synthetic import ROBOT, EpisodeBuilder, walk
from tests.examples import examples

_SLACK = 48 << 20  # bytes: what reading takes of any file, however small
FUZZ = settings(max_examples=examples(60), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])

Flips = st.lists(st.tuples(st.floats(0, 1, exclude_max=True), st.integers(1, 255)), min_size=1, max_size=20)
HOSTILE = (
    b"", b"null", b"true", b'"x"', b"[]", b"{}", b"[[]]", b"[null]", b"[1e999]", b"[NaN]", b"[" * 5000,
    b'{"a":' * 5000, b"9" * 5000, b"\xff\xfe", b'{"name": "\\ud800"}', b'{"state": [1], "age_s": "x", "clamped": true}',
    b'{"name": "fall", "detail": {"tilt_rad": NaN, "contacts": [[1]]}}', b'{"phase": ["x"]}', b"\0" * 8, b"\xff" * 520,
    codec.json_object([2**62] * 9), b"[" + b"9" * 60 + b"]", b'["a","a","a","a","a","a","a","a"]', b"[null,1,1,1,1,1]",
    b"[1e308,1e308,1,1,1,1,1,1]", b"\x7f\xf0" * 260,
)  # fmt: skip
TOPICS = (
    twist_keys.action_body(), keys.command_source(ROBOT), keys.robot_state(ROBOT), keys.sim_qpos(ROBOT),
    keys.policy_obs(ROBOT), keys.policy_action(ROBOT), keys.command_gate(ROBOT), keys.command_used(ROBOT),
    keys.policy_timing(ROBOT), keys.target(ROBOT), keys.EVENT, twist_keys.T_ACTION, keys.RECORDER, layout.STAMPS_TOPIC,
    "policy_obs_", "policy_timing_../..", "robot_state_x", "policy_obs_x",
)  # fmt: skip


class Files(NamedTuple):
    """The two files of an episode."""

    signals: bytes
    manifest: bytes

    def __repr__(self) -> str:
        """Keep hypothesis from printing them."""
        return "Files(…)"


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Files:
    """An episode that is fine."""
    builder = EpisodeBuilder(tmp_path_factory.mktemp("whole"))
    walk(builder, seconds=1.0)
    builder.foreign("other", b"abc", at_s=0.5)
    builder.event("fall", at_s=0.9, robot=ROBOT, tilt_rad=1.5)
    servers = {"g1": {"role": "low-level", "robot": ROBOT, "policy": {"name": "linear"}, "config": {"pace": "clock"}}}
    folder = builder.finish({"servers": servers, "holes": [], "motions": [{"file": "walk.pkl"}]})
    return Files((folder / layout.SIGNALS).read_bytes(), (folder / layout.MANIFEST).read_bytes())


@pytest.fixture
def put(tmp_path: Path) -> Callable[[bytes, bytes], Path]:
    """Put an episode of two files into a data folder, in place of the last one."""

    def place(signals: bytes, manifest: bytes) -> Path:
        folder = tmp_path / "data" / "walk" / "2026-11-21-g1-walk-0001"
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        (folder / layout.SIGNALS).write_bytes(signals)
        (folder / layout.MANIFEST).write_bytes(manifest)
        return folder

    return place


def read_everything(folder: Path) -> int:
    """Do all that can be done with an episode offline; return how many of the readings were refused, in one line."""
    assert len(list_episodes(folder.parent.parent)) == 1
    refused = 0
    try:
        reader = open_episode(folder)
    except StationError as error:
        _is_fine(error)
        return 1
    for reading in (_check, _show, _audit, _messages, _values):
        try:
            reading(reader)
        except StationError as error:
            _is_fine(error)
            refused += 1
    return refused


def _is_fine(error: StationError) -> None:
    assert "\n" not in str(error)
    assert str(error)


def _check(reader: EpisodeReader) -> None:
    quality = check(reader)
    codec.json_object(quality)
    if quality.is_finished:
        write_measured(reader.folder, quality)
        load_manifest(reader.folder)


def _show(reader: EpisodeReader) -> None:
    facts = show(reader)
    facts.manifest.streams = facts.streams
    dump_manifest(facts.manifest)


def _audit(reader: EpisodeReader) -> None:
    with np.errstate(all="ignore"):  # the policy of these tests adds what it is given
        audit(reader, policy=LinearPolicy())


def _messages(reader: EpisodeReader) -> None:
    for _ in moments(reader, None, Replay(episode_id="", bus="", roles=[], speed=1.0)):
        pass
    for _ in reader.messages(order="log"):
        pass
    for _ in reader.messages(stamps=True):
        pass


def _values(reader: EpisodeReader) -> None:
    for topic in reader.topics():
        reader.json(topic)
        try:
            reader.vectors(topic)
        except StationError as error:
            _is_fine(error)


def _flipped(data: bytes, flips: list[tuple[float, int]], first: float = 0.0, last: float = 1.0) -> bytes:
    changed = bytearray(data)
    for place, bits in flips:
        changed[min(int((first + place * (last - first)) * len(data)), len(data) - 1)] ^= bits
    return bytes(changed)


def test_a_whole_episode_is_read_by_all_of_these(whole: Files, put: Callable[..., Path]) -> None:
    assert read_everything(put(*whole)) == 0


@FUZZ
@given(flips=Flips)
def test_flipped_bytes_anywhere(whole: Files, put: Callable[..., Path], flips: list[tuple[float, int]]) -> None:
    read_everything(put(_flipped(whole.signals, flips), whole.manifest))


@FUZZ
@given(flips=Flips, is_head=st.booleans())
def test_flipped_bytes_where_the_structure_is(
    whole: Files, put: Callable[..., Path], flips: list[tuple[float, int]], is_head: bool
) -> None:
    first, last = (0.0, 0.02) if is_head else (0.9, 1.0)
    read_everything(put(_flipped(whole.signals, flips, first, last), whole.manifest))


@FUZZ
@given(length=st.floats(0, 1, exclude_max=True))
def test_cut_short_anywhere(whole: Files, put: Callable[..., Path], length: float) -> None:
    read_everything(put(whole.signals[: int(length * len(whole.signals))], whole.manifest))


@FUZZ
@given(flips=st.lists(st.tuples(st.floats(0, 1, exclude_max=True), st.integers(1, 255)), min_size=1, max_size=8))
def test_manifests_with_flipped_bytes(whole: Files, put: Callable[..., Path], flips: list[tuple[float, int]]) -> None:
    read_everything(put(whole.signals, _flipped(whole.manifest, flips)))


@FUZZ
@given(flips=Flips)
def test_damage_that_no_checksum_tells(whole: Files, put: Callable[..., Path], flips: list[tuple[float, int]]) -> None:
    read_everything(put(_rewritten(put(*whole), lambda body: _flipped(body, flips)), whole.manifest))


@FUZZ
@given(
    writes=st.lists(
        st.tuples(st.sampled_from(TOPICS), st.integers(0, len(HOSTILE) - 1), st.booleans()), min_size=1, max_size=40
    )
)
def test_values_that_are_not_what_their_contract_says(
    tmp_path_factory: pytest.TempPathFactory, writes: list[tuple[str, int, bool]]
) -> None:
    builder = EpisodeBuilder(tmp_path_factory.mktemp("values"))
    walk(builder, seconds=0.1)
    for number, (topic, which, is_native) in enumerate(writes):
        at_s, value = 0.1 + number * 0.005, HOSTILE[which]
        if is_native:
            builder.write({topic: value}, at_s=at_s)
        else:
            builder.foreign(topic, value, at_s=at_s)
    folder = builder.finish()
    read_everything(folder)
    check(open_episode(folder))


@pytest.mark.parametrize(
    ("name", "body"),
    [
        ("claims gigabytes", lambda: chunk(b"x" * 100, size=1 << 40, kind="zstd")),
        ("claims gigabytes within", lambda: chunk(frame_that_claims(1 << 40), size=1 << 20, kind="zstd")),
        ("bomb", lambda: chunk(zstandard.compress(bytes(1 << 26)), size=1 << 20, kind="zstd")),
        ("bomb that says nothing", lambda: chunk(silent_bomb(1 << 26), size=1 << 20, kind="zstd")),
        ("unknown compression", lambda: chunk(b"x", size=1, kind="lz4")),
        ("message beyond its chunk", lambda: chunk(record(5, bytes(22), 1 << 60))),
        ("message without a head", lambda: chunk(record(5, bytes(3)))),
        ("message of no channel", lambda: chunk(record(5, bytes(22)))),
        ("channel that is none", lambda: chunk(record(4, bytes(3)))),
        ("channel of endless text", lambda: chunk(record(4, struct.pack("<HHI", 1, 0, 1 << 31)))),
        ("time beyond all clocks", lambda: chunk(channel() + record(5, struct.pack("<HIQQ", 1, 1, 1 << 63, 1)))),
        ("stamps that are none", lambda: chunk(channel() + record(5, struct.pack("<HIQQ", 1, 1, 1, 1) + b"x y"))),
        ("endless record", lambda: record(9, b"x", (1 << 64) - 1)),
        ("zeros", lambda: bytes(1000)),
        ("attachment that is none", lambda: record(9, bytes(5))),
        ("metadata in circles", lambda: record(12, text("a") + struct.pack("<I", 1 << 31))),
    ],
)
def test_records_made_to_harm_are_refused_within_a_bounded_memory(
    whole: Files, put: Callable[..., Path], name: str, body: Callable[[], bytes]
) -> None:
    folder = put(MAGIC + record(1, text(layout.PROFILE) + text("")) + body(), whole.manifest)
    tracemalloc.start()
    try:
        read_everything(folder)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < _SLACK, name


def test_reading_takes_no_more_memory_than_twice_the_file(tmp_path: Path) -> None:
    """Of an episode with pictures, which are what makes files large; then of one with flipped bytes."""
    builder = EpisodeBuilder(tmp_path)
    random = np.random.default_rng(0)
    for number in range(200):
        builder.write({"camera": random.bytes(60_000)}, at_s=0.01 * number)
    folder = builder.finish()
    signals = folder / layout.SIGNALS
    data = signals.read_bytes()
    for place in (None, 40, len(data) // 2, len(data) - 40):
        signals.write_bytes(data if place is None else _flipped(data, [(place / len(data), 255)]))
        tracemalloc.start()
        try:
            read_everything(folder)
            _, peak = tracemalloc.get_traced_memory()
        finally:
            tracemalloc.stop()
        assert peak < 2 * len(data)


def _rewritten(folder: Path, change: Callable[[bytes], bytes]) -> bytes:
    """Return a file with the same chunks, their contents changed, uncompressed and without a checksum."""
    path = folder / layout.SIGNALS
    parts = [MAGIC, record(1, text(layout.PROFILE) + text(""))]
    with path.open("rb") as file:
        parts += [chunk(change(read_chunk(file, place))) for place in records_of(path).chunks]
    return b"".join(parts)


@pytest.mark.parametrize(
    "data", [b"", b"\xff\xfe", b"[" * 100_000, b'{"x":' + b"[" * 100_000, b'{"episode_id": "\xff"}', b'{"size": 1e999}']
)
def test_a_resume_file_that_says_nothing_readable_counts_as_none(
    whole: Files, put: Callable[..., Path], data: bytes
) -> None:
    folder = put(whole.signals, whole.manifest)
    (folder / layout.RESUME).write_bytes(data)
    assert len(list_episodes(folder.parent.parent)) == 1
