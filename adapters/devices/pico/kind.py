"""What `station devices` knows of Pico headsets."""

from __future__ import annotations

import socket
from collections.abc import Sequence
from pathlib import Path

from adapters.devices import pair
from adapters.devices.pico.controls import CONTROLS
from adapters.devices.pico.headset import DEFAULT_PORT
from station.operator.device import DeviceKind
from station.operator.measure import OperatorMeasure

_HOST = "127.0.0.1"
_LOOK_S = 0.2


def _plugged_in() -> Sequence[str]:
    """Say whether a PC service listens; whether a headset sends to it, its library alone can tell."""
    try:
        socket.create_connection((_HOST, DEFAULT_PORT), timeout=_LOOK_S).close()
    except OSError:
        return []
    return [f"PC service at {_HOST}:{DEFAULT_PORT}"]


def _play(file: Path, port: int | None) -> None:
    from adapters.devices.fakes.pico.run import run_for_person

    run_for_person(file, DEFAULT_PORT if port is None else port)


def _measure() -> OperatorMeasure:
    from adapters.retarget.operators import BodyMeasure

    return BodyMeasure()


KIND = DeviceKind(
    name="pico",
    about="headset, controllers, body and hands",
    library="xrobotoolkit-sdk",
    extra="pico",
    example=Path(__file__).parents[1] / "fakes/pico/example.json",
    plugged_in=_plugged_in,
    play=_play,
    controls=tuple(CONTROLS),
    buttons=pair.BUTTONS,
    port=DEFAULT_PORT,
    measure=_measure,
)
