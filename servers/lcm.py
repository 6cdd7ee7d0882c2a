"""The LCM bridge: HOMIE's cockpit drives our robot, or we drive a robot that HOMIE's programs move.

===============  ======================================================================================================
`their-cockpit`  hears HOMIE's channels and writes the command of each part as it comes. A channel that falls silent
                 writes nothing more: the robot's gate does the rest.
`our-cockpit`    sends HOMIE's channels 50 times a second, of the commands on the bus. Their robot does what came last
                 for ever, so the gates of its parts are in here: what falls silent is brought to rest.
===============  ======================================================================================================

Which channel is which part stands in one table, `adapters.lcm.homie`. LCM has no authentication and its messages say no
time: a message is as old as it lay in this computer, one sender is heard on each channel, and nothing leaves the
computer unless a network interface is named.
"""

from __future__ import annotations

import contextlib
import ipaddress
import math
import re
from collections.abc import Iterator, Sequence
from typing import Any, Literal

import msgspec
import numpy as np

from adapters.lcm import homie, types
from adapters.lcm.homie import Legs, Route
from adapters.lcm.message import BadMessage
from adapters.lcm.multicast import GROUP, LOOPBACK, PORT, Multicast, Sender
from station.bus import codec
from station.config import to_plain
from station.control.foreign_commander import ForeignCommander
from station.control.foreign_robot import ForeignRobot, Rest
from station.control.foreign_stream import (
    LATE_S,
    SILENT_S,
    Arrived,
    Dropped,
    ForeignStream,
    why_no_command,
)
from station.life.events import Severity
from station.life.loop import real_time
from station.life.server import Life, ServerKind
from station.parts import PartedCommand, part_name
from station.protocols import Floats

Mode = Literal["their-cockpit", "our-cockpit"]

RATE_HZ = 50.0
"""Messages per second on each channel that we send: HOMIE's policy runs as often."""

HEIGHT_M_S, ARMS_RAD_S = 0.25, 1.0
"""How fast a robot of theirs is brought to rest: its height, and its arms. Velocities end as everywhere."""

_NAME = re.compile(r"[a-z0-9_]+")


