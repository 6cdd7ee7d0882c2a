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
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, Self

import msgspec
import numpy as np

from adapters.lcm import homie, types
from adapters.lcm.homie import Legs, Route
from adapters.lcm.message import BadMessage
from adapters.lcm.multicast import GROUP, LOOPBACK, PORT, Multicast, Received, Sender
from station.blends import VELOCITY_FADE_S
from station.bus import acl, codec, keys
from station.config import to_plain
from station.control.arming import Arming
from station.control.command_arbiter import CommandArbiter
from station.control.command_path import CommandPath
from station.control.command_receiver import CommandReceiver, CommandWatch
from station.control.command_validator import CommandSample, Refusal, check_command
from station.control.gate import FOLLOWING, Decision, GateConfig
from station.control.parted_path import PartedPath
from station.life import estop
from station.life.events import Severity
from station.life.loop import real_time
from station.life.pace import WallPace
from station.life.server import Life, ServerKind
from station.life.stop_file import StopFile
from station.parts import PartedCommand
from station.protocols import Floats

Mode = Literal["their-cockpit", "our-cockpit"]

RATE_HZ = 50.0
"""Messages per second on each channel that we send: HOMIE's policy runs as often."""

SILENT_S = 0.5
"""Whoever has sent nothing for so long on a channel is silent, and another may command on it [s]."""

LATE_S = 0.1
"""A message that lay in this computer for longer is refused [s]: it came while this process stood still."""

HEIGHT_M_S, ARMS_RAD_S = 0.25, 1.0
"""How fast a robot of theirs is brought to rest: its height, and its arms. Velocities end as everywhere."""

_LOOK_S = 0.02
_REPEATED = 10  # so often the last message is sent again at the end: a datagram may be lost
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
            TheirCockpit(life, lcm, routes).run()
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


@dataclass(frozen=True, slots=True)
class Taken:
    """A message that may be passed on.

    Attributes:
        values: Bytes of each key.
        arrived_s: When it came, on the monotonic clock [s].
        sender: Who sent it.
    """

    values: dict[str, bytes]
    arrived_s: float
    sender: str


class Dropped(NamedTuple):
    """Why a message is not passed on: a word, and a sentence."""

    kind: str
    text: str


