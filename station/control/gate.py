"""The gate between a command and the robot: blends in, holds, returns to standing, stops. Pure; its time is given.

    waiting    ─ a good command ──► entering
    entering   ─ blend done ──────► tracking        ─ stale ────────► holding
    tracking   ─ stale ───────────► holding
    holding    ─ a good command ──► tracking, or entering where the blend had not ended
                                                    ─ still stale ──► returning
    returning  ─ a good command ──► entering        ─ blend done ───► waiting
    any        ─ a stop ──────────► stopped, which only `reset` leaves

A stop, or an arm's own controller's fault (`faulted`), is left by `reset`, and then only commands are followed that
begin anew, after a silence that was heard since: no robot goes on with a command that ran through its stop. A hole in a
stream is not letting go, nor is a bus that is cut or frozen.

A robot that stays where it is without a command (an arm) has no way back: after holding it is `waiting`, is told in
every tick where it rests, and enters a command at once, as fast as the rates let it.

A command that comes back while holding is followed at once if it was followed before; from returning, when the blend
had not ended, or when another writer gives it, it is entered again. What is a good command is decided before, in
`station.control.command_validator`. Whatever the state, no element moves faster than its rate
(`Bounds`): a command that jumps is caught up with. Two things jump: `reset`, to standing, where a robot
starts anew; and the output for a robot that stays while it is not commanded, which is where it rests.

Where commands are lost, poses are held and then blended to standing; velocities begin to fade in the first tick that
follows no command, and are zero `GateConfig.velocity_fade_s` later, since a velocity that is held moves the robot on.
After a hold they come back in the same time, while poses follow at once.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import msgspec
import numpy as np

from station.blends import VELOCITY_FADE_S
from station.control.command_arbiter import Rule
from station.control.envelope import Envelope, EnvelopeLimit
from station.errors import ConfigError
from station.protocols import CommandFormat, Floats

LONGEST_SLEW_TICK_S = 0.04
"""A tick stands for no more than this [s]: after a stall the robot would get the whole of it as one kick."""

_UNLIMITED = 1e12  # in place of infinity, of which nothing is no number

State = Literal["waiting", "entering", "tracking", "holding", "returning", "stopped", "faulted"]

MOVING: tuple[State, ...] = ("entering", "tracking")
"""A good command of this moment is followed."""

FOLLOWING: tuple[State, ...] = (*MOVING, "holding")
"""A commander decides where the robot is; it may have fallen silent a moment ago."""

LATCHED: tuple[State, ...] = ("stopped", "faulted")
"""Left by `station.control.gate.Gate.reset` alone."""

_ROUNDING = 1e-9  # [s]: five ticks of 0.02 s are 100 ms, 75 of 4 ms are 0.3 s
_LONGEST_TICK_S = 0.1  # a clock that leaps takes a blend no further than this
_LATEST_S = 1e12  # beyond, a clock's ticks are lost in rounding
_TOLD_S = 0.05  # a delay that explains something
_SLACK_S = 0.02  # a command may arrive between the reading of the clock and of the command


class GateConfig(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """How the gate treats fresh, late and absent commands.

    Attributes:
        blend_in_s: Time from the present output to the live command [s]; none for a robot that stays.
        hold_after_s: Age of the newest good command beyond which it is held rather than followed [s].
        return_after_s: Age beyond which the robot is taken back to standing [s]; one that stays follows no commander
            from then on. Where a silence is asked for, commands have to cease for longer than this.
        blend_out_s: Time from the held command to standing [s].
        velocity_fade_s: Time from the velocities of the last command to zero, from the first tick on that does not
            follow it, and back to live ones after a hold [s]; longer where a low `rate_factor` does not let them.
        stale_after_s: Time since a command was written, by its writer's own clock where that is known, beyond which it
            is held rather than followed, however newly it arrived [s]; at least `hold_after_s`.
        rate_factor: Times the greatest rates of the command format; less moves more gently.
        rivals: Which to obey when two write the command: ``keep-first`` refuses the second until the first has been
            silent for longer than `return_after_s`; ``newest`` obeys each writer that begins.

    Raises:
        ValueError: a number that is not positive and finite, or returning before holding.
    """

    blend_in_s: float = 1.0
    hold_after_s: float = 0.1
    return_after_s: float = 0.3
    blend_out_s: float = 2.0
    velocity_fade_s: float = VELOCITY_FADE_S
    stale_after_s: float = 0.25
    rate_factor: float = 1.0
    rivals: Rule = "keep-first"

    def __post_init__(self) -> None:
        for name in ("blend_in_s", "hold_after_s", "return_after_s", "blend_out_s", "velocity_fade_s", "stale_after_s"):
            value = getattr(self, name)
            if not (0.0 < value < math.inf):
                raise ValueError(f"{name} must be a positive time in seconds, got {value}")
        if not (0.0 < self.rate_factor < math.inf):
            raise ValueError(f"rate_factor must be a positive number, got {self.rate_factor}")
        hold_s, return_s = self.hold_after_s, self.return_after_s
        if return_s < hold_s:
            raise ValueError(f"return_after_s ({return_s}) must not be less than hold_after_s ({hold_s})")

    @property
    def longest_delay_s(self) -> float:
        """Greatest time from writing to arrival with which a command is followed [s]."""
        return max(self.stale_after_s, self.hold_after_s)


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
        vector: Command for the robot, shape (m,); always finite. Within its bounds, where the robot is within them: one
            that stays, and was pushed out, comes back at its rate.
        reason: Why it is in this state.
        age_s: Age of the newest good command [s]; infinite when there is none.
        transitions: Changes since the last tick, in order.
        limited: Indices of the elements that are not where the command wants them: its way is beyond rate or range.
        beyond: Indices of the elements that the command wanted beyond the policy's envelope.
        parts: Of a robot whose parts are commanded apart, the decision of each; `vector` is all of theirs.
        at_s: The instant that it is for, where the parts of a robot are told of it [s].
    """

    state: State
    vector: Floats
    reason: str
    age_s: float
    transitions: tuple[Transition, ...]
    limited: tuple[int, ...] = ()
    beyond: tuple[int, ...] = ()
    parts: tuple[Decision, ...] = ()
    at_s: float = 0.0


