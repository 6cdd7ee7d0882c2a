"""What TWIST2's recorder wrote, read: exact bytes, honest times, and nothing taken on trust."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from adapters.foreign import twist2
from adapters.robots.g1 import twist_keys
from station.bus import keys
from station.errors import BadFile
from station.foreign.kind import ForeignWrite, Recording
from tests.foreign.recorded import PERIOD_MS, STARTED_MS, document, jpeg, record

IMAGE = keys.camera_image("rgb")


def of(recording: Recording, key: str) -> list[ForeignWrite]:
    return [write for write in recording.writes() if write.key == key]


def refused(folder: Path) -> str:
    with pytest.raises(BadFile) as caught:
        list(twist2.read(folder).writes())
    assert "\n" not in str(caught.value)
    return str(caught.value).removeprefix(f"{folder}/")


def test_values_are_the_bytes_that_the_stock_scripts_had_written_and_pictures_their_files(tmp_path: Path) -> None:
    recording = twist2.read(record(tmp_path / "cabinet" / "episode_0007"))
    found = [write.value for write in of(recording, twist_keys.state_body(twist_keys.TWIST2_ROBOT))]
    assert found == [json.dumps([0.1 * n, 1e-05, *[0.0] * 32]).encode() for n in range(5)]
    assert of(recording, twist_keys.state_neck())[0].value == b"[0, 0]"
    assert of(recording, twist_keys.T_ACTION)[1].value == b"%d" % (STARTED_MS + PERIOD_MS - 8)
    assert [write.value for write in of(recording, IMAGE)] == [jpeg(n) for n in range(5)]
    assert (recording.task, recording.number, recording.operator) == ("cabinet", "0007", "ada")
    assert recording.odd == []


def test_times_are_the_recorders_own_clock(tmp_path: Path) -> None:
    recording = twist2.read(record(tmp_path / "episode_0000"))
    assert recording.times.source == "measured"
    assert recording.times.started_ns == STARTED_MS * 1_000_000
    assert [write.at_ns for write in of(recording, IMAGE)] == [n * PERIOD_MS * 1_000_000 for n in range(5)]


@pytest.mark.parametrize(("left", "started_ms"), [("t_action", STARTED_MS - 8), ("t_state", STARTED_MS - 5)])
def test_without_them_whatever_clock_was_written_down_and_went_on(tmp_path: Path, left: str, started_ms: int) -> None:
    data = document()
    for entry in data["data"]:
        for name in ("t_img", "t_action", "t_state"):
            entry[name] = entry[name] if name == left else None
    times = twist2.read(record(tmp_path / "episode_0000", data)).times
    assert (times.source, times.started_ns) == ("measured", started_ms * 1_000_000)
    assert left in times.note


@pytest.mark.parametrize("stamps", [[None] * 4, [STARTED_MS] * 4, [STARTED_MS, STARTED_MS + 9, STARTED_MS + 3, 0]])
def test_times_that_nobody_wrote_down_are_nominal_and_have_no_beginning(tmp_path: Path, stamps: list[Any]) -> None:
    data = document(4)
    data["info"]["image"]["fps"] = 20
    for entry, stamp in zip(data["data"], stamps, strict=True):
        entry |= {"t_img": stamp, "t_action": stamp, "t_state": None}
    recording = twist2.read(record(tmp_path / "episode_0000", data))
    assert (recording.times.source, recording.times.started_ns, recording.times.rate_hz) == ("nominal", None, 20.0)
    assert [write.at_ns for write in of(recording, IMAGE)] == [0, 50_000_000, 100_000_000, 150_000_000]


def test_what_is_missing_is_left_out_and_said(tmp_path: Path) -> None:
    data = document(3)
    data["data"][1]["state_body"] = None
    data["data"][0]["state_body"] = [0.0] * 127
    for entry in data["data"]:
        entry["state_hand_left"] = None
        entry["t_state"] = 17
        entry["depth_ok"] = True
    recording = twist2.read(record(tmp_path / "episode_0000", data))
    assert len(of(recording, twist_keys.state_body(twist_keys.TWIST2_ROBOT))) == 2
    assert of(recording, twist_keys.state_hand("left")) == []
    assert "state_hand_left: in no entry" in recording.unknown
    assert list(recording.odd) == [
        "state_body: missing in 1 of 3 entries",
        "state_body: 1 of 2 values have 127 numbers, expected 34",
        "t_state: the same in every entry: whoever writes it did not run",
        "fields that the stock recorder does not write, kept as keys of that name: depth_ok",
    ]
    assert [write.value for write in of(recording, "depth_ok")] == [b"true"] * 3


def test_a_recording_is_found_by_itself_by_its_task_and_by_the_folder_of_tasks(tmp_path: Path) -> None:
    first = record(tmp_path / "cabinet" / "episode_0000")
    second = record(tmp_path / "cup" / "episode_0001")
    torn = tmp_path / "cup" / "episode_0002"
    (torn / "rgb").mkdir(parents=True)
    assert twist2.find(first) == [first]
    assert twist2.find(tmp_path / "cup") == [second, torn]
    assert twist2.find(tmp_path) == [first, second, torn]
    assert twist2.find(torn) == []
    assert refused(torn).startswith("data.json: not there: TWIST2's recorder writes it as an episode ends")


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ('{"data": [', "data.json: not JSON: Expecting value in line 1, column 11"),
        ("[" * 200_000, "data.json: not JSON that can be read: maximum recursion depth"),
        ("[]", "data.json: expected an object with info, text and data, came []"),
        ("{}", "data.json: data: expected a list of entries, came null"),
        ('{"data": []}', "data.json: data: holds no entry"),
        ('{"info": 3, "data": [{}]}', "data.json: info: expected an object, came 3"),
        ('{"data": [{}, 7]}', "data.json: data[1]: expected an object, came 7"),
        ('{"data": [{"state_body": "x"}]}', "data.json: data[0].state_body: expected a list of numbers or null"),
        ('{"data": [{"action_neck": [1, true]}]}', "data.json: data[0].action_neck: expected a list of numbers"),
        ('{"data": [{"t_img": 1.5}]}', "data.json: data[0].t_img: expected milliseconds since the epoch or null"),
        ('{"data": [{"t_state": -1}]}', "data.json: data[0].t_state: expected milliseconds since the epoch or null"),
        ('{"data": [{"rgb": 4}]}', "data.json: data[0].rgb: expected the name of a file or null, came 4"),
        ('{"data": [{"rgb": "rgb/1.jpg"}]}', "data.json: data[0].rgb: 'rgb/1.jpg' is not there"),
        ('{"data": [{"rgb": "rgb"}]}', "data.json: data[0].rgb: 'rgb' is not there"),
        ('{"data": [{"rgb": "a\\u0000b"}]}', "data.json: data[0].rgb: 'a\\x00b' cannot be read"),
        ('{"data": [{"rgb": "/etc/passwd"}]}', "data.json: data[0].rgb: '/etc/passwd' leads out of the recording's"),
        ('{"data": [{"rgb": "../../etc/passwd"}]}', "data.json: data[0].rgb: '../../etc/passwd' leads out of the"),
        ('{"data": [{"rgb": "link.jpg"}]}', "data.json: data[0].rgb: 'link.jpg' leads out of the recording's folder"),
        ('{"data": [{"rgb": "a.png"}]}', "data.json: data[0].rgb: 'a.png' is no JPEG file (it begins with 89504e47)"),
        ('{"data": [{"rgb": "cut.jpg"}]}', "data.json: data[0].rgb: 'cut.jpg' is cut off"),
    ],
)  # fmt: skip
def test_what_is_no_recording_is_refused_by_file_and_field(tmp_path: Path, text: str, told: str) -> None:
    folder = tmp_path / "episode_0000"
    (folder / "rgb").mkdir(parents=True)
    (tmp_path / "outside.jpg").write_bytes(jpeg(1))
    (folder / "link.jpg").symlink_to(tmp_path / "outside.jpg")
    (folder / "a.png").write_bytes(b"\x89PNG\r\n")
    (folder / "cut.jpg").write_bytes(jpeg(1)[:-40])
    (folder / "data.json").write_text(text)
    assert refused(folder).startswith(told)


def test_numbers_that_are_none_stay_as_the_bus_had_them(tmp_path: Path) -> None:
    data = document(1)
    data["data"][0]["action_neck"] = [float("nan"), 0.0]
    recording = twist2.read(record(tmp_path / "episode_0000", data))
    assert of(recording, twist_keys.action_neck())[0].value == b"[NaN, 0.0]"
