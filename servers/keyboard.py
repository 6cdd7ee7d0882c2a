"""The keyboard server: keys of a terminal, for discrete commands and short jogs, and never for a dead-man.

A supervisor's children have no terminal. So either run it beside ``station up``, in a terminal of its own
(``station serve keyboard``), or name one in which nothing else reads (``--set keyboard.tty=/dev/pts/3``, where the
command ``tty`` says the name and ``sleep infinity`` keeps the shell from reading). The terminal is put back as it was
when the server ends. With ``fake: FILE`` a pseudo terminal is typed into by a script
(`adapters.devices.fakes.keyboard`), which begins when the server is active and goes on after a restart.
"""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import msgspec

from adapters.devices.keyboard.device import HOLD_S, Keyboard
from station.config import to_plain
from station.life.server import Life, ServerKind
from station.operator import script_time
from station.operator.serve import serve_device


class KeyboardConfig(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Configuration of the keyboard server.

    Attributes:
        rate_hz: Looks at the terminal per second [Hz].
        tty: Name of the terminal, such as ``/dev/pts/3``; "" for that of the process.
        hold_s: For how long a key counts as held after each press [s]; a terminal does not tell when it comes up.
        fake: Script of a fake typist, in place of a real one.
    """

    rate_hz: float = 50.0
    tty: str = ""
    hold_s: float = HOLD_S
    fake: Path | None = None

    def __post_init__(self) -> None:
        if not 10.0 <= self.rate_hz <= 500.0:
            raise ValueError(f"rate_hz is {self.rate_hz:g}; expected 10 to 500 Hz")
        if not 0.05 <= self.hold_s <= 0.5:
            raise ValueError(f"hold_s is {self.hold_s:g}; expected 0.05 to 0.5 s: a longer jog is a run-away")


def main(config: KeyboardConfig, life: Life) -> int:
    """Publish which keys are held until asked to stop; return the exit code."""
    with contextlib.ExitStack() as stack:
        tty = config.tty
        begin: Callable[[], Mapping[str, Any]] | None = None
        if config.fake is not None:
            from adapters.devices.fakes.keyboard import install

            fake = install(config.fake)
            stack.callback(fake.close)
            begin, tty = functools.partial(script_time.begin, fake.begin, script_time.now_s(life)), str(fake.path)
        return serve_device(
            life,
            lambda: Keyboard(tty=tty, hold_s=config.hold_s),
            rate_hz=config.rate_hz,
            config=to_plain(config),
            on_active=begin,
        )


KIND = ServerKind(
    name="keyboard",
    role="sensor",
    summary="reads keys of a terminal: discrete commands and short jogs of an operator",
    config=KeyboardConfig,
    main=main,
)
