"""Nothing that others write without end makes a recorder, or a manifest, grow without end."""

from __future__ import annotations

import gc
import json
import tracemalloc
from pathlib import Path

import pytest
from mcap.reader import make_reader
from mcap.records import ChunkIndex

from station.bus import keys
from station.bus.tap import Write
from station.episode.reading.reader import open_episode
from station.episode.recorder.active_episode import ActiveEpisode
from station.episode.recorder.controller import Answers
from station.episode.recorder.options import RecordingOptions
from station.episode.recorder.recording import Recording
from station.episode.recorder.writer import EpisodeWriter
from station.episode.storage.anchor import read_anchor
from station.episode.storage.manifest import MAX_STREAMS, Manifest, Timing, add_recovery, dump_manifest, parse_manifest
from station.episode.storage.progress import Totals, WriterOptions
from station.episode.storage.request import RecordAnswer
from station.episode.storage.tail import Index
from station.episode.writing import chunks
from station.episode.writing.closing import close_manifest
from station.episode.writing.summary import EpisodeSummary, add_event
from tests.episode.writes import Native, foreign
from tests.waiting import wait_until


def writer_in(folder: Path) -> tuple[EpisodeWriter, Manifest]:
    anchor = read_anchor()
    manifest = Manifest(episode_id=folder.name, timing=Timing(anchor=anchor))
    return EpisodeWriter(folder, anchor=anchor, manifest=manifest), manifest


def test_an_hour_of_chunks_leaves_some_megabytes_of_index() -> None:
    places = {channel: 1 << 40 for channel in range(16)}
    index = Index()
    tracemalloc.start()
    try:
        for _ in range(1440):  # a tenth of an hour at 30 MB/s
            index.add(ChunkIndex(8_000_000, 1 << 40, "zstd", 8_000_000, 1 << 60, 500, places, 1 << 60, 8_000_000), {})
        gc.collect()
        assert tracemalloc.get_traced_memory()[0] < 600_000
    finally:
        tracemalloc.stop()


def test_a_client_that_invents_keys_leaves_a_manifest_that_can_be_read(tmp_path: Path) -> None:
    writer, manifest = writer_in(tmp_path)
    writer.put([foreign(f"invented{n}", b"1") for n in range(MAX_STREAMS + 100)])

    def closing(totals: Totals) -> Manifest:
        close_manifest(manifest, writer.anchor, totals)
        return manifest

    writer.finish(closing)
    assert writer.wait(60.0)
    reader = open_episode(tmp_path)
    assert (len(reader.manifest.streams), reader.manifest.streams_not_listed) == (MAX_STREAMS, 100)
    assert len(reader.streams()) == reader.manifest.recorder.messages == MAX_STREAMS + 100


def test_of_a_flood_of_requests_the_newest_are_answered_and_told(tmp_path: Path) -> None:
    recording = Recording(RecordingOptions(data=tmp_path), backend="replication", is_lossless=True)
    cli = Native("record")
    recording.feed([cli.request("mark", f"m{n}") for n in range(5_000)])
    assert len(recording.notices) < 1_000
    assert recording.answers.pop()[-1].id == "m4999"
    answers = Answers()
    for n in range(5_000):
        answers.give(RecordAnswer(id=str(n), ok=True))
    assert len(answers.pop()) < 1_000
    recording.close()


def test_what_a_file_tells_of_requests_and_servers_is_bounded() -> None:
    episode_summary = EpisodeSummary(read_anchor())
    at_ns = read_anchor().wall_ns + 1
    for n in range(2_000):
        episode_summary.on_value(keys.RECORD, json.dumps({"id": f"m{n}", "action": "mark"}).encode(), at_ns)
        episode_summary.on_value(keys.server_config(f"s{n}"), b'{"role": "low-level"}', at_ns)
        episode_summary.on_value(keys.EVENT, b'{"name": "e"}', at_ns)
    assert len(episode_summary.told.requests) < 1_000
    assert episode_summary.told.requests[-1] == "m1999"
    assert len(episode_summary.told.servers) < 1_000
    assert len(episode_summary.told.events) + episode_summary.told.events_not_listed == 2_000