class Gate:
    """The state machine; one `step` per control tick.

    Args:
        default: The command that asks the robot to stand, shape (m,).
        config: Its times.
        bounds: Range and rate of each element; None bounds nothing.
        holds_position: Whether the robot stays where it is without a command, instead of going back to `default`.
        velocities: Indices of the elements that are velocities, 0 in `default`.
        envelopes: Keep the command where the policies survive it.

    Raises:
        ConfigError: an element cannot be back at its default within `GateConfig.blend_out_s`.
    """

    def __init__(
        self,
        default: Floats,
        config: GateConfig | None = None,
        bounds: Bounds | None = None,
        *,
        holds_position: bool = False,
        velocities: Sequence[int] = (),
        envelopes: Sequence[EnvelopeLimit] = (),
    ) -> None:
        self.config = config or GateConfig()
        self._default = np.array(default, dtype=np.float64)
        self._bounds, self._holds_position, self._envelopes = bounds, holds_position, tuple(envelopes)
        if bounds is not None and not holds_position:
            bounds.expect_back_within(self._default, self.config.blend_out_s)
        self._state: State = "waiting"
        self._reason = "no command yet"
        self._vector = self._default.copy()
        self._start = self._vector  # where a blend began
        self._since_s = 0.0
        self._fade = VelocityFade(velocities, min(self.config.velocity_fade_s, self.config.blend_out_s))
        self._is_entered = False  # whether the blend into the command has ended
        self._new_hands = ""  # why the next command is entered again
        self._silence = ReengageInterlock(self.config.return_after_s)
        self._transitions: list[Transition] = []
        self._now_s: float | None = None
        self._passed_s = 0.0  # since the last tick, as far as it counts
        self._limited: tuple[int, ...] = ()
        self._beyond: tuple[int, ...] = ()

    @classmethod
    def of(cls, command_format: CommandFormat, config: GateConfig, envelopes: Sequence[Envelope] = ()) -> Gate:
        """Return the gate of a command format, within the envelopes of the policies that follow it.

        Raises:
            ConfigError: as above, or an envelope in which the robot does not stand.
        """
        limits = [EnvelopeLimit(envelope, command_format) for envelope in envelopes]
        return cls(
            command_format.default, config, Bounds.of(command_format, config.rate_factor, limits),
            holds_position=command_format.holds_position, velocities=command_format.velocities, envelopes=limits,
        )  # fmt: skip

    @property
    def state(self) -> State:
        """The present state."""
        return self._state

    @property
    def reason(self) -> str:
        """Why it is in this state."""
        return self._reason

    @property
    def why_not_follow(self) -> str:
        """What the commander has to do before it is followed, and why, or ""."""
        return self._silence.missing

    def step(
        self,
        now_s: float,
        command: Floats | None,
        age_s: float,
        *,
        delay_s: float = 0.0,
        refusal: str = "",
        quiet: QuietTime | None = None,
    ) -> Decision:
        """Advance to an instant and return what the policy gets.

        Args:
            now_s: The instant [s]. Where the clock runs backwards or is no number, no time passes; where it leaps, a
                tick's worth.
            command: The newest good command, shape (m,), or None.
            age_s: Time since it arrived [s]; infinite when unknown. Ignored without a command.
            delay_s: Time from its writing to its arrival [s]; 0.0 where unknown.
            refusal: Why something newer was refused, or "".
            quiet: For how long nothing has come, be it only to be refused; None: for as long as the age says.
        """
        now_s = self._pass_time(now_s)
        self._limited, self._beyond = (), ()
        self._silence.on_tick(quiet or QuietTime(age_s), self._passed_s)
        if self.why_not_follow:
            command, refusal = None, refusal or self.why_not_follow
        if command is None or command.shape != self._default.shape or not np.isfinite(command).all():
            command, age_s = None, math.inf
        elif not (age_s >= -_SLACK_S and delay_s >= -_SLACK_S):
            age_s = math.inf  # from the future, or not a number: nothing is known of it
        why = refusal or _staleness(age_s, delay_s)
        if self._state in LATCHED:
            pass
        elif command is not None and self._is_in_time(age_s, delay_s):
            self._follow(now_s, command)
        elif self._state in FOLLOWING and age_s <= self.config.return_after_s + _ROUNDING:
            self._hold(now_s, why)
        else:
            self._go_home(now_s, why)
        for envelope in self._envelopes:
            if self._state in ("waiting", *LATCHED):
                envelope.begin()
            else:
                envelope.on_tick(self._vector, self._passed_s)
        transitions, self._transitions = tuple(self._transitions), []
        reason = refusal if refusal and self._state == "waiting" else self._reason
        return Decision(self._state, self._vector.copy(), reason, age_s, transitions, self._limited, self._beyond)

    def change_hands(self, reason: str) -> None:
        """Blend into the next good command again: another writer gives it."""
        self._new_hands = reason

    def insist_on_silence(self, why: str) -> None:
        """Follow no command until commands have ceased, from now on, for longer than `GateConfig.return_after_s`."""
        self._silence.insist(why)

    def rest(self, where: Floats, bounds: Bounds | None = None) -> None:
        """Set where a robot that holds its position is, shape (m,), before each `step`; and new bounds, if any."""
        self._default = np.array(where, dtype=np.float64)
        self._bounds = bounds or self._bounds
        if self._state in ("waiting", *LATCHED):
            self._vector = self._default.copy()

    def stop(self, reason: str) -> None:
        """Latch the stop; the output stays what it was, or where a robot that stays is (`rest`)."""
        self._move("stopped", self._now_s or 0.0, reason)

    def fault(self, reason: str) -> None:
        """Latch what the robot's own controller says has gone wrong, now; a stop is more, and stays."""
        if self._state != "stopped":
            self._move("faulted", self._now_s or 0.0, reason)
            self._reason = reason

    def reset(self, reason: str = "reset by the operator") -> None:
        """Leave the stop, a fault, and any other state: wait for a command, output standing (or where it rests).

        A writer that commanded through a stop or fault has to cease, and begin anew.
        """
        if self._state in LATCHED:
            self._silence.insist(f"there was a {'stop' if self._state == 'stopped' else 'fault'}")
        self._vector = self._default.copy()
        self._is_entered = False
        self._move("waiting", self._now_s or 0.0, reason)

    def restore(self, vector: Floats, now_s: float) -> None:
        """Go on from an instant [s] in which a command had long been tracked, shape (m,): an audit may begin there."""
        self._state, self._reason, self._vector = "tracking", "restored", np.array(vector, dtype=np.float64)
        self._start, self._since_s, self._now_s, self._is_entered = self._vector, now_s, now_s, True
        self._fade.end()
        for envelope in self._envelopes:
            envelope.forget()

    @property
    def knows_averages(self) -> bool:
        """Whether it knows what its envelopes average: it has been `waiting` since a `restore`."""
        return all(envelope.is_known for envelope in self._envelopes)

    def _follow(self, now_s: float, command: Floats) -> None:
        if self._state in ("waiting", "returning") or (self._state == "holding" and not self._is_entered):
            self._move("entering", now_s, "a good command came")
        elif self._new_hands:
            self._enter_again(now_s)
        elif self._state == "holding":
            self._move("tracking", now_s, "a good command came")
        self._new_hands = ""
        is_blending = self._state == "entering" and not self._holds_position
        fraction = self._fraction(now_s, self.config.blend_in_s) if is_blending else 1.0
        wanted = self._start + fraction * (command - self._start) if fraction < 1.0 else command
        self._approach(self._fade.apply(wanted, command, self._passed_s))
        if fraction >= 1.0 and self._state == "entering" and not (self._holds_position and self._limited):
            self._is_entered = True
            self._move("tracking", now_s, "caught up" if self._holds_position else "blend done")

    def _is_in_time(self, age_s: float, delay_s: float) -> bool:
        config = self.config
        return age_s <= config.hold_after_s + _ROUNDING and age_s + delay_s <= config.longest_delay_s + _ROUNDING

    def _enter_again(self, now_s: float) -> None:
        self._move("entering", now_s, self._new_hands)
        self._since_s, self._start = now_s, self._vector  # also when it was entering: `_move` does nothing then

    def _hold(self, now_s: float, why: str) -> None:
        self._move("holding", now_s, why)
        if self._fade.has_velocities:  # else nothing moves, not even an arm that was pushed out of its range
            self._approach(self._fade.apply(self._vector, self._default, self._passed_s))

    def _go_home(self, now_s: float, why: str) -> None:
        if self._holds_position:
            self._move("waiting", now_s, why)
            self._reason = why
        if self._state == "waiting":
            return
        self._move("returning", now_s, why)
        fraction = self._fraction(now_s, self.config.blend_out_s)
        wanted = self._start + fraction * (self._default - self._start) if fraction < 1.0 else self._default
        self._approach(self._fade.apply(wanted, self._default, self._passed_s))
        if fraction >= 1.0 and not self._limited:
            self._move("waiting", now_s, "standing again")

    def _approach(self, wanted: Floats) -> None:
        """Go to a vector, as far as its bounds let it."""
        if self._bounds is None:
            self._vector = np.array(wanted)
            return
        asked = wanted
        for envelope in self._envelopes:
            wanted = envelope.limit(wanted, self._vector, self._passed_s)
        self._beyond = tuple(np.flatnonzero(wanted != asked).tolist()) if wanted is not asked else ()
        moved = self._bounds.step(self._vector, wanted, self._passed_s)
        for envelope in self._envelopes:
            moved = envelope.on_the_way(self._vector, wanted, moved, self._passed_s)
        self._vector = moved
        self._limited = tuple(np.flatnonzero(self._vector != wanted).tolist())

    def _pass_time(self, now_s: float) -> float:
        """Count the time that a tick is worth; return the instant, or the last one when it is none."""
        if not abs(now_s) < _LATEST_S:
            self._passed_s = 0.0
            return self._now_s or 0.0
        before = now_s if self._now_s is None else self._now_s
        passed_s = now_s - before
        self._passed_s = min(max(passed_s, 0.0), _LONGEST_TICK_S)
        self._since_s += passed_s - self._passed_s  # what does not count is no part of a blend
        if self._now_s is None:
            self._since_s += now_s
        self._now_s = now_s
        return now_s

    def _move(self, state: State, now_s: float, reason: str) -> None:
        """Change state; a blend starts from the present output."""
        if state == self._state:
            return
        self._transitions.append(Transition(self._state, state, reason))
        is_lost, is_back = self._state in MOVING, state == "tracking" and self._state == "holding"
        if state in ("entering", "waiting"):
            self._fade.end()
        elif is_back or (is_lost and state in ("holding", "returning")):
            self._fade.begin(self._vector)
        self._state, self._reason = state, reason
        self._since_s, self._start = now_s, self._vector
        if state in ("entering", "returning"):
            self._is_entered = False

    def _fraction(self, now_s: float, duration_s: float) -> float:
        fraction = max(0.0, (now_s - self._since_s) / duration_s)
        return 1.0 if fraction >= 1.0 - _ROUNDING else fraction


