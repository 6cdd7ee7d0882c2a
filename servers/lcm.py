"""The LCM bridge: HOMIE's cockpit or its policy drives our robot, or we drive a robot that HOMIE's programs move.

===============  ======================================================================================================
`their-policy`   tells HOMIE's policy where our robot is, as its ``g1_control`` would, and writes what it asks of the
                 legs, and what a cockpit asks of the arms. While it sends nothing the robot stands by itself.
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
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, Literal, Self

import msgspec
import numpy as np

from adapters.lcm import homie, types
from adapters.lcm.homie import Legs, Route
from adapters.lcm.message import BadMessage
from adapters.lcm.multicast import GROUP, LOOPBACK, PORT, Multicast, Received, Sender
from station.bus import codec, keys
from station.config import to_plain
from station.control.foreign_commander import ForeignCommander
from station.control.foreign_robot import ForeignRobot, Rest
from station.control.foreign_stream import (
    LATE_S,
    SILENT_S,
    Arrived,
    Dropped,
    ForeignStream,
    as_command,
)
from station.life.events import Severity
from station.life.loop import real_time
from station.life.server import Life, ServerKind
from station.parts import PartedCommand, part_name
from station.protocols import Floats

Mode = Literal["their-policy", "their-cockpit", "our-cockpit"]

RATE_HZ = 50.0
"""Messages per second on each channel that we send: HOMIE's policy runs as often."""

HEIGHT_M_S, ARMS_RAD_S = 0.25, 1.0
"""How fast a robot of theirs is brought to rest: its height, and its arms. Velocities end as everywhere."""

STATE_HZ = 200.0
"""How often their policy is told where the robot is, as ``g1_control`` does."""

STEADY_HZ, STEADY_S = 30.0, 0.3
"""Targets are followed once they have come so often for so long: their policy sends 50 a second, and 14 while it
calibrates, when it asks for a pose that it has not tried out whether a robot stands in it."""

PRESS_AFTER_S, PRESS_EVERY_S, PRESS_S = 1.0, 2.0, 0.2
"""R2 of the remote is pressed once no targets have come for so long, again each so often, for so long [s]."""

_LOOK_S = 0.02
_STATE_SIZE = 65
_LARGEST = float(np.finfo(np.float32).max)  # what their messages hold
_GATE_S = 0.5  # a living robot says the state of its gate fifty times a second

_NAME = re.compile(r"[a-z0-9_]+")


