"""A robot that programs of others move, commanded by the bus: the gates that those programs lack.

They do what came last, for long or for ever, and know no emergency stop of ours. So each part of the command has the
gate here that our own robots have, and what falls silent, is stopped or ends is brought to rest at speeds that are
given. What is sent to them says who derives.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from station.blends import VELOCITY_FADE_S
from station.bus import acl, codec, keys
from station.control.arming import Arming
from station.control.command_arbiter import CommandArbiter
from station.control.command_path import CommandPath
from station.control.command_receiver import CommandReceiver, CommandWatch
from station.control.command_validator import CommandSample
from station.control.gate import FOLLOWING, Decision, GateConfig
from station.control.parted_path import PartedPath
from station.life import estop
from station.life.pace import Pace, WallPace
from station.life.server import Life
from station.life.stop_file import StopFile
from station.parts import PartedCommand
from station.protocols import CommandFormat, Floats

_REPEATED = 10  # so often the last message is sent again at the end: one may be lost


@dataclass(frozen=True, slots=True, eq=False)
class Rest:
    """How a part is without commands.

    Attributes:
        start: Where it is taken to be before its first command, shape (m,); None for its default.
        stays: Whether it stays as it is, and is never brought home.
        speed: How fast its elements are brought home, per second; velocities end within `VELOCITY_FADE_S`.
    """

    start: Floats | None = None
    stays: bool = False
    speed: float = 1.0


class CommandedPart:
    """A part of their robot: the command's way to it, its writers, and where it rests.

    Args:
        path: Of its command.
        watch: Watches the part's key.
        rest: How it is without commands.

    Attributes:
        vector: What their robot is asked for, shape (m,).
        is_begun: Whether it was commanded yet.
    """

    def __init__(self, path: CommandPath, watch: CommandWatch, rest: Rest) -> None:
        self.path, self.watch = path, watch
        command_format, config = path.command_format, path.gate.config
        self._receiver = CommandReceiver(
            watch, command_format.key, CommandArbiter(config.rivals, config.return_after_s)
        )
        start = command_format.default if rest.start is None else rest.start
        self.vector: Floats = np.clip(start, command_format.lower, command_format.upper)
        self.is_begun = False
        self._home = None if rest.stays else command_format.default
        self._speed = np.full(len(self.vector), rest.speed)
        fastest = np.maximum(-command_format.lower, command_format.upper)
        for index in command_format.velocities:
            self._speed[index] = fastest[index] / VELOCITY_FADE_S

    @property
    def is_at_rest(self) -> bool:
        """Whether it is where it is brought without commands; one that stays, as with what a hand holds, always is."""
        return self._home is None or bool(np.array_equal(self.vector, self._home))

    @property
    def is_followed(self) -> bool:
        """Whether a commander is followed."""
        return self.path.gate.state in FOLLOWING

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
            measured: Where their robot has it, shape (m,); None where that is not known, or it has begun.
            dt_s: The period [s].
        """
        if not self.path.command_format.holds_position:
            return
        if measured is not None:
            self.vector = measured
        elif self.is_begun and self.path.gate.state == "waiting":
            self.bring_home(dt_s)
        self.path.gate.rest(self.vector)

    def status(self, now_s: float) -> dict[str, Any]:
        """Return what a heartbeat tells of it at an instant [s]."""
        age_s = self.path.validator.age_s(now_s)
        return {
            "gate": self.path.gate.state, "dropped": dict(self.path.validator.refused),
            "age_s": round(age_s, 3) if math.isfinite(age_s) else None,
        }  # fmt: skip


