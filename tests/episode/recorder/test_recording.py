from __future__ import annotations

import resource
import shutil
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from adapters.robots.g1 import twist_keys
from servers.recorder import RecorderConfig
from station.bus import keys
from station.bus.tap import Write
from station.config import build
from station.episode.reading.listing import list_episodes
from station.episode.reading.reader import open_episode
from station.episode.recorder.active_episode import ActiveEpisode
from station.episode.recorder.options import RecordingOptions
from station.episode.recorder.recording import Recording
from station.episode.recorder.writer import EpisodeWriter
from station.episode.storage.anchor import read_anchor
from station.episode.storage.folder import new_folder
from station.episode.storage.manifest import Manifest, Recorder, load_manifest
from station.episode.storage.progress import WriterOptions
from station.episode.storage.request import RecordAnswer
from station.errors import ConfigError
from tests.episode.writes import Native, foreign
from tests.waiting import wait_until

BODY = twist_keys.action_body()
SECOND = 1_000_000_000
Make = Callable[..., Recording]


@pytest.fixture
def make(tmp_path: Path) -> Iterator[Make]:
    made: list[Recording] = []

    def build(**options: Any) -> Recording:
        chosen = {"data": tmp_path, "min_free_mb": 0.0, **options}
        made.append(Recording(RecordingOptions(**chosen), backend="replication", is_lossless=True, bus="unix:///x"))
        return made[-1]

    yield build
    for recording in made:
        recording.close()


def answer(recording: Recording) -> RecordAnswer:
    """Poll until there is an answer."""
    found: list[RecordAnswer] = []

    def arrived() -> bool:
        recording.poll()
        next_one = recording.answers.next()
        found.extend([next_one] if next_one else [])
        return bool(found)

    wait_until(arrived)
    return found[0]


def health(server: Native, name: str = "g1", role: str = "low-level", state: str = "active") -> Write:
    return server.json(keys.server(name), name=name, role=role, state=state, pid=1)


def stated(server: Native, name: str = "g1", **facts: Any) -> Write:
    policy = {"name": "twist2", "checkpoint": "c.onnx", "sha256": "ab", "rate_hz": 50, "kp": [1.0, 2.0]}
    base = {"server": name, "role": "low-level", "robot": twist_keys.TWIST2_ROBOT, "robot_facts": {"model": "m.xml"}}
    return server.json(keys.server_config(name), **base, policy=policy, **facts)