def test_events_that_hold_thousands_of_numbers_leave_a_manifest_that_can_be_read() -> None:
    manifest, event = Manifest(), json.dumps({"name": "e", "detail": {"numbers": [1] * 2_000}}).encode()
    for _ in range(600):
        add_event(manifest, event, 1.0)
    add_event(manifest, b'{"name": "small", "detail": {"n": 1}}', 1.0)
    found = parse_manifest(dump_manifest(manifest), "it")
    assert (len(found.events), found.events_not_listed) == (500, 101)
    assert found.events[0].numbers == {"bytes": len(event)}


def test_a_bus_that_comes_and_goes_without_end_leaves_one_long_last_hole(tmp_path: Path) -> None:
    writer, manifest = writer_in(tmp_path)
    take = ActiveEpisode(writer, manifest)
    start_ns = take.anchor.mono_ns
    for second in range(1_500):
        take.hole(start_ns + second * 1_000_000_000, start_ns + (second + 1) * 1_000_000_000, "gone")
    assert len(manifest.holes) == 1_000
    assert (manifest.holes[-1].from_s, manifest.holes[-1].to_s) == (999.0, 1500.0)
    assert (manifest.holes_not_listed, take.summary()["holes"]) == (500, 1_500)
    writer.finish(lambda _: manifest)
    assert writer.wait(60.0)


def test_a_recorder_that_is_killed_without_end_leaves_the_newest_notes_and_a_count() -> None:
    manifest = Manifest()
    for number in range(1_200):
        add_recovery(manifest, {"kind": "resumed", "away_s": number})
    found = parse_manifest(dump_manifest(manifest), "it")
    assert (len(found.recovery), found.recovery_not_listed) == (500, 700)
    assert found.recovery[-1]["away_s"] == 1_199


def test_taps_that_change_without_end_are_told_with_the_first_and_the_last(tmp_path: Path) -> None:
    recording = Recording(RecordingOptions(data=tmp_path), backend="replication", is_lossless=True)
    cli = Native("record")
    recording.feed([cli.request("start", "r1")])
    for _ in range(500):
        recording.retapped("notifications", is_lossless=False)
        recording.retapped("replication", is_lossless=True)
    take = recording._active
    assert take is not None
    told = take.manifest.recorder.backend
    assert told.startswith("replication, then notifications, then ")
    assert told.endswith("…, then replication")
    assert len(told) < 300
    assert not take.manifest.recorder.is_lossless
    recording.close()


def test_an_index_that_grows_large_is_read_from_the_file_at_the_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(chunks, "_LARGEST_INDEX", 5_000)
    anchor = read_anchor()
    manifest = Manifest(episode_id=tmp_path.name, timing=Timing(anchor=anchor))
    writer = EpisodeWriter(tmp_path, anchor=anchor, manifest=manifest, options=WriterOptions(flush_bytes=5_000))
    for number in range(200):
        writer.put([foreign(f"key{number % 20}", bytes(100))] * 100)  # more than a flush
    wait_until(lambda: writer.queued == 0)
    files = writer._files
    assert files is not None
    wait_until(lambda: not files.signals._writer.is_indexed)
    assert files.signals._writer._index.size == 0
    writer.finish(lambda _: manifest)
    assert writer.wait(60.0)
    with (tmp_path / "signals.mcap").open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_count == 20_000
    assert len(open_episode(tmp_path).topics()) == 20


def test_megabytes_are_not_parsed_to_learn_what_they_are(tmp_path: Path) -> None:
    writer, manifest = writer_in(tmp_path)
    writer.put([Write("large", b"[" + b"1," * 1_000_000 + b"1]", None, 0), Write("small", b"[1]", None, 0)])
    writer.finish(lambda totals: manifest)
    assert writer.wait(60.0)
    assert {s.channel.topic: s.channel.encoding for s in open_episode(tmp_path).streams()} == {
        "large": "application/octet-stream",
        "small": "json",
    }


@pytest.mark.parametrize("count", [9])
def test_no_more_episodes_begin_than_the_disk_closes(tmp_path: Path, count: int) -> None:
    recording = Recording(
        RecordingOptions(data=tmp_path, min_free_mb=0, preroll_s=0.0), backend="replication", is_lossless=True
    )
    cli = Native("record")
    recording.feed([cli.request(action, f"{action}{n}") for n in range(count) for action in ("start", "stop")])
    refused = [answer for answer in recording.answers.pop() if not answer.ok]
    assert refused[0].id == f"start{count - 1}"
    assert "still being closed" in refused[0].reason
    recording.close()
