"""The station's side of the guard of a G1: datagrams as arrays, and a client that sends and polls.

`bridges/g1_guard/src/datagram.h` is the other side and says what each field means. A client never waits and starts no
thread: whoever has it sends one command per tick and polls.
"""

from __future__ import annotations

import math
import secrets
import socket
import zlib
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from station.clock import SYSTEM, Clock
from station.errors import ConfigError
from station.protocols import Floats

MOTORS = 29
VERSION = 1
DEFAULT_PORT = 47029

_HELLO_EVERY_NS = 200_000_000  # the guard tells who was heard within a second
_ASK_EVERY_NS = 20_000_000  # while arming: an answer may be lost
_NEVER = 0xFFFFFFFF

_HEAD = [("magic", "S4"), ("version", "u1"), ("kind", "u1"), ("size", "<u2"), ("seq", "<u4"), ("state_tick", "<u4"),
         ("sender_ns", "<u8"), ("token", "<u8")]  # fmt: skip
_TARGETS = [("q", "<f4", MOTORS), ("kp", "<f4", MOTORS), ("kd", "<f4", MOTORS)]


class Kind(IntEnum):
    """What a station sends: ``enum request_kind``."""

    HELLO = 1
    ARM = 2
    CONFIRM = 3
    COMMAND = 4
    DISARM = 5


class Answer(IntEnum):
    """What a guard sends: ``enum answer_kind``."""

    STATUS = 1
    CHALLENGE = 2
    ARMED = 3
    ARM_REFUSED = 4


class State(IntEnum):
    """What a guard does: ``enum guard_state``."""

    WAITING = 0
    ARMED = 1
    FROZEN = 2
    RAMPING = 3
    DAMPING = 4


class Reason(IntEnum):
    """Why it came to damping, or does not arm: ``enum reason``."""

    NONE = 0
    SILENCE = 1
    DISARMED = 2
    NO_STATE = 3
    TICK = 4
    TILT = 5
    WINDING = 6
    CASING = 7
    MOTOR_ERROR = 8
    FOREIGN_WRITER = 9
    REMOTE = 10
    REFUSALS = 11
    LATE = 12
    ENDING = 13
    RESTARTED = 14
    MACHINE = 15
    BUSY = 16
    CHALLENGE = 17
    STARTING = 18


WORDS = {
    Reason.NONE: "",
    Reason.SILENCE: "no command came for 100 ms",
    Reason.DISARMED: "the station disarmed it",
    Reason.NO_STATE: "the robot's LowState did not come for 50 ms: is it on, is the cable in?",
    Reason.TICK: "the robot's LowState comes, but its tick stands still",
    Reason.TILT: "the robot is tilted by more than 60°",
    Reason.WINDING: "the winding of a motor has 120 °C or more: let it cool",
    Reason.CASING: "the casing of a motor has 85 °C or more: let it cool",
    Reason.MOTOR_ERROR: "a motor of a leg reports an error",
    Reason.FOREIGN_WRITER: "another program writes rt/lowcmd",
    Reason.REMOTE: "SELECT, or L2 and B, is held on the remote",
    Reason.REFUSALS: "three damaged or impossible datagrams came in a row",
    Reason.LATE: "the guard itself stood still for 100 ms: is it allowed real-time priority?",
    Reason.ENDING: "the guard is ending",
    Reason.RESTARTED: "the guard before this one ended while it was armed",
    Reason.MACHINE: "the robot's mode_machine is not that of a G1 (1 to 6)",
    Reason.BUSY: "it is armed already, or its stiffness is still falling",
    Reason.CHALLENGE: "its challenge was not confirmed within a second",
    Reason.STARTING: "it runs for less than a second, and does not know yet who else writes rt/lowcmd",
}
"""Each reason in words, with what to do where that is not plain."""


class Refusal(IntEnum):
    """Why a datagram was refused: ``enum refusal``."""

    SIZE = 0
    MAGIC = 1
    VERSION = 2
    CRC = 3
    KIND = 4
    NUMBER = 5
    LIMIT = 6
    SEQ = 7
    SENDER = 8
    TOKEN = 9
    STALE = 10
    NOT_ARMED = 11