def test_an_episode_holds_exactly_what_lies_between_start_and_stop_and_the_preroll(make: Make) -> None:
    recording, g1, cli = make(preroll_s=1.0), Native(), Native("record")
    now = time.monotonic_ns()
    old = [g1.write(BODY, b"[%d]" % n, written_ns=now - 3 * SECOND + n) for n in range(5)]
    just_before = [g1.write(BODY, b"[%d]" % n, written_ns=now - SECOND // 2 + n) for n in range(5)]
    start, stop = cli.request("start", task="walk"), cli.request("stop", success=True)
    within = [g1.write(BODY, b"[%d]" % n) for n in range(7)]
    after = [g1.write(BODY, b"[99]")]
    recording.feed([*old, *just_before])
    recording.feed([start, *within, stop, *after])
    first, last = answer(recording), answer(recording)
    assert (first.id, first.ok, last.id, last.ok) == ("start", True, "stop", True)
    reader = open_episode(Path(last.path or ""))
    found = list(reader.messages(stamps=True))
    assert [(m.topic, m.data, m.stamp) for m in found] == [
        (w.key, w.value, w.stamp) for w in [*just_before, start, *within, stop]
    ]
    assert reader.anchor is not None
    assert all((m.log_ns < reader.anchor.wall_ns) == (m.stamp in {w.stamp for w in just_before}) for m in found)
    assert [m.sequence for m in found if m.topic == BODY] == list(range(6, 18))
    assert last.summary["messages"] == len(found) == reader.manifest.recorder.messages
    assert last.summary["lost"] == 0
    assert reader.manifest.quality_flags.success is True
    assert reader.manifest.timing.preroll_s == pytest.approx(0.5, abs=0.4)
    assert reader.manifest.recorder.ended_by == "stop"


def test_an_episode_ends_when_that_was_asked_for_however_late_its_recorder_hears_of_it(make: Make) -> None:
    recording, g1, cli, now = make(preroll_s=0.0), Native(), Native("record"), time.monotonic_ns()
    start, within = cli.request("start"), [g1.write(BODY, b"[%d]" % n, written_ns=now + n * SECOND) for n in range(3)]
    asked = cli.json(keys.RECORD, written_ns=now + 3 * SECOND, id="stop", action="stop")
    recording.feed([start, *within, asked._replace(mono_ns=now + 5 * SECOND)])
    answer(recording)
    timing = load_manifest(Path(answer(recording).path or "")).timing
    assert timing.duration_s == pytest.approx(3.0, abs=0.1)


@pytest.mark.parametrize("stamp", [b"1 1 1 record.1.otherboot.ab", b"nonsense", None])
def test_where_a_stop_does_not_say_when_it_was_written_its_arrival_counts(make: Make, stamp: bytes | None) -> None:
    recording, cli, now = make(preroll_s=0.0), Native("record"), time.monotonic_ns()
    asked = cli.request("stop")._replace(mono_ns=now + 5 * SECOND, stamp=stamp)
    recording.feed([cli.request("start"), asked])
    answer(recording)
    assert load_manifest(Path(answer(recording).path or "")).timing.duration_s == pytest.approx(5.0, abs=0.1)


def test_without_preroll_an_episode_begins_behind_the_request(make: Make) -> None:
    recording, g1, cli = make(preroll_s=0.0), Native(), Native("record")
    recording.feed([g1.write(BODY, b"[0]"), cli.request("start"), g1.write(BODY, b"[1]"), cli.request("stop")])
    answer(recording)
    path = Path(answer(recording).path or "")
    assert [m.topic for m in open_episode(path).messages()] == [BODY, keys.RECORD]


def test_episodes_follow_each_other_in_one_batch(make: Make, tmp_path: Path) -> None:
    recording, cli = make(preroll_s=0.0), Native("record")
    recording.feed([cli.request(action, f"{action}{n}", task="t") for n in range(3) for action in ("start", "stop")])
    answers = {found.id: found for found in (answer(recording) for _ in range(6))}
    assert all(found.ok for found in answers.values())
    assert [row.episode_id[-4:] for row in list_episodes(tmp_path)] == ["0001", "0002", "0003"]
    assert {row.state for row in list_episodes(tmp_path)} == {"finished"}


def test_start_is_refused_until_every_living_low_level_server_has_stated_its_configuration(make: Make) -> None:
    recording, cli, g1 = make(), Native("record"), Native("g1")
    recording.feed([health(g1), health(Native("motion"), "motion", "command"), cli.request("start", "1")])
    refusal = answer(recording)
    assert not refusal.ok
    assert "'g1' is up" in refusal.reason
    assert "station:config:g1" in refusal.reason
    recording.feed([stated(Native("g1")), cli.request("start", "2")])  # from the process that ran before
    assert not answer(recording).ok
    recording.feed([stated(g1, note="x"), cli.request("start", "3")])
    accepted = answer(recording)
    assert accepted.ok
    manifest = load_manifest(Path(accepted.path or ""))
    assert "-g1-" in (accepted.episode_id or "")
    assert (manifest.robot.suffix, manifest.robot.facts) == (twist_keys.TWIST2_ROBOT, {"model": "m.xml"})
    assert (manifest.policy.server, manifest.policy.name, manifest.policy.sha256) == ("g1", "twist2", "ab")
    assert manifest.policy.facts["kp"] == [1.0, 2.0]
    assert manifest.servers["g1"]["note"] == "x"
    assert manifest.state == "recording"


@pytest.mark.parametrize("farewell", [True, False])
def test_a_low_level_server_that_is_gone_does_not_hold_up_recording(make: Make, farewell: bool) -> None:
    recording, cli, g1 = make(), Native("record"), Native("g1")
    beat = health(g1, state="finalized" if farewell else "active")
    recording.feed([beat._replace(mono_ns=beat.mono_ns - (0 if farewell else 10 * SECOND)), cli.request("start")])
    assert answer(recording).ok


def test_what_was_said_before_the_tap_was_open_counts(make: Make) -> None:
    recording, cli, g1 = make(), Native("record"), Native("g1")
    for write in (health(g1), stated(g1), cli.request("start", "old")):
        recording.seed(write.key, write.value or b"", write.stamp)
    recording.feed([cli.request("start", "old"), cli.request("start", "new")])
    found = answer(recording)
    assert (found.id, found.ok) == ("new", True)
    assert load_manifest(Path(found.path or "")).policy.name == "twist2"


def test_requests_that_cannot_be_done_are_refused_in_one_line(make: Make, tmp_path: Path) -> None:
    cases = [
        (make(), [("stop", {})], "nothing to stop"),
        (make(), [("mark", {})], "nothing to mark"),
        (make(), [("discard", {})], "nothing to discard"),
        (make(), [("dance", {})], "Invalid enum value 'dance'"),
        (make(), [("start", {"task": 3})], "Expected `str`, got `int`"),
        (make(min_free_mb=1e12), [("start", {})], "MB free, at least 1000000000000 MB wanted"),
        (make(), [("start", {}), ("start", {})], "already recording"),
    ]
    (tmp_path / "file").write_text("")
    cases.append((make(data=tmp_path / "file"), [("start", {})], "cannot make an episode in it: Not a directory"))
    for recording, requests, words in cases:
        cli = Native("record")
        recording.feed([cli.request(action, str(n), **fields) for n, (action, fields) in enumerate(requests)])
        wanted = str(len(requests) - 1)
        found = answer(recording)
        while found.id != wanted:
            found = answer(recording)
        assert not found.ok
        assert words in found.reason
        assert "\n" not in found.reason
        assert any(notice.name == "record-refused" for notice in recording.notices)


def test_a_request_without_id_or_sense_is_answered_and_forgotten(make: Make) -> None:
    recording = make()
    recording.feed([foreign(keys.RECORD, b"\xff\xfe"), foreign(keys.RECORD, b"[]"), foreign(keys.RECORD, None)])
    assert [answer(recording).ok for _ in range(2)] == [False, False]


def test_a_request_that_is_sent_twice_is_done_once_and_answered_twice(make: Make, tmp_path: Path) -> None:
    recording, cli = make(), Native("record")
    recording.feed([cli.request("start", "1")])
    first = answer(recording)
    recording.feed([cli.request("start", "1")])
    assert answer(recording) == first
    assert len(list_episodes(tmp_path)) == 1


def test_a_request_that_came_while_no_tap_was_open_is_done_once(make: Make) -> None:
    recording, cli = make(), Native("record")
    recording.feed([cli.request("start")])
    answer(recording)
    stop = cli.request("stop")
    recording.missed(stop)
    recording.missed(stop)
    found = answer(recording)
    assert (found.id, found.ok) == ("stop", True)
    recording.poll()
    assert recording.answers.next() is None


def test_discard_ends_the_episode_marks_it_and_deletes_nothing(make: Make, tmp_path: Path) -> None:
    recording, cli, g1 = make(), Native("record"), Native()
    recording.feed([cli.request("start"), g1.write(BODY, b"[1]"), cli.request("discard", label="dropped it")])
    answer(recording)
    found = answer(recording)
    assert found.ok
    assert found.summary["discarded"] is True
    manifest = load_manifest(Path(found.path or ""))
    assert manifest.quality_flags.discarded
    assert manifest.marks[0].label == "discarded: dropped it"
    assert sum(1 for _ in open_episode(Path(found.path or "")).messages([BODY])) == 1
    assert [row.is_discarded for row in list_episodes(tmp_path)] == [True]


def test_between_episodes_discard_marks_the_last_one(make: Make) -> None:
    recording, cli = make(), Native("record")
    recording.feed([cli.request("start"), cli.request("stop"), cli.request("discard")])
    found = {item.id: item for item in (answer(recording) for _ in range(3))}
    assert found["discard"].ok
    assert load_manifest(Path(found["stop"].path or "")).quality_flags.discarded
    recording.feed([cli.request("discard", "again")])
    assert answer(recording).episode_id == found["stop"].episode_id


def test_marks_events_and_motions_stand_in_the_manifest(make: Make) -> None:
    recording, cli, g1, motion = make(), Native("record"), Native(), Native("motion")
    source = keys.command_source(twist_keys.TWIST2_ROBOT)
    early = g1.event("gate", to="tracking")
    recording.feed([early._replace(mono_ns=early.mono_ns - SECOND), g1.event("fall", tilt_rad=2.0)])
    operator = {"interface": "pico", "id": "ab", "x": 1}
    recording.feed([cli.request("start", instruction="go", operator=operator, runbook={"steps": [1]})])
    recording.feed([motion.json(source, file="a.pkl", sha256="1", frame=n) for n in range(100)])
    recording.feed([motion.json(source, file="b.pkl", sha256="2", frame=0), g1.event("fall", tilt_rad=1.5)])
    recording.feed([foreign(keys.EVENT, b"rubbish"), g1.event("estop"), g1.event("operator-reset")])
    recording.feed([cli.request("mark", "m1", label="nice", success=False), cli.request("stop")])
    answer(recording)
    answer(recording)
    manifest = load_manifest(Path(answer(recording).path or ""))
    assert [(m["file"], m["frame"], m["key"]) for m in manifest.motions] == [("a.pkl", 0, source), ("b.pkl", 0, source)]
    assert [e.name for e in manifest.events] == ["gate", "fall", "fall", "undecodable", "estop", "operator-reset"]
    assert [e.at_s < 0 for e in manifest.events] == [True, True, False, False, False, False]
    assert manifest.events[2].numbers == {"tilt_rad": 1.5}
    flags = manifest.quality_flags
    assert (flags.falls, flags.estop, flags.operator_reset, flags.success) == (1, True, True, False)
    assert [mark.label for mark in manifest.marks] == ["nice"]
    assert (manifest.task.instruction, manifest.operator.interface) == ("go", "pico")
    assert (manifest.operator.details, manifest.runbook) == ({"x": 1}, {"steps": [1]})
    assert manifest.recorder.software["version"]


def test_the_list_of_events_is_bounded_and_says_so(make: Make) -> None:
    recording, cli, g1 = make(), Native("record"), Native()
    recording.feed([cli.request("start"), *(g1.event("gate", n=n) for n in range(600)), cli.request("stop")])
    answer(recording)
    path = Path(answer(recording).path or "")
    manifest = load_manifest(path)
    assert (len(manifest.events), manifest.events_not_listed) == (500, 100)
    assert sum(1 for _ in open_episode(path).messages([keys.EVENT])) == 600


def test_events_reach_the_manifest_on_disk_while_the_episode_runs(make: Make) -> None:
    recording, cli, g1 = make(), Native("record"), Native()
    recording.feed([cli.request("start")])
    folder = Path(answer(recording).path or "")
    recording.feed([g1.event("fall")])

    def is_saved() -> bool:
        recording.poll()
        return bool(load_manifest(folder).events)

    wait_until(is_saved)
    assert load_manifest(folder).state == "recording"


def test_a_hole_stands_in_the_manifest_and_cuts_the_preroll(make: Make) -> None:
    recording, cli, g1 = make(), Native("record"), Native()
    recording.feed([g1.write(BODY, b"[0]"), cli.request("start", "1")])
    now = time.monotonic_ns()
    recording.hole(now, now + SECOND // 4, "the tap was lost")
    recording.retapped("poll", False)
    recording.feed([cli.request("stop", "2"), cli.request("start", "3"), cli.request("stop", "4")])
    found = {item.id: item for item in (answer(recording) for _ in range(4))}
    manifest = load_manifest(Path(found["2"].path or ""))
    (hole,) = manifest.holes
    assert hole.to_s is not None
    assert hole.to_s - hole.from_s == pytest.approx(0.25, abs=1e-5)
    assert (manifest.recorder.backend, manifest.recorder.is_lossless) == ("replication, then poll", False)
    after = open_episode(Path(found["4"].path or ""))
    assert after.topics() == [keys.RECORD]
    assert after.manifest.recorder.backend == "poll"


def test_a_start_that_a_hole_has_swallowed_is_not_waited_for(make: Make, tmp_path: Path) -> None:
    recording, cli = make(), Native("record")
    recording.ignore_until("swallowed", tmp_path / "reserved")
    recording.hole(0, time.monotonic_ns(), "the tap was lost")
    recording.feed([cli.request("start")])
    assert answer(recording).ok


def test_an_episode_whose_start_a_hole_has_swallowed_goes_on_and_can_be_ended(make: Make, tmp_path: Path) -> None:
    recording, cli = make(), Native("record")
    folder, manifest = new_folder(tmp_path, "walk", "g1"), Manifest(episode_id="e")
    take = ActiveEpisode(EpisodeWriter(folder, anchor=read_anchor(), manifest=manifest), manifest, start_id="swallowed")
    recording.resume(take, [], awaited="swallowed")
    recording.hole(0, time.monotonic_ns(), "the tap was lost")
    recording.feed([Native().write(BODY, b"[0]"), cli.request("stop")])
    found = {item.id: item.ok for item in (answer(recording) for _ in range(2))}
    assert found == {"swallowed": True, "stop": True}
    assert [message.data for message in open_episode(folder).messages([BODY])] == [b"[0]"]


def test_a_request_that_the_recorder_before_has_done_is_answered_and_not_done_again(make: Make, tmp_path: Path) -> None:
    recording, cli = make(), Native("record")
    folder, manifest = new_folder(tmp_path, "walk", "g1"), Manifest(episode_id="e")
    take = ActiveEpisode(EpisodeWriter(folder, anchor=read_anchor(), manifest=manifest), manifest, start_id=None)
    recording.resume(take, ["marked"])
    recording.feed([cli.request("mark", "marked", label="again")])
    assert (answer(recording).id, manifest.marks) == ("marked", [])


def test_a_disk_that_goes_away_is_an_event_and_a_state_and_the_next_episode_works(make: Make) -> None:
    recording, cli, g1 = make(writer=WriterOptions(flush_s=0.01)), Native("record"), Native()
    recording.feed([cli.request("start", "1", task="a")])
    shutil.rmtree(Path(answer(recording).path or ""))

    def failed() -> bool:
        recording.feed([g1.write(BODY, b"[1]")])
        recording.poll()
        return recording.state().state == "idle"

    wait_until(failed)
    assert "No such file" in recording.state().error
    assert "record-failed" in [notice.name for notice in recording.notices]
    recording.feed([cli.request("stop", "2"), cli.request("start", "3", task="b"), cli.request("stop", "4")])
    found = {item.id: item for item in (answer(recording) for _ in range(3))}
    assert [found[asker].ok for asker in "234"] == [False, True, True]


def test_a_start_on_a_full_disk_is_answered_with_the_reason_and_leaves_nothing(make: Make, tmp_path: Path) -> None:
    recording, cli = make(), Native("record")
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, hard))  # Python ignores the signal, so every write fails
    try:
        recording.feed([cli.request("start", task="walk")])
        found = answer(recording)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert not found.ok
    assert "File too large" in found.reason
    assert list((tmp_path / "walk").iterdir()) == []


def test_a_discard_of_an_episode_whose_folder_is_gone_is_answered_with_that(make: Make) -> None:
    recording, cli, g1 = make(), Native("record"), Native()
    recording.feed([cli.request("start")])
    folder = Path(answer(recording).path or "")
    shutil.rmtree(folder)
    recording.feed([g1.write(BODY, b"[1]"), cli.request("stop"), cli.request("discard")])
    found = {item.id: item for item in (answer(recording) for _ in range(2))}
    assert [found[asker].ok for asker in ("stop", "discard")] == [False, False]
    assert "No such file" in found["discard"].reason
    assert recording.state().state == "idle"


def test_closing_ends_the_episode_and_says_why(make: Make) -> None:
    recording, cli = make(), Native("record")
    recording.feed([cli.request("start")])
    path = Path(answer(recording).path or "")
    assert recording.close()
    assert load_manifest(path).recorder.ended_by == "shutdown"
    assert (path / "signals.mcap").exists()
    assert recording.state().state == "idle"


def test_the_interface_is_the_command_server_that_is_up(make: Make) -> None:
    recording, cli, gone, pico = make(), Native("record"), Native("motion"), Native("pico")
    recording.feed([health(gone, "motion", "command", "finalized"), health(pico, "pico", "command")])
    recording.feed([cli.request("start"), cli.request("stop")])
    answer(recording)
    assert load_manifest(Path(answer(recording).path or "")).operator.interface == "pico"


def test_keys_that_are_left_out_by_wish_are_in_no_episode_and_the_manifest_says_which(make: Make) -> None:
    recording, g1, cli = make(preroll_s=1.0, leave_out=("policy_obs",)), Native(), Native("record")
    seen = keys.policy_obs("g1")

    def tick() -> list[Write]:
        return [g1.write(BODY, b"[1]"), g1.write(seen, b"\0\0\0\0"), g1.write(keys.target("g1"), b"[2]")]

    recording.feed(tick())
    start = cli.request("start", task="walk", leave_out=["target_g1"])
    recording.feed([start, *tick(), g1.write(keys.policy_obs("g1").replace("_obs", "_observer"), b"[3]")])
    recording.feed(tick())
    stop = cli.request("stop")
    recording.feed([stop])
    assert answer(recording).ok
    reader = open_episode(Path(answer(recording).path or ""))
    assert set(reader.topics()) == {BODY, keys.RECORD, "policy_observer_g1"}
    assert [message.data for message in reader.messages([BODY])] == [b"[1]"] * 3
    manifest = load_manifest(reader.folder)
    assert manifest.recorder.leave_out == ["policy_obs", "target_g1"]
    assert sum(stream.lost for stream in manifest.streams) == 0, "what is left out is not lost"


def test_an_episode_that_is_taken_up_again_leaves_out_what_its_manifest_says(tmp_path: Path) -> None:
    manifest = Manifest(episode_id="e", recorder=Recorder(leave_out=["policy_obs"]))
    (tmp_path / "e").mkdir()
    writer = EpisodeWriter(tmp_path / "e", anchor=read_anchor(), manifest=manifest)
    take, g1 = ActiveEpisode(writer, manifest), Native()
    take.put([g1.write(keys.policy_obs("g1"), b"1"), g1.write(BODY, b"[1]")], None)
    take.finish("stop", time.monotonic_ns())
    wait_until(lambda: take.is_over)
    assert set(open_episode(tmp_path / "e").topics()) == {BODY}


@pytest.mark.parametrize("name", ["", "station:event"])
def test_what_the_station_says_of_itself_is_never_left_out(make: Make, name: str) -> None:
    with pytest.raises(ConfigError, match="what the station says of itself is always recorded"):
        build(RecorderConfig, {"leave_out": [name]}, where="recorder")
    recording, cli = make(), Native("record")
    recording.feed([cli.request("start", task="walk", leave_out=[name])])
    refused = answer(recording)
    assert not refused.ok
    assert "what the station says of itself is always recorded" in refused.reason
