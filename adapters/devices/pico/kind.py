"""The Pico headset as a device: headset, controllers, body and hands, through XRoboToolkit's PC service.

Beside the keys of an operator its server writes stock TWIST2's `controller_data`. The library may take the process down
with it; a runbook has the server started again (``if_it_dies: restart``), which moves nothing by itself. A fake is a PC
service of ours in a process of its own, on a free port, under the real library.
"""

from __future__ import annotations

import contextlib
import socket
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from adapters.devices import pair
from adapters.devices.pico.controls import CONTROLS
from adapters.devices.pico.headset import DEFAULT_PORT
from station.bus import codec
from station.clock import Clock
from station.operator.device import Device, Source
from station.operator.device_kind import DeviceConfig, DeviceKind
from station.operator.measure import OperatorMeasure
from station.operator.sample import OperatorSample, Side

_HOST = "127.0.0.1"
_LOOK_S = 0.2


class PicoConfig(DeviceConfig, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of the Pico server, beside `rate_hz` and `fake`; a headset sends 72 or 90 samples a second.

    Attributes:
        address: Where XRoboToolkit's PC service is.
        port: Its TCP port.
    """

    address: str = _HOST
    port: int = DEFAULT_PORT

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 1 <= self.port <= 65535:
            raise ValueError(f"port is {self.port}; expected 1 to 65535")
        if not self.address or not self.address.isprintable() or " " in self.address:
            raise ValueError(f"address is {self.address!r}; expected a host name or an IP address")


@contextlib.contextmanager
def _source(config: PicoConfig, clock: Clock, start_s: float) -> Iterator[Source]:
    def opened(address: str, port: int) -> Device:
        from adapters.devices.pico.headset import Headset

        return Headset(address, port, clock=clock)

    if config.fake is None:
        yield Source(open=lambda: opened(config.address, config.port), also=_stock)
        return
    from adapters.devices.fakes.pico.child import child

    with child(config.fake, start_s) as fake:
        yield Source(open=lambda: opened(_HOST, fake.port), begin=fake.begin, also=_stock)


def _stock(reading: OperatorSample) -> Mapping[str, bytes]:
    from adapters.robots.g1 import twist_keys

    return {twist_keys.CONTROLLER_DATA: codec.json_object(controller_data(reading))}


def _plugged_in() -> Sequence[str]:
    """Return whether a PC service listens; whether a headset sends to it, its library alone can tell."""
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
    config=PicoConfig,
    source=_source,
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


def controller_data(reading: OperatorSample) -> dict[str, Any]:
    """Return a sample as stock TWIST2 teleoperation writes it; the time stamp is the headset's [ns].

    Source: amazon-far/TWIST2, ``deploy_real/xrobot_teleop_to_robot_w_hand.py``; its recorder fails where a key lacks.
    """
    return {
        "LeftController": _controller("left", reading),
        "RightController": _controller("right", reading),
        "timestamp": reading.capture_ns or 0,
    }


def _controller(side: Side, reading: OperatorSample) -> dict[str, Any]:
    def value(name: str) -> float:
        return reading.controls.get(f"{side}_{name}", 0.0)

    return {
        "index_trig": value("trigger"),
        "grip": value("grip"),
        "key_one": value("primary") > 0.5,
        "key_two": value("secondary") > 0.5,
        "axis": [value("stick_x"), value("stick_y")],
        "axis_click": value("stick_click") > 0.5,
    }
