"""What `station devices` knows of spacemice."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from station.operator.device import DeviceKind


def _plugged_in() -> Sequence[str]:
    from adapters.devices.spacemouse import find

    return find.plugged_in()


def _play(file: Path, _port: int | None) -> None:
    from adapters.devices.fakes import show, spacemouse

    show.play("spacemouse", file, spacemouse.opened)


KIND = DeviceKind(
    name="spacemouse",
    about="six-axis mouse: a twist and buttons",
    library="hidapi",
    extra="spacemouse",
    example=Path(__file__).parents[1] / "fakes/spacemouse/example.json",
    plugged_in=_plugged_in,
    play=_play,
    controls=("button_*",),
    buttons={
        "start_pause": "button_0", "mode": "hold button_0", "record": "button_1", "discard": "hold button_1",
        "estop": "button_0+button_1",  # none is left to arm with: `station arm`, or a file for a larger one
    },
)  # fmt: skip
