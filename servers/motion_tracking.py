"""The bridge from motion_tracking's teleoperation: its pose server's poses are whole-body commands of our robot.

It plays motion_tracking's robot side: it asks for a pose 50 times a second from the server's button to begin until that
to end, and writes what comes. A server that falls silent leaves nothing written; the robot's gate does the rest, and
blends into the first pose. What a pose becomes stands in `adapters.pose_server`.
"""

from __future__ import annotations

import contextlib
import re
from collections import Counter
from collections.abc import Iterator

import msgspec

from adapters import zeromq
from adapters.commands.g1_walk_track import motion_of
from adapters.pose_server import PORTS, BadPose, PosedRobot, PoseServer, Session, parse_pose
from station import libraries
from station.bus import codec
from station.config import to_plain
from station.control.foreign_commander import ForeignCommander
from station.control.foreign_stream import Arrived, Dropped, ForeignStream, why_no_command
from station.life.server import Life, ServerKind

_NAME = re.compile(r"[a-z0-9_]*")


class MotionTrackingConfig(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Configuration of the bridge from motion_tracking's pose server.

    Attributes:
        host: Where the pose server is: a name or an address.
        ports: Its ports for questions, answers and buttons.
        robot: Which motion command, by the end of the robot's keys; "" for TWIST2's robot.
    """

    host: str = "127.0.0.1"
    ports: tuple[int, int, int] = PORTS
    robot: str = ""

    def __post_init__(self) -> None:
        for port in self.ports:
            zeromq.expect_address("host and ports", f"tcp://{self.host}:{port}", listens=False)
        if not _NAME.fullmatch(self.robot):
            raise ValueError(f"robot is {self.robot!r}; expected the end of a robot's keys, such as g1_29_track")


def main(config: MotionTrackingConfig, life: Life) -> int:
    """Pass poses on until asked to stop; return the exit code."""
    command = motion_of(config.robot)
    with contextlib.closing(PoseServer(config.host, config.ports)) as server:
        life.configured({
            "server": life.name, "role": KIND.role, "robot": command.robot, "key": command.key,
            "config": to_plain(config),
        })  # fmt: skip
        if life.ready():
            PosesIn(life, server, config).run()
    return 0


KIND = ServerKind(
    name="motion-tracking",
    role="command",
    summary="motion_tracking's teleoperation drives our robot: its pose server's poses",
    config=MotionTrackingConfig,
    main=main,
    expect=lambda config: libraries.expect("the bridge from motion_tracking", "pyzmq", zeromq.EXTRA),
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
        data = codec.json_vector(self._robot.command(pose.qpos, asked_s))
        return why_no_command(data, self._command) or {self._command.key: data}
