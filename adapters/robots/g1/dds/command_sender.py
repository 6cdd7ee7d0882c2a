"""How commands reach the motors: written to the robot's network by this process, or through the guard of the motors."""

from __future__ import annotations

import contextlib
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from adapters.robots.g1.dds import guard_client, messages, topics, types
from adapters.robots.g1.dds.guard_client import GuardClient, Reason, State
from adapters.robots.g1.dds.health_monitor import JOINTS
from adapters.robots.g1.dds.network import Network, raw
from adapters.robots.g1.dds.options import ABSENT
from adapters.robots.g1.dds.other_writers import OtherWriters
from station.bus import codec
from station.clock import Clock
from station.errors import StationError
from station.protocols import Floats

DAMPING_KD = 8.0
"""Of every joint of a robot that is damped [N m s/rad]: what others that drive a G1 use, and the guard too."""

_TELLS_EVERY = 5  # periods
_GUARD_SILENT_S = 0.3  # it speaks 50 times a second
_CLOSING_S = 0.3


class CommandSender(Protocol):
    """Sends commands to the motors. `poll` comes first in each control period.

    Attributes:
        guard: Address of the guard that owns the motors, ``none`` where nothing does.
        guard_is_here: Whether that runs on this computer.
    """

    guard: str
    guard_is_here: bool

    def poll(self) -> None:
        """Take what came since the last period."""
        ...

    def why_not_arm(self) -> str:
        """Return what is against sending a first command, or ""."""
        ...

    def why_not_drive(self) -> str:
        """Return why commands do not reach the motors any more, or must not, or ""."""
        ...

    def open(self) -> bool:
        """Ask for control of the motors until it is given; return whether a command reaches them."""
        ...

    def send(self, state: NDArray[Any], q: Floats, kp: Floats, kd: Floats) -> None:
        """Send a command that answers a state, a record of `messages.STATE`; shape (29,) each."""
        ...

    def damp(self, state: NDArray[Any], q: Floats) -> None:
        """Damp the motors, unless they were never under control from here."""
        ...

    def values(self) -> dict[str, bytes]:
        """Return what there is to record, by the name of its stream."""
        ...

    def close(self, state: NDArray[Any], q: Floats) -> None:
        """Leave the motors damped."""
        ...


class DirectSender:
    """This process writes ``rt/lowcmd``. What the robot does when the process dies is not known (`docs/g1-real.md`).

    Args:
        network: The robot's.
        period_s: Control period [s].
        clock: Of the process.
    """

    guard = "none"
    guard_is_here = False

    def __init__(self, network: Network, period_s: float, clock: Clock) -> None:
        self._period_s, self._clock = period_s, clock
        self._writer = network.writer(topics.LOW_CMD, raw(types.LowCmd))
        self._command = messages.new_command()
        self._machine = -1
        self._has_sent = False
        self._others = OtherWriters(network, topics.LOW_CMD)

    def poll(self) -> None:
        """Check for other writers."""
        self._others.poll()

    def why_not_arm(self) -> str:
        """Return that another program has the motors, or ""."""
        return self.why_not_drive()

    def why_not_drive(self) -> str:
        """Return that another program has the motors, or ""."""
        return self._others.why_not()

    def open(self) -> bool:
        """Return True: whatever is written reaches the motors."""
        return True

    def send(self, state: NDArray[Any], q: Floats, kp: Floats, kd: Floats) -> None:
        """Write a command."""
        if state["mode_machine"] != self._machine:
            self._machine = int(state["mode_machine"])
            modes = np.ones(JOINTS, np.uint8)
            modes[list(ABSENT.get(self._machine, ()))] = 0
            messages.set_modes(self._command, modes)
            self._command["mode_machine"] = self._machine
        motors = self._command["motors"][0, :JOINTS]
        motors["q"], motors["kp"], motors["kd"] = q, kp, kd
        self._writer.write(messages.signed(self._command))
        self._has_sent = True

    def damp(self, state: NDArray[Any], q: Floats) -> None:
        """Write damping; to a robot that was sent nothing, nothing."""
        if self._has_sent:
            self.send(state, q, np.zeros(JOINTS), np.full(JOINTS, DAMPING_KD))

    def values(self) -> dict[str, bytes]:
        """Nothing but the targets, which are recorded anyway."""
        return {}

    def close(self, state: NDArray[Any], q: Floats) -> None:
        """Write damping for a while: what is heard last is held."""
        until_s = self._clock.monotonic_s() + _CLOSING_S * self._has_sent
        while self._clock.monotonic_s() < until_s:
            with contextlib.suppress(StationError):
                self.damp(state, q)
            self._clock.sleep(self._period_s)


class GuardedSender:
    """The guard writes ``rt/lowcmd``, and damps the robot when this process falls silent.

    Args:
        host, port: Of the guard.
        clock: Of the process.
    """

    def __init__(self, host: str, port: int, clock: Clock) -> None:
        self._client = GuardClient(host, port, clock)
        self.guard, self.guard_is_here = f"{host}:{port}", self._client.is_here
        self._is_ours = self._is_asked = False
        self._polls = 0

    def poll(self) -> None:
        """Hear what the guard says, and go on with a handshake."""
        self._client.poll()
        self._polls += 1

    def why_not_arm(self) -> str:
        """Return why the guard would not arm now, or ""."""
        status = self._client.status
        return self._why_silent() or ("" if status is None else self._in_words(status.why_not))

    def why_not_drive(self) -> str:
        """Return why the guard does not follow any more, or ""."""
        if self._client.why_not_armed is not Reason.NONE and self._is_asked:
            return self._in_words(self._client.why_not_armed)
        if self._is_asked and (why_not := self._why_silent()):
            return why_not
        status = self._client.status
        if self._is_ours and status is not None and status.state in (State.RAMPING, State.DAMPING):
            return self._in_words(status.reason)
        return ""

    def open(self) -> bool:
        """Ask the guard for the motors; they are ours once it has armed."""
        if not self._is_asked:
            self._is_asked = True
            self._client.arm()
        self._is_ours = self._client.is_granted  # a guard that is damping again by now says why
        return self._client.is_armed

    def send(self, state: NDArray[Any], q: Floats, kp: Floats, kd: Floats) -> None:
        """Send a command to the guard."""
        self._client.send(int(state["tick"]), q, kp, kd)

    def damp(self, state: NDArray[Any], q: Floats) -> None:
        """Have the guard damp the robot; once it does, it goes on by itself."""
        if self._is_asked:
            self._client.disarm()
        self._is_ours = self._is_asked = False

    def values(self) -> dict[str, bytes]:
        """Return what the guard last said, ten times a second."""
        status = self._client.status
        if status is None or self._polls % _TELLS_EVERY:
            return {}
        return {"guard": codec.json_object(guard_client.shown(status))}

    def close(self, state: NDArray[Any], q: Floats) -> None:
        """Have the guard damp the robot."""
        self.damp(state, q)
        self._client.close()

    def _why_silent(self) -> str:
        if self._client.silence_s <= _GUARD_SILENT_S:
            return ""
        return f"the guard at {self.guard} does not answer; `systemctl status g1-guard` on the robot's computer"

    def _in_words(self, reason: Reason) -> str:
        if reason is Reason.NONE:
            return ""
        foreign = self._client.status.foreign if self._client.status is not None else ""
        told = f": {foreign}" if reason is Reason.FOREIGN_WRITER and foreign else ""
        return f"guard: {guard_client.WORDS[reason]}{told}"
