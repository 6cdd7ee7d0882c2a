"""The guard's rules in virtual time: the C code, called step by step, with a robot and a station that obey."""

from __future__ import annotations

import ctypes
import itertools
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from adapters.robots.g1.dds import guard_client
from adapters.robots.g1.dds.guard_client import ANSWER, MOTORS, GuardStatus, Kind

ROBOT = np.dtype(
    [("mode_machine", "u1"), ("remote", "u1", 40), ("tick", "<u4"), ("quat_wxyz", "<f4", 4), ("q", "<f4", MOTORS),
     ("temperature", "<i2", (MOTORS, 2)), ("error", "<u4", MOTORS)], align=True,
)  # fmt: skip
MOTOR_COMMAND = np.dtype(
    [("mode_machine", "u1"), ("mode", "u1", MOTORS), ("q", "<f4", MOTORS), ("kp", "<f4", MOTORS),
     ("kd", "<f4", MOTORS)], align=True,
)  # fmt: skip
FOREIGN = np.dtype([("is_there", "u1"), ("pid", "<i4"), ("host", "S64"), ("process", "S32")], align=True)

GUARD_BYTES = 16384  # more than the struct has
STATION, STRANGER = 7, 8
"""Addresses."""

Q, KP, KD = np.full(MOTORS, 0.1), np.full(MOTORS, 40.0), np.full(MOTORS, 2.0)
"""What the station commands unless told otherwise: within the range of every joint."""


class Library:
    """The compiled rules."""

    def __init__(self, path: Path) -> None:
        self._loaded = ctypes.CDLL(str(path))
        self._loaded.crc_init()
        self.random = ctypes.CFUNCTYPE(ctypes.c_uint64)
        for name in ("guard_on_datagram", "guard_step", "guard_is_done"):
            getattr(self._loaded, name).restype = ctypes.c_bool
        self._loaded.guard_listener.restype = ctypes.c_uint64
        self._loaded.crc32_unitree.restype = self._loaded.crc32_zlib.restype = ctypes.c_uint32

    def __getattr__(self, name: str) -> Any:
        return getattr(self._loaded, name)


class Sent(NamedTuple):
    """A LowCmd, and when it was sent [ms]."""

    at_ms: int
    command: Any


def pointer(record: NDArray[Any]) -> ctypes.c_void_p:
    return ctypes.c_void_p(record.ctypes.data)


class Rules:
    """A guard, a robot whose LowState comes every 2 ms, and a station whose command comes every 20 ms.

    Args:
        library: The compiled rules.
        was_armed: The guard before this one ended while armed.
        begun_ms: How long ago the guard began; meanwhile it made no step.

    Attributes:
        now_ms: The time.
        robot: The LowState that comes next; its tick counts by itself.
        is_heard, is_ticking: Whether LowStates come, and whether their tick counts.
        sent: All LowCmds so far.
    """

    def __init__(self, library: Library, was_armed: bool = False, begun_ms: int = 1000) -> None:
        self._library = library
        self._guard = ctypes.create_string_buffer(GUARD_BYTES)
        numbers = itertools.count(1000)
        self._random = library.random(lambda: next(numbers))
        self.now_ms = 1000
        self.robot = np.zeros(1, ROBOT)
        self.robot["mode_machine"], self.robot["quat_wxyz"][0, 0], self.robot["tick"] = 5, 1.0, 50_000
        self.is_heard = self.is_ticking = True
        self.sent: list[Sent] = []
        self.seq = self.token = 0
        self._call("guard_init", ctypes.c_bool(was_armed), self._random)
        self.now_ms += begun_ms

    def _call(self, name: str, *arguments: Any) -> Any:
        return getattr(self._library, name)(self._guard, ctypes.c_int64(self.now_ms * 1_000_000), *arguments)

    def datagram(self, data: bytes, sender: int = STATION) -> GuardStatus | None:
        """Bring a datagram; return what is answered."""
        reply = np.zeros(1, ANSWER)
        address = ctypes.c_uint64(sender)
        is_answered = self._call("guard_on_datagram", data, ctypes.c_size_t(len(data)), address, pointer(reply))
        return guard_client.status(reply.tobytes()) if is_answered else None

    def ask(self, kind: Kind, token: int = 0, sender: int = STATION) -> GuardStatus | None:
        self.seq += 1
        return self.datagram(guard_client.request(kind, seq=self.seq, sender_ns=0, token=token), sender)

    def command(self, q: Any = Q, kp: Any = KP, kd: Any = KD, **changed: int) -> bytes:
        """Return the next command of the station."""
        self.seq += 1
        head = {"seq": self.seq, "state_tick": int(self.robot["tick"][0]), "sender_ns": 0, "token": self.token}
        return guard_client.command(q, kp, kd, **(head | changed))

    def state(self) -> None:
        if self.is_ticking:
            self.robot["tick"] += 2
        if self.is_heard:
            self._call("guard_on_state", pointer(self.robot))

    def foreign(self, host: bytes, pid: int, process: bytes = b"") -> None:
        record = np.zeros(1, FOREIGN)
        record["is_there"], record["host"], record["pid"], record["process"] = bool(host), host, pid, process
        self._library.guard_on_foreign(self._guard, pointer(record))

    def step(self) -> bool:
        out = np.zeros(1, MOTOR_COMMAND)
        is_sent = bool(self._call("guard_step", pointer(out)))
        if is_sent:
            self.sent.append(Sent(self.now_ms, out[0]))
        return is_sent

    def run(self, milliseconds: int, command: Callable[[], bytes] | None = None) -> list[Sent]:
        """Let time go by; return the LowCmds that were sent meanwhile."""
        before = len(self.sent)
        for passed in range(0, milliseconds, 2):
            self.now_ms += 2
            self.state()
            if command is not None and passed % 20 == 0:
                self.datagram(command())
            self.step()
        return self.sent[before:]

    def skip(self, milliseconds: int) -> None:
        """Let the guard stand still."""
        self.now_ms += milliseconds
        self.robot["tick"] += milliseconds

    def arm(self) -> GuardStatus:
        said = self.ask(Kind.ARM, 77)
        assert said is not None
        if said.challenge:
            self.token = said.challenge
            said = self.ask(Kind.CONFIRM, said.challenge)
        assert said is not None
        return said

    def driven(self) -> Rules:
        """Arm, and command for 0.2 s."""
        self.run(20)
        assert self.arm().kind is guard_client.Answer.ARMED
        self.run(200, self.command)
        return self

    def end(self) -> None:
        self._call("guard_end")

    def is_done(self) -> bool:
        return bool(self._call("guard_is_done"))

    def listener(self) -> int:
        return int(self._call("guard_listener"))

    @property
    def status(self) -> GuardStatus:
        out = np.zeros(1, ANSWER)
        self._call("guard_status", pointer(out))
        said = guard_client.status(out.tobytes())
        assert said is not None
        return said
