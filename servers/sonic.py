"""The SONIC bridge: what commands GEAR-SONIC's robot drives ours, or our devices drive SONIC's robot.

==================  ===================================================================================================
`their-commander`   hears the topics ``command`` and ``planner`` or ``pose``, and writes the command of our robot as it
                    comes. What falls silent, or says ``stop``, writes nothing more: the robot's gate does the rest.
`our-commander`     publishes the same 50 times a second, of the command on the bus. The gate of that command is in
                    here: SONIC goes on with what came last, a planner's command for 1 s, a pose for ever.
==================  ===================================================================================================

What a field becomes stands in two tables, `adapters.sonic.planner` and `adapters.sonic.pose`. The messages say neither
who sends nor when.
"""

from __future__ import annotations

import contextlib
import re
from collections import Counter
from collections.abc import Iterator
from typing import Any, Literal

import msgspec
import numpy as np

from adapters import zeromq
from adapters.commands import velocity
from adapters.commands.g1_walk_track import motion_of
from adapters.sonic import planner, pose
from adapters.sonic.message import BadMessage, parse, topic_of
from adapters.sonic.planner import Order, PlannedVelocity, VelocityPlan
from adapters.sonic.pose import PosedMotion, StreamedPose
from station import libraries
from station.bus.address import is_loopback
from station.config import to_plain
from station.control.foreign_commander import ForeignCommander
from station.control.foreign_robot import ForeignRobot, Rest
from station.control.foreign_stream import SILENT_S, Arrived, Dropped, ForeignStream, as_command
from station.life.events import Severity
from station.life.loop import real_time
from station.life.server import Life, ServerKind
from station.protocols import CommandFormat, Floats

Mode = Literal["their-commander", "our-commander"]
Stream = Literal["planner", "pose"]
Legs = Literal["velocity", "velocity-height"]

ADDRESS = "tcp://127.0.0.1:5556"
"""Where SONIC's robot looks for its commander."""

RATE_HZ = 50.0
"""Messages per second that we send."""

JOINTS_RAD_S = 1.0
"""How fast a robot of theirs is brought to its standing pose."""

MOST_M_S, MOST_RAD_S = 2.5, 1.5
"""The most that SONIC's robot is asked for: it walks up to there, and runs beyond; the turn is ours."""

_QUEUED, _KERNEL_BYTES = 10, 16384  # that wait for a robot which does not read: old commands are worse than none
_MOST_LEFT_OUT = 32  # names of fields that are told: a stranger may invent some
_STARTS = 10  # so often an order is repeated: a subscriber that has just come may miss one
_NAME = re.compile(r"[a-z0-9_]*")


