"""Devices and cameras keep their time: no sample is stale, no picture old, a key that is held is let go once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

import numpy as np
import pytest

from adapters.devices.keyboard.device import HOLD_S
from station.bus.address import BusAddress
from tests.figures import Figures
from tests.lateness import STALE_S, TooLate, Waits, in_time
from tests.servers.camera_trials import stall_the_bus
from tests.servers.device_station import presses, station

SAMPLES = 300
OLD_S = 0.5  # no picture goes to the bus so long after it was taken
SCRIPTS: dict[str, Sequence[Mapping[str, Any]]] = {
    "spacemouse": [{"at_s": 0.5, "twist": [0.0, 0.5, 0.0, 0.0, 0.0, -1.0]}],
    "gamepad": [{"at_s": 0.5, "set": {"left_stick_y": 0.5}}],
    "keyboard": [{"at_s": 0.5, "press": "w", "for_s": 1.0}],
}


@pytest.mark.parametrize("device", SCRIPTS)
def test_a_device_that_is_there_is_never_stale(
    device: str, bus_server: BusAddress, tmp_path: Path, proof: Figures
) -> None:
    def once() -> None:
        folder = Path(mkdtemp(dir=tmp_path))
        with Waits.watched() as waits, station(device, bus_server, folder) as made:
            made.start(SCRIPTS[device])
            made.until(lambda: len(made.samples) > SAMPLES)
        if "stale" in made.states():
            raise TooLate(str(made.states()), STALE_S / 2, waits.longest_s)
        assert made.states() == ["live"]
        taken_ns = np.array([sample.capture_ns for sample in made.samples if sample.capture_ns is not None])
        if len(taken_ns) > 1:
            gap_ms = float(np.diff(taken_ns).max()) * 1e-6
            proof.figure(f"{device}: longest time between two of {SAMPLES} samples", gap_ms, "ms", limit="100 ms")

    in_time(once)


def test_a_key_that_is_held_is_let_go_once_before_it_repeats(
    bus_server: BusAddress, tmp_path: Path, proof: Figures
) -> None:
    def once() -> None:
        folder = Path(mkdtemp(dir=tmp_path))
        with Waits.watched() as waits, station("keyboard", bus_server, folder) as typist:
            typist.start([{"at_s": 0.5, "press": "w", "for_s": 1.0}, {"at_s": 2.5, "press": "space", "for_s": 60.0}])
            typist.until(lambda: typist.samples and typist.samples[-1].controls.get("key_space") == 1.0)
            rises = presses(typist)
        assert rises >= 2, "pressed once, and a while later by auto-repeat"
        if rises > 2:
            raise TooLate(f"auto-repeat let go {rises - 2} time(s)", HOLD_S / 2, waits.longest_s)

    in_time(once)


def test_no_old_picture_is_written_after_a_stall(processes: None, tmp_path: Path, proof: Figures) -> None:
    def once() -> float:
        with Waits.watched() as waits:
            oldest_s = stall_the_bus(Path(mkdtemp(dir=tmp_path)))
        if oldest_s >= OLD_S:
            raise TooLate("a picture", oldest_s - OLD_S, waits.longest_s)
        return oldest_s

    figure_ms = in_time(once) * 1e3
    proof.figure("oldest picture that is written after the bus stalled", figure_ms, "ms", limit="500 ms")