COMMAND = np.dtype([*_HEAD, *_TARGETS, ("crc", "<u4")])
SHORT = np.dtype([*_HEAD, ("crc", "<u4")])
ANSWER = np.dtype([
    ("magic", "S4"), ("version", "u1"), ("kind", "u1"), ("size", "<u2"), ("seq", "<u4"), ("state", "u1"),
    ("reason", "u1"), ("why_not", "u1"), ("mode_machine", "u1"), ("guard_ns", "<u8"), ("sender_ns", "<u8"),
    ("nonce", "<u8"), ("challenge", "<u8"), ("command_seq", "<u4"), ("state_tick", "<u4"), ("state_age_us", "<u4"),
    ("command_age_us", "<u4"), ("sent", "<u4"), ("accepted", "<u4"), ("refused", "<u4", len(Refusal)),
    ("states", "<u4"), ("bad_states", "<u4"), ("freezes", "<u4"), ("damped", "<u4"), ("clamped", "<u4"),
    ("max_late_us", "<u4"), ("is_realtime", "u1"), ("is_foreign", "u1"), ("reserved", "u1", 2), ("foreign_pid", "<i4"),
    ("foreign_host", "S64"), ("foreign_process", "S32"), ("failed_sends", "<u4"), ("crc", "<u4"),
])  # fmt: skip
"""Datagrams as records; ``datagram.h`` says what each field means."""


def request(kind: Kind, *, seq: int, sender_ns: int, token: int = 0) -> bytes:
    """Return a datagram without targets."""
    record = np.zeros(1, SHORT)
    _fill_head(record, kind, seq, sender_ns, token)
    return sealed(record)


def command(q: Floats, kp: Floats, kd: Floats, *, seq: int, state_tick: int, sender_ns: int, token: int) -> bytes:
    """Return a datagram with targets, each of shape (29,) [rad], [N m/rad], [N m s/rad]; `state_tick` in [ms]."""
    record = np.zeros(1, COMMAND)
    _fill_head(record, Kind.COMMAND, seq, sender_ns, token)
    record["state_tick"] = state_tick
    record["q"][0], record["kp"][0], record["kd"][0] = q, kp, kd
    return sealed(record)


def _fill_head(record: NDArray[Any], kind: Kind, seq: int, sender_ns: int, token: int) -> None:
    record["magic"], record["version"], record["kind"] = b"G1GD", VERSION, kind
    record["size"], record["seq"], record["sender_ns"], record["token"] = record.itemsize, seq % 2**32, sender_ns, token


def sealed(record: NDArray[Any]) -> bytes:
    """Return a record of one datagram as bytes, with its checksum."""
    body = record.tobytes()[:-4]
    return body + zlib.crc32(body).to_bytes(4, "little")


@dataclass(frozen=True, slots=True)
class GuardStatus:
    """What a guard said.

    Attributes:
        kind: What it answers.
        state, reason: What it does, and why it came to damping; in ARM_REFUSED why it does not arm.
        why_not: What is in the way of arming now.
        seq: Of this answer.
        guard_ns: Monotonic clock of the guard when it said this [ns].
        mode_machine, state_tick: Of the newest LowState; the tick in [ms].
        state_age_s: How long ago a LowState came [s]; infinite if never.
        command_age_s: How long ago a command was accepted [s]; infinite if never in this session.
        round_trip_ns: Since the newest intact datagram that the guard had when it said this was sent [ns].
        command_seq: Of the newest command that was accepted.
        sent, failed_sends: LowCmds so far, and those of them that DDS did not take.
        accepted, refused: Commands, and datagrams by why they were refused.
        states, bad_states: LowStates so far, and those that were damaged.
        freezes, damped, clamped: How often; commands of which a position was outside of a joint's range.
        max_late_s: Of the guard's own 2 ms [s].
        is_realtime: Whether it has real-time priority.
        foreign: Who else writes rt/lowcmd, "" for nobody.
        nonce, challenge: Of the handshake.
    """

    kind: Answer
    state: State
    reason: Reason
    why_not: Reason
    seq: int
    guard_ns: int
    mode_machine: int
    state_tick: int
    state_age_s: float
    command_age_s: float
    round_trip_ns: int
    command_seq: int
    sent: int
    failed_sends: int
    accepted: int
    refused: dict[Refusal, int]
    states: int
    bad_states: int
    freezes: int
    damped: int
    clamped: int
    max_late_s: float
    is_realtime: bool
    foreign: str
    nonce: int = field(repr=False)
    challenge: int = field(repr=False)