class ChannelIntake:
    """Which message of a channel is passed on, and why another is not. Pure: no socket, no bus, no clock.

    Args:
        route: The channel.

    Attributes:
        passed: Messages that were passed on.
        dropped: Others, by the reason.
    """

    def __init__(self, route: Route) -> None:
        self.route = route
        self.passed, self.dropped = 0, Counter[str]()
        self._senders = CommandArbiter("keep-first", SILENT_S)
        self._taken: Taken | None = None
        self._delay_s = 0.0
        self._is_live = False
        self._refused_s: float | None = None  # when a message was refused last; None once that is over
        self._events: list[tuple[str, Severity, dict[str, Any]]] = []

    @property
    def is_live(self) -> bool:
        """Whether messages of it are being passed on."""
        return self._is_live

    def take(self, received: Received, now_s: float) -> Taken | None:
        """Return what is to be written for a message, or None.

        Args:
            received: A message of the channel.
            now_s: The instant [s].
        """
        arrived_s, sender = received.arrived_ns * 1e-9, _spoken(received.sender)
        found = self._values(received.message, now_s - arrived_s)
        if isinstance(found, Dropped):
            self.dropped[found.kind] += 1
            if self._refused_s is None:
                self._tell("lcm-refused", "warning", reason=f"{found.kind}: {found.text}", sender=sender)
            self._refused_s = now_s
            return None
        if not self._senders.on_write(sender, arrived_s):
            self.dropped["second-sender"] += 1
            return None
        return Taken(found, arrived_s, sender)

    def record(self, taken: Taken, now_s: float) -> None:
        """Record that a message has been passed on, at an instant [s]."""
        self.passed, self._delay_s = self.passed + 1, now_s - taken.arrived_s
        if not self._is_live:
            self._is_live = True
            back = {} if self._taken is None else {"silent_s": round(taken.arrived_s - self._taken.arrived_s, 3)}
            self._tell("lcm-live" if self._taken is None else "lcm-back", "info", sender=taken.sender, **back)
        self._taken = taken

    def on_tick(self, now_s: float) -> Iterator[tuple[str, Severity, dict[str, Any]]]:
        """Yield the events since the last call: name, severity, detail.

        Args:
            now_s: The instant until which every message was taken [s].
        """
        self._senders.know((-math.inf, now_s))
        if self._is_live and self._taken is not None and now_s - self._taken.arrived_s > SILENT_S:
            self._is_live = False
            self._tell(
                "lcm-silent", "warning", sender=self._taken.sender, passed=self.passed,
                then="nothing is written for " + ", ".join(self.route.channel.parts),
            )  # fmt: skip
        if self._refused_s is not None and now_s - self._refused_s > SILENT_S:
            self._refused_s = None
            self._tell("lcm-refused", "info", ended=True, dropped=dict(self.dropped))
        for news in self._senders.pop_news(now_s):
            severity: Severity = "warning" if news.kind == "rivals" else "info"
            name = "lcm-handover" if news.kind == "handover" else "lcm-second-sender"
            ended = {"ended": True} if news.kind == "alone" else {}
            self._tell(name, severity, senders=list(news.writers), heard=news.obeyed, refused=news.refused, **ended)
        events, self._events = self._events, []
        yield from events

    def status(self, now_s: float) -> dict[str, Any]:
        """Return what a heartbeat tells of the channel at an instant [s]; `delay_ms` is from arrival to the bus."""
        told: dict[str, Any] = {"passed": self.passed, "dropped": dict(self.dropped), "live": self._is_live}
        if self._taken is not None:
            age_s = now_s - self._taken.arrived_s
            told |= {"sender": self._taken.sender, "age_s": round(age_s, 3), "delay_ms": round(self._delay_s * 1e3, 2)}
        return told

    def _values(self, message: bytes, age_s: float) -> dict[str, bytes] | Dropped:
        if age_s > LATE_S:
            return Dropped("stale", f"it lay here for {age_s:.3g} s, allowed are {LATE_S:g} s")
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
            if isinstance(checked := check_command(data, each), Refusal):
                return Dropped(checked.kind, checked.text)
            values[each.key] = data
        return values

    def _tell(self, name: str, severity: Severity, **detail: Any) -> None:
        self._events.append((name, severity, {"channel": self.route.channel.name, **detail}))


def _spoken(sender: Sender) -> str:
    return f"{sender[0]}:{sender[1]}"


class TheirCockpit:
    """The loop: hear, write, tell.

    Args:
        life: The server's.
        lcm: Where the cockpit sends to.
        routes: The channels that are heard.
    """

    def __init__(self, life: Life, lcm: Multicast, routes: Sequence[Route]) -> None:
        self._life, self._lcm, self._clock = life, lcm, life.clock
        self._intakes = {route.channel.name: ChannelIntake(route) for route in routes}
        self._other = Counter[str]()

    def run(self) -> None:
        """Pass on what comes until the server is asked to stop."""
        while not self._life.stopping:
            self._pass_on(self._lcm.receive(_LOOK_S))
            now_s = self._clock.monotonic_s()
            for intake in self._intakes.values():
                for name, severity, detail in intake.on_tick(now_s):
                    self._life.event(name, severity=severity, **detail)
            self._life.report(
                channels={name: intake.status(now_s) for name, intake in self._intakes.items()},
                not_for_us=dict(self._other + self._lcm.dropped),
            )
        if live := [name for name, intake in self._intakes.items() if intake.is_live]:
            reason = "the server was asked to stop"
            self._life.event("teleop-commands-end", reason=reason, channels=live, then="the robot's gate takes over")

    def _pass_on(self, received: Iterable[Received]) -> None:
        """Write the newest good message of each channel, all at once."""
        newest: dict[str, Taken] = {}
        for each in received:
            intake = self._intakes.get(each.channel)
            if intake is None:
                self._other["another channel"] += 1
            elif (taken := intake.take(each, self._clock.monotonic_s())) is not None:
                if each.channel in newest:
                    intake.dropped["superseded"] += 1
                newest[each.channel] = taken
        if not newest:
            return
        values: dict[str, bytes] = {}
        for name, taken in newest.items():
            source = codec.json_object({"kind": "lcm", "channel": name, "sender": taken.sender})
            robots = [part.robot for part in self._intakes[name].route.formats]
            values |= taken.values | {keys.command_source(robot): source for robot in robots}
        is_taken = self._life.bus.publish(values)
        now_s = self._clock.monotonic_s()
        for name, taken in newest.items():
            if is_taken:
                self._intakes[name].record(taken, now_s)
            else:
                self._intakes[name].dropped["bus-lost"] += 1


