"""The gate between a command and the robot: blends in, holds, returns to standing, stops. Pure; its time is given.

    waiting ──fresh──► entering ──blend done──► tracking
       ▲                  │  ▲                    │  ▲
       │                stale│fresh             stale│fresh
       │                  ▼  │                    ▼  │
       └──blend done── returning ◄──still stale── holding          stopped: from anywhere, left only by `reset`

A command that comes back while holding is followed at once if it was followed before; from returning, or when the
blend had not ended, it is entered again. What is a good command is decided before, in `station.life.inlet`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import msgspec
import numpy as np

from station.protocols import Floats

_ROUNDING = 1e-9  # five ticks of 0.02 s are 100 ms

State = Literal["waiting", "entering", "tracking", "holding", "returning", "stopped"]


class GateConfig(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """How the gate treats fresh, late and absent commands.

    Attributes:
        blend_in_s: Time from the present output to the live command [s].
        hold_after_s: Age of the newest good command beyond which it is held rather than followed [s].
        return_after_s: Age beyond which the robot is taken back to standing [s].
        blend_out_s: Time from the held command to standing [s].

    Raises:
        ValueError: a time that is not positive and finite, or returning before holding.
    """

    blend_in_s: float = 1.0
    hold_after_s: float = 0.1
    return_after_s: float = 0.3
    blend_out_s: float = 2.0

    def __post_init__(self) -> None:
        for name in self.__struct_fields__:
            value = getattr(self, name)
            if not (0.0 < value < math.inf):
                raise ValueError(f"{name} must be a positive time in seconds, got {value}")
        if self.return_after_s < self.hold_after_s:
            raise ValueError(
                f"return_after_s ({self.return_after_s}) must not be less than hold_after_s ({self.hold_after_s})"
            )


@dataclass(frozen=True, slots=True)
class Transition:
    """A change of state and why it came."""

    before: State
    after: State
    reason: str


@dataclass(frozen=True, slots=True)
class Decision:
    """What the gate lets through in one tick.

    Attributes:
        state: State after this tick.
        vector: Command for the policy, shape (m,); always finite.
        reason: Why it is in this state.
        age_s: Age of the newest good command [s]; infinite when there is none.
        transitions: Changes since the last tick, in order.
    """

    state: State
    vector: Floats
    reason: str
    age_s: float
    transitions: tuple[Transition, ...]


class Gate:
    """The state machine; one `step` per control tick.

    Args:
        default: The command that asks the robot to stand, shape (m,).
        config: Its times.
    """

    def __init__(self, default: Floats, config: GateConfig | None = None) -> None:
        self.config = config or GateConfig()
        self._default = np.array(default, dtype=np.float64)
        self._state: State = "waiting"
        self._reason = "no command yet"
        self._vector = self._default.copy()
        self._start = self._vector  # where a blend began
        self._since_s = 0.0
        self._is_entered = False  # whether the blend into the command has ended
        self._transitions: list[Transition] = []

    @property
    def state(self) -> State:
        """The present state."""
        return self._state

    @property
    def reason(self) -> str:
        """Why it is in this state."""
        return self._reason

    def step(self, now_s: float, command: Floats | None, age_s: float, *, refusal: str = "") -> Decision:
        """Advance to an instant and return what the policy gets.

        Args:
            now_s: The instant, on any clock that does not run backwards [s].
            command: The newest good command, shape (m,), or None.
            age_s: Its age [s]; infinite when unknown. Ignored without a command.
            refusal: Why something newer was refused, or "".
        """
        if command is None or not np.isfinite(command).all():
            command, age_s = None, math.inf
        why = refusal or _staleness(age_s)
        # Written so that an age that is not a number counts as old.
        if self._state == "stopped":
            pass
        elif command is not None and age_s <= self.config.hold_after_s + _ROUNDING:
            self._follow(now_s, command)
        elif self._state in ("entering", "tracking", "holding") and age_s <= self.config.return_after_s + _ROUNDING:
            self._move("holding", now_s, why)
        else:
            self._go_home(now_s, why)
        transitions, self._transitions = tuple(self._transitions), []
        reason = refusal if refusal and self._state == "waiting" else self._reason
        return Decision(self._state, self._vector.copy(), reason, age_s, transitions)

    def stop(self, reason: str) -> None:
        """Latch the stop; the output stays what it was."""
        self._move("stopped", 0.0, reason)

    def reset(self, reason: str = "reset by the operator") -> None:
        """Leave the stop, and any other state: wait for a command, output standing."""
        self._vector = self._default.copy()
        self._is_entered = False
        self._move("waiting", 0.0, reason)

    def _follow(self, now_s: float, command: Floats) -> None:
        if self._state in ("waiting", "returning") or (self._state == "holding" and not self._is_entered):
            self._move("entering", now_s, "a good command came")
        elif self._state == "holding":
            self._move("tracking", now_s, "a good command came")
        fraction = self._fraction(now_s, self.config.blend_in_s) if self._state == "entering" else 1.0
        self._vector = self._start + fraction * (command - self._start) if fraction < 1.0 else np.array(command)
        if fraction >= 1.0 and self._state == "entering":
            self._is_entered = True
            self._move("tracking", now_s, "blend done")

    def _go_home(self, now_s: float, why: str) -> None:
        if self._state == "waiting":
            return
        self._move("returning", now_s, why)
        fraction = self._fraction(now_s, self.config.blend_out_s)
        self._vector = self._start + fraction * (self._default - self._start)
        if fraction >= 1.0:
            self._vector = self._default.copy()
            self._move("waiting", now_s, "standing again")

    def _move(self, state: State, now_s: float, reason: str) -> None:
        """Change state; a blend starts from the present output."""
        if state == self._state:
            return
        self._transitions.append(Transition(self._state, state, reason))
        self._state, self._reason = state, reason
        self._since_s, self._start = now_s, self._vector
        if state in ("entering", "returning"):
            self._is_entered = False

    def _fraction(self, now_s: float, duration_s: float) -> float:
        fraction = max(0.0, (now_s - self._since_s) / duration_s)
        return 1.0 if fraction >= 1.0 - _ROUNDING else fraction


def _staleness(age_s: float) -> str:
    if age_s == math.inf:
        return "no command yet"
    return f"the newest good command is {age_s * 1e3:.0f} ms old"