def status(datagram: bytes, now_ns: int = 0) -> GuardStatus | None:
    """Return what a guard said at a time of the sender's clock; None for what is damaged, or not of a guard."""
    if len(datagram) != ANSWER.itemsize or zlib.crc32(datagram[:-4]).to_bytes(4, "little") != datagram[-4:]:
        return None
    said = np.frombuffer(datagram, ANSWER)[0]
    if said["magic"] != b"G1GS" or said["version"] != VERSION:
        return None
    try:
        kind, state = Answer(int(said["kind"])), State(int(said["state"]))
        reason, why_not = Reason(int(said["reason"])), Reason(int(said["why_not"]))
    except ValueError:
        return None
    numbers = (
        "seq", "guard_ns", "mode_machine", "state_tick", "command_seq", "sent", "failed_sends", "accepted", "states",
        "bad_states", "freezes", "damped", "clamped", "nonce", "challenge",
    )  # fmt: skip
    return GuardStatus(
        kind=kind, state=state, reason=reason, why_not=why_not, state_age_s=_age_s(said["state_age_us"]),
        command_age_s=_age_s(said["command_age_us"]), round_trip_ns=now_ns - int(said["sender_ns"]),
        refused={why: int(said["refused"][why]) for why in Refusal}, max_late_s=int(said["max_late_us"]) / 1e6,
        is_realtime=bool(said["is_realtime"]), foreign=_foreign(said), **{name: int(said[name]) for name in numbers},
    )  # fmt: skip


def shown(said: GuardStatus) -> dict[str, Any]:
    """Return what a recording keeps of what a guard said."""
    return {
        "state": said.state.name.lower(), "reason": WORDS[said.reason], "why_not_arm": WORDS[said.why_not],
        "state_age_s": _finite(said.state_age_s), "command_age_s": _finite(said.command_age_s),
        "round_trip_s": said.round_trip_ns * 1e-9, "command_seq": said.command_seq, "sent": said.sent,
        "accepted": said.accepted, "refused": {why.name.lower(): count for why, count in said.refused.items() if count},
        "states": said.states, "states_damaged": said.bad_states, "frozen": said.freezes, "damped": said.damped,
        "clamped": said.clamped, "late_max_s": said.max_late_s, "is_realtime": said.is_realtime,
        "foreign": said.foreign,
    }  # fmt: skip


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _age_s(age_us: Any) -> float:
    return math.inf if age_us == _NEVER else int(age_us) / 1e6


def _foreign(said: Any) -> str:
    if not said["is_foreign"]:
        return ""
    host, process = (said[name].decode("utf-8", "replace") for name in ("foreign_host", "foreign_process"))
    pid = int(said["foreign_pid"])
    return f"{process or 'a process'} (pid {pid or 'unknown'}) on {host or 'an unknown host'}"


