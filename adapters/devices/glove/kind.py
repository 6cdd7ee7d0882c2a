"""Sensor gloves as a device: how far each finger of one hand is closed, from a microcontroller on a serial port.

The gloves are those of the open designs, with Hall sensors or potentiometers, and of one's own making: whatever writes
a line of numbers per sample (`adapters.devices.glove.lines`). None has been tried on real hardware: look first at what
an adapter's chip does when its port is opened, for many microcontrollers start anew.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from station.clock import Clock
from station.operator.device import Device, Source
from station.operator.device_kind import DeviceConfig, DeviceKind

if TYPE_CHECKING:
    import click


class GloveConfig(DeviceConfig, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of the glove server, beside `rate_hz` and `fake`. It reads one glove; a second hand is a second server.

    Attributes:
        side: The hand that wears it, left or right.
        port: Its serial port; "" for the only adapter that has a calibration of a glove for that side.
        baud: Rate of the port [bit/s].
        protocol: How it writes, numbers or opengloves; "" for as it did when it was calibrated.
        patience_s: For how long no good line may come before that is a fault [s].
        calibrations: Folder with a calibration by serial number and side; None for that of the user's settings.
    """

    side: Literal["left", "right"] = "right"
    port: str = ""
    baud: int = 115_200
    protocol: Literal["", "numbers", "opengloves"] = ""
    patience_s: float = 0.5
    calibrations: Path | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 1200 <= self.baud <= 4_000_000:
            raise ValueError(f"baud is {self.baud}; expected 1200 to 4000000")
        if not 0.05 <= self.patience_s <= 5.0:
            raise ValueError(f"patience_s is {self.patience_s:g}; expected 0.05 to 5 s")


@contextlib.contextmanager
def _source(config: GloveConfig, clock: Clock, start_s: float) -> Iterator[Source]:
    def opened(places: dict[str, Any]) -> Device:
        from adapters.devices.glove.device import Glove

        return Glove(side=config.side, baud=config.baud, protocol=config.protocol, patience_s=config.patience_s,
                     clock=clock, **places)  # fmt: skip

    if config.fake is None:
        yield Source(open=lambda: opened({"port": config.port, "calibrations_folder": config.calibrations}))
        return
    from adapters.devices.fakes.glove import FakeGloves

    with contextlib.closing(FakeGloves(config.fake, sides=(config.side,), start_s=start_s)) as fake:
        places = {"calibrations_folder": fake.calibrations, "by_id": fake.folder}
        yield Source(open=lambda: opened(places), begin=fake.begin)


def _plugged_in() -> Sequence[str]:
    from adapters.devices.glove import ports

    return ports.plugged_in()


def _play(file: Path, _port: int | None) -> None:
    from adapters.devices.fakes.glove.run import run

    run(file)


def _calibrate() -> click.Command:
    from adapters.devices.glove.verb import command

    return command


KIND = DeviceKind(
    name="glove",
    about="a sensor glove: how far fingers are closed",
    config=GloveConfig,
    source=_source,
    library="pyserial",
    extra="glove",
    example=Path(__file__).parents[1] / "fakes/glove/example.json",
    plugged_in=_plugged_in,
    play=_play,
    calibrate=_calibrate,
)
