"""A verdict is of the files that were judged: others in their place, or another manifest, are said and judged anew."""

from __future__ import annotations

import hashlib
import json
import shutil
import struct
import zlib
from collections.abc import Callable
from io import BytesIO
from pathlib import Path
from typing import Any

import msgspec
import pytest
import yaml
from click.testing import CliRunner
from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Attachment

from station.cli.main import cli
from station.episode.quality import rule_file
from station.episode.quality.check import check, write_measured
from station.episode.quality.standing import standing, stands
from station.episode.reading.listing import EpisodeFilter, list_episodes
from station.episode.reading.reader import EpisodeReader, open_episode
from station.episode.storage import edits, layout
from station.episode.storage.file_hashes import changes, glance, measure
from station.episode.storage.manifest import Mark, load_manifest, save_manifest
from station.episode.storage.tail import body, whole_records
from station.episode.writing.repair import repair
from station.export import verdict
from station.export.kind import Source
from station.report.gather import gather
from tests.episode.filming import Scene, film
from tests.episode.recorded import recorded
from tests.episode.writes import Native

_CHUNK_HEAD = struct.Struct("<BQQQQL")  # opcode, length, first and last time, size, checksum


def episode(data: Path, *, writes: int = 20, task: str = "walk") -> Path:
    g1 = Native()
    return recorded(data, [g1.json("own", number=number) for number in range(writes)], task=task)


def filmed(folder: Path) -> Path:
    """Signals and uncompressed pictures."""
    scene = Scene()
    film(folder, [[*scene.signals(3), scene.picture()], [scene.picture(), *scene.signals(2)]], scene.anchor)
    return folder


def replaced(folder: Path, *, by: Path) -> None:
    """Put the signals of another episode, whole and with right checksums, in the place of its own."""
    shutil.copyfile(by / layout.SIGNALS, folder / layout.SIGNALS)


def retouched(cameras: Path) -> None:
    """Change a byte of a picture in its place, and make the checksum of its chunk right again."""
    data = bytearray(cameras.read_bytes())
    place = EpisodeReader(cameras.with_name(layout.SIGNALS)).parts[1].contents.chunks[0]
    start = place.offset - 9
    *_, size, _ = _CHUNK_HEAD.unpack_from(data, start)
    records = start + _CHUNK_HEAD.size + 4 + 8  # no name of a compression
    data[data.index(b"\xff\xd8", records) + 100] ^= 1  # within the first picture
    checksum = zlib.crc32(data[records : records + size])
    data[start + _CHUNK_HEAD.size - 4 : start + _CHUNK_HEAD.size] = struct.pack("<L", checksum)
    cameras.write_bytes(data)


def touched(folder: Path) -> None:
    """Change one byte, of a record that no checksum covers."""
    data = bytearray((folder / layout.SIGNALS).read_bytes())
    data[data.index(b"station.summary")] ^= 1
    (folder / layout.SIGNALS).write_bytes(data)


def said(folder: Path, *options: str) -> tuple[int, Any]:
    done = CliRunner().invoke(cli, ["check", str(folder), "--json", *options])
    return done.exit_code, json.loads(done.stdout)


def test_the_manifest_of_a_closed_episode_holds_size_and_hash_of_each_file(tmp_path: Path) -> None:
    folder = filmed(tmp_path / "walk" / "e")
    cameras, signals = sorted(load_manifest(folder).files, key=lambda file: file.name)
    for file in (cameras, signals):
        data = (folder / file.name).read_bytes()
        with (folder / file.name).open("rb") as opened:
            reader = make_reader(opened, validate_crcs=True)
            assert reader.get_summary() is not None
        assert (file.bytes, file.summary_crc) == (len(data), f"{struct.unpack('<L', data[-12:-8])[0]:08x}")
    assert signals.sha256 == hashlib.sha256((folder / layout.SIGNALS).read_bytes()).hexdigest()
    assert (cameras.sha256, signals.chunks_sha256) == ("", "")
    assert load_manifest(folder).recorder.bytes == cameras.bytes + signals.bytes
    assert check(open_episode(folder)).changed == []


