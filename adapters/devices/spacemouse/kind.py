"""The spacemouse as a device: a six-axis twist and buttons.

A mouse at rest is live and sends zeros; one that is torn out is lost, its last sample is zero, and it is looked for
until it is back.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from pathlib import Path

from station.clock import Clock
from station.operator.device import Device, Source
from station.operator.device_kind import DeviceConfig, DeviceKind


class SpacemouseConfig(DeviceConfig, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of the spacemouse server, beside `rate_hz` and `fake`.

    Attributes:
        serial: Serial number of the mouse, where several are plugged in; "" for the only one.
        path: Or one of its interfaces, such as ``/dev/hidraw3``.
        dead_band: Part of full deflection below which an axis counts as zero.
        scale: Factor of each axis vx vy vz wx wy wz (x forward, y left, z up), -1 to 1.
        silence_s: After how long without a report a deflection counts as let go [s].
    """

    serial: str = ""
    path: str = ""
    dead_band: float = 0.05
    scale: tuple[float, float, float, float, float, float] = (1.0, 1.0, 1.0, 1.0, 1.0, 1.0)
    silence_s: float = 0.5

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0.0 <= self.dead_band <= 0.5:
            raise ValueError(f"dead_band is {self.dead_band:g}; expected 0 to 0.5 of full deflection")
        if not all(-1.0 <= factor <= 1.0 for factor in self.scale):
            raise ValueError(f"scale is {list(self.scale)}; expected six numbers from -1 to 1")
        if not 0.1 <= self.silence_s <= 10.0:
            raise ValueError(f"silence_s is {self.silence_s:g}; expected 0.1 to 10 s: a held cap reports every 16 ms")


@contextlib.contextmanager
def _source(config: SpacemouseConfig, clock: Clock, start_s: float) -> Iterator[Source]:
    def opened() -> Device:
        from adapters.devices.spacemouse.device import Spacemouse

        return Spacemouse(
            serial=config.serial, path=config.path, dead_band=config.dead_band, scale=config.scale,
            silence_s=config.silence_s, clock=clock,
        )  # fmt: skip

    if config.fake is None:
        yield Source(open=opened)
        return
    from adapters.devices.fakes.spacemouse import install

    install(config.fake, start_s=start_s)
    yield Source(open=opened, begin=lambda: None)  # its script has begun with the first look


def _plugged_in() -> Sequence[str]:
    from adapters.devices.spacemouse import find

    return find.plugged_in()


KIND = DeviceKind(
    name="spacemouse",
    about="six-axis mouse: a twist and buttons",
    config=SpacemouseConfig,
    source=_source,
    library="hidapi",
    extra="spacemouse",
    example=Path(__file__).parents[1] / "fakes/spacemouse/example.json",
    plugged_in=_plugged_in,
    controls=("button_*",),
    buttons={
        "start_pause": "button_0", "mode": "hold button_0", "record": "button_1", "discard": "hold button_1",
        "estop": "button_0+button_1",  # none is left to arm with: `station arm`, or a file for a larger one
    },
)  # fmt: skip
