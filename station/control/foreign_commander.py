"""Programs of others command on the bus: the newest good message of each of their streams, all in one write.

A stream that falls silent writes nothing more; the gate of the robot does the rest.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from typing import Any

from station.bus import codec, keys
from station.control.foreign_stream import Arrived, ForeignStream, Taken
from station.life.server import Life

_LOOK_S = 0.02
_TELL_S = 0.1  # between two looks at who is silent; a heartbeat says what it is told twice a second

Receive = Callable[[float], Iterable[tuple[str, Arrived]]]
"""Yields what has come, with the stream's name, once something is there or a time has passed [s]."""


class ForeignCommander:
    """The loop: hear, write, tell.

    Args:
        life: The server's.
        kind: Who commands, in a command's source: ``lcm``.
        called: What one of its streams is called: ``channel``.
        streams: Each, and the robots that it commands, by their keys' suffix.
        receive: Yields messages.
        not_for_us: Counts, by reason, what was no message of these streams.
    """

    def __init__(
        self, life: Life, kind: str, called: str, streams: Sequence[tuple[ForeignStream, Sequence[str]]],
        receive: Receive, not_for_us: Counter[str],
    ) -> None:  # fmt: skip
        self._life, self._clock, self._kind, self._called = life, life.clock, kind, called
        self._streams = {stream.name: stream for stream, _ in streams}
        self._robots = {stream.name: robots for stream, robots in streams}
        self._receive, self._not_for_us = receive, not_for_us

    def run(self) -> None:
        """Pass on what comes until the server is asked to stop."""
        told_s = -math.inf
        while not self._life.stopping:
            self._pass_on(self._receive(_LOOK_S))
            if (now_s := self._clock.monotonic_s()) - told_s < _TELL_S:
                continue
            told_s = now_s
            for stream in self._streams.values():
                for name, severity, detail in stream.on_tick(now_s):
                    self._life.event(name, severity=severity, **detail)
            told = {name: stream.status(now_s) for name, stream in self._streams.items()}
            self._life.report(**{f"{self._called}s": told}, not_for_us=dict(self._not_for_us))
        if live := [name for name, stream in self._streams.items() if stream.is_live]:
            of: dict[str, Any] = {f"{self._called}s": live}
            reason = "the server was asked to stop"
            self._life.event("teleop-commands-end", reason=reason, **of, then="the robot's gate takes over")

    def _pass_on(self, received: Iterable[tuple[str, Arrived]]) -> None:
        """Write the newest good message of each stream, all at once."""
        newest: dict[str, Taken] = {}
        for name, arrived in received:
            stream = self._streams.get(name)
            if stream is None:
                self._not_for_us[f"another {self._called}"] += 1
            elif (taken := stream.take(arrived, self._clock.monotonic_s())) is not None:
                if name in newest:
                    stream.dropped["superseded"] += 1
                newest[name] = taken
        if not newest:
            return
        values: dict[str, bytes] = {}
        for name, taken in newest.items():
            values |= taken.values
            if robots := self._robots[name]:
                source = codec.json_object({"kind": self._kind, self._called: name, "sender": taken.sender})
                values |= {keys.command_source(robot): source for robot in robots}
        is_taken = self._life.bus.publish(values)
        now_s = self._clock.monotonic_s()
        for name, taken in newest.items():
            if is_taken:
                self._streams[name].record(taken, now_s)
            else:
                self._streams[name].dropped["bus-lost"] += 1
