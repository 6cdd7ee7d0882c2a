"""Buttons, dead-man and driver together, with a driver that is a number."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from station.errors import ConfigError
from station.operator.buttons import Buttons, button_map
from station.operator.deadman import Snapshot
from station.operator.driver import DriverInput
from station.operator.driving import Driving, DrivingStep, buttons_to_drive
from station.operator.sample import OperatorSample
from station.protocols import CommandFormat, Floats

TICK_S = 0.01


class Slider:
    """A robot of one joint that goes as far as the operator's x."""

    name = "slider"
    command_format: CommandFormat
    is_still = True

    def __init__(self) -> None:
        self.target = 0.5
        self.mode = "slow"
        self.auxiliary: Mapping[str, Floats] = {}

    def inspect(self, sample: OperatorSample) -> DriverInput:
        if sample.twist is None:
            return DriverInput(None, "nothing to slide")
        x = float(sample.twist[0])
        return DriverInput(x, why_not_engage="too far" if abs(x) > 3.0 else "")

    def jump(self, before: float, now: float) -> str:
        return "it jumped" if abs(now - before) > 1.0 else ""

    def next_mode(self) -> str:
        self.mode = "fast" if self.mode == "slow" else "slow"
        return self.mode

    def step(self, sample: OperatorSample | None, snapshot: Snapshot[Any, Any] | None, dt_s: float) -> Floats:
        if sample is not None and snapshot is not None:
            assert sample.twist is not None
            self.target = snapshot.target + float(sample.twist[0]) - snapshot.start
        return np.array([self.target])

    def resume_from(self, command: Floats) -> None:
        self.target = float(command[0])

    def facts(self) -> dict[str, Any]:
        return {"driver": self.name}


class Seat:
    """An operator who sits down with everything released."""

    def __init__(self) -> None:
        changes = {"engage": "right_grip"}
        self.driving = Driving(Slider(), Buttons(button_map("pico", changes)))
        self.tick(0.0)

    def tick(self, x: float | None, *down: str, why_blocked: str = "") -> DrivingStep:
        twist = None if x is None else np.array([x, 0.0, 0.0, 0.0, 0.0, 0.0])
        return self.driving.step(
            OperatorSample(controls=dict.fromkeys(down, 1.0), twist=twist), TICK_S, why_blocked=why_blocked
        )

    def release(self, x: float = 0.0) -> DrivingStep:
        return [self.tick(x) for _ in range(5)][-1]

    def silence(self) -> DrivingStep:
        return self.driving.step(None, TICK_S, why_blocked="pico is stale")


def change(driven: DrivingStep) -> tuple[str, str] | None:
    return None if driven.change is None else (driven.change.name, driven.change.reason)


def test_held_it_follows_and_released_it_stays() -> None:
    seat = Seat()
    assert change(seat.tick(0.2, "right_grip")) == ("operator-engaged", "")
    assert seat.tick(0.5, "right_grip").command[0] == 0.8
    seat.release(0.9)
    assert seat.tick(0.9).command[0] == seat.tick(-0.9).command[0]


def test_the_start_button_turns_driving_on_and_off() -> None:
    seat = Seat()
    assert change(seat.tick(0.0, "right_primary")) == ("operator-engaged", "")
    seat.release()
    assert seat.tick(0.3).command[0] == 0.8
    assert change(seat.tick(0.3, "right_primary")) == ("operator-disengaged", "released")


def test_silence_ends_it_and_the_button_must_be_pressed_anew() -> None:
    seat = Seat()
    seat.tick(0.0, "right_grip")
    assert change(seat.silence()) == ("operator-disengaged", "pico is stale")
    for _ in range(10):
        assert change(seat.tick(0.4, "right_grip")) is None
    assert seat.tick(0.4, "right_grip").command[0] == 0.5
    seat.release(0.4)
    assert change(seat.tick(0.4, "right_grip")) == ("operator-engaged", "")
    assert seat.tick(0.4, "right_grip").command[0] == 0.5


def test_what_the_driver_lacks_and_minds_is_the_reason_of_the_refusal() -> None:
    seat = Seat()
    assert change(seat.tick(None, "right_grip")) == ("operator-refused", "nothing to slide")
    seat.release()
    seat.tick(3.5)
    assert change(seat.tick(3.5, "right_grip")) == ("operator-refused", "too far")


def test_a_jump_and_the_stop_button_end_it_in_the_same_tick() -> None:
    seat = Seat()
    seat.tick(0.0, "right_grip")
    assert change(seat.tick(2.0, "right_grip")) == ("operator-disengaged", "it jumped")
    seat.release()
    seat.tick(0.0, "right_grip")
    driven = seat.tick(0.0, "right_grip", "left_stick_click")
    assert change(driven) == ("operator-disengaged", "emergency stop")
    assert "estop" in driven.pressed.started


def test_the_mode_button_changes_the_driver() -> None:
    seat = Seat()
    assert seat.tick(0.0, "right_stick_click").mode == "fast"
    assert seat.tick(0.0, "right_stick_click").mode == ""
    assert seat.driving.driver.mode == "fast"


def test_a_device_on_which_nothing_engages_needs_another_one_s_buttons(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="no control of a gello engages"):
        buttons_to_drive("gello", None)
    file = tmp_path / "pedal.yaml"
    file.write_text("engage: button_0")
    assert buttons_to_drive("gello", file).how_to_drive == "hold button_0 to drive"
