"""A gamepad as an operator's device: sticks, triggers and buttons by the names of `names`."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

from adapters.devices.gamepad import names, pedals, sdl
from station.operator.device import DeviceError
from station.operator.sample import OperatorSample


class Gamepad:
    """Reads a gamepad through SDL; to be made and read in one thread, the one of the process.

    What it shows is what its events have said. So a trigger is at rest until its first event, though SDL may say of one
    that was never touched that it is half pulled; and what is held while the pad is opened counts once it is moved. A
    tap that is over by the next look is seen by that look. A pad that is torn out gives one more sample, of rest,
    before it is gone.

    Args:
        name, index: Which one, where several are plugged in: a part of its name, SDL's number.
        dead_band: Part of full deflection within which a stick or trigger counts as at rest.
        mapping: An SDL mapping for a pad that SDL does not know.
        controls: What numbered controls stand for (`adapters.devices.gamepad.pedals`), of pedals, or of any pad,
            whatever SDL knows of it.

    Raises:
        DeviceError: no such pad, several, no permission, no such control, or no library.
    """

    def __init__(
        self, *, name: str = "", index: int | None = None, dead_band: float = 0.05, mapping: str = "",
        controls: Mapping[str, str] = MappingProxyType({}),
    ) -> None:  # fmt: skip
        self._pygame = sdl.start(mapping)
        self._dead_band = dead_band
        self._named = pedals.parsed(controls)
        self._pad = sdl.choose(self._pygame, name=name, index=index)
        self._is_mapped = self._pad.is_mapped and not self._named
        try:
            self._opened = self._open()
        except self._pygame.error as error:
            raise DeviceError(f"gamepad {self._pad}: cannot be opened: {error}") from None
        self._lost = ""
        self._tapped: set[str] = set()
        self._rest = dict.fromkeys(names.CONTROLS, 0.0) if self._is_mapped else self._unmapped()
        self._state = dict(self._rest)
        self._pygame.event.clear(pump=False)  # what was pressed before is nobody's command

    def read(self) -> OperatorSample | None:
        """Return the controls as they are now; never blocks.

        Raises:
            DeviceError: it was torn out, and a sample of rest has been given.
        """
        if self._lost:
            self.close()
            raise DeviceError(self._lost)
        for event in self._events():
            if getattr(event, "instance_id", None) == self._id:
                self._on_event(event)
        shown = dict(self._state)
        for control in self._tapped:
            shown[control] = 1.0
        self._tapped.clear()
        if self._named:
            shown = dict.fromkeys(names.CONTROLS, 0.0) | {
                name: pedals.value(name, terms, shown) for name, terms in self._named.items()
            }
        if self._is_mapped or self._named:
            names.apply_dead_band(shown, self._dead_band)
        return OperatorSample(controls=shown)

    def why_silent(self) -> str:
        """Return nothing: a gamepad that is there is never silent, it rests."""
        return self._lost

    def facts(self) -> dict[str, Any]:
        """Return the pad, whether SDL knows it, its controls, and the library."""
        version = ".".join(map(str, self._pygame.get_sdl_version()))
        return {
            "device": "gamepad",
            "model": self._pad.name,
            "guid": self._pad.guid,
            "is_mapped": self._is_mapped,
            "controls": list(names.CONTROLS if self._named else self._state),
            "dead_band": self._dead_band,
            "library": f"pygame {self._pygame.version.ver}, SDL {version}",
        }

    def close(self) -> None:
        """Let go of the pad."""
        if self._opened is not None:
            self._opened.quit()
            self._opened = None

    def _events(self) -> list[Any]:
        try:
            return list(self._pygame.event.get())
        except (SystemError, KeyError):  # pygame's, of a pad that came and went before anybody looked
            self._lose("SDL lost count of the pads that came and went; it is opened anew")
            return []

    def _lose(self, why: str) -> None:
        self._lost = f"gamepad {self._pad.name!r}: {why}"
        self._state = dict(self._rest)
        self._tapped.clear()

    def _open(self) -> Any:
        if not self._is_mapped:
            opened = self._pygame.joystick.Joystick(self._pad.index)
            self._id = opened.get_instance_id()
            return opened
        opened = importlib.import_module("pygame._sdl2.controller").Controller(self._pad.index)
        self._id = opened.as_joystick().get_instance_id()
        return opened

    def _unmapped(self) -> dict[str, float]:
        joystick = self._opened
        hats = [f"hat_{number}_{axis}" for number in range(joystick.get_numhats()) for axis in "xy"]
        axes = [f"axis_{number}" for number in range(joystick.get_numaxes())]
        buttons = [f"button_{number}" for number in range(joystick.get_numbuttons())]
        found, rests = dict.fromkeys([*axes, *hats, *buttons], 0.0), pedals.rests(self._named)
        if missing := [control for control in rests if control not in found]:
            self._opened.quit()
            raise DeviceError(
                f"gamepad {self._pad}: controls: no {', '.join(missing)}; it has {len(axes)} axes, {len(buttons)} "
                f"buttons and {len(hats) // 2} hats, counted from 0"
            )
        return found | rests

    def _on_event(self, event: Any) -> None:
        pygame = self._pygame
        if event.type in (pygame.JOYDEVICEREMOVED, pygame.CONTROLLERDEVICEREMOVED):
            self._lose("gone; plug it in again, or wake it")
        elif self._lost:
            return
        elif self._is_mapped:
            self._on_mapped_event(event)
        else:
            self._on_numbered_event(event)

    def _on_mapped_event(self, event: Any) -> None:
        pygame = self._pygame
        if event.type == pygame.CONTROLLERAXISMOTION and event.axis < len(names.AXES):
            self._state[names.AXES[event.axis]] = names.axis(event.axis, event.value)
        is_button = event.type in (pygame.CONTROLLERBUTTONDOWN, pygame.CONTROLLERBUTTONUP)
        if is_button and event.button < len(names.BUTTONS):
            self._press(names.BUTTONS[event.button], event.type == pygame.CONTROLLERBUTTONDOWN)

    def _on_numbered_event(self, event: Any) -> None:
        pygame = self._pygame
        if event.type == pygame.JOYAXISMOTION:
            self._state[f"axis_{event.axis}"] = max(-1.0, min(1.0, event.value))
        elif event.type == pygame.JOYHATMOTION:
            self._state[f"hat_{event.hat}_x"], self._state[f"hat_{event.hat}_y"] = map(float, event.value)
        elif event.type in (pygame.JOYBUTTONDOWN, pygame.JOYBUTTONUP):
            self._press(f"button_{event.button}", event.type == pygame.JOYBUTTONDOWN)

    def _press(self, control: str, is_down: bool) -> None:
        self._state[control] = float(is_down)
        if is_down:
            self._tapped.add(control)
