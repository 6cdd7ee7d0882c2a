"""The gamepad server: sticks, triggers and buttons of an operator.

It only translates (`adapters.devices.gamepad`); it knows no robot. A pad at rest is live; one that is torn out is lost,
its last sample is rest, and it is looked for until it is back. With ``fake: FILE`` SDL has a virtual pad that plays a
script (`adapters.devices.fakes.gamepad`), which begins when the server is active and goes on after a restart.
"""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import msgspec

from adapters.devices.gamepad.device import Gamepad
from station.config import to_plain
from station.life.server import Life, ServerKind
from station.operator import script_time
from station.operator.serve import serve_device


class GamepadConfig(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Configuration of the gamepad server.

    Attributes:
        rate_hz: Looks at the pad per second [Hz]; each takes in all events that have queued up.
        pad: A part of the pad's name, where several are plugged in; "" for the only one.
        index: Or SDL's number of it.
        dead_band: Part of full deflection within which a stick or trigger counts as at rest.
        mapping: An SDL mapping for a pad that SDL does not know.
        fake: Script of a fake gamepad, played in place of a real one.
    """

    rate_hz: float = 100.0
    pad: str = ""
    index: int | None = None
    dead_band: float = 0.05
    mapping: str = ""
    fake: Path | None = None

    def __post_init__(self) -> None:
        if not 10.0 <= self.rate_hz <= 500.0:
            raise ValueError(f"rate_hz is {self.rate_hz:g}; expected 10 to 500 Hz")
        if not 0.0 <= self.dead_band <= 0.5:
            raise ValueError(f"dead_band is {self.dead_band:g}; expected 0 to 0.5 of full deflection")
        if self.mapping and self.mapping.count(",") < 2:
            raise ValueError("mapping is no SDL mapping; expected one such as 03000000…,My pad,a:b0,b:b1,leftx:a0")


def main(config: GamepadConfig, life: Life) -> int:
    """Publish what the gamepad shows until asked to stop; return the exit code."""
    with contextlib.ExitStack() as stack:
        name = config.pad
        begin: Callable[[], Mapping[str, Any]] | None = None
        if config.fake is not None:
            from adapters.devices.fakes.gamepad import install
            from adapters.devices.fakes.gamepad.pad import NAME

            fake = install(config.fake)
            stack.callback(fake.close)
            begin, name = functools.partial(script_time.begin, fake.begin, script_time.now_s(life)), NAME
        return serve_device(
            life,
            lambda: Gamepad(name=name, index=config.index, dead_band=config.dead_band, mapping=config.mapping),
            rate_hz=config.rate_hz,
            config=to_plain(config),
            on_active=begin,
        )


KIND = ServerKind(
    name="gamepad",
    role="sensor",
    summary="reads a gamepad: sticks, triggers and buttons of an operator",
    config=GamepadConfig,
    main=main,
)
