"""The GELLO server: joints and grippers of one or two leader arms.

It only translates (`adapters.devices.gello`); it knows no follower, so whether leader and follower are close enough to
engage is judged elsewhere. A servo that falls silent makes the device lost, with the servo's name; its last joints are
never repeated. With ``fake: FILE`` the servos are fake ones on pseudo terminals, held by a script
(`adapters.devices.fakes.gello`), under the real dynamixel-sdk; the script begins when the server is active and goes on
after a restart, and its leaders come calibrated.
"""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import msgspec

from adapters.devices.gello.bus import BAUDS
from adapters.devices.gello.device import Gello
from station.config import to_plain
from station.life.server import Life, ServerKind
from station.operator import script_time
from station.operator.serve import serve_device


class GelloConfig(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Configuration of the GELLO server.

    Attributes:
        leaders: How many leader arms there are, 1 or 2.
        ports: Their serial ports; none for the U2D2 adapters that are plugged in.
        baud: Rate of the servos [bit/s].
        rate_hz: Readings per second [Hz].
        patience_s: For how long readings may fail before that is a fault [s].
        calibrations: Folder with a calibration by serial number; None for that of the user's settings.
        fake: Script of fake leaders, played in place of real ones; it says how many there are.
    """

    leaders: int = 1
    ports: tuple[str, ...] = ()
    baud: int = BAUDS[0]
    rate_hz: float = 100.0
    patience_s: float = 0.25
    calibrations: Path | None = None
    fake: Path | None = None

    def __post_init__(self) -> None:
        if self.leaders not in (1, 2):
            raise ValueError(f"leaders is {self.leaders}; expected 1 or 2")
        if self.ports and len(self.ports) != self.leaders:
            raise ValueError(f"{len(self.ports)} ports for {self.leaders} leaders; expected one each, or none")
        if self.baud not in BAUDS:
            raise ValueError(f"baud is {self.baud}; expected one of {', '.join(map(str, BAUDS))}")
        if not 10.0 <= self.rate_hz <= 200.0:
            raise ValueError(f"rate_hz is {self.rate_hz:g}; expected 10 to 200 Hz: a reading takes 4 ms")
        if not 0.05 <= self.patience_s <= 5.0:
            raise ValueError(f"patience_s is {self.patience_s:g}; expected 0.05 to 5 s")


def main(config: GelloConfig, life: Life) -> int:
    """Publish what the leaders show until asked to stop; return the exit code."""
    with contextlib.ExitStack() as stack:
        places: dict[str, Any] = {"leaders": config.leaders, "ports_wanted": config.ports,
                                  "calibrations_folder": config.calibrations}  # fmt: skip
        begin: Callable[[], Mapping[str, Any]] | None = None
        if config.fake is not None:
            from adapters.devices.fakes.gello import FakeGello

            start_s = script_time.now_s(life)
            fake = FakeGello(config.fake, start_s=start_s)
            stack.callback(fake.close)
            begin = functools.partial(script_time.begin, lambda _: fake.begin(), start_s)
            places = {"leaders": len(fake.leaders), "calibrations_folder": fake.calibrations, "by_id": fake.folder}
        return serve_device(
            life,
            lambda: Gello(
                baud=config.baud, rate_hz=config.rate_hz, patience_s=config.patience_s, clock=life.clock, **places
            ),
            rate_hz=config.rate_hz,
            config=to_plain(config),
            on_active=begin,
        )


KIND = ServerKind(
    name="gello",
    role="sensor",
    summary="reads GELLO leader arms: joints and grippers of an operator",
    config=GelloConfig,
    main=main,
)