class CommandedPart:
    """A part of their robot: the command's way to it, its writers, and where it rests.

    One that was never commanded is asked to stay where it is.

    Args:
        path: Validator and gate.
        watch: Watches the part's key.

    Attributes:
        vector: What their robot is asked for, shape (m,).
        is_begun: Whether it was commanded yet.
    """

    def __init__(self, path: CommandPath, watch: CommandWatch) -> None:
        self.path, self.watch = path, watch
        command_format, config = path.command_format, path.gate.config
        self._receiver = CommandReceiver(
            watch, command_format.key, CommandArbiter(config.rivals, config.return_after_s)
        )
        start = homie.HANDS_AT_START.get(path.part, command_format.default)
        self.vector: Floats = np.clip(start, command_format.lower, command_format.upper)
        self.is_begun = False
        self._home = None if path.part in homie.HANDS_AT_START else command_format.default
        self._speed = np.full(len(self.vector), HEIGHT_M_S if command_format.velocities else ARMS_RAD_S)
        fastest = np.maximum(-command_format.lower, command_format.upper)
        for index in command_format.velocities:
            self._speed[index] = fastest[index] / VELOCITY_FADE_S

    @property
    def is_at_rest(self) -> bool:
        """Whether it is where it is brought without commands; a hand stays as it is, with what it holds."""
        return self._home is None or bool(np.array_equal(self.vector, self._home))

    def bring_home(self, dt_s: float) -> None:
        """Go on towards rest for a period [s]."""
        if self._home is not None:
            most = self._speed * dt_s
            self.vector = self.vector + np.clip(self._home - self.vector, -most, most)

    def sample(self) -> CommandSample | None:
        """Return the newest command of the writer that is obeyed, and say to the gate what was heard."""
        found = self._receiver.newest()
        if refused := self._receiver.pop_refused():
            self.path.refuse_rivals(refused, self._receiver.writers.refusal)
        self.path.heard_all(*self._receiver.heard_s)
        return found

    def rest(self, measured: Floats | None, dt_s: float) -> None:
        """Say to the gate of a part that has no way back where it is now; call before each decision.

        Args:
            measured: Where their robot has it, shape (m,); None where that is not known, or the channel has begun.
            dt_s: The period [s].
        """
        if not self.path.command_format.holds_position:
            return
        if measured is not None:
            self.vector = measured
        elif self.is_begun and self.path.gate.state == "waiting":
            self.bring_home(dt_s)
        self.path.gate.rest(self.vector)


