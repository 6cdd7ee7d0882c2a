"""The script of a fake headset: mistakes are told by file and field, and what it plays is a function of time."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from adapters.devices.fakes import pico
from adapters.devices.fakes.pico import recorded, wire
from adapters.devices.fakes.pico.play import Wearer
from adapters.devices.fakes.pico.scene import scene_of
from adapters.devices.fakes.pico.script import Script, load
from adapters.devices.fakes.pico.service import PicoService
from station import rotations
from station.errors import BadFile
from station.operator.device import DeviceError
from station.operator.sample import Body, OperatorSample, Pose

LEVEL = [1.0, 0.0, 0.0, 0.0]
HALF = float(np.sqrt(0.5))
START_NS = 1_000_000_000


def written(folder: Path, **script: Any) -> Path:
    path = folder / "script.json"
    path.write_text(json.dumps(script))
    return path


def script(folder: Path, **fields: Any) -> Script:
    return load(written(folder, **fields))


@pytest.mark.parametrize(
    ("fields", "complaint"),
    [
        ({"device": "gello"}, "device: invalid enum value 'gello'"),
        ({"rate_hz": "fast"}, "rate_hz: expected 'float', got 'str'"),
        ({"rate_hz": 0}, "rate_hz: expected 1 to 1000 Hz, got 0; a headset sends 72 or 90"),
        ({"height_m": 17}, "height_m: expected 0.5 to 2.5 m, got 17"),
        ({"faults": [{"at_s": 1, "kind": "crash", "for": 2}]}, "faults[0]: unknown field 'for' (did you mean"),
        ({"faults": [{"kind": "crash"}]}, "faults[0]: missing required field 'at_s'"),
        ({"faults": [{"at_s": -1, "kind": "crash"}]}, "faults[0].at_s: expected seconds from the start, got -1"),
        ({"faults": [{"at_s": 1, "kind": "jump", "by_m": [1]}]}, "faults[0].by_m: expected 3 numbers [m], got 1"),
        ({"controls": [{"at_s": 0}]}, "controls[0]: expected either press or set"),
        ({"controls": [{"at_s": 0, "press": "left_primary", "for_s": 0}]}, "controls[0].for_s: expected more than 0 s"),
        ({"controls": [{"at_s": 0, "set": {"left_trigger": 2}}]}, "controls[0]: left_trigger: expected 0 to 1, got 2"),
        ({"controls": [{"at_s": 0, "set": {"left_stik_x": 0}}]}, "(did you mean 'left_stick_x'?)"),
        ({"frames": [{"at_s": 0, "head": [0, 0]}]}, "frames[0].head: expected 7 numbers, got 2"),
        ({"frames": [{"at_s": 0, "head": [0] * 7}]}, "frames[0].head: expected a quaternion w x y z of length 1"),
        ({"frames": [{"at_s": 1}, {"at_s": 1}]}, "frames[1].at_s: expected more than 1, got 1"),
        (
            {"frames": [{"at_s": 0, "body": {"positions": [[0, 0, 0]], "quats_wxyz": []}}]},
            "frames[0].body.positions: expected 24 rows of 3 numbers, got 1",
        ),
        ({"frames": [{"at_s": 0}], "motion": "builtin:wave"}, "frames: expected either a motion or frames, got both"),
    ],
)
def test_what_is_wrong_is_told_by_file_and_field(tmp_path: Path, fields: dict[str, Any], complaint: str) -> None:
    path = written(tmp_path, **fields)
    with pytest.raises(BadFile) as refusal:
        load(path)
    assert str(refusal.value).startswith(f"{path}: ")
    assert complaint in str(refusal.value)
    assert len(str(refusal.value).splitlines()) == 1


def test_the_example_plays_all_its_frames() -> None:
    example = load(Path(pico.__file__).with_name("example.json"))
    wearer = Wearer(example)
    assert all(wearer.frame(number, START_NS) for number in range(0, 10 * 72, 7))
    assert {control.press for control in example.controls if control.press} >= {"right_primary", "left_primary"}


def test_a_file_that_is_not_there_or_not_json_is_told_of(tmp_path: Path) -> None:
    (tmp_path / "wave.json").write_text("{")
    with pytest.raises(BadFile, match=r"wave\.json: not JSON"):
        load(tmp_path / "wave.json")
    with pytest.raises(BadFile, match=r"No such file or directory \(did you mean 'wave\.json'\?\)"):
        load(tmp_path / "wve.json")


@pytest.mark.usefixtures("processes")
def test_the_program_ends_in_one_line(tmp_path: Path) -> None:
    with PicoService(0) as service:
        (tmp_path / "bad").mkdir()
        for path, options, complaint in (
            (written(tmp_path / "bad", fauts=[]), [], "unknown field 'fauts'"),
            (written(tmp_path), ["--port", str(service.port)], f"port {service.port} on 127.0.0.1 is in use"),
        ):
            command = [sys.executable, "-m", "adapters.devices.fakes.pico", str(path), *options]
            done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
            assert done.returncode in (1, 2)
            assert complaint in done.stderr
            assert len(done.stderr.splitlines()) == 1


def test_a_port_in_use_is_refused() -> None:
    with PicoService(0) as service, pytest.raises(DeviceError, match=f"port {service.port} on 127.0.0.1 is in use"):
        PicoService(service.port)


def test_between_two_frames_things_move_evenly_or_stay(tmp_path: Path) -> None:
    frames = [{"at_s": 0.0, "left": [0.0, 0.0, 0.0, *LEVEL]}, {"at_s": 1.0, "left": [1.0, 0.0, 0.0, HALF, 0, 0, HALF]}]
    blended, held = (scene_of(script(tmp_path, frames=frames, between=how)) for how in ("blend", "hold"))
    half, still = blended(0.5).left, held(0.5).left
    assert half is not None
    assert still is not None
    assert half.position.tolist() == [0.5, 0.0, 0.0]
    assert rotations.roll_pitch_yaw(half.quat_wxyz)[2] == pytest.approx(np.pi / 4)
    assert still.position.tolist() == [0.0, 0.0, 0.0]
    assert blended(9.0).left is not None
    assert blended(0.5).right is None


def test_the_world_begins_at_the_head_and_its_heading_as_in_the_real_app(tmp_path: Path) -> None:
    frames = [{"at_s": 0.0, "head": [1.0, 2.0, 1.6, HALF, 0, 0, HALF], "left": [1.0, 3.0, 1.0, HALF, 0, 0, HALF]}]
    reading = scene_of(script(tmp_path, frames=frames))(0.0)
    assert reading.head is not None
    assert reading.left is not None
    assert reading.head.position == pytest.approx(np.zeros(3), abs=1e-12)
    assert reading.left.position == pytest.approx([1.0, 0.0, -0.6]), "what is a metre ahead is ahead"
    assert rotations.roll_pitch_yaw(reading.left.quat_wxyz)[2] == pytest.approx(0.0)
    as_it_is = scene_of(script(tmp_path, frames=frames, origin="floor"))(0.0)
    assert as_it_is.head is not None
    assert as_it_is.head.position.tolist() == [1.0, 2.0, 1.6]


def test_a_motion_becomes_a_person_with_a_controller_in_each_hand(tmp_path: Path) -> None:
    scene = scene_of(script(tmp_path, motion="builtin:wave", height_m=1.75, origin="floor"))
    reading = scene(0.0)
    assert reading.body is not None
    assert reading.head is not None
    assert reading.left is not None
    assert reading.right is not None
    assert reading.body.positions[15] == pytest.approx(reading.head.position)
    assert reading.left.position[1] > 0.1 > -0.1 > reading.right.position[1]
    assert 1.3 < reading.head.position[2] < 1.75
    raised = max(pose.position[2] for t in np.linspace(0.0, 5.0, 26) if (pose := scene(t).right) is not None)
    assert raised > reading.right.position[2] + 0.3, "it waves"
    # The forearms point forward and 1.2 rad down, and so do the controllers in the hands: forward is x, their top z.
    for hand in (reading.left, reading.right):
        forward, _, up = rotations.rotate(hand.quat_wxyz, [1.0, 0.0, 0.0])
        assert (forward, up) == pytest.approx((np.cos(1.2), -np.sin(1.2)), abs=0.2)
        assert rotations.rotate(hand.quat_wxyz, [0.0, 0.0, 1.0])[2] > 0.0


def test_a_motion_that_swings_never_jumps(tmp_path: Path) -> None:
    scene = scene_of(script(tmp_path, motion="builtin:walk-forward", repeat="swing"))
    heads = np.array([pose.position for t in np.arange(0.0, 30.0, 0.1) if (pose := scene(t).head) is not None])
    assert np.linalg.norm(np.diff(heads, axis=0), axis=-1).max() < 0.2


def test_a_button_is_pressed_for_its_time_and_a_stick_stays(tmp_path: Path) -> None:
    controls = [{"at_s": 0.5, "press": "right_primary"}, {"at_s": 0.25, "set": {"left_stick_y": 0.5}}]
    wearer = Wearer(script(tmp_path, rate_hz=100, controls=controls))
    frames = [wearer.frame(number, START_NS) or {} for number in range(100)]
    pressed = [number for number, frame in enumerate(frames) if frame["Controller"]["right"]["primaryButton"]]
    assert pressed == list(range(50, 70))
    assert [frame["Controller"]["left"]["axisY"] for frame in frames] == [0.0] * 25 + [0.5] * 75


def test_faults_come_when_they_are_due(tmp_path: Path) -> None:
    kinds = ("silence", "freeze", "no-controllers", "torn", "poison", "jump")
    faults = [{"at_s": 1.0 + index, "kind": kind, "for_s": 0.5} for index, kind in enumerate(kinds)]
    wearer = Wearer(script(tmp_path, rate_hz=100, faults=faults))

    def frame(time_s: float) -> Any:
        return wearer.frame(round(time_s * 100), START_NS)

    assert frame(0.99) is not None
    assert [frame(1.0), frame(1.49)] == [None, None]
    assert frame(1.5) is not None
    assert {frame(time_s)["timeStampNs"] for time_s in (2.0, 2.2, 2.49)} == {START_NS + 2_000_000_000}
    assert frame(2.5)["timeStampNs"] == START_NS + 2_500_000_000
    assert "Controller" not in frame(3.0)
    assert ["pose" in frame(time_s)["Head"] for time_s in (3.99, 4.0, 4.01)] == [True, False, True]
    assert ["nowhere" in frame(time_s)["Head"]["pose"] for time_s in (4.99, 5.0, 5.01)] == [False, True, False]
    z = [float(frame(time_s)["Head"]["pose"].split(",")[2]) for time_s in (5.99, 6.0, 6.49, 6.5)]
    assert z == [0.0, -0.5, -0.5, 0.0], "half a metre forward is -z for a headset"


def test_a_frame_that_is_spoilt_is_sent_however_late_it_gets(tmp_path: Path) -> None:
    wearer = Wearer(script(tmp_path, rate_hz=10, faults=[{"at_s": 1.0, "kind": "poison"}]))
    assert wearer.next_number(3, 0.3001) == 4
    assert wearer.next_number(3, 0.75) == 7
    assert wearer.next_number(3, 3.0) == 10
    assert wearer.next_number(10, 3.05) == 30


def test_what_was_recorded_is_sent_at_its_own_times_and_to_the_last_digit(tmp_path: Path) -> None:
    times_s = [0.0, 0.013, 0.031, 0.5]
    readings = [
        (100.0 + time_s, OperatorSample(
            head=Pose(np.array([0.1, 0.2, 0.3]), np.array(LEVEL)), left=Pose(np.array([time_s, 0, 0]), np.array(LEVEL)),
            right=Pose(np.array([0.5, 0, 0]), np.array([HALF, 0, 0, HALF])), controls={"left_trigger": time_s},
            body=Body(np.full((24, 3), time_s), np.tile(LEVEL, (24, 1))),
        )) for time_s in times_s
    ]  # fmt: skip
    path = tmp_path / "recorded.json"
    path.write_bytes(recorded.script(readings))
    wearer = Wearer(load(path))
    assert [wearer.time_s(number) for number in range(4)] == pytest.approx(times_s, abs=1e-9)
    for number, time_s in enumerate(times_s):
        frame: Any = wearer.frame(number, START_NS)
        assert frame["timeStampNs"] == pytest.approx(START_NS + time_s * 1e9, abs=1)
        left = [float(text) for text in frame["Controller"]["left"]["pose"].split(",")]
        assert left == pytest.approx([0.0, 0.0, -time_s, 0.0, 0.0, 0.0, 1.0], abs=1e-9)
        assert frame["Controller"]["left"]["trigger"] == time_s
        joint = [float(text) for text in frame["Body"]["joints"][7]["p"].split(",")]
        assert joint[:3] == pytest.approx([-time_s, time_s, -time_s], abs=1e-9)
    assert wearer.time_s(5) == pytest.approx(0.5 + 2 / 72)
    assert [wearer.number(time_s) for time_s in (0.0, 0.01, 0.02, 0.5, 0.5 + 2 / 72)] == [0, 1, 2, 3, 5]
    assert wearer.next_number(0, 0.04) == 2


@given(st.integers(0, 2000))
def test_the_same_number_gives_the_same_frame(number: int) -> None:
    faults = [{"at_s": 3.0, "kind": "jump", "turn_deg": 90.0}, {"at_s": 5.0, "kind": "no-body"}]
    content = json.dumps({"motion": "builtin:wave", "repeat": "swing", "faults": faults}).encode()
    import msgspec

    fixed = msgspec.json.decode(content, type=Script)
    assert WEARERS.setdefault(content, Wearer(fixed)).frame(number, START_NS) == Wearer(fixed).frame(number, START_NS)


WEARERS: dict[bytes, Wearer] = {}


def test_a_whole_body_with_both_hands_fits_into_what_the_library_takes(tmp_path: Path) -> None:
    row = [-12.345678, -12.345678, -12.345678, HALF, -HALF, 0.0, 0.0]
    body = {"positions": [row[:3]] * 24, "quats_wxyz": [row[3:]] * 24}
    frame = {
        "at_s": 0,
        "head": row,
        "left": row,
        "right": row,
        "body": body,
        "hands": {s: [row] * 26 for s in ("left", "right")},
    }
    sent = Wearer(script(tmp_path, frames=[frame], origin="floor")).frame(0, 1_800_000_000_000_000_000)
    assert sent is not None
    assert len(wire.device_state("x", sent)) < wire.LONGEST_STATE
