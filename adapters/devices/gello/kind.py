"""GELLO leader arms as a device: joints and grippers of one or two.

It knows no follower, so whether leader and follower are close enough to engage is judged elsewhere. A servo that falls
silent makes the device lost, with the servo's name; its last joints are never repeated.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from adapters.devices.gello.bus import BUSES, Servos
from station.clock import Clock
from station.operator.device import Device, Source
from station.operator.device_kind import DeviceConfig, DeviceKind

if TYPE_CHECKING:
    import click


class GelloConfig(DeviceConfig, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of the GELLO server, beside `rate_hz` and `fake`, which says how many leaders there are.

    Attributes:
        leaders: How many leader arms there are, 1 or 2.
        ports: Their serial ports; none for the adapters that are plugged in (a U2D2; for Feetech one with a CH343).
        servos: Whose servos they have: Dynamixel's, or Feetech's STS3215.
        baud: Rate of the servos [bit/s]; None for the most usual: 57600 of Dynamixel, 1000000 of Feetech.
        patience_s: For how long readings may fail before that is a fault [s].
        calibrations: Folder with a calibration by serial number; None for that of the user's settings.
    """

    leaders: int = 1
    ports: tuple[str, ...] = ()
    servos: Servos = "dynamixel"
    baud: int | None = None
    patience_s: float = 0.25
    calibrations: Path | None = None

    def __post_init__(self) -> None:
        if self.leaders not in (1, 2):
            raise ValueError(f"leaders is {self.leaders}; expected 1 or 2")
        if self.ports and len(self.ports) != self.leaders:
            raise ValueError(f"{len(self.ports)} ports for {self.leaders} leaders; expected one each, or none")
        bauds = BUSES[self.servos].bauds
        if self.baud is not None and self.baud not in bauds:
            rates = ", ".join(map(str, bauds))
            raise ValueError(f"baud is {self.baud}; expected one of {rates} for servos of {self.servos}")
        if not 10.0 <= self.rate_hz <= 200.0:
            raise ValueError(f"rate_hz is {self.rate_hz:g}; expected 10 to 200 Hz: a reading takes 4 ms")
        if not 0.05 <= self.patience_s <= 5.0:
            raise ValueError(f"patience_s is {self.patience_s:g}; expected 0.05 to 5 s")


@contextlib.contextmanager
def _source(config: GelloConfig, clock: Clock, start_s: float) -> Iterator[Source]:
    def opened(places: dict[str, Any]) -> Device:
        from adapters.devices.gello.device import Gello

        return Gello(servos=config.servos, baud=config.baud, rate_hz=config.rate_hz, patience_s=config.patience_s,
                     clock=clock, **places)  # fmt: skip

    if config.fake is None:
        yield Source(open=lambda: opened({"leaders": config.leaders, "ports_wanted": config.ports,
                                          "calibrations_folder": config.calibrations}))  # fmt: skip
        return
    from adapters.devices.fakes.gello import FakeGello

    with contextlib.closing(FakeGello(config.fake, start_s=start_s)) as fake:
        places = {"leaders": len(fake.leaders), "calibrations_folder": fake.calibrations, "by_id": fake.folder}
        yield Source(open=lambda: opened(places), begin=fake.begin)


def _plugged_in() -> Sequence[str]:
    from adapters.devices.gello import ports

    return ports.plugged_in()


def _play(file: Path, _port: int | None) -> None:
    from adapters.devices.fakes.gello.run import run

    run(file)


def _calibrate() -> click.Command:
    from adapters.devices.gello.verb import command

    return command


KIND = DeviceKind(
    name="gello",
    about="one or two leader arms: joints and grippers",
    config=GelloConfig,
    source=_source,
    library="dynamixel-sdk",
    extra="gello",
    example=Path(__file__).parents[1] / "fakes/gello/example.json",
    plugged_in=_plugged_in,
    play=_play,
    controls=("button_*",),
    calibrate=_calibrate,
)
