"""The keyboard as a device: for discrete commands and short jogs, and never for a dead-man."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from pathlib import Path

from adapters.devices.keyboard.device import HOLD_S, Keyboard
from adapters.devices.keyboard.keys import NAMES
from station.clock import Clock
from station.operator.device import Source
from station.operator.device_kind import DeviceConfig, DeviceKind


class KeyboardConfig(DeviceConfig, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of the keyboard server, beside `rate_hz` and `fake`.

    In a station, keys that are typed in the terminal of ``station up`` drive, except those that it uses itself: SPACE
    and e, answers, and r where it offers a restart. Elsewhere the server reads the terminal in which it runs (``station
    serve keyboard``), or one that is named and in which nothing else reads (``--set keyboard.tty=/dev/pts/3``; there
    the command ``tty`` says the name, and ``sleep infinity`` keeps the shell from reading). A terminal is put back as
    it was when the server ends.

    Attributes:
        tty: Name of the terminal, such as ``/dev/pts/3``; "" for the keys of the terminal of ``station up``, or
            else for the terminal of the process.
        hold_s: For how long a key counts as held after each press [s]; a terminal does not tell when it comes up.
    """

    rate_hz: float = 50.0
    tty: str = ""
    hold_s: float = HOLD_S

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0.05 <= self.hold_s <= 0.5:
            raise ValueError(f"hold_s is {self.hold_s:g}; expected 0.05 to 0.5 s: a longer jog is a run-away")


@contextlib.contextmanager
def _source(config: KeyboardConfig, _clock: Clock, start_s: float) -> Iterator[Source]:
    if config.fake is None:
        yield Source(open=lambda: Keyboard(tty=config.tty, hold_s=config.hold_s))
        return
    from adapters.devices.fakes.keyboard import install

    with contextlib.closing(install(config.fake)) as fake:
        yield Source(open=lambda: Keyboard(tty=str(fake.path), hold_s=config.hold_s), begin=lambda: fake.begin(start_s))


def _plugged_in() -> Sequence[str]:
    return ["any terminal"]


KIND = DeviceKind(
    name="keyboard",
    about="keys of a terminal: discrete commands, short jogs",
    config=KeyboardConfig,
    source=_source,
    example=Path(__file__).parents[1] / "fakes/keyboard/example.json",
    plugged_in=_plugged_in,
    controls=tuple(f"key_{name}" for name in sorted(NAMES)),
    buttons={
        "start_pause": "key_enter", "exit": "key_q", "mode": "key_tab", "record": "key_r",
        "estop": ["key_space", "key_e", "key_escape"],  # the first two stop in the terminal of `station up`, too
        "mark": "key_m", "discard": "key_delete", "rerecord": "key_backspace", "success": "key_y",
        "arm": "key_o+key_p",  # two at once, since a terminal does not tell how long one is held
        "disarm": "key_x",
    },
)  # fmt: skip