class SonicConfig(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Configuration of the SONIC bridge.

    Attributes:
        mode: ``their-commander`` drives our robot by what SONIC's would hear; ``our-commander`` drives SONIC's robot by
            the command on the bus.
        stream: ``planner``: velocities; ``pose``: whole-body motions, joint by joint.
        address: Where their commander publishes, or where ours listens for SONIC's robot.
        robot: Which command, by the end of the robot's keys; "" for ``g1_29``, with ``pose`` for TWIST2's robot.
        legs: With ``planner``: command format, ``velocity``, or ``velocity-height`` for a policy that takes a height.
        fastest_m_s: With ``planner`` and ``our-commander``: the fastest that SONIC's robot is asked to walk [m/s].
    """

    mode: Mode
    stream: Stream = "planner"
    address: str = ADDRESS
    robot: str = ""
    legs: Legs = "velocity"
    fastest_m_s: float = 0.8

    def __post_init__(self) -> None:
        zeromq.expect_address("address", self.address, listens=self.mode == "our-commander")
        if not _NAME.fullmatch(self.robot):
            raise ValueError(f"robot is {self.robot!r}; expected the end of a robot's keys, such as g1_29")
        if not 0.1 <= self.fastest_m_s <= MOST_M_S:
            raise ValueError(f"fastest_m_s is {self.fastest_m_s:g}; expected 0.1 to {MOST_M_S:g} m/s")
        if self.mode == "our-commander" and self.legs != "velocity":
            raise ValueError(f"legs is {self.legs!r}; SONIC's planner takes no height while it walks: leave it out")

    @property
    def command(self) -> CommandFormat:
        """Format of the robot's command."""
        if self.stream == "pose":
            return motion_of(self.robot)
        robot = self.robot or "g1_29"
        if self.mode == "their-commander":
            return velocity.FORMATS[self.legs].for_robot(robot)
        most = np.array([self.fastest_m_s, self.fastest_m_s, MOST_RAD_S])
        return velocity.FORMAT.for_robot(robot, -most, most)


def main(config: SonicConfig, life: Life) -> int:
    """Pass commands on until asked to stop; return the exit code."""
    command, is_theirs = config.command, config.mode == "their-commander"
    with contextlib.ExitStack() as stack:
        opened = (
            zeromq.Subscriber(config.address, (planner.COMMAND, config.stream), clock=life.clock)
            if is_theirs
            else zeromq.Publisher(config.address, queued=_QUEUED, kernel_bytes=_KERNEL_BYTES)
        )
        stack.callback(opened.close)
        life.configured({
            "server": life.name, "role": KIND.role, "robot": command.robot, "mode": config.mode,
            "topics": {config.stream: command.key}, "config": to_plain(config),
        })  # fmt: skip
        if not life.ready():
            return 0
        if isinstance(opened, zeromq.Subscriber):
            TheirCommander(life, opened, config).run()
        else:
            life.report(scheduling=real_time())
            if not is_loopback(zeromq.host_of(config.address)):
                note = "everybody who reaches it hears what is commanded; nobody can command here"
                life.event("sonic-open-to-network", severity="warning", address=config.address, note=note)
            with OurCommander(life, opened, config) as ours:
                ours.run()
    return 0


KIND = ServerKind(
    name="sonic",
    role="command",
    summary="GEAR-SONIC's streams: its commander drives our robot, or ours its robot",
    config=SonicConfig,
    main=main,
    expect=lambda config: libraries.expect("the SONIC bridge", "pyzmq", zeromq.EXTRA),
)


class TheirCommander:
    """Passes on what their commander sends.

    Args:
        life: The server's.
        heard: What it publishes.
        config: The server's.
    """

    def __init__(self, life: Life, heard: zeromq.Subscriber, config: SonicConfig) -> None:
        self._life, self._heard, self._config, self._command = life, heard, config, config.command
        self._topics = (planner.COMMAND, config.stream)
        self._not_for_us = Counter[str]()
        self._order: Order | None = None
        self._why_not = ""
        self._newest_s = 0.0
        self._walk = PlannedVelocity(has_height=len(self._command.default) > 3)
        self._motion = PosedMotion()
        self._left_out: frozenset[str] = frozenset()
        translate = self._planned if config.stream == "planner" else self._posed
        then = f"nothing is written on {self._command.key}"
        self._stream = ForeignStream(("sonic", "topic"), config.stream, translate, then=then)

    def run(self) -> None:
        """Pass on what comes until the server is asked to stop."""
        streams = [(self._stream, [self._command.robot])]
        ForeignCommander(self._life, "sonic", "topic", streams, self._receive, self._not_for_us).run()

    def _receive(self, timeout_s: float) -> Iterator[tuple[str, Arrived]]:
        self._life.report(ordered=self._why_not or "to follow", missing=self._motion.missing)
        for data, arrived_s in self._heard.receive(timeout_s):
            topic = topic_of(data, self._topics)
            if topic == planner.COMMAND:
                self._obey(data)
            elif topic:
                yield topic, Arrived(data, self._config.address, arrived_s)
            else:
                self._not_for_us["no topic of SONIC's"] += 1

    def _obey(self, data: bytes) -> None:
        """Obey an order: what they stop stays stopped until they start it."""
        try:
            order = planner.order_of(parse(planner.COMMAND, data))
        except BadMessage as error:
            self._not_for_us[f"a bad order: {error.kind}"] += 1
            return
        selected = "planner" if order.is_planner else "pose"
        was_stopped = self._order is not None and self._order.stop
        self._order = order._replace(stop=order.stop or (was_stopped and not order.start))
        why_not = ""
        if self._order.stop:
            why_not = "their commander said stop; it goes on with start"
        elif selected != self._config.stream:
            why_not = f"their commander chose the {selected} stream"
        if why_not != self._why_not:
            self._why_not = why_not
            severity: Severity = "warning" if why_not else "info"
            name = "sonic-stopped" if self._order.stop else "sonic-ordered"
            self._life.event(name, severity=severity, stream=selected, reason=why_not or "its commands are followed")

    def _planned(self, message: bytes, arrived_s: float) -> dict[str, bytes] | Dropped:
        return self._written(message, arrived_s, planner.PLANNER)

    def _posed(self, message: bytes, arrived_s: float) -> dict[str, bytes] | Dropped:
        return self._written(message, arrived_s, pose.POSE)

    def _written(self, message: bytes, arrived_s: float, topic: str) -> dict[str, bytes] | Dropped:
        if self._why_not:
            return Dropped("ordered-not-to", self._why_not)
        if arrived_s - self._newest_s > SILENT_S:
            self._walk.realign()
        self._newest_s = arrived_s
        try:
            said = parse(topic, message)
            if topic == pose.POSE:
                numbers = self._motion.command(pose.frame_of(said)).tolist()
            else:
                numbers = self._walk.command(planner.planned_of(said), arrived_s)
        except BadMessage as error:
            return Dropped(error.kind, str(error))
        self._tell_left_out(said.names)
        return as_command(numbers, self._command)

    def _tell_left_out(self, fields: frozenset[str]) -> None:
        """Tell once of each field that says what the command cannot, or that nobody here knows."""
        found = fields - _USED[self._config.stream] - self._left_out
        if found and len(self._left_out) < _MOST_LEFT_OUT:
            self._left_out |= found
            self._life.event("sonic-left-out", severity="warning", fields=sorted(found))


_USED: dict[Stream, frozenset[str]] = {"planner": planner.FIELDS, "pose": pose.FIELDS}


class OurCommander(ForeignRobot):
    """Commands SONIC's robot by what is on the bus. A context manager.

    Args:
        life: The server's.
        socket: Where their robot hears.
        config: The server's.
    """

    def __init__(self, life: Life, socket: zeromq.Publisher, config: SonicConfig) -> None:
        command = config.command
        at_end = "their robot stands"
        super().__init__(
            life, command, word="sonic", rests={command.name: Rest(speed=JOINTS_RAD_S)}, rate_hz=RATE_HZ, at_end=at_end
        )
        self._socket, self._stream = socket, config.stream
        (self._part,) = self.parts.values()
        self._plan, self._pose = VelocityPlan(), StreamedPose()
        self._starts = 0
        self._was_followed = False
        self._sent = self._unsent = 0
        self._why_unsent = ""
        self._is_heard = False

    def where(self, name: str, now_s: float) -> Floats | None:
        """Nothing is known: what SONIC's robot tells of itself is not read."""
        return None

    def hear(self) -> None:
        """Hear whether their robot listens."""
        self._socket.poll()
        is_heard = self._socket.is_wanted(self._stream.encode())
        if is_heard != self._is_heard:
            self._is_heard = is_heard
            self.life.event(
                "sonic-heard" if is_heard else "sonic-not-heard", severity="info" if is_heard else "warning"
            )

    def send(self, dt_s: float) -> None:
        """Send the command once there was one, and whoever engages also starts their robot."""
        if not self._part.is_begun:
            return
        if self._part.is_followed and not self._was_followed:
            self._starts = _STARTS
        self._was_followed = self._part.is_followed
        if self._starts:
            self._starts -= 1
            self._publish(planner.pack_order(Order(start=True, stop=False, is_planner=self._stream == "planner")))
        vector = self._part.vector
        if self._stream == "planner":
            self._publish(planner.pack_planned(self._plan.planned(vector, dt_s)))
        else:
            self._publish(self._pose.pack(vector, dt_s))

    def facts(self, now_s: float) -> dict[str, Any]:
        """Return what was sent, and how the command is."""
        told = {"sent": self._sent, "unsent": self._unsent, "heard": self._is_heard, **self._part.status(now_s)}
        return {"topics": {self._stream: told}}

    def _publish(self, message: bytes) -> None:
        why_not = self._socket.send(message)
        self._sent += not why_not
        self._unsent += bool(why_not)
        if why_not != self._why_unsent:
            severity: Severity = "warning" if why_not else "info"
            self.life.event("sonic-unsent", severity=severity, reason=why_not, ended=not why_not, unsent=self._unsent)
            self._why_unsent = why_not
