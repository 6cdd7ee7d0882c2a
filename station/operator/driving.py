"""Buttons, dead-man and driver as one: from a sample to a command. Pure: no bus, no clock.

What records, ends the session or stops the robot is not done here: `DrivingStep.pressed` says what the operator asked
for.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from station.blends import times_to_standing
from station.bus import codec, keys
from station.errors import ConfigError
from station.life.server import Life
from station.operator import buttons as button_maps
from station.operator.buttons import ButtonMap, Buttons, Pressed
from station.operator.deadman import Change, DeadMan
from station.operator.device_subscriber import DeviceSample
from station.operator.driver import Driver, DriverInput
from station.operator.sample import OperatorSample
from station.protocols import CommandFormat, Floats

_NOTHING = DriverInput(None, "no valid data from the device")

COMES_TO_REST_S = 5.0
"""Longest wait for what was let go to come to rest [s]; a walk stands within two."""


def buttons_to_drive(device: str, file: Path | None) -> ButtonMap:
    """Return what the buttons of a kind of device mean: by default, or with the changes that a file makes.

    Raises:
        ConfigError: with none of them one can engage, or as `station.operator.buttons.load`.
        BadFile: the file cannot be read.
    """
    bound = button_maps.button_map(device) if file is None else button_maps.load(device, file)
    if not (bound.gestures.get("engage") or bound.gestures.get("start_pause")):
        raise ConfigError(
            f"no control of a {device} engages: a device without buttons needs `controls_from`, the name of one that "
            "has some (a gamepad, a pedal that is one), or `buttons`, a file that binds `engage` or `start_pause`"
        )
    return bound


@dataclass(frozen=True, slots=True, eq=False)
class DrivingStep:
    """What a tick brought.

    Attributes:
        command: For the robot, shape (m,).
        auxiliary: Values of the keys beside it.
        pressed: What the operator asked for beside moving.
        change: Of the dead-man, for an event.
        mode: The driver's new mode, when it changed in this tick.
    """

    command: Floats
    auxiliary: Mapping[str, Floats]
    pressed: Pressed
    change: Change | None = None
    mode: str = ""


class Driving:
    """An operator at the wheel.

    Args:
        driver: Makes commands.
        buttons: Makes actions of controls.

    Attributes:
        deadman: For the status line: its state and reason.
    """

    def __init__(self, driver: Driver, buttons: Buttons) -> None:
        self.driver = driver
        self.deadman: DeadMan[Any, Any] = DeadMan(driver.jump)
        self._buttons = buttons

    def step(self, sample: OperatorSample | None, dt_s: float, *, why_blocked: str = "") -> DrivingStep:
        """Go on for a period.

        Args:
            sample: The newest sample; None when it is stale, lost, or cannot be read.
            dt_s: The period [s].
            why_blocked: Why driving is not allowed now (an emergency stop, a lost bus, stale data), or "".
        """
        pressed = self._buttons.step(None if sample is None else sample.controls, dt_s)
        before = self.driver.mode
        if "mode" in pressed.started:
            self.driver.next_mode()
        look = _NOTHING if sample is None else self.driver.inspect(sample)
        if "disarm" in pressed.started:
            why_blocked = "disarmed"
        if "estop" in pressed.started:
            why_blocked = "emergency stop"
        change = self.deadman.step(
            None if sample is None else "engage" in pressed.held,
            look.input,
            self.driver.target,
            toggled="start_pause" in pressed.started,
            why_blocked=why_blocked or look.why_not,
            why_not_engage=look.why_not_engage,
        )
        command = self.driver.step(sample, self.deadman.snapshot, dt_s)
        mode = self.driver.mode  # a driver may change it by other controls as well
        return DrivingStep(command, self.driver.auxiliary, pressed, change, mode if mode != before else "")


class ExitBlend:
    """From whatever is driven to the default command.

    Args:
        command_format: Of the commands.
        blend_s: Time of the blend [s].
    """

    def __init__(self, command_format: CommandFormat, blend_s: float) -> None:
        self._command_format, self._default, self._blend_s = command_format, np.array(command_format.default), blend_s
        self._times_s = times_to_standing(command_format, blend_s)
        self._rested_s, self._blended_s = 0.0, 0.0
        self._start: Floats | None = None

    @property
    def is_done(self) -> bool:
        """Whether the default has been reached, or there is none to go to."""
        return self._start is not None and (self._command_format.holds_position or self._blended_s >= self._blend_s)

    def _part(self, time_s: Floats | float) -> Floats:
        """How much of a way to the default is done that takes so long [s], 0 to 1."""
        return np.asarray(0.5 - 0.5 * np.cos(np.pi * np.minimum(self._blended_s / time_s, 1.0)))

    def auxiliary(self, values: Mapping[str, Floats]) -> Mapping[str, Floats]:
        """Return the values beside the command: a neck goes along to its default, hands keep what they hold."""
        going = {
            key: self._command_format.auxiliary[key] for key in self._command_format.stock.returning if key in values
        }
        part = self._part(self._blend_s)
        return {**values, **{key: values[key] + part * (np.asarray(rest) - values[key]) for key, rest in going.items()}}

    def step(self, command: Floats, dt_s: float, *, is_still: bool) -> Floats:
        """Return the command after a period.

        Args:
            command: What the driver wants, shape (m,); looked at until the blend begins.
            dt_s: The period [s].
            is_still: Whether the driver has come to rest.
        """
        if self._start is None:
            self._rested_s += dt_s
            if not is_still and self._rested_s < COMES_TO_REST_S:
                return command
            self._start = command
        if self._command_format.holds_position:
            return self._start
        self._blended_s += dt_s
        return self._start + self._part(self._times_s) * (self._default - self._start)


class CommandWriter:
    """Writes commands.

    Args:
        life: Its bus is written to.
        command_format: Of the commands.
        device, driver: Whose they are, for their source.

    Attributes:
        newest: The newest command, shape (m,); None before the first.
        why_not: Why the newest command did not get away, or "".
    """

    def __init__(self, life: Life, command_format: CommandFormat, *, device: str, driver: str) -> None:
        self._life, self._command_format = life, command_format
        self._whose = {"kind": "operator", "device": device, "driver": driver}
        self.newest: Floats | None = None
        self.why_not = ""

    def write(self, command: Floats, auxiliary: Mapping[str, Floats], heard: DeviceSample, **state: Any) -> None:
        """Write a command.

        Args:
            command: Shape (m,).
            auxiliary: Values of the keys beside it.
            heard: The sample that it was made of.
            state: What else its source tells.
        """
        capture_ns = heard.sample.capture_ns if heard.sample is not None else None
        source = {**self._whose, **state, "sample": heard.number, "capture_ns": capture_ns}
        beside = {key: codec.json_vector(value) for key, value in auxiliary.items()}
        self._publish(command, beside | {keys.command_source(self._command_format.robot): codec.json_object(source)})

    def write_alone(self, command: Floats) -> None:
        """Write a command and nothing else, shape (m,)."""
        self._publish(command, {})

    def _publish(self, command: Floats, others: dict[str, bytes]) -> None:
        self.newest = command
        clocks = dict.fromkeys(self._command_format.stock.clocks, b"%d" % (self._life.clock.wall_ns() // 1_000_000))
        taken = self._life.bus.publish({self._command_format.key: codec.json_vector(command), **others, **clocks})
        self.why_not = "" if taken else "the bus is lost"