class LcmConfig(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Configuration of the LCM bridge.

    Attributes:
        mode: ``their-cockpit`` drives our robot by HOMIE's channels; ``their-policy`` has HOMIE's policy move its legs;
            ``our-cockpit`` drives a robot of HOMIE's by the commands on the bus.
        robot: Which commands, by the end of the robot's keys.
        legs: Command format of the legs: ``velocity-height``, or ``velocity`` for a policy that takes no height; of no
            use to ``their-policy``.
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
        if self.hands and self.mode == "their-policy":
            raise ValueError("hands is true; expected false with mode their-policy: its robot has none")
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
    if config.mode == "their-policy":
        command = homie.low_level_of(config.robot)
        routes = homie.low_level_routes(command)
    else:
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
            _commander(life, lcm, [ChannelIntake(route) for route in routes], lambda: lcm.receive(_LOOK_S)).run()
            return 0
        life.report(scheduling=real_time())
        if config.mode == "their-policy":
            with OurRobot(life, lcm, config.robot) as robot:
                _commander(life, lcm, [TargetsIntake(routes[0]), ChannelIntake(routes[1])], robot.receive).run()
        else:
            with OurCockpit(life, lcm, command) as ours:
                ours.run()
    return 0


KIND = ServerKind(
    name="lcm",
    role="command",
    summary="HOMIE's LCM channels: its cockpit or policy drives our robot, or our cockpit its robot",
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
        if not all(map(math.isfinite, numbers)):
            return Dropped("not-finite", f"a number of {self.route.channel.field} is not finite")
        values: dict[str, bytes] = {}
        for each, part in zip(self.route.formats, self.route.commands(self._numbers(numbers)), strict=True):
            if isinstance(value := as_command(part, each), Dropped):
                return value
            values |= value
        return values

    def _numbers(self, numbers: Sequence[float]) -> Sequence[float]:
        """Return what of a message's numbers are the command."""
        return numbers


class TargetsIntake(ChannelIntake):
    """As `ChannelIntake`, of the targets of their policy, from when it has begun to run."""

    def __init__(self, route: Route) -> None:
        super().__init__(route)
        self._came_s = deque[float](maxlen=round(STEADY_HZ * STEADY_S) + 1)
        self._is_steady = False

    def _numbers(self, numbers: Sequence[float]) -> Sequence[float]:
        return homie.leg_command(numbers)

    def _commands(self, message: bytes, arrived_s: float) -> dict[str, bytes] | Dropped:
        found = super()._commands(message, arrived_s)
        if isinstance(found, Dropped):
            return found
        if self._came_s and arrived_s - self._came_s[-1] > STEADY_S:
            self._came_s.clear()
            self._is_steady = False
        self._came_s.append(arrived_s)
        took_s = arrived_s - self._came_s[0]
        self._is_steady = self._is_steady or (len(self._came_s) == self._came_s.maxlen and took_s <= STEADY_S)
        if self._is_steady:
            return found
        rate = f"{(len(self._came_s) - 1) / took_s:.0f} messages a second" if took_s > 0.0 else "the first message"
        expected = f"{STEADY_HZ:g} or more a second for {STEADY_S:g} s"
        return Dropped("not-steady", f"{rate}, expected {expected}; a policy that calibrates is waited for")


def _spoken(sender: Sender) -> str:
    return f"{sender[0]}:{sender[1]}"


def _commander(
    life: Life, lcm: Multicast, intakes: Sequence[ChannelIntake], receive: Callable[[], Iterable[Received]]
) -> ForeignCommander:
    """Return what passes on the messages of some channels."""

    def received(_: float) -> Iterator[tuple[str, Arrived]]:
        for each in receive():
            yield each.channel, Arrived(each.message, _spoken(each.sender), each.arrived_ns * 1e-9)

    streams = [(intake, [part.robot for part in intake.route.formats]) for intake in intakes]
    return ForeignCommander(life, "lcm", "channel", streams, received, lcm.dropped)


class Outlet:
    """Sends messages; counts them, and tells when that fails and when it does again.

    Args:
        life: The server's.
        lcm: Where it sends.

    Attributes:
        sent: Messages of each channel.
        unsent: Those that could not be sent.
    """

    def __init__(self, life: Life, lcm: Multicast) -> None:
        self._life, self._lcm = life, lcm
        self.sent, self.unsent, self._why_not = Counter[str](), 0, ""

    def send(self, channel: str, message: bytes) -> None:
        """Send a message."""
        why_not = self._lcm.send(channel, message)
        self.sent[channel] += not why_not
        self.unsent += bool(why_not)
        if why_not != self._why_not:
            severity: Severity = "error" if why_not else "info"
            self._life.event("lcm-unsent", severity=severity, channel=channel, reason=why_not, ended=not why_not)
            self._why_not = why_not


class Rivals:
    """Whether somebody else sends on channels that are ours to send on.

    Args:
        life: The server's.
    """

    def __init__(self, life: Life) -> None:
        self._life, self._heard_s = life, -math.inf

    def record(self, heard: Received) -> None:
        """Record a message of somebody else."""
        if self._heard_s == -math.inf:
            detail = {"channel": heard.channel, "sender": _spoken(heard.sender)}
            self._life.event("lcm-second-sender", severity="warning", **detail)
        self._heard_s = heard.arrived_ns * 1e-9

    def on_tick(self, now_s: float) -> None:
        """Tell when that has ended, at an instant [s]."""
        if now_s - self._heard_s > SILENT_S and self._heard_s != -math.inf:
            self._heard_s = -math.inf
            self._life.event("lcm-second-sender", ended=True)


class OurRobot:
    """Tells their policy where our robot is, and presses its buttons. A context manager.

    R2 is what a person presses there to have it calibrate, and once more to have it begin. Here a person arms the
    robot; while it is armed and no targets come, R2 is pressed now and then, whatever it is that they wait for.

    Args:
        life: The server's.
        lcm: Where their policy hears.
        robot: Suffix of the robot's keys.
    """

    def __init__(self, life: Life, lcm: Multicast, robot: str) -> None:
        self._life, self._lcm, self._clock = life, lcm, life.clock
        self._state_key, self._gate_key = keys.robot_state(robot), keys.command_gate(robot)
        self._watch = life.bus.watch([self._state_key, self._gate_key])
        self._outlet, self._rivals = Outlet(life, lcm), Rivals(life)
        self._due_s = self._came_s = self._pressed_s = self._clock.monotonic_s()
        self._is_told = False  # whether their policy is told where the robot is
        self._presses = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._watch.close()

    def receive(self) -> Iterator[Received]:
        """Tell where the robot is, if that is due; yield what comes until it is due again."""
        now_s = self._clock.monotonic_s()
        if now_s >= self._due_s:
            self._due_s = max(self._due_s + 1.0 / STATE_HZ, now_s)
            self._tell(now_s)
        for each in self._lcm.receive(max(0.0, self._due_s - self._clock.monotonic_s())):
            if each.channel in self._outlet.sent:
                self._rivals.record(each)
                continue
            if each.channel == homie.TARGETS_CHANNEL.name:
                self._came_s = each.arrived_ns * 1e-9
            yield each

    def _tell(self, now_s: float) -> None:
        self._rivals.on_tick(now_s)
        state = self._state()
        if (state is not None) != self._is_told:
            self._is_told = state is not None
            then = {} if self._is_told else {"then": "their policy is told nothing"}
            severity: Severity = "info" if self._is_told else "warning"
            self._life.event("lcm-robot-told" if self._is_told else "lcm-robot-silent", severity=severity, **then)
        if state is not None:
            messages = homie.robot_messages(state, is_pressed=self._is_pressed(now_s))
            for channel, message in messages.items():
                self._outlet.send(channel, message)
        told = {"sent": dict(self._outlet.sent), "unsent": self._outlet.unsent, "presses": self._presses}
        self._life.report(**told, robot_heard=self._is_told)

    def _state(self) -> Floats | None:
        """Return the robot's state, shape (65,), if it says one that is new."""
        sample = self._watch.latest(self._state_key, max_age_s=LATE_S)
        if sample is None:
            return None
        try:
            state = codec.parse_f64(sample.value)
        except codec.BadValue:
            return None
        fits = state.shape == (_STATE_SIZE,) and bool((np.abs(state) < _LARGEST).all())
        return state if fits else None

    def _is_pressed(self, now_s: float) -> bool:
        """Return whether R2 is down; tell each time that it is pressed."""
        since_s = now_s - self._pressed_s
        if self._presses and since_s < PRESS_S:
            return self._came_s < self._pressed_s
        if now_s - self._came_s < PRESS_AFTER_S or since_s < PRESS_EVERY_S or not self._is_armed():
            return False
        self._pressed_s, self._presses = now_s, self._presses + 1
        if self._presses == 1:
            self._life.event("lcm-pressed", button="R2", then="again while no targets come")
        return True

    def _is_armed(self) -> bool:
        """Whether the robot's server says that it is armed, and not stopped."""
        sample = self._watch.latest(self._gate_key, max_age_s=_GATE_S)
        gate = codec.parse_facts(None if sample is None else sample.value)
        return gate.get("arming") == "armed" and gate.get("state") != "stopped"


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
        self._outlet, self._rivals = Outlet(life, lcm), Rivals(life)
        self._ours = {route.channel.name for route in self._routes}
        self._measured: tuple[float, Sequence[float]] | None = None

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
            elif each.channel in self._ours:
                self._rivals.record(each)
        self._rivals.on_tick(self.clock.monotonic_s())

    def send(self, dt_s: float) -> None:
        """Send the channels on which anything was commanded yet."""
        for route in self._routes:
            parts = [self.parts[name] for name in route.channel.parts]
            if any(part.is_begun for part in parts):
                numbers = route.numbers([part.vector.tolist() for part in parts])
                self._outlet.send(route.channel.name, route.channel.kind.encode({route.channel.field: numbers}))

    def facts(self, now_s: float) -> dict[str, Any]:
        """Return what was sent on each channel, and how its parts are."""
        return {
            "channels": {
                route.channel.name: {
                    "sent": self._outlet.sent[route.channel.name],
                    "parts": {name: self.parts[name].status(now_s) for name in route.channel.parts},
                }
                for route in self._routes
            },
            "unsent": self._outlet.unsent, "robot_heard": self._measured is not None,
        }  # fmt: skip


_MEASURED = {"left_arm": slice(15, 22), "right_arm": slice(22, 29)}
"""Of the 29 joints of a G1."""