def test_a_recording_that_was_replaced_after_it_was_closed_is_rejected_with_what_was_expected(tmp_path: Path) -> None:
    folder, other = episode(tmp_path / "a"), episode(tmp_path / "b", writes=30)
    replaced(folder, by=other)
    code, quality = said(folder)
    mine, its = load_manifest(folder).files[0], (other / layout.SIGNALS).stat().st_size
    assert (code, quality["verdict"]) == (1, "reject")
    (reason,) = [reason for reason in quality["reasons"] if reason["rule"] == "changed"]
    assert reason["text"] == (
        f"the recording was changed after it was closed: signals.mcap: expected {mine.bytes} bytes, found {its} bytes"
    )


def test_one_byte_of_the_signals_is_enough(tmp_path: Path) -> None:
    folder = episode(tmp_path)
    touched(folder)
    assert changes(load_manifest(folder).files, glance(folder)) == [], "a list does not read it all"
    (change,) = check(open_episode(folder)).changed
    assert (change.name, change.expected[:7]) == ("signals.mcap", "sha256 ")


def test_a_picture_that_was_retouched_is_found_by_the_checksums_of_the_chunks(tmp_path: Path) -> None:
    folder = filmed(tmp_path / "walk" / "e")
    assert check(open_episode(folder)).changed == []
    retouched(folder / layout.CAMERAS)
    (change,) = check(open_episode(folder)).changed
    assert change.name == "cameras.mcap"
    assert change.expected.startswith("chunks of sha256 ")


@pytest.mark.parametrize("name", [layout.CAMERAS, layout.SIGNALS])
def test_a_file_that_is_gone_or_was_added_is_said(tmp_path: Path, name: str) -> None:
    folder = filmed(tmp_path / "walk" / "e")
    expected = load_manifest(folder).files
    (folder / name).rename(tmp_path / name)
    assert [(one.name, one.found) for one in changes(expected, measure(folder))] == [(name, "not there")]
    assert [(one.name, one.expected) for one in changes(measure(folder), expected)] == [(name, "not there")]


def test_no_verdict_of_another_file_is_taken(tmp_path: Path) -> None:
    data = tmp_path / "data"
    folder, other = episode(data), episode(tmp_path / "b", writes=30)
    write_measured(folder, judged_good(folder))
    assert list_episodes(data)[0].verdict == "good"
    assert [verdict.expect(source(folder), least).verdict for least in ("usable", "any")] == ["good", "good"]
    replaced(folder, by=other)
    (row,) = list_episodes(data)
    assert (row.verdict, row.changed.partition(":")[0]) == ("", "signals.mcap")
    assert list_episodes(data, wanted=EpisodeFilter(least="usable")) == []
    assert "changed after it was closed or checked: signals.mcap" in listed(data)
    assert stands(open_episode(folder)) is None
    with pytest.raises(verdict.NotWanted, match="the recording was changed after it was closed"):
        verdict.expect(source(folder), "usable")
    assert verdict.expect(source(folder), "any").verdict is None, "an export of any has the verdict of no other file"
    (reported,), _ = gather([folder], rule_file.shipped(), named=True)
    assert reported.quality.verdict == "reject"
    assert [reason.rule for reason in reported.quality.reasons if reason.verdict == "reject"][:1] == ["changed"]


def test_a_verdict_of_the_replaced_file_is_none_once_the_own_one_is_back(tmp_path: Path) -> None:
    folder, other = episode(tmp_path / "a"), episode(tmp_path / "b", writes=30)
    shutil.copyfile(folder / layout.SIGNALS, tmp_path / "kept")
    replaced(folder, by=other)
    write_measured(folder, check(open_episode(folder)))
    assert stands(open_episode(folder)) is not None, "it says that the recording was changed, and it is"
    shutil.copyfile(tmp_path / "kept", folder / layout.SIGNALS)
    assert standing(open_episode(folder), rule_file.shipped()).changed == []


