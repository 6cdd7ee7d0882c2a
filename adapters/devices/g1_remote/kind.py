"""A G1's remote as a device: sticks and buttons. What stops the robot, Select or L2 with B, stops the station, too."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from adapters.devices import pair
from adapters.devices.gamepad.names import CONTROLS
from adapters.robots.g1.dds.options import LOOPBACK, ROBOT_DOMAIN, NetworkOptions
from station.clock import Clock
from station.operator.device import Device, Source
from station.operator.device_kind import DeviceConfig, DeviceKind

if TYPE_CHECKING:  # it loads DDS
    from adapters.devices.g1_remote.device import States


class G1RemoteConfig(DeviceConfig, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of the remote's server, beside `rate_hz` and `fake`.

    Attributes:
        interface: Network interface that the robot's cable is plugged into; ``lo`` for a robot twin on this machine.
        domain: DDS domain: 0 for a robot.
        dead_band: Part of full deflection within which a stick counts as at rest.
    """

    interface: str = LOOPBACK
    domain: int = ROBOT_DOMAIN
    dead_band: float = 0.05

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0.0 <= self.dead_band <= 0.5:
            raise ValueError(f"dead_band is {self.dead_band:g}; expected 0 to 0.5 of full deflection")
        NetworkOptions(interface=self.interface, domain=self.domain)


@contextlib.contextmanager
def _source(config: G1RemoteConfig, _clock: Clock, start_s: float) -> Iterator[Source]:
    def opened(states: States | None = None) -> Device:
        from adapters.devices.g1_remote.device import G1Remote

        where = NetworkOptions(interface=config.interface, domain=config.domain)
        return G1Remote(where, config.dead_band, states)

    if config.fake is None:
        yield Source(open=opened)
        return
    from adapters.devices.fakes.g1_remote import install

    fake = install(config.fake)
    yield Source(open=lambda: opened(fake), begin=lambda: fake.begin(start_s))


def _plugged_in() -> Sequence[str]:
    return ()


KIND = DeviceKind(
    name="g1-remote",
    about="the remote of a Unitree G1, over its network",
    config=G1RemoteConfig,
    source=_source,
    library="cyclonedds",
    extra="g1",
    example=Path(__file__).parents[1] / "fakes/g1_remote/example.json",
    plugged_in=_plugged_in,
    controls=CONTROLS,
    buttons={action: gesture for action, gesture in pair.BUTTONS.items() if action not in ("arm", "disarm", "estop")}
    | {"engage": "left_bumper", "estop": ["back", "left_trigger+right_secondary"], "disarm": "left_stick_click"},
)