def _staleness(age_s: float, delay_s: float) -> str:
    if age_s == math.inf:
        return "no command yet"
    came = f" and was written {delay_s * 1e3:.0f} ms before it came" if delay_s >= _TOLD_S else ""
    return f"the newest good command is {age_s * 1e3:.0f} ms old{came}"


@dataclass(frozen=True, slots=True, eq=False)
class Bounds:
    """Where a command vector may be and how fast it may get there; each of shape (m,).

    Attributes:
        lower, upper: Range of each element.
        rate: Greatest change of each element per second.
    """

    lower: Floats
    upper: Floats
    rate: Floats

    @classmethod
    def of(cls, command_format: CommandFormat, factor: float = 1.0, envelopes: Sequence[EnvelopeLimit] = ()) -> Bounds:
        """Return the bounds of a format within those of envelopes, their rates times a factor."""
        rate = np.minimum.reduce([command_format.rate, *(envelope.rate for envelope in envelopes)]) * factor
        return cls(
            np.maximum.reduce([command_format.lower, *(envelope.lower for envelope in envelopes)]),
            np.minimum.reduce([command_format.upper, *(envelope.upper for envelope in envelopes)]),
            np.minimum(rate, _UNLIMITED),
        )

    def step(self, before: Floats, wanted: Floats, passed_s: float) -> Floats:
        """Return what comes nearest to a vector after some time; the very vector where range and rate allow it.

        The rate goes before the range: what is out of its range (an arm that was pushed there by hand) comes back at
        its rate, and is out of it until it is back. Without time nothing moves.

        Args:
            before: Where it was, shape (m,).
            wanted: Where to, shape (m,).
            passed_s: How much time has passed [s]; counts for `LONGEST_SLEW_TICK_S` at most, and below 0 for none.
        """
        most = self.rate * min(max(passed_s, 0.0), LONGEST_SLEW_TICK_S)
        moved: Floats = np.clip(np.clip(wanted, self.lower, self.upper), before - most, before + most)
        return moved

    def expect_back_within(self, default: Floats, blend_s: float) -> None:
        """See that no element is too slow to be back at its default after a blend.

        Raises:
            ConfigError: one is.
        """
        farthest = np.maximum(default - self.lower, self.upper - default)
        if (farthest > self.rate * blend_s).any():
            slowest = int(np.argmax(farthest - self.rate * blend_s))
            raise ConfigError(
                f"gate: element {slowest} needs more than blend_out_s ({blend_s:g} s) to return to standing: it may be "
                f"{farthest[slowest]:.3g} away and change by {self.rate[slowest]:.3g} a second; raise rate_factor or "
                "blend_out_s"
            )