def test_an_episode_of_an_earlier_station_has_nothing_to_compare(tmp_path: Path) -> None:
    folder, other = episode(tmp_path / "a"), episode(tmp_path / "b", writes=30)
    forgotten(folder)
    replaced(folder, by=other)
    _, quality = said(folder, "--no-write")
    assert quality["changed"] == []
    assert "changed" not in {reason["rule"] for reason in quality["reasons"]}
    assert quality["files"][0]["bytes"] == (folder / layout.SIGNALS).stat().st_size


def test_its_verdict_is_of_the_file_that_was_checked_all_the_same(tmp_path: Path) -> None:
    folder, other = episode(tmp_path / "a"), episode(tmp_path / "b", writes=30)
    forgotten(folder)
    write_measured(folder, judged_good(folder))
    assert stands(open_episode(folder)) is not None
    touched(folder)
    assert stands(open_episode(folder)) is None
    replaced(folder, by=other)
    assert list_episodes(tmp_path / "a")[0].verdict == ""


def test_a_repair_may_change_files_and_says_so(tmp_path: Path) -> None:
    folder = episode(tmp_path)
    signals = folder / layout.SIGNALS
    before = load_manifest(folder).files[0]
    signals.write_bytes(signals.read_bytes()[:-40])
    assert [change.name for change in check(open_episode(folder)).changed] == ["signals.mcap"]
    assert repair(folder).state == "repaired"
    manifest = load_manifest(folder)
    assert manifest.files == measure(folder)
    assert check(open_episode(folder)).changed == []
    (change,) = manifest.recovery[-1]["changed"]
    assert (change["name"], change["expected"]) == ("signals.mcap", f"{before.bytes} bytes")
    assert repair(folder).state == "whole"


@pytest.mark.parametrize("is_earlier", [False, True], ids=["of today", "of an earlier station"])
def test_a_repaired_file_has_each_manifest_once(tmp_path: Path, is_earlier: bool) -> None:
    folder = episode(tmp_path)
    signals = folder / layout.SIGNALS
    data = signals.read_bytes()[:-40]
    if is_earlier:  # the manifests of the start and of the end have one name
        data = renamed_start(data)
    signals.write_bytes(data)
    assert repair(folder).state == "repaired"
    with signals.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        found = {one.name: yaml.safe_load(one.data) for one in reader.iter_attachments()}
        assert [one.name for one in reader.iter_attachments()] == ["manifest.start.yaml", "manifest.yaml"]
    assert (found["manifest.start.yaml"]["state"], found["manifest.yaml"]["state"]) == ("recording", "finished")


def renamed_start(data: bytes) -> bytes:
    """Return a file without an end as an earlier station wrote it."""
    with BytesIO(data) as file:
        (place,) = (
            place for place in whole_records(file, len(data))
            if place.opcode == Opcode.ATTACHMENT and b"manifest.start.yaml" in body(file, place)
        )  # fmt: skip
        record = Attachment.read(ReadDataStream(BytesIO(body(file, place))))
    record.name, builder = layout.MANIFEST, RecordBuilder()
    record.write(builder)
    return data[: place.offset] + bytes(builder.end()) + data[place.end :]


def test_a_repair_does_not_bless_a_whole_file_of_another_episode(tmp_path: Path) -> None:
    folder, other = episode(tmp_path / "a"), episode(tmp_path / "b", writes=30)
    replaced(folder, by=other)
    assert repair(folder).state == "whole"
    assert [change.name for change in check(open_episode(folder)).changed] == ["signals.mcap"]


