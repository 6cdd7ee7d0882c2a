"""What `station devices` knows of gamepads."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from adapters.devices import pair
from adapters.devices.gamepad.names import CONTROLS
from station.operator.device import DeviceError, DeviceKind


def _plugged_in() -> Sequence[str]:
    from adapters.devices.gamepad import sdl

    found = sdl.plugged_in()
    why = "" if found else sdl.why_none()
    if sdl.UDEV_RULE in why:  # there is one, and we may not read it
        raise DeviceError(why)
    return found


def _play(file: Path, _port: int | None) -> None:
    from adapters.devices.fakes import gamepad, show

    show.play("gamepad", file, gamepad.opened)


KIND = DeviceKind(
    name="gamepad",
    about="sticks, triggers and buttons",
    library="pygame",
    extra="gamepad",
    example=Path(__file__).parents[1] / "fakes/gamepad/example.json",
    plugged_in=_plugged_in,
    play=_play,
    controls=CONTROLS,
    buttons=pair.BUTTONS | {
        "engage": "left_bumper", "exit": "back", "start_pause": ["right_primary", "start"],
        "arm": "hold left_trigger+right_trigger+right_bumper", "disarm": "guide",
    },
)  # fmt: skip
