"""What `station devices` knows of keyboards."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from adapters.devices.keyboard.keys import NAMES
from station.operator.device import DeviceKind


def _plugged_in() -> Sequence[str]:
    return ["any terminal"]


def _play(file: Path, _port: int | None) -> None:
    from adapters.devices.fakes import keyboard, show

    show.play("keyboard", file, keyboard.opened)


KIND = DeviceKind(
    name="keyboard",
    about="keys of a terminal: discrete commands, short jogs",
    library="",
    extra="",
    example=Path(__file__).parents[1] / "fakes/keyboard/example.json",
    plugged_in=_plugged_in,
    play=_play,
    controls=tuple(f"key_{name}" for name in sorted(NAMES)),
    buttons={
        "start_pause": "key_space", "exit": "key_q", "estop": "key_escape", "mode": "key_tab", "record": "key_r",
        "mark": "key_m", "discard": "key_delete", "rerecord": "key_backspace", "success": "key_y",
        "arm": "key_o+key_p",  # two at once, since a terminal does not tell how long one is held
        "disarm": "key_x",
    },
)  # fmt: skip
