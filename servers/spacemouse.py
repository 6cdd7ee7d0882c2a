"""The spacemouse server: a six-axis twist and buttons of an operator.

It only translates (`adapters.devices.spacemouse`); it knows no robot. A mouse at rest is live and sends zeros; one that
is torn out is lost, its last sample is zero, and it is looked for until it is back. With ``fake: FILE`` the C functions
under the real hidapi play a script (`adapters.devices.fakes.spacemouse`), which begins when the server is active and
goes on after a restart.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import msgspec

from adapters.devices.spacemouse.device import Spacemouse
from station.config import to_plain
from station.life.server import Life, ServerKind
from station.operator import script_time
from station.operator.serve import serve_device


class SpacemouseConfig(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Configuration of the spacemouse server.

    Attributes:
        rate_hz: Looks at the mouse per second [Hz]; each takes in all reports that have queued up.
        serial: Serial number of the mouse, where several are plugged in; "" for the only one.
        path: Or one of its interfaces, such as ``/dev/hidraw3``.
        dead_band: Part of full deflection below which an axis counts as zero.
        scale: Factor of each axis vx vy vz wx wy wz (x forward, y left, z up), -1 to 1.
        silence_s: After how long without a report a deflection counts as let go [s].
        fake: Script of a fake spacemouse, played in place of a real one.
    """

    rate_hz: float = 100.0
    serial: str = ""
    path: str = ""
    dead_band: float = 0.05
    scale: tuple[float, float, float, float, float, float] = (1.0, 1.0, 1.0, 1.0, 1.0, 1.0)
    silence_s: float = 0.5
    fake: Path | None = None

    def __post_init__(self) -> None:
        if not 10.0 <= self.rate_hz <= 500.0:
            raise ValueError(f"rate_hz is {self.rate_hz:g}; expected 10 to 500 Hz")
        if not 0.0 <= self.dead_band <= 0.5:
            raise ValueError(f"dead_band is {self.dead_band:g}; expected 0 to 0.5 of full deflection")
        if not all(-1.0 <= factor <= 1.0 for factor in self.scale):
            raise ValueError(f"scale is {list(self.scale)}; expected six numbers from -1 to 1")
        if not 0.1 <= self.silence_s <= 10.0:
            raise ValueError(f"silence_s is {self.silence_s:g}; expected 0.1 to 10 s: a held cap reports every 16 ms")


def main(config: SpacemouseConfig, life: Life) -> int:
    """Publish what the spacemouse gives until asked to stop; return the exit code."""
    begin: Callable[[], Mapping[str, Any]] | None = None
    if config.fake is not None:
        from adapters.devices.fakes.spacemouse import install

        start_s = script_time.now_s(life)
        install(config.fake, start_s=start_s)
        begin = functools.partial(script_time.began, start_s)
    return serve_device(
        life,
        lambda: Spacemouse(
            serial=config.serial,
            path=config.path,
            dead_band=config.dead_band,
            scale=config.scale,
            silence_s=config.silence_s,
            clock=life.clock,
        ),
        rate_hz=config.rate_hz,
        config=to_plain(config),
        on_active=begin,
    )


KIND = ServerKind(
    name="spacemouse",
    role="sensor",
    summary="reads a spacemouse: a six-axis twist and buttons of an operator",
    config=SpacemouseConfig,
    main=main,
)