class LcmConfig(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Configuration of the LCM bridge.

    Attributes:
        mode: ``their-cockpit`` drives our robot by HOMIE's channels; ``our-cockpit`` drives a robot of HOMIE's by the
            commands on the bus.
        robot: Which commands, by the end of the robot's keys.
        legs: Command format of the legs: ``velocity-height``, or ``velocity`` for a policy that takes no height.
        hands: Whether ``hand_action`` is passed on: the robot has Dex3-1 hands, as ``g1_dex3`` has.
        interface: IPv4 address of this computer, in the network of the others; LCM stays on this computer unless
            another than 127.0.0.1 is named.
        peer: IPv4 address of the only computer that is heard; "" for all that reach the interface.
        group: Multicast group.
        port: UDP port of the group.
    """

    mode: Mode
    robot: str = "g1_29"
    legs: Legs = "velocity-height"
    hands: bool = False
    interface: str = LOOPBACK
    peer: str = ""
    group: str = GROUP
    port: int = PORT

    def __post_init__(self) -> None:
        if not _NAME.fullmatch(self.robot):
            raise ValueError(f"robot is {self.robot!r}; expected the end of a robot's keys, such as g1_29")
        here = _ipv4("interface", self.interface)
        if here.is_unspecified or here.is_multicast:
            raise ValueError(f"interface is {here}; expected the one address that this computer has in that network")
        if self.peer and _ipv4("peer", self.peer).is_loopback != here.is_loopback:
            raise ValueError(
                f"peer is {self.peer}, interface is {self.interface}: neither reaches the other; expected both in one "
                "network"
            )
        if not _ipv4("group", self.group).is_multicast:
            raise ValueError(f"group is {self.group}; expected a multicast group such as {GROUP}")
        if not 1 <= self.port <= 65535:
            raise ValueError(f"port is {self.port}; expected 1 to 65535")


def _ipv4(name: str, text: str) -> ipaddress.IPv4Address:
    try:
        return ipaddress.IPv4Address(text)
    except ValueError:
        raise ValueError(f"{name} is {text!r}; expected an IPv4 address such as 192.168.123.222") from None


def main(config: LcmConfig, life: Life) -> int:
    """Pass commands on until asked to stop; return the exit code."""
    command = homie.command_of(config.robot, config.legs, hands=config.hands)
    routes = homie.routes(command)
    with contextlib.closing(
        Multicast(config.group, config.port, interface=config.interface, peer=config.peer, clock=life.clock)
    ) as lcm:
        life.configured({
            "server": life.name, "role": KIND.role, "robot": config.robot, "mode": config.mode,
            "channels": {route.channel.name: [each.key for each in route.formats] for route in routes},
            "config": to_plain(config),
        })  # fmt: skip
        if not life.ready():
            return 0
        if config.mode == "their-cockpit":
            _their_cockpit(life, lcm, routes).run()
        else:
            life.report(scheduling=real_time())
            with OurCockpit(life, lcm, command) as ours:
                ours.run()
    return 0


KIND = ServerKind(
    name="lcm",
    role="command",
    summary="HOMIE's LCM channels: its cockpit drives our robot, or ours its robot",
    config=LcmConfig,
    main=main,
)


class ChannelIntake(ForeignStream):
    """Which message of a channel is passed on, and why another is not. Pure: no socket, no bus, no clock.

    Args:
        route: The channel.
    """

    def __init__(self, route: Route) -> None:
        then = "nothing is written for " + ", ".join(route.channel.parts)
        super().__init__(("lcm", "channel"), route.channel.name, self._commands, then=then)
        self.route = route

    def _commands(self, message: bytes, arrived_s: float) -> dict[str, bytes] | Dropped:
        try:
            numbers = self.route.channel.kind.decode(message)[self.route.channel.field]
        except BadMessage as error:
            return Dropped("wrong-length" if error.kind == "length" else "wrong-type", str(error))
        assert isinstance(numbers, tuple)
        if not np.isfinite(numbers).all():
            return Dropped("not-finite", f"a number of {self.route.channel.field} is not finite")
        values = {}
        for each, vector in zip(self.route.formats, self.route.commands(numbers), strict=True):
            data = codec.json_vector(vector)
            if (why_not := why_no_command(data, each)) is not None:
                return why_not
            values[each.key] = data
        return values


def _spoken(sender: Sender) -> str:
    return f"{sender[0]}:{sender[1]}"


def _their_cockpit(life: Life, lcm: Multicast, routes: Sequence[Route]) -> ForeignCommander:
    """Return what passes on the messages of a cockpit."""

    def receive(timeout_s: float) -> Iterator[tuple[str, Arrived]]:
        for each in lcm.receive(timeout_s):
            yield each.channel, Arrived(each.message, _spoken(each.sender), each.arrived_ns * 1e-9)

    intakes = [(ChannelIntake(route), [part.robot for part in route.formats]) for route in routes]
    return ForeignCommander(life, "lcm", "channel", intakes, receive, lcm.dropped)


class OurCockpit(ForeignRobot):
    """Commands their robot by what is on the bus. A context manager.

    Args:
        life: The server's.
        lcm: Where their robot hears.
        command: Of their robot.
    """

    def __init__(self, life: Life, lcm: Multicast, command: PartedCommand) -> None:
        rests = {
            name: Rest(
                None if (hand := homie.HANDS_AT_START.get(name)) is None else np.array(hand),
                stays=hand is not None, speed=HEIGHT_M_S if part.velocities else ARMS_RAD_S,
            )
            for part in command.parts if (name := part_name(command, part))
        }  # fmt: skip
        at_end = "their robot stands, its arms at rest"
        super().__init__(life, command, word="lcm", rests=rests, rate_hz=RATE_HZ, at_end=at_end)
        self._lcm, self._routes = lcm, homie.routes(command)
        self._sent = dict.fromkeys((route.channel.name for route in self._routes), 0)
        self._unsent, self._why_unsent = 0, ""
        self._measured: tuple[float, Sequence[float]] | None = None
        self._rival_s = -math.inf

    def where(self, name: str, now_s: float) -> Floats | None:
        """Return where their robot has an arm, if it says so and no arm was commanded yet.

        Later it lags behind what is asked of it, and who asks for that lets it sag.
        """
        if self._measured is None or name not in _MEASURED or any(self.parts[arm].is_begun for arm in _MEASURED):
            return None
        at_s, joints = self._measured
        if now_s - at_s > LATE_S:
            return None
        command_format = self.parts[name].path.command_format
        return np.clip(joints[_MEASURED[name]], command_format.lower, command_format.upper)

    def hear(self) -> None:
        """Hear where their robot is, and whether somebody else commands it."""
        for each in self._lcm.receive(0.0):
            if each.channel == homie.STATE_CHANNEL:
                with contextlib.suppress(BadMessage):  # of another project's robot, or of a later version
                    joints = types.BODY_CONTROL.decode(each.message)["q"]
                    if isinstance(joints, tuple) and np.isfinite(joints).all():
                        self._measured = each.arrived_ns * 1e-9, joints
            elif each.channel in self._sent:
                if self._rival_s == -math.inf:
                    detail = {"channel": each.channel, "sender": _spoken(each.sender)}
                    self.life.event("lcm-second-sender", severity="warning", **detail)
                self._rival_s = each.arrived_ns * 1e-9
        if self.clock.monotonic_s() - self._rival_s > SILENT_S and self._rival_s != -math.inf:
            self._rival_s = -math.inf
            self.life.event("lcm-second-sender", ended=True)

    def send(self, dt_s: float) -> None:
        """Send the channels on which anything was commanded yet."""
        for route in self._routes:
            parts = [self.parts[name] for name in route.channel.parts]
            name = route.channel.name
            if not any(part.is_begun for part in parts):
                continue
            numbers = route.numbers([part.vector for part in parts])
            why_not = self._lcm.send(name, route.channel.kind.encode({route.channel.field: numbers}))
            self._sent[name] += not why_not
            self._unsent += bool(why_not)
            if why_not != self._why_unsent:
                severity: Severity = "error" if why_not else "info"
                self.life.event("lcm-unsent", severity=severity, channel=name, reason=why_not, ended=not why_not)
                self._why_unsent = why_not

    def facts(self, now_s: float) -> dict[str, Any]:
        """Return what was sent on each channel, and how its parts are."""
        return {
            "channels": {
                route.channel.name: {
                    "sent": self._sent[route.channel.name],
                    "parts": {name: self.parts[name].status(now_s) for name in route.channel.parts},
                }
                for route in self._routes
            },
            "unsent": self._unsent, "robot_heard": self._measured is not None,
        }  # fmt: skip


_MEASURED = {"left_arm": slice(15, 22), "right_arm": slice(22, 29)}
"""Of the 29 joints of a G1."""
