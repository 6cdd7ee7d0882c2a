"""The fake gloves: their scripts, what they write, and the real pyserial on their pseudo terminals."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from adapters.devices.fakes.glove import FakeGloves
from adapters.devices.fakes.glove.hand import GARBAGE
from adapters.devices.glove.calibration import load
from adapters.devices.glove.device import Glove
from adapters.devices.glove.lines import LineReader
from adapters.devices.glove.ports import GlovePort
from adapters.devices.glove.sensors import FINGERS, PRESETS
from station.errors import BadFile
from station.operator.device import DeviceError
from station.operator.sample import OperatorSample
from tests.adapters.devices.by_hand import HandClock
from tests.waiting import DEADLINE_S, wait_until

FLAT, FIST = [0.0] * 5, [1.0] * 5


@pytest.fixture
def play(tmp_path: Path) -> Iterator[Callable[..., FakeGloves]]:
    """Starts fake gloves that play steps, by a clock that stands still."""
    fakes: list[FakeGloves] = []

    def begin(*steps: dict[str, Any], period_s: float | None = None, **how: Any) -> FakeGloves:
        file, folder = tmp_path / "script.json", tmp_path / f"by-id-{len(fakes)}"
        file.write_text(json.dumps({"device": "glove", "steps": steps, "period_s": period_s}))
        folder.mkdir()
        fakes.append(FakeGloves(file, HandClock(), folder, **how))
        return fakes[-1]

    yield begin
    for fake in fakes:
        fake.close()


@pytest.mark.parametrize(
    ("steps", "told"),
    [
        ([{"at_s": 0, "silent": True}], "no step says how left or right is held"),
        (
            [{"at_s": 0, "left": FLAT}, {"at_s": 1, "left": [0.0] * 15}],
            r"left: \[5, 15\] values; expected 5 or 15",
        ),
        ([{"at_s": 0, "left": [0.0]}], r"left: \[1\] values; expected 5 or 15"),
        ([{"at_s": 0, "left": [0.0] * 15, "protocol": "opengloves"}], r"\[15\] values; expected 5"),
        ([{"at_s": 0, "left": FLAT, "sensors": ["thumb", "-"]}], r"\[5\] values; expected 2"),
        ([{"at_s": 0, "left": FLAT, "sensors": ["pinky"]}], "sensors: 'pinky' is no sensor"),
        ([{"at_s": 0, "up": 1}], "unknown field `up`; a step may say at_s, left, right"),
    ],
)
def test_a_bad_script_is_one_line(play: Callable[..., FakeGloves], steps: list[dict[str, Any]], told: str) -> None:
    with pytest.raises(BadFile, match=told):
        play(*steps)


def test_a_hand_that_a_script_does_not_move_is_refused(play: Callable[..., FakeGloves]) -> None:
    with pytest.raises(BadFile, match="moves no right hand, but left; set side: left"):
        play({"at_s": 0, "left": FLAT}, sides=("right",))


@pytest.mark.parametrize("protocol", ["numbers", "opengloves"])
def test_what_is_written_is_how_the_hand_is_held_and_the_same_every_time(
    play: Callable[..., FakeGloves], protocol: str
) -> None:
    steps = [{"at_s": 0, "right": FLAT, "protocol": protocol}, {"at_s": 2, "right": FIST}]
    glove = play(*steps, period_s=4.0).gloves[0]
    known = load(glove.port.path.parent / "calibrations", "FAKE-RIGHT", "right")
    assert (known.protocol, known.names) == (protocol, FINGERS)
    times = np.arange(0.0, 8.0, 0.25)
    written = [glove.line(at_s) for at_s in times]
    assert written == [glove.line(at_s) for at_s in times]
    reader = LineReader(known.protocol, 5)
    shown = np.array([known.values(line) for line in reader.feed(b"\n" + b"".join(written))])
    expected = [1.0 - abs(1.0 - at_s % 4.0 / 2.0) for at_s in times]
    np.testing.assert_allclose(shown, np.tile(np.array(expected)[:, None], 5), atol=0.001)


def test_sensors_have_the_names_of_the_script(play: Callable[..., FakeGloves]) -> None:
    glove = play({"at_s": 0, "left": [0.5, 0.0, 1.0], "sensors": ["thumb_rotation", "-", "index_0"]}).gloves[0]
    assert glove.calibration.names == ("thumb_rotation", "index_0")
    line = [float(word) for word in glove.line(0.0).split()]
    assert glove.calibration.values(line).tolist() == [0.5, 1.0]


def test_faults_come_when_the_script_says_and_to_the_hand_that_it_says(play: Callable[..., FakeGloves]) -> None:
    steps = [
        {"at_s": 0, "left": FLAT, "right": FLAT}, {"at_s": 1, "garbage": 1}, {"at_s": 1, "cut": 1, "side": "left"},
        {"at_s": 2, "silent": True, "side": "right"}, {"at_s": 3, "silent": False},
    ]  # fmt: skip
    fake, clock = play(*steps), HandClock()
    for glove in fake.gloves:
        glove.port.close()  # nobody else takes its bytes
        glove._play._clock = clock
    fake.begin()
    left, right = fake.gloves
    whole = left.line(0.0), right.line(0.0)
    assert (left.next_bytes(), right.next_bytes()) == whole
    clock.pass_(1.0)
    assert [left.next_bytes() for _ in range(3)] == [GARBAGE, whole[0][: len(whole[0]) // 2], whole[0]]
    assert [right.next_bytes() for _ in range(2)] == [GARBAGE, whole[1]]
    clock.pass_(1.0)
    assert (left.next_bytes(), right.next_bytes()) == (whole[0], b"")
    clock.pass_(1.0)
    assert (left.next_bytes(), right.next_bytes()) == whole


@pytest.mark.usefixtures("processes")
def test_the_real_pyserial_reads_it_until_it_is_torn_out(tmp_path: Path) -> None:
    file = tmp_path / "script.json"
    file.write_text(json.dumps({"device": "glove", "steps": [{"at_s": 0, "left": [0.25] * 15}]}))
    fake = FakeGloves(file)
    device = Glove(side="left", calibrations_folder=fake.calibrations, by_id=fake.folder, patience_s=DEADLINE_S)
    try:
        found: list[OperatorSample] = []
        wait_until(lambda: found.append(reading) if (reading := device.read()) else found)
        assert found[0].joints == pytest.approx([0.25] * 15, abs=0.001)
        assert device.facts()["joints"] == list(PRESETS[15])
        with pytest.raises(DeviceError, match="in use by another process"):
            GlovePort(str(fake.gloves[0].port.path), 115_200)
        fake.gloves[0].port.unplug()
        with pytest.raises(DeviceError, match=r"gone .*plug the glove in again"):
            wait_until(lambda: device.read() and False)
    finally:
        device.close()
        fake.close()
    assert not fake.folder.exists()
