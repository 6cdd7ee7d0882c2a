"""A fake's script goes on where it is when its device server is killed and started again, whatever the device."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pytest

from station.bus.address import BusAddress
from station.life.restarts import RESTARTS_VARIABLE
from station.operator.sample import OperatorSample
from tests.servers.device_station import station

AGAIN = f"import os; os.environ['{RESTARTS_VARIABLE}'] = '1'\n"
FIRST_S, LATER_S = 0.3, 2.0  # what is to be seen in between lasts long enough for a busy machine
PULL = [1.0, 0.0, 0.0, 0.0, 0.0, 0.0]
PUSH = [0.5, 0.0, 0.0, 0.0, 0.0, 0.0]

Number = Callable[[OperatorSample], float]
CASES: dict[str, tuple[list[Mapping[str, Any]], Number]] = {
    "gamepad": (
        [{"at_s": FIRST_S, "set": {"left_stick_y": 1.0}}, {"at_s": LATER_S, "set": {"left_stick_y": 0.5}}],
        lambda reading: reading.controls["left_stick_y"],
    ),
    "keyboard": (
        [{"at_s": FIRST_S, "press": "a"}, {"at_s": LATER_S, "press": "b", "for_s": 300.0}],
        lambda reading: reading.controls["key_a"] + 0.5 * reading.controls["key_b"],
    ),
    "spacemouse": (
        [{"at_s": FIRST_S, "twist": PULL}, {"at_s": LATER_S, "twist": PUSH}],
        lambda reading: 0.0 if reading.twist is None else float(reading.twist[0]),
    ),
    "gello": (
        [
            {"at_s": 0.0, "left": [1.0, 0.0]},
            {"at_s": FIRST_S, "left": [1.0, 0.0]},
            {"at_s": LATER_S, "left": [0.5, 0.0]},
        ],
        lambda reading: 0.0 if reading.joints is None else float(reading.joints[0]),
    ),
}


@pytest.mark.parametrize("device", CASES)
def test_a_restarted_server_plays_nothing_anew(device: str, bus_server: BusAddress, tmp_path: Path) -> None:
    steps, number = CASES[device]
    with station(device, bus_server, tmp_path) as fake:
        fake.start(steps)
        fake.until(lambda: any(number(sample) > 0.9 for sample in fake.samples))
        fake.until(lambda: 0.4 < number(fake.samples[-1]) < 0.6)
        fake.process.kill()
        fake.process.wait()
        before = len(fake.samples)
        fake.start(steps, before=AGAIN)
        fake.until(lambda: len(fake.samples) > before + 20 and 0.4 < number(fake.samples[-1]) < 0.6)
        assert max(number(sample) for sample in fake.samples[before:]) < 0.9, "what was done before is not done again"
        fake.stop()
