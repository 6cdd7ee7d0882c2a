"""The gamepad as a device: sticks, triggers and buttons.

A pad at rest is live; one that is torn out is lost, its last sample is rest, and it is looked for until it is back.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from pathlib import Path

import msgspec

from adapters.devices import pair
from adapters.devices.gamepad.names import CONTROLS
from adapters.devices.gamepad.pedals import parsed
from station.clock import Clock
from station.operator.device import Device, DeviceError, Source
from station.operator.device_kind import DeviceConfig, DeviceKind


class GamepadConfig(DeviceConfig, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of the gamepad server, beside `rate_hz` and `fake`.

    Attributes:
        pad: A part of the pad's name, where several are plugged in; "" for the only one.
        index: Or SDL's number of it.
        dead_band: Part of full deflection within which a stick or trigger counts as at rest.
        mapping: An SDL mapping for a pad that SDL does not know.
        controls: What the numbered controls of pedals stand for, by the name of a gamepad's control: `left_stick_y:
            axis_1@-1 - axis_0@-1` for two pedals that rest at -1, `left_bumper: button_0`.
    """

    pad: str = ""
    index: int | None = None
    dead_band: float = 0.05
    mapping: str = ""
    controls: dict[str, str] = msgspec.field(default_factory=dict)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0.0 <= self.dead_band <= 0.5:
            raise ValueError(f"dead_band is {self.dead_band:g}; expected 0 to 0.5 of full deflection")
        if self.mapping and self.mapping.count(",") < 2:
            raise ValueError("mapping is no SDL mapping; expected one such as 03000000…,My pad,a:b0,b:b1,leftx:a0")
        if self.controls and self.mapping:
            raise ValueError("controls and mapping both say which control is which; expected one of them")
        parsed(self.controls)


@contextlib.contextmanager
def _source(config: GamepadConfig, _clock: Clock, start_s: float) -> Iterator[Source]:
    def opened(name: str = config.pad) -> Device:
        from adapters.devices.gamepad.device import Gamepad

        return Gamepad(name=name, index=config.index, dead_band=config.dead_band, mapping=config.mapping,
                       controls=config.controls)  # fmt: skip

    if config.fake is None:
        yield Source(open=opened)
        return
    from adapters.devices.fakes.gamepad import install
    from adapters.devices.fakes.gamepad.pad import NAME

    with contextlib.closing(install(config.fake)) as fake:
        yield Source(open=lambda: opened(NAME), begin=lambda: fake.begin(start_s))


def _plugged_in() -> Sequence[str]:
    from adapters.devices.gamepad import sdl

    found = sdl.plugged_in()
    why = "" if found else sdl.why_none()
    if sdl.UDEV_RULE in why:  # there is one, and we may not read it
        raise DeviceError(why)
    return found


KIND = DeviceKind(
    name="gamepad",
    about="sticks, triggers and buttons",
    config=GamepadConfig,
    source=_source,
    library="pygame",
    extra="gamepad",
    example=Path(__file__).parents[1] / "fakes/gamepad/example.json",
    plugged_in=_plugged_in,
    controls=CONTROLS,
    buttons=pair.BUTTONS | {
        "engage": "left_bumper", "exit": "back", "start_pause": ["right_primary", "start"],
        "arm": "hold left_trigger+right_trigger+right_bumper", "disarm": "guide",
    },
)  # fmt: skip
