"""Buttons, dead-man and driver as one: from a sample to a command. Pure: no bus, no clock.

What records, ends the session or stops the robot is not done here: `Driven.pressed` says what the operator asked for.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from station.errors import ConfigError
from station.operator import buttons as button_maps
from station.operator.buttons import ButtonMap, Buttons, Pressed
from station.operator.deadman import Change, DeadMan
from station.operator.driver import Driver, Look
from station.operator.sample import OperatorSample
from station.protocols import Floats

_NOTHING = Look(None, "no valid data from the device")


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
class Driven:
    """What a tick brought.

    Attributes:
        command: For the robot, shape (m,).
        companions: Values of the keys beside it.
        pressed: What the operator asked for beside moving.
        change: Of the dead-man, for an event.
        mode: The driver's new mode, when it changed in this tick.
    """

    command: Floats
    companions: Mapping[str, Floats]
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

    def step(self, reading: OperatorSample | None, dt_s: float, *, obstacle: str = "") -> Driven:
        """Go on for a period.

        Args:
            reading: The newest sample; None when it is stale, lost, or cannot be read.
            dt_s: The period [s].
            obstacle: Why nobody may drive now (an emergency stop, a lost bus, the reason why data are stale), or "".
        """
        pressed = self._buttons.step(None if reading is None else reading.controls, dt_s)
        before = self.driver.mode
        if "mode" in pressed.started:
            self.driver.next_mode()
        look = _NOTHING if reading is None else self.driver.look(reading)
        if "disarm" in pressed.started:
            obstacle = "disarmed"
        if "estop" in pressed.started:
            obstacle = "emergency stop"
        change = self.deadman.step(
            None if reading is None else "engage" in pressed.held,
            look.input,
            self.driver.target,
            toggled="start_pause" in pressed.started,
            obstacle=obstacle or look.flaw,
            objection=look.objection,
        )
        command = self.driver.step(reading, self.deadman.snapshot, dt_s)
        mode = self.driver.mode  # a driver may change it by other controls as well
        return Driven(command, self.driver.companions, pressed, change, mode if mode != before else "")