class VelocityFade:
    """A linear way from some velocities to those of a goal that may move; all other elements are left alone.

    Args:
        elements: Indices of the velocities within a command.
        duration_s: Time that it takes [s].
    """

    def __init__(self, elements: Sequence[int], duration_s: float) -> None:
        self._elements, self._duration_s = list(elements), duration_s
        self._start: Floats | None = None  # None: nothing fades
        self._passed_s = 0.0

    @property
    def has_velocities(self) -> bool:
        """Whether there is anything to fade."""
        return bool(self._elements)

    def begin(self, start: Floats) -> None:
        """Begin anew from the velocities of a command, shape (m,)."""
        self._start, self._passed_s = start, 0.0

    def end(self) -> None:
        """Leave velocities alone from now on."""
        self._start = None

    def apply(self, wanted: Floats, goal: Floats, passed_s: float) -> Floats:
        """Return a command with its velocities as they are after a further period.

        Args:
            wanted: The command, shape (m,); not changed.
            goal: Where its velocities are going, shape (m,).
            passed_s: The period [s].
        """
        if self._start is None or not self._elements:
            return wanted
        self._passed_s += passed_s
        part = self._passed_s / self._duration_s
        start, end = self._start[self._elements], goal[self._elements]
        wanted = wanted.copy()
        wanted[self._elements] = end if part >= 1.0 - _ROUNDING else start + part * (end - start)
        return wanted


