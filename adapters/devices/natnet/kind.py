"""OptiTrack's Motive as a device: the body of one actor, live.

It has no buttons: those of a gamepad, a keyboard or a pedal beside it count (``teleop.controls_from``). A fake is a
server of ours on a UDP port of its own.
"""

from __future__ import annotations

import contextlib
import ipaddress
from collections.abc import Iterator, Sequence
from pathlib import Path

from adapters.devices.natnet.wire import COMMAND_PORT, DATA_PORT
from station.clock import Clock
from station.operator.device import Device, Source
from station.operator.device_kind import DeviceConfig, DeviceKind
from station.operator.measure import OperatorMeasure

_HOST = "127.0.0.1"


class NatnetConfig(DeviceConfig, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of the server of Motive's stream, beside `rate_hz` and `fake`.

    Attributes:
        address: IPv4 address of the computer that Motive runs on.
        local: IPv4 address of this computer in the same network.
        port: UDP port of Motive's commands.
        multicast: Group that Motive sends to, to be joined; "" where it sends to this computer alone (unicast).
        data_port: UDP port of the group.
        actor: Name of the skeleton in Motive; "" for the only one.
    """

    address: str = _HOST
    local: str = _HOST
    port: int = COMMAND_PORT
    multicast: str = ""
    data_port: int = DATA_PORT
    actor: str = ""

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, port in (("port", self.port), ("data_port", self.data_port)):
            if not 1 <= port <= 65535:
                raise ValueError(f"{name} is {port}; expected 1 to 65535")
        server, here = _ipv4("address", self.address), _ipv4("local", self.local)
        if server.is_loopback != here.is_loopback:
            raise ValueError(
                f"address is {server}, local is {here}: neither reaches the other; expected both in one network"
            )
        if self.multicast and not _ipv4("multicast", self.multicast).is_multicast:
            raise ValueError(f"multicast is {self.multicast}; expected a group such as 239.255.42.99, or nothing")


def _ipv4(name: str, text: str) -> ipaddress.IPv4Address:
    try:
        return ipaddress.IPv4Address(text)
    except ValueError:
        raise ValueError(f"{name} is {text!r}; expected an IPv4 address such as 192.168.1.20") from None


@contextlib.contextmanager
def _source(config: NatnetConfig, clock: Clock, start_s: float) -> Iterator[Source]:
    def opened(address: str, local: str, port: int, group: str) -> Device:
        from adapters.devices.natnet.device import Natnet

        return Natnet(
            address, local, port=port, group=group, data_port=config.data_port, actor=config.actor, clock=clock
        )

    if config.fake is None:
        yield Source(open=lambda: opened(config.address, config.local, config.port, config.multicast))
        return
    from adapters.devices.fakes.natnet.server import FakeMotive

    with contextlib.closing(FakeMotive(config.fake)) as fake:
        yield Source(open=lambda: opened(_HOST, _HOST, fake.port, ""), begin=lambda: fake.begin(start_s))


def _plugged_in() -> Sequence[str]:
    """Return what answers on this computer; one elsewhere in the network is not looked for."""
    from adapters.devices.natnet.device import Natnet

    with contextlib.closing(Natnet()) as found:
        facts = found.facts()
    return [f"{facts['application']}, NatNet {facts['natnet']}, at {facts['server']}"] if "natnet" in facts else []


def _play(file: Path, port: int | None) -> None:
    from adapters.devices.fakes.natnet.server import run_for_person

    run_for_person(file, COMMAND_PORT if port is None else port)


def _measure() -> OperatorMeasure:
    from adapters.retarget.operators import BodyMeasure

    return BodyMeasure()


KIND = DeviceKind(
    name="natnet",
    about="OptiTrack's Motive: an actor's body",
    config=NatnetConfig,
    source=_source,
    example=Path(__file__).parents[1] / "fakes/natnet/example.json",
    plugged_in=_plugged_in,
    play=_play,
    port=COMMAND_PORT,
    measure=_measure,
)
