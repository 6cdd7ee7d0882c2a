"""The bridge to motion_tracking's teleoperation: its pose server's poses drive our robot, or our commands its robot.

==================  ===================================================================================================
`their-commander`   plays its robot: asks its pose server for a pose 50 times a second, from the button to begin until
                    that to end, and writes what comes. A server that falls silent leaves nothing written; the robot's
                    gate does the rest, and blends into the first pose.
`our-commander`     plays its pose server: answers each question with what the command on the bus means at that
                    instant. The gate of that command is in here: a robot of theirs stays in the pose that came last,
                    also when it is told to end. So it is brought to stand first.
==================  ===================================================================================================

What a pose becomes, and a command, stands in `adapters.pose_server` and `adapters.commands.root`.
"""

from __future__ import annotations

import contextlib
import re
from collections import Counter, deque
from collections.abc import Iterator
from typing import Any, Literal

import msgspec
import numpy as np

from adapters import zeromq
from adapters.commands.g1_walk_track import motion_of
from adapters.commands.root import CommandedRoot
from adapters.pose_server import PORTS, AskingRobot, BadPose, Pose, PosedRobot, PoseServer, Session, parse_pose
from station import libraries
from station.bus.address import is_loopback
from station.clock import Clock
from station.config import to_plain
from station.control.foreign_commander import ForeignCommander
from station.control.foreign_robot import ForeignRobot, Rest
from station.control.foreign_stream import SILENT_S, Arrived, Dropped, ForeignStream, as_command
from station.life.ages import Ages
from station.life.events import Severity
from station.life.loop import real_time
from station.life.pace import Pace
from station.life.server import Life, ServerKind
from station.protocols import Floats

Mode = Literal["their-commander", "our-commander"]

RATE_HZ = 50.0
"""Questions per second of a robot of theirs."""

JOINTS_RAD_S = 1.0
"""How fast a robot of theirs is brought to its standing pose where nothing else does."""

_IDLE_S = 0.03  # without a question; longer than the time between two, so that none has to wait for a tick
_SHORTEST_S = 0.005  # between two ticks: whoever asks more often waits
_LONGEST_S = 0.1  # of motion that a tick makes up for, after this process stood still
_CONNECTED_S = 1.0  # a robot that waits for this server tries ten times a second
_SEEN_S = 0.2  # it has to have seen the buttons released: what is pressed from the start says nothing
_SETTLED = 25  # ticks at rest before their robot is told to end: it stays in what it was answered last
_PRESSED = 10  # ticks for which a button is pressed: a robot looks 50 times a second, at what was said last
_NAME = re.compile(r"[a-z0-9_]*")


