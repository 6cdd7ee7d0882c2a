"""Another recorder's recording becomes an episode of ours: once, whole, marked, and usable as any other."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from adapters.robots.g1 import twist_keys
from station.episode.quality.check import check
from station.episode.quality.findings import Quality
from station.episode.quality.timing import IMPORTED
from station.episode.reading import frames
from station.episode.reading.listing import list_episodes
from station.episode.reading.reader import open_episode
from station.episode.storage.folder import find_episodes
from station.errors import BadFile
from station.export.jobs import map_episodes
from station.foreign.take_in import ImportJob, ImportResult, import_recording
from tests.foreign.recorded import PERIOD_MS, STARTED_MS, document, jpeg, record
from tests.waiting import DEADLINE_S, wait_until

ENTRIES = 2000

pytestmark = pytest.mark.usefixtures("processes")

ROOT = Path(__file__).parents[2]


def taken(folder: Path, data: Path, **more: str) -> ImportResult:
    return import_recording(ImportJob(format="twist2", path=str(folder), data=str(data), **more))


def test_every_value_and_picture_is_in_the_episode_at_its_time(tmp_path: Path) -> None:
    done = taken(record(tmp_path / "cabinet" / "episode_0003"), tmp_path / "data", instruction="open the cabinet")
    reader = open_episode(done.path)
    assert reader.torn is None
    assert (done.is_new, done.messages, done.are_times_measured) == (True, 60, True)
    body = list(reader.messages([twist_keys.action_body()]))
    assert [m.data for m in body] == [json.dumps([0.01 * n, *[0.5] * 34]).encode() for n in range(5)]
    assert [m.log_ns for m in body] == [(STARTED_MS + n * PERIOD_MS) * 1_000_000 for n in range(5)]
    assert not any(message.channel.is_native for message in reader.messages()), "nobody numbered them"
    cameras = frames.cameras(reader)
    assert list(cameras) == ["rgb"]
    shown = list(frames.frames(reader, cameras["rgb"]))
    assert [frame.data for frame in shown] == [jpeg(n) for n in range(5)]
    assert [frame.captured_ns for frame in shown] == [m.log_ns for m in body]
    manifest = reader.manifest
    assert (manifest.task.name, manifest.task.instruction) == ("cabinet", "open the cabinet")
    assert manifest.recorder.backend == "TWIST2's recorder"
    assert not manifest.recorder.is_lossless


def test_the_manifest_says_what_it_was_made_of_and_what_is_not_known(tmp_path: Path) -> None:
    data = document(3)
    for entry in data["data"]:
        entry |= {"t_img": None, "t_action": None, "t_state": None}
    done = taken(record(tmp_path / "cabinet" / "episode_0000", data), tmp_path / "data")
    assert not done.are_times_measured
    manifest = open_episode(done.path).manifest
    imported = manifest.foreign[IMPORTED]
    assert imported["times"]["source"] == "nominal"
    assert imported["facts"]["text"]["goal"] == "pick up the cup"
    assert "t_img: in no entry" in imported["unknown"]
    assert manifest.timing.started == ""
    assert manifest.timing.duration_s == pytest.approx(2 / 30, abs=1e-6)
    quality = check(open_episode(done.path))
    assert quality.verdict == "usable"
    assert any("times not measured: 30 Hz is nominal" in reason.text for reason in quality.reasons)


def shaking(entries: int, **changes: object) -> dict[str, Any]:
    """A recording in which a wrist jumps from tick to tick."""
    data = document(entries)
    for number, one in enumerate(data["data"]):
        one |= {"state_body": [*[0.0] * 33, 0.8 * (-1) ** number], **changes}
    return data


def rules_of(folder: Path, data: dict[str, Any], place: Path) -> tuple[Quality, set[str]]:
    quality = check(open_episode(taken(record(folder, data), place).path))
    return quality, {reason.rule for reason in quality.reasons}


def test_rules_of_time_do_not_judge_times_that_nobody_measured(tmp_path: Path) -> None:
    data = shaking(40, t_img=None, t_action=None, t_state=None)
    quality, rules = rules_of(tmp_path / "cabinet" / "episode_0000", data, tmp_path / "data")
    assert quality.times_of == "nominal"
    assert rules == {"lossy-tap", "no-steps"}
    assert {"gap", "slow", "camera-gap", "camera-slow", "old-command", "misaligned", "jerky"} <= {*quality.not_judged}


def test_times_of_who_polled_show_gaps_and_say_nothing_of_the_writers(tmp_path: Path) -> None:
    data = shaking(40)
    for one in data["data"][20:]:
        one["t_img"] += 2500
    quality, rules = rules_of(tmp_path / "cabinet" / "episode_0000", data, tmp_path / "data")
    assert quality.times_of == "polled"
    assert rules == {"lossy-tap", "no-steps", "gap", "camera-gap", "camera-drops"}
    assert quality.verdict == "reject"
    assert quality.not_judged["slow"] == quality.not_judged["jerky"]


def test_a_recording_is_taken_in_once_whatever_its_task_is_called(tmp_path: Path) -> None:
    folder, data = record(tmp_path / "cabinet" / "episode_0000"), tmp_path / "data"
    first = taken(folder, data)
    before = sorted((path, path.stat().st_mtime_ns) for path in data.rglob("*"))
    again = taken(folder, data, task="another")
    assert (again.is_new, again.path) == (False, first.path)
    assert sorted((path, path.stat().st_mtime_ns) for path in data.rglob("*")) == before
    other = taken(record(tmp_path / "b" / "episode_0000", document(started_ms=STARTED_MS + 1)), data, task="cabinet")
    assert other.is_new, "the same task and number in another folder is another recording"
    assert [row.task for row in list_episodes(data)] == ["cabinet", "cabinet"]


def test_a_recording_that_turns_out_bad_half_way_leaves_nothing(tmp_path: Path) -> None:
    folder, data = record(tmp_path / "cabinet" / "episode_0000", pictures=4), tmp_path / "data"
    with pytest.raises(BadFile, match=r"data\[4\]\.rgb: 'rgb/000004\.jpg' is not there"):
        taken(folder, data)
    assert list(data.iterdir()) == []
    (folder / "rgb" / "000004.jpg").write_bytes(jpeg(4))
    assert taken(folder, data).is_new


def long_recording(folder: Path) -> Path:
    entries = [{"idx": n, "t_img": STARTED_MS + n, "action_neck": [0.0, 0.0]} for n in range(ENTRIES)]
    return record(folder, {"data": entries}, pictures=0)


def begun(folder: Path, data: Path, task: str = "") -> subprocess.Popen[bytes]:
    """Take a recording in, in a process of its own, which stands still in the middle until it is told to go on."""
    code = """