class OurCockpit:
    """The loop: hear commands and the stop, decide, send, tell. A context manager.

    Args:
        life: The server's.
        lcm: Where their robot hears.
        command: Of their robot.
    """

    def __init__(self, life: Life, lcm: Multicast, command: PartedCommand) -> None:
        self._life, self._lcm, self._clock = life, lcm, life.clock
        self._all = PartedPath(command, GateConfig(), Arming(is_armed=True))
        self._parts: dict[str, CommandedPart] = {}
        for path in self._all.paths:
            watched = [path.command_format.key, *(() if self._parts else estop.KEYS)]
            bus = life.bus
            watch = CommandWatch(bus.address, watched, key=watched[0], outages=bus.outages, clocks=bus.clocks)
            self._parts[path.part] = CommandedPart(path, watch)
        self._stops = next(iter(self._parts.values())).watch
        self._routes = homie.routes(command)
        self._sent = dict.fromkeys((route.channel.name for route in self._routes), 0)
        self._unsent, self._why_unsent = 0, ""
        self._why_stopped = ""
        self._is_stopped_past_bus = False
        self._returning = set[str]()
        self._measured: tuple[float, Sequence[float]] | None = None
        self._rival_s = -math.inf
        user = life.bus.address.username
        self._may_say_where = user not in acl.ROLES or user == "low-level"
        life.on_estop(self._on_supervisor_stop)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        for part in self._parts.values():
            part.watch.close()

    def run(self) -> None:
        """Send until asked to stop; then, or on an error, bring their robot to rest first."""
        pace = WallPace(RATE_HZ, self._clock)
        dt_s = 1.0 / RATE_HZ
        self._begin()
        try:
            while not self._life.stopping:
                self._tick(dt_s)
                self._life.report(**pace.health())
                dt_s = pace.wait(is_leaving=False)
        except Exception as error:
            self._life.event("lcm-error", severity="error", reason=f"{type(error).__name__}: {error}")
            raise
        finally:
            self._leave(pace)

    def _begin(self) -> None:
        if not self._may_say_where:
            reason = f"user {self._life.bus.address.username!r} of the bus may not say where a robot is"
            self._life.event("lcm-says-not-where", severity="warning", reason=reason, then="leaders do not engage")
        self._stops.begin_stops()
        if (found := estop.latched(self._stops.latest)) is not None:
            self._stop(found[0].reason)
        elif (remembered := StopFile(self._life.bus.address).read()) is not None:
            self._stop(remembered.reason)

    def _tick(self, dt_s: float) -> None:
        self._hear()
        self._obey_stop()
        now_s = self._clock.monotonic_s()
        for name, part in self._parts.items():
            part.rest(self._where(name, now_s), dt_s)
        samples = tuple(part.sample() for part in self._parts.values())
        why_blocked = f"emergency stop: {self._why_stopped}" if self._why_stopped else ""
        decision = self._all.decide(samples, now_s, why_blocked=why_blocked)
        for part, of_part in zip(self._parts.values(), decision.parts, strict=True):
            part.vector = of_part.vector
            part.is_begun = part.is_begun or of_part.state in FOLLOWING
        self._send()
        if self._may_say_where:
            self._life.bus.publish(self._values(decision))
        self._tell(now_s)

    def _where(self, name: str, now_s: float) -> Floats | None:
        """Return where their robot has an arm, if it says so and no arm was commanded yet.

        Later it lags behind what is asked of it, and who asks for that lets it sag.
        """
        if self._measured is None or name not in _MEASURED or any(self._parts[arm].is_begun for arm in _MEASURED):
            return None
        at_s, joints = self._measured
        if now_s - at_s > LATE_S:
            return None
        command_format = self._parts[name].path.command_format
        return np.clip(joints[_MEASURED[name]], command_format.lower, command_format.upper)

    def _hear(self) -> None:
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
                    self._life.event("lcm-second-sender", severity="warning", **detail)
                self._rival_s = each.arrived_ns * 1e-9
        if self._clock.monotonic_s() - self._rival_s > SILENT_S and self._rival_s != -math.inf:
            self._rival_s = -math.inf
            self._life.event("lcm-second-sender", ended=True)

    def _obey_stop(self) -> None:
        news = self._stops.pop_stop()
        if self._is_stopped_past_bus:
            self._is_stopped_past_bus = False
            self._stop("key in `station up`")
        elif news is not None and news.request.stop:
            self._stop(news.request.reason)
        elif news is not None and self._why_stopped:
            self._why_stopped = ""
            for part in self._parts.values():  # a commander that wrote through the stop has to cease, and begin anew
                part.path.gate.insist_on_silence("there was a stop")
            self._life.event("estop-reset", reason=news.request.reason)

    def _stop(self, reason: str) -> None:
        if not self._why_stopped:
            self._life.event("estop", severity="error", reason=reason, then="their robot is brought to rest")
        self._why_stopped = reason

    def _on_supervisor_stop(self) -> None:
        self._is_stopped_past_bus = True

    def _send(self) -> None:
        """Send the channels on which anything was commanded yet."""
        for route in self._routes:
            parts = [self._parts[name] for name in route.channel.parts]
            name = route.channel.name
            if not any(part.is_begun for part in parts):
                continue
            numbers = route.numbers([part.vector for part in parts])
            why_not = self._lcm.send(name, route.channel.kind.encode({route.channel.field: numbers}))
            self._sent[name] += not why_not
            self._unsent += bool(why_not)
            if why_not != self._why_unsent:
                severity: Severity = "error" if why_not else "info"
                self._life.event("lcm-unsent", severity=severity, channel=name, reason=why_not, ended=not why_not)
                self._why_unsent = why_not

    def _values(self, decision: Decision) -> dict[str, bytes]:
        """Return what a commander has to know of each part, by key: whether it is followed, and where the part is."""
        values: dict[str, bytes] = {}
        for part, of_part in zip(self._parts.values(), decision.parts, strict=True):
            robot = part.path.command_format.robot
            values[keys.command_gate(robot)] = codec.json_object(part.path.status(of_part))
            values[keys.command_used(robot)] = codec.f64(part.vector)
        return values

    def _tell(self, now_s: float) -> None:
        for each in self._all.taken():
            self._life.event(each.name, severity=each.severity, **each.detail)
        unled = {name for name, part in self._parts.items() if part.is_begun and part.path.gate.state not in FOLLOWING}
        returning = {name for name in unled if not self._parts[name].is_at_rest}
        if begin := sorted(returning - self._returning):
            why = {name: self._parts[name].path.gate.reason for name in begin}
            self._life.event("lcm-returning", severity="warning", parts=why)
        if rests := sorted((self._returning & unled) - returning):
            self._life.event("lcm-at-rest", parts=rests)
        self._returning = returning
        self._life.report(
            channels={
                route.channel.name: {
                    "sent": self._sent[route.channel.name],
                    "parts": {name: self._told(name, now_s) for name in route.channel.parts},
                }
                for route in self._routes
            },
            unsent=self._unsent, stopped=self._why_stopped, robot_heard=self._measured is not None,
        )  # fmt: skip

    def _told(self, name: str, now_s: float) -> dict[str, Any]:
        path = self._parts[name].path
        age_s = path.validator.age_s(now_s)
        return {
            "gate": path.gate.state, "dropped": dict(path.validator.refused),
            "age_s": round(age_s, 3) if math.isfinite(age_s) else None,
        }  # fmt: skip

    def _leave(self, pace: WallPace) -> None:
        """Bring what was commanded to rest without anything that may have broken: the bus, a gate."""
        begun = [part for part in self._parts.values() if part.is_begun]
        if not begun:
            return
        self._life.event(
            "lcm-returning", severity="warning", parts={part.path.part: "the bridge ends" for part in begun}
        )
        repeated = 0
        while repeated < _REPEATED:
            repeated += all(part.is_at_rest for part in begun)
            dt_s = pace.wait(is_leaving=True)
            for part in begun:
                part.bring_home(dt_s)
            self._send()
        self._life.event("teleop-commands-end", reason="the bridge ends", then="their robot stands, its arms at rest")


_MEASURED = {"left_arm": slice(15, 22), "right_arm": slice(22, 29)}
"""Of the 29 joints of a G1."""