class MotionTrackingConfig(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Configuration of the bridge to motion_tracking.

    Attributes:
        mode: ``their-commander`` drives our robot by its pose server; ``our-commander`` drives its robot by the
            whole-body command on the bus.
        host: Where its pose server is, a name or an address; or the one address of this computer on which ours listens.
        ports: For questions, answers and buttons.
        robot: Which motion command, by the end of the robot's keys; "" for TWIST2's robot.
    """

    mode: Mode = "their-commander"
    host: str = "127.0.0.1"
    ports: tuple[int, int, int] = PORTS
    robot: str = ""

    def __post_init__(self) -> None:
        for port in self.ports:
            listens = self.mode == "our-commander"
            zeromq.expect_address("host and ports", f"tcp://{self.host}:{port}", listens=listens)
        if not _NAME.fullmatch(self.robot):
            raise ValueError(f"robot is {self.robot!r}; expected the end of a robot's keys, such as g1_29_track")


def main(config: MotionTrackingConfig, life: Life) -> int:
    """Pass poses on until asked to stop; return the exit code."""
    command = motion_of(config.robot)
    kind = PoseServer if config.mode == "their-commander" else AskingRobot
    with contextlib.closing(kind(config.host, config.ports)) as opened:
        life.configured({
            "server": life.name, "role": KIND.role, "robot": command.robot, "mode": config.mode, "key": command.key,
            "config": to_plain(config),
        })  # fmt: skip
        if not life.ready():
            return 0
        if isinstance(opened, PoseServer):
            PosesIn(life, opened, config).run()
        else:
            life.report(scheduling=real_time())
            if not is_loopback(config.host):
                note = "everybody who reaches it is told what is commanded; nobody can command here"
                life.event("motion-tracking-open-to-network", severity="warning", host=config.host, note=note)
            with PosesOut(life, opened, config) as ours:
                ours.run()
    return 0


KIND = ServerKind(
    name="motion-tracking",
    role="command",
    summary="motion_tracking's teleoperation: its poses drive our robot, or our commands its robot",
    config=MotionTrackingConfig,
    main=main,
    expect=lambda config: libraries.expect("the bridge to motion_tracking", "pyzmq", zeromq.EXTRA),
)


class PosesIn:
    """Asks, and passes on what is answered.

    Args:
        life: The server's.
        server: What is asked.
        config: The server's.
    """

    def __init__(self, life: Life, server: PoseServer, config: MotionTrackingConfig) -> None:
        self._life, self._server, self._clock = life, server, life.clock
        self._command, self._name = motion_of(config.robot), f"{config.host}:{config.ports[1]}"
        self._session, self._robot = Session(), PosedRobot()
        self._asked, self._not_for_us = 0, Counter[str]()
        self._buttons = 0
        then = f"nothing is written on {self._command.key}"
        self._stream = ForeignStream(("motion-tracking", "stream"), "poses", self._translate, then=then)

    def run(self) -> None:
        """Pass on what comes until the server is asked to stop."""
        streams = [(self._stream, [self._command.robot])]
        ForeignCommander(
            self._life, "motion-tracking", "stream", streams, self._receive, self._not_for_us
        ).run()  # fmt: skip

    def _receive(self, timeout_s: float) -> Iterator[tuple[str, Arrived]]:
        self._server.wait(min(timeout_s, self._session.due_s(self._clock.monotonic_s())))
        for begins, ends in self._server.buttons():
            self._buttons += 1
            before, now = self._session.state, self._session.on_buttons(begins, ends)
            if now != before:
                self._life.event("motion-tracking-ended" if now == "waiting" else "motion-tracking-begun")
        for message in self._server.answers():
            asked_s = self._session.asked_s
            yield "poses", Arrived(message, self._name, self._clock.monotonic_s() if asked_s is None else asked_s)
        if (question := self._session.ask(self._clock.monotonic_s())) is not None:
            self._asked += self._server.ask(question)
        self._not_for_us.clear()
        self._not_for_us.update(self._server.bad)
        self._life.report(session=self._session.state, asked=self._asked, buttons=self._buttons)

    def _translate(self, message: bytes, asked_s: float) -> dict[str, bytes] | Dropped:
        try:
            pose = parse_pose(message)
        except BadPose as error:
            return Dropped("bad-pose", str(error))
        if why_not := self._session.on_answer(pose.is_start):
            return Dropped("not-asked", why_not)
        return as_command(self._robot.command(pose.qpos, asked_s).tolist(), self._command)


class PosesOut(ForeignRobot):
    """Answers their robot by the command on the bus. A context manager.

    Args:
        life: The server's.
        robot: Who asks.
        config: The server's.
    """

    def __init__(self, life: Life, robot: AskingRobot, config: MotionTrackingConfig) -> None:
        command = motion_of(config.robot)
        rests = {command.name: Rest(speed=JOINTS_RAD_S)}
        at_end = "their robot stands, and follows no more"
        super().__init__(life, command, word="motion-tracking", rests=rests, rate_hz=RATE_HZ, at_end=at_end)
        self._robot, self._key = robot, command.key
        (self._part,) = self.parts.values()
        self._root = CommandedRoot()
        self._begin_ticks = self._end_ticks = self._rest_ticks = 0
        self._was_followed = False
        self._engaged_s: float | None = None  # when somebody did for whom no robot was begun yet
        self._connected, self._connected_s = frozenset[int](), 0.0
        self._begun: int | None = None  # the connection that was told to begin, as long as it is there
        self._is_open = self._is_to_end = False
        self._asked = self._answered = 0
        self._asked_s: float | None = None
        self._is_asked = False
        self._unanswered = Counter[str]()
        self._ages = Ages()

    def __exit__(self, *_: object) -> None:
        if self._is_to_end:
            self._robot.press(begins=False, ends=True, wall_ns=self.clock.wall_ns())
        super().__exit__()

    def pace(self) -> Pace:
        """Return what says when to answer: their robot, by its questions."""
        return QuestionPace(self._robot, self.clock)

    def where(self, name: str, now_s: float) -> Floats | None:
        """Nothing is known: their robot does not say where it is."""
        return None

    def hear(self) -> None:
        """Hear who is there, and whether it asks."""
        self._robot.poll()
        now_s, connected = self.clock.monotonic_s(), self._robot.connected
        if connected != self._connected:
            self._connected, self._connected_s = connected, now_s
            if self._begun not in connected:
                self._begun, self._is_open, self._is_to_end = None, False, False
            name = "several" if len(connected) > 1 else "heard" if connected else "not-heard"
            severity: Severity = "info" if len(connected) == 1 else "warning"
            self._tell_of(name, severity, connected=len(connected))
        is_asked = self._asked_s is not None and now_s - self._asked_s < SILENT_S
        if is_asked != self._is_asked:
            self._is_asked = is_asked
            is_odd = not is_asked and self._is_to_end
            self._tell_of("asked" if is_asked else "not-asked", "warning" if is_odd else "info", asked=self._asked)

    def send(self, dt_s: float) -> None:
        """Answer what is asked once there was a command; say when to begin and to end."""
        part = self._part
        if part.is_begun:
            self._root.advance(part.vector, dt_s)
        self._press()
        if (is_start := self._robot.question()) is None:
            return
        now_s = self.clock.monotonic_s()
        self._asked, self._asked_s = self._asked + 1, now_s
        if not part.is_begun:
            self._unanswered["before the first command"] += 1
            return
        if self._begun is None or not (is_start or self._is_open):
            # It follows since before this server was there, or anew: it is not to jump to where the command is now.
            self._unanswered["not begun"] += 1
            return
        qpos = np.concatenate([self._root.position, self._root.quat_wxyz, part.vector[6:]])
        if not self._robot.answer(Pose(is_start, qpos)):
            self._unanswered["who asked does not read"] += 1
            return
        self._answered, self._is_open = self._answered + 1, True
        if part.is_followed:
            self._ages.add(part.path.validator.age_s(now_s) * 1e3)

    def facts(self, now_s: float) -> dict[str, Any]:
        """Return what was answered, how old the command was then, and how it is."""
        told = {
            "asked": self._asked, "answered": self._answered, "connected": len(self._connected),
            "unanswered": dict(self._unanswered + self._robot.bad), **self._part.status(now_s),
        }  # fmt: skip
        return {"streams": {"poses": told | self._ages.facts("age_ms")}}

    def _press(self) -> None:
        """Press the button to begin when a commander is followed anew, that to end when their robot stands again."""
        is_followed = self._part.is_followed
        self._rest_ticks = 0 if is_followed or not self._part.is_at_rest else self._rest_ticks + 1
        now_s = self.clock.monotonic_s()
        if not is_followed or self.life.stopping:
            self._engaged_s = None
        elif not self._was_followed:
            self._engaged_s = now_s
        is_one = len(self._connected) == 1
        if self._engaged_s is not None and is_one and now_s - self._connected_s > _SEEN_S:
            self._engaged_s = None
            (self._begun,) = self._connected
            self._begin_ticks, self._end_ticks, self._is_to_end = _PRESSED, 0, True
        elif self._engaged_s is not None and not is_one and now_s - self._engaged_s > _CONNECTED_S:
            self._engaged_s = None
            why_not = "more than one robot is connected" if self._connected else "no robot is connected"
            self._tell_of("not-begun", "warning", reason=why_not, then="whoever engages anew begins")
        if self._is_to_end and self._rest_ticks >= _SETTLED:
            self._begin_ticks, self._end_ticks, self._is_to_end = 0, _PRESSED, False
        self._was_followed = is_followed
        begins, ends = self._begin_ticks > 0, self._end_ticks > 0
        self._robot.press(begins=begins, ends=ends, wall_ns=self.clock.wall_ns())
        self._begin_ticks, self._end_ticks = self._begin_ticks - begins, self._end_ticks - ends

    def _tell_of(self, name: str, severity: Severity, **detail: Any) -> None:
        self.life.event(f"motion-tracking-{name}", severity=severity, key=self._key, **detail)


class QuestionPace:
    """When to answer: as soon as something is asked; now and then also without a question (`station.life.pace.Pace`).

    Args:
        robot: Who asks.
        clock: The clock.
    """

    def __init__(self, robot: AskingRobot, clock: Clock) -> None:
        self._robot, self._clock = robot, clock
        self._woke_s = deque([clock.monotonic_s()], maxlen=50)

    @property
    def state_seq(self) -> None:
        """A question is no state of a robot."""
        return

    def wait(self, *, is_leaving: bool) -> float:
        """Wait for the next question; return how long that was, at most 0.1 s [s]."""
        last_s = self._woke_s[-1]
        self._clock.sleep_until(round((last_s + _SHORTEST_S) * 1e9))
        self._robot.wait(max(0.0, last_s + _IDLE_S - self._clock.monotonic_s()))
        now_s = self._clock.monotonic_s()
        self._woke_s.append(now_s)
        return min(now_s - last_s, _LONGEST_S)

    def health(self) -> dict[str, Any]:
        """Return how often it woke lately."""
        passed_s = self._woke_s[-1] - self._woke_s[0]
        return {"rate_hz": (len(self._woke_s) - 1) / passed_s} if passed_s > 0.0 else {}