class ForeignRobot(ABC):
    """The loop: hear commands and the stop, decide, send, tell. A context manager.

    Args:
        life: The server's.
        command: Of their robot.
        word: What its events begin with.
        rests: How parts are without commands, by name; a command without parts has its format's name.
        rate_hz: How often it sends [Hz].
        at_end: How their robot is once it was brought to rest, for the event of its end.

    Attributes:
        parts: By name.
    """

    def __init__(
        self, life: Life, command: CommandFormat, *, word: str, rests: Mapping[str, Rest], rate_hz: float, at_end: str
    ) -> None:
        self.life, self.clock = life, life.clock
        self._word, self._rate_hz, self._at_end = word, rate_hz, at_end
        config, arming = GateConfig(), Arming(is_armed=True)
        self._all = (
            PartedPath(command, config, arming)
            if isinstance(command, PartedCommand)
            else CommandPath(command, config, arming)
        )
        self.parts: dict[str, CommandedPart] = {}
        for path in self._all.paths:
            watched = [path.command_format.key, *(() if self.parts else estop.KEYS)]
            bus = life.bus
            watch = CommandWatch(bus.address, watched, key=watched[0], outages=bus.outages, clocks=bus.clocks)
            name = path.part or path.command_format.name
            self.parts[name] = CommandedPart(path, watch, rests[name])
        self._stops = next(iter(self.parts.values())).watch
        self.why_stopped = ""
        self._stopped_past_bus = ""
        self._returning = set[str]()
        user = life.bus.address.username
        self._may_say_where = user not in acl.ROLES or user == "low-level"
        life.on_estop(self._on_supervisor_stop)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        for part in self.parts.values():
            part.watch.close()

    @abstractmethod
    def hear(self) -> None:
        """Hear what their robot tells."""

    @abstractmethod
    def where(self, name: str, now_s: float) -> Floats | None:
        """Return where their robot has a part that was not commanded yet, shape (m,), if that is known."""

    @abstractmethod
    def send(self, dt_s: float) -> None:
        """Send what was decided, for a period [s]."""

    @abstractmethod
    def facts(self, now_s: float) -> dict[str, Any]:
        """Return what the heartbeat says at an instant [s]."""

    def pace(self) -> Pace:
        """Return what says when to send: the clock, unless their robot does."""
        return WallPace(self._rate_hz, self.clock)

    def run(self) -> None:
        """Send until asked to stop; then, or on an error, bring their robot to rest first."""
        pace = self.pace()
        dt_s = 1.0 / self._rate_hz
        self._begin()
        try:
            while not self.life.stopping:
                self._tick(dt_s)
                self.life.report(**pace.health())
                dt_s = pace.wait(is_leaving=False)
        except Exception as error:
            self.life.event(f"{self._word}-error", severity="error", reason=f"{type(error).__name__}: {error}")
            raise
        finally:
            self._leave(pace)

    def _begin(self) -> None:
        if not self._may_say_where:
            reason = f"user {self.life.bus.address.username!r} of the bus may not say where a robot is"
            name = f"{self._word}-says-not-where"
            self.life.event(name, severity="warning", reason=reason, then="leaders do not engage")
        self._stops.begin_stops()
        if (found := estop.latched(self._stops.latest)) is not None:
            self._stop(found[0].reason)
        elif (remembered := StopFile(self.life.bus.address).read()) is not None:
            self._stop(remembered.reason)

    def _tick(self, dt_s: float) -> None:
        self.hear()
        self._obey_stop()
        now_s = self.clock.monotonic_s()
        for name, part in self.parts.items():
            part.rest(self.where(name, now_s), dt_s)
        samples = tuple(part.sample() for part in self.parts.values())
        why_blocked = f"emergency stop: {self.why_stopped}" if self.why_stopped else ""
        decision = self._all.decide(samples, now_s, why_blocked=why_blocked)
        decided = decision.parts or (decision,)
        for part, of_part in zip(self.parts.values(), decided, strict=True):
            part.vector = of_part.vector
            part.is_begun = part.is_begun or of_part.state in FOLLOWING
        self.send(dt_s)
        if self._may_say_where:
            self.life.bus.publish(self._values(decided))
        self._tell(now_s)

    def _obey_stop(self) -> None:
        news = self._stops.pop_stop()
        if reason := self._stopped_past_bus:
            self._stopped_past_bus = ""
            self._stop(reason)
        elif news is not None and news.request.stop:
            self._stop(news.request.reason)
        elif news is not None and self.why_stopped:
            self.why_stopped = ""
            for part in self.parts.values():  # a commander that wrote through the stop has to cease, and begin anew
                part.path.gate.insist_on_silence("there was a stop")
            self.life.event("estop-reset", reason=news.request.reason)

    def _stop(self, reason: str) -> None:
        if not self.why_stopped:
            self.life.event("estop", severity="error", reason=reason, then="their robot is brought to rest")
        self.why_stopped = reason

    def _on_supervisor_stop(self, reason: str) -> None:
        self._stopped_past_bus = reason

    def _values(self, decided: tuple[Decision, ...]) -> dict[str, bytes]:
        """Return what a commander has to know of each part, by key: whether it is followed, and where the part is."""
        values: dict[str, bytes] = {}
        for part, of_part in zip(self.parts.values(), decided, strict=True):
            robot = part.path.command_format.robot
            values[keys.command_gate(robot)] = codec.json_object(part.path.status(of_part))
            values[keys.command_used(robot)] = codec.f64(part.vector)
        return values

    def _tell(self, now_s: float) -> None:
        for each in self._all.taken():
            self.life.event(each.name, severity=each.severity, **each.detail)
        unled = {name for name, part in self.parts.items() if part.is_begun and not part.is_followed}
        returning = {name for name in unled if not self.parts[name].is_at_rest}
        if begin := sorted(returning - self._returning):
            why = {name: self.parts[name].path.gate.reason for name in begin}
            self.life.event(f"{self._word}-returning", severity="warning", parts=why)
        if rests := sorted((self._returning & unled) - returning):
            self.life.event(f"{self._word}-at-rest", parts=rests)
        self._returning = returning
        self.life.report(stopped=self.why_stopped, **self.facts(now_s))

    def _leave(self, pace: Pace) -> None:
        """Bring what was commanded to rest without anything that may have broken: the bus, a gate."""
        begun = {name: part for name, part in self.parts.items() if part.is_begun}
        if not begun:
            return
        parts = dict.fromkeys(begun, "the bridge ends")
        self.life.event(f"{self._word}-returning", severity="warning", parts=parts)
        repeated = 0
        while repeated < _REPEATED:
            repeated += all(part.is_at_rest for part in begun.values())
            dt_s = pace.wait(is_leaving=True)
            for part in begun.values():
                part.bring_home(dt_s)
            self.send(dt_s)
        self.life.event("teleop-commands-end", reason="the bridge ends", then=self._at_end)