class GuardClient:
    """Commands a G1 through its guard. A context manager.

    ::

        with GuardClient("192.168.123.164") as guard:
            guard.arm()
            for tick in ticks:  # 50 Hz
                status = guard.poll()  # goes on with the handshake; None before the first answer
                if guard.is_armed:
                    guard.send(state_tick, q, kp, kd)  # in every tick: a silence makes it damp the motors

    Args:
        host, port: Of the guard.
        clock: Monotonic; stamps datagrams.
    """

    def __init__(self, host: str = "127.0.0.1", port: int = DEFAULT_PORT, clock: Clock = SYSTEM) -> None:
        self._clock = clock
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        try:
            self._socket.connect((host, port))  # only the guard is heard
        except OSError as error:
            self._socket.close()
            raise ConfigError(f"guard at {host}:{port}: {error.strerror or error}; expected its address") from None
        self._seq = 0
        self._sent_ns = -_HELLO_EVERY_NS
        self._nonce = self._challenge = self._token = 0
        self._heard_ns: int | None = None
        self.status: GuardStatus | None = None
        self.why_not_armed = Reason.NONE

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the socket; an armed guard that hears nothing damps the motors."""
        self._socket.close()

    @property
    def is_granted(self) -> bool:
        """Whether the guard has armed for this client; it may have come to damping since."""
        return self._token != 0

    @property
    def is_armed(self) -> bool:
        """Whether the guard, as it last said, follows the commands of this client (`silence_s` ago)."""
        return self.is_granted and self.status is not None and self.status.state in (State.ARMED, State.FROZEN)

    @property
    def is_here(self) -> bool:
        """Whether the guard runs on this computer: whoever writes to itself does so from the address it writes to."""
        host: str = self._socket.getpeername()[0]
        return host.startswith("127.") or host == self._socket.getsockname()[0]

    @property
    def silence_s(self) -> float:
        """How long ago the guard was heard [s]; infinite if never."""
        return math.inf if self._heard_ns is None else (self._clock.monotonic_ns() - self._heard_ns) / 1e9

    def arm(self) -> None:
        """Ask the guard to arm; `poll` goes on with the handshake. `why_not_armed` tells when it refuses, `silence_s`
        when no guard is there."""
        self._nonce, self._challenge, self._token = secrets.randbits(64) or 1, 0, 0
        self.why_not_armed = Reason.NONE
        self._request(Kind.ARM, self._nonce)

    def disarm(self) -> None:
        """Let the motors come to damping now."""
        self._request(Kind.DISARM, self._token)
        self._nonce = 0

    def send(self, state_tick: int, q: Floats, kp: Floats, kd: Floats) -> int:
        """Send a command that answers the LowState of a tick [ms]; return its seq. Nothing moves when not armed."""
        self._seq += 1
        now_ns = self._clock.monotonic_ns()
        self._send(command(q, kp, kd, seq=self._seq, state_tick=state_tick, sender_ns=now_ns, token=self._token))
        return self._seq

    def poll(self) -> GuardStatus | None:
        """Take what the guard said, go on with a handshake; return its newest status, None before the first."""
        while (datagram := self._receive()) is not None:
            if (said := status(datagram, self._clock.monotonic_ns())) is not None:
                self._take(said)
        since_ns = self._clock.monotonic_ns() - self._sent_ns
        if self._nonce and since_ns >= _ASK_EVERY_NS:
            self._request(*((Kind.CONFIRM, self._challenge) if self._challenge else (Kind.ARM, self._nonce)))
        elif since_ns >= _HELLO_EVERY_NS:
            self._request(Kind.HELLO, 0)
        return self.status

    def _take(self, said: GuardStatus) -> None:
        if said.kind is not Answer.ARM_REFUSED:
            self.status, self._heard_ns = said, self._clock.monotonic_ns()
        if said.kind is Answer.STATUS or said.nonce != self._nonce or not self._nonce:
            return
        if said.kind is Answer.CHALLENGE and not self._challenge:
            self._challenge = said.challenge
            self._request(Kind.CONFIRM, self._challenge)
        elif said.kind is Answer.ARMED:
            self._token, self._nonce = said.challenge, 0
        elif said.kind is Answer.ARM_REFUSED:
            self.why_not_armed, self._nonce = said.reason, 0

    def _request(self, kind: Kind, token: int) -> None:
        self._seq += 1
        self._send(request(kind, seq=self._seq, sender_ns=self._clock.monotonic_ns(), token=token))

    def _send(self, datagram: bytes) -> None:
        self._sent_ns = self._clock.monotonic_ns()
        try:
            self._socket.send(datagram)
        except OSError:  # no guard there, or no network: its status, which grows old, tells
            return

    def _receive(self) -> bytes | None:
        try:
            return self._socket.recv(ANSWER.itemsize + 1)
        except OSError:  # nothing there; or a guard that is not
            return None
