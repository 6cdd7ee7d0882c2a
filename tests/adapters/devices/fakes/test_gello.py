"""The fake leaders: their scripts, and as a process of their own."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from adapters.devices.fakes.gello import FakeGello
from adapters.devices.gello.device import Gello
from station.errors import BadFile
from station.operator.sample import OperatorSample
from tests.adapters.devices.by_hand import HandClock
from tests.adapters.devices.gello.test_device import OTHER, POSE, near
from tests.waiting import DEADLINE_S, wait_until

Play = Callable[..., FakeGello]


@pytest.fixture
def play(tmp_path: Path) -> Iterator[Play]:
    """Starts fake leaders that play steps."""
    fakes: list[FakeGello] = []

    def begin(*steps: dict[str, Any], period_s: float | None = None) -> FakeGello:
        file, folder = tmp_path / "script.json", tmp_path / "by-id"
        file.write_text(json.dumps({"device": "gello", "steps": steps, "period_s": period_s}))
        folder.mkdir()
        fakes.append(FakeGello(file, HandClock(), folder))
        return fakes[-1]

    yield begin
    for fake in fakes:
        fake.close()


@pytest.mark.parametrize(
    ("steps", "told"),
    [
        ([{"at_s": 0, "silent": [1]}], "no step says where left or right is held"),
        ([{"at_s": 0, "left": [0.0] * 8}, {"at_s": 1, "left": [0.0] * 7}], r"left: \[7, 8\] values; expected the same"),
        ([{"at_s": 0, "left": [0.0]}], r"left: \[1\] values"),
        (
            [{"at_s": 0, "left": POSE, "servos": "feetech"}, {"at_s": 1, "servos": "dynamixel"}],
            "servos are dynamixel and feetech; expected the same from the beginning to the end",
        ),
        ([{"at_s": 0, "left": POSE, "servos": "feetec"}], "Invalid enum value 'feetec'"),
        ([{"at_s": 0, "up": 1}], "unknown field `up`; a step may say at_s, left, right"),
    ],
)
def test_a_bad_script_is_one_line(play: Play, steps: list[dict[str, Any]], told: str) -> None:
    with pytest.raises(BadFile, match=told):
        play(*steps)


def test_a_script_is_played_alike_every_time(play: Play) -> None:
    fake = play({"at_s": 0, "left": POSE}, {"at_s": 1, "left": OTHER}, period_s=2.0)
    leader = fake.leaders[0]
    times = np.arange(0.0, 4.0, 0.05)
    first = [leader._shown(time_s).tolist() for time_s in times]
    assert first == [leader._shown(time_s).tolist() for time_s in times]
    assert leader._shown(0.5).tolist() == pytest.approx(leader._shown(2.5).tolist())
    assert leader._shown(2.0).tolist() == pytest.approx(leader._shown(0.0).tolist())


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.usefixtures("processes")
def test_the_fake_as_a_process_says_how_to_use_it(tmp_path: Path, number: signal.Signals) -> None:
    file = tmp_path / "script.json"
    file.write_text(json.dumps({"device": "gello", "steps": [{"at_s": 0, "left": POSE}]}))
    environment = {**os.environ, "PYTHONUNBUFFERED": "1"}
    command = [sys.executable, "-m", "station", "devices", "fake", "gello", "--play", str(file)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment) as process:
        assert process.stdout is not None
        line = process.stdout.readline()
        port = Path(line.split("[")[1].split("]")[0])
        folder = line.split("gello.calibrations=")[1].strip()
        device = Gello(
            ports_wanted=(str(port),), calibrations_folder=Path(folder), by_id=port.parent, patience_s=DEADLINE_S
        )
        try:
            found: list[OperatorSample] = []
            wait_until(lambda: found.append(reading) if (reading := device.read()) else found)
            assert found[0].joints == near(POSE)
        finally:
            device.close()
            process.send_signal(number)
            assert process.wait(DEADLINE_S) == 0
    assert not port.parent.exists()