import os, sys
from station.foreign import take_in as taking
from tests.foreign.test_take_in import *
feed, folder, data, task = taking._feed, Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3]
def feed_and_stop(*arguments):
    feed(*arguments)
    wait_until(lambda: list(data.glob(".importing-*/*.active")))
    os.kill(os.getpid(), signal.SIGSTOP)
taking._feed = feed_and_stop
done = taken(folder, data, task=task)
print(done.is_new, done.path)
"""
    return subprocess.Popen([sys.executable, "-c", code, folder, data, task], cwd=ROOT, stdout=subprocess.PIPE)


def test_one_that_was_killed_in_the_middle_is_no_episode_and_is_done_anew(tmp_path: Path) -> None:
    folder, data = long_recording(tmp_path / "cabinet" / "episode_0000"), tmp_path / "data"
    with begun(folder, data) as process:
        wait_until(lambda: stands_still(process.pid))
        process.send_signal(signal.SIGKILL)
    assert process.returncode == -signal.SIGKILL
    assert find_episodes(data) == []
    done = taken(folder, data)
    assert (done.is_new, done.messages) == (True, 2 * ENTRIES)
    assert [path.name for path in data.iterdir()] == ["cabinet"]


def stands_still(pid: int) -> bool:
    return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] == "T"


def waits_for_a_lock(pid: int) -> bool:
    """Whether a process has opened what only one at a time may lock."""
    try:
        return any(os.readlink(file).endswith(".lock") for file in Path(f"/proc/{pid}/fd").iterdir())
    except FileNotFoundError:  # closed while we looked
        return False


def test_two_processes_that_take_in_the_same_recording_make_one_episode_of_it(tmp_path: Path) -> None:
    folder, data = long_recording(tmp_path / "cabinet" / "episode_0000"), tmp_path / "data"
    with begun(folder, data) as first:
        wait_until(lambda: stands_still(first.pid))
        with begun(folder, data, "another") as second:
            wait_until(lambda: second.poll() is not None or waits_for_a_lock(second.pid))
            first.send_signal(signal.SIGCONT)
            told = [process.communicate(timeout=DEADLINE_S)[0].decode().split() for process in (first, second)]
    (episode,) = find_episodes(data)
    assert told == [["True", str(episode)], ["False", str(episode)]]
    assert (first.returncode, second.returncode) == (0, 0)
    assert [path.name for path in data.iterdir()] == ["cabinet"]


def test_a_data_folder_that_cannot_be_made_is_told_in_a_line(tmp_path: Path) -> None:
    (tmp_path / "data").write_text("a file")
    order = ImportJob(format="twist2", path=str(record(tmp_path / "episode_0000")), data=str(tmp_path / "data"))
    (attempt,) = map_episodes(import_recording, [order], jobs=1)
    assert attempt.error.startswith(f"{tmp_path}/data/.importing-")
    assert attempt.error.endswith(": Not a directory")