class QuietTime(NamedTuple):
    """How quiet it is where commands come from.

    Attributes:
        for_s: For how long nothing has come and all of it would have been heard [s]; infinite, or no number, where
            nothing ever came.
        unheard_s: For how long it is not known whether something was written, up to now [s]: a bus that is cut or
            frozen tells nothing, and one that is well is asked only so often.
    """

    for_s: float
    unheard_s: float = 0.0


class ReengageInterlock:
    """Counts for how long nothing has come since silence was insisted on.

    Only time that was waited through counts. What came before does not, and neither does what a stalled process or a
    clock that leaps has not heard: a hole in a stream around the instant of a reset is no letting go. Nor does time in
    which writes may have been missed.

    Args:
        needed_s: Longer than this has nothing to come [s].
    """

    def __init__(self, needed_s: float) -> None:
        self._needed_s = needed_s
        self._heard_s: float | None = None  # None: from the next tick on
        self._why = ""

    @property
    def missing(self) -> str:
        """Why no command may be followed yet, or ""."""
        return f"{self._why}; let go, then engage anew" if self._why else ""

    def insist(self, why: str) -> None:
        """Follow no command before there was a silence from now on, for a reason."""
        self._why, self._heard_s = why, None

    def on_tick(self, quiet: QuietTime, passed_s: float) -> None:
        """Record a tick.

        Args:
            quiet: As it is now.
            passed_s: How much time the tick counts for [s].
        """
        if not self._why:
            return
        if self._heard_s is None:
            self._heard_s = 0.0
            return
        for_s = math.inf if math.isnan(quiet.for_s) else max(quiet.for_s, 0.0)
        self._heard_s = min(self._heard_s + passed_s, for_s)
        if self._heard_s - quiet.unheard_s > self._needed_s + _ROUNDING:  # never where that is no number
            self._why = ""