EDITS: dict[str, Callable[[Any], None]] = {
    "task.name": lambda manifest: setattr(manifest.task, "name", "dance"),
    "task.instruction": lambda manifest: setattr(manifest.task, "instruction", "fall over"),
    "operator.id": lambda manifest: setattr(manifest.operator, "id", "somebody else"),
    "servers.g1": lambda manifest: manifest.servers.update(g1={"software": {"revision": "another"}}),
    "timing.started": lambda manifest: setattr(manifest.timing, "started", "2020-01-01T00:00:00+00:00"),
    "timing.anchor.wall_ns": lambda manifest: setattr(
        manifest.timing, "anchor", msgspec.structs.replace(manifest.timing.anchor, wall_ns=1)
    ),
    "motions": lambda manifest: manifest.motions.append({"file": "other.pkl"}),
    "recorder.software.revision": lambda manifest: manifest.recorder.software.update(revision="another"),
}


@pytest.mark.parametrize("field", EDITS)
def test_a_manifest_that_says_other_than_the_recording_is_rejected_by_the_name_of_the_field(
    tmp_path: Path, field: str
) -> None:
    folder = episode(tmp_path)
    write_measured(folder, judged_good(folder))
    manifest = load_manifest(folder)
    EDITS[field](manifest)
    save_manifest(manifest, folder)
    assert stands(open_episode(folder)) is None, "the verdict is of what the manifest said before"
    quality = check(open_episode(folder))
    assert quality.manifest_changed == [field]
    (reason,) = [reason for reason in quality.reasons if reason.rule == "manifest-changed"]
    assert reason.verdict == "reject"
    assert reason.text == f"the manifest says other than the recording itself, in {field}"


def test_what_people_say_of_it_later_may_change(tmp_path: Path) -> None:
    folder = episode(tmp_path)
    write_measured(folder, judged_good(folder))
    manifest = load_manifest(folder)
    manifest.quality_flags.success = True
    manifest.marks.append(Mark(at_s=0.1, label="later"))
    manifest.foreign["tags"] = ["shown to visitors"]
    save_manifest(manifest, folder)
    assert check(open_episode(folder)).manifest_changed == []


def test_another_task_that_is_noted_as_a_change_of_somebody_is_no_forgery(tmp_path: Path) -> None:
    folder = edits.rename_task(episode(tmp_path), tmp_path, "fetch", by="anna")
    edits.change_tags(folder, tmp_path, ["blue"], [], by="anna")
    assert check(open_episode(folder)).manifest_changed == []
    _, folder = edits.undo(edits.undo(folder, tmp_path, by="anna")[1], tmp_path, by="anna")
    assert check(open_episode(folder)).manifest_changed == [], "tags and task are what they were"
    folder = edits.rename_task(folder, tmp_path, "fetch", by="anna")
    manifest = load_manifest(folder)
    manifest.task.name = "steal"
    save_manifest(manifest, folder)
    assert check(open_episode(folder)).manifest_changed == ["task.name"]


def test_the_first_manifest_inside_has_a_name_of_its_own_and_serves_where_there_is_no_other(tmp_path: Path) -> None:
    folder = episode(tmp_path)
    with (folder / layout.SIGNALS).open("rb") as file:
        names = [attachment.name for attachment in make_reader(file).iter_attachments()]
    assert names == ["manifest.start.yaml", "manifest.yaml"]
    data = (folder / layout.SIGNALS).read_bytes()
    (folder / layout.MANIFEST).unlink()
    (folder / layout.SIGNALS).unlink()
    (folder / layout.ACTIVE).write_bytes(data[: data.index(b"station.summary") - 200])
    assert open_episode(folder).manifest.task.name == "walk"


def judged_good(folder: Path) -> Any:
    quality = check(open_episode(folder))
    quality.verdict, quality.reasons = "good", []
    return quality


def forgotten(folder: Path) -> None:
    """Make it one of a station that wrote no hashes."""
    manifest = load_manifest(folder)
    manifest.files = []
    save_manifest(manifest, folder)


def listed(data: Path) -> str:
    return CliRunner().invoke(cli, ["episodes", "list", "--data", str(data)]).stdout


def source(folder: Path) -> Source:
    return Source(episode_id=folder.name, folder=str(folder))
