"""Playing a motion as commands: a pure state machine, one vector per step, without a clock, a bus or a thread.

    waiting ─► entering ─► playing ─► leaving ─► done
                  ▲   │       │          ▲
                  │   ▼       ▼          │
                  └── paused ◄┘   (from anywhere)

Every change of place (into the first frame, a seek, the start of a loop, back to the default) is a blend, element by
element, from the last vector that was sent to the one that is wanted; motion time stands still until it ends. So no
vector is ever further from the one before it than the motion itself or a blend goes in one step.

Paused means standing still: the pose is held and every velocity of the command eases to zero. A held walking velocity
would ask the policy to walk on with a frozen gait.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from station.blends import times_to_standing
from station.protocols import CommandFormat, Floats, Motion

Phase = Literal["waiting", "entering", "playing", "paused", "leaving", "done"]
AtEnd = Literal["exit", "hold"]

LONGEST_STEP_S = 0.1
"""A step asked to be longer is cut to this: a process that was stopped for a while must not make a jump."""

_ROUNDING = 1e-9  # s; fifty steps of 0.02 s are a second


@dataclass(frozen=True, slots=True)
class Frame:
    """What one step sends.

    Attributes:
        command: The vector, shape (m,), finite.
        phase: Where playing stands.
        time_s: Motion time that the vector belongs to, or that a blend leads to [s].
        frame_index: Recorded frame at or before that time, from 0, within the motion.
    """

    command: Floats
    phase: Phase
    time_s: float
    frame_index: int


@dataclass(frozen=True, slots=True)
class _Blend:
    start: Floats
    end: Floats
    duration_s: float
    elapsed_s: float = 0.0
    times_s: Floats | None = None  # of each element, where some take less than the whole

    @property
    def remaining_s(self) -> float:
        return self.duration_s - self.elapsed_s

    @property
    def is_over(self) -> bool:
        return self.remaining_s <= _ROUNDING

    def value(self) -> Floats:
        if self.is_over:
            return self.end.copy()
        times_s = self.duration_s if self.times_s is None else self.times_s
        return self.start + (self.end - self.start) * np.minimum(self.elapsed_s / times_s, 1.0)


class Playback:
    """Plays a motion through a command format.

    Args:
        motion: What is played.
        command: The vector it is made of.
        enter_s: Blend from the default into the first frame [s].
        leave_s: Blend from the last vector sent back to the default [s]; velocities fade sooner (`station.blends`).
        seek_s: Blend into another place of the motion, by a seek or a loop [s].
        ease_s: Blend into and out of a pause [s].
        lead_s: How far ahead of the playing time the motion is sampled [s]; stock TWIST2 samples one period ahead.
        loop: Whether the motion starts again when it ends.
        wait_for_start: Whether the default is sent until `start` is called.
        at_end: What follows the last frame without `loop`: leave, or hold it until told otherwise.
    """

    def __init__(
        self,
        motion: Motion,
        command: CommandFormat,
        *,
        enter_s: float = 1.0,
        leave_s: float = 2.0,
        seek_s: float = 1.0,
        ease_s: float = 0.5,
        lead_s: float = 0.0,
        loop: bool = False,
        wait_for_start: bool = False,
        at_end: AtEnd = "exit",
    ) -> None:
        self.loop = loop
        self.blends = 0
        self.loops = 0
        self._motion, self._command = motion, command
        self._enter_s, self._leave_s, self._seek_s, self._ease_s = enter_s, leave_s, seek_s, ease_s
        self._lead_s, self._at_end = lead_s, at_end
        self._sent: Floats = command.default.copy()
        self._playhead_s = 0.0
        self._phase: Phase = "waiting"
        self._blend: _Blend | None = None
        self._has_ended = False
        if not wait_for_start:
            self.start()

    @property
    def phase(self) -> Phase:
        """Where playing stands."""
        return self._phase

    @property
    def time_s(self) -> float:
        """Motion time of the newest vector [s]."""
        return min(self._playhead_s + self._lead_s, self._motion.duration_s)

    @property
    def is_complete(self) -> bool:
        """Whether the last frame of the motion has been sent at least once."""
        return self._has_ended

    @property
    def is_done(self) -> bool:
        """Whether the default has been reached for good."""
        return self._phase == "done"

    def start(self) -> bool:
        """Leave `waiting`; False when it was left already."""
        if self._phase != "waiting":
            return False
        self._enter(self._enter_s)
        return True

    def pause(self) -> bool:
        """Hold the pose of the present time, velocities easing to zero; False where there is nothing to pause."""
        if self._phase not in ("entering", "playing"):
            return False
        self._hold(self._ease_s)
        return True

    def resume(self) -> bool:
        """Play on after a pause; after the last frame of a motion, from its beginning. False when not paused."""
        if self._phase != "paused":
            return False
        if self._is_at_end():
            self._playhead_s = 0.0
            self._enter(self._seek_s)
        else:
            self._enter(self._ease_s)
        return True

    def seek(self, time_s: float) -> bool:
        """Go to a motion time [s], clamped to the motion; playing goes on there, a pause stays one.

        Returns:
            False once playing has begun to end, or for a time that is not finite.
        """
        if self._phase in ("leaving", "done") or not math.isfinite(time_s):
            return False
        self._playhead_s = min(max(time_s - self._lead_s, 0.0), self._last_playhead_s())
        if self._phase == "paused":
            self._hold(self._seek_s)
        elif self._phase != "waiting":
            self._enter(self._seek_s)
        return True

    def leave(self) -> bool:
        """Blend back to the default, whatever happens; False when that is under way already."""
        if self._phase in ("leaving", "done"):
            return False
        self._phase = "leaving"
        is_there = np.array_equal(self._sent, self._command.default)
        times_s = times_to_standing(self._command, self._leave_s)
        self._blend = _Blend(self._sent, self._command.default, 0.0 if is_there else self._leave_s, times_s=times_s)
        self.blends += 1
        return True

    def step(self, dt_s: float) -> Frame:
        """Advance by a period [s] and return what to send; `step(0.0)` returns what stands now."""
        dt_s = min(max(dt_s, 0.0), LONGEST_STEP_S)
        if self._phase == "playing":
            self._sent = self._play(dt_s)
        elif self._blend is not None:
            self._sent = self._advance(self._blend, dt_s)
        time_s = self.time_s
        return Frame(self._sent.copy(), self._phase, time_s, int(time_s * self._motion.fps + _ROUNDING))

    def _play(self, dt_s: float) -> Floats:
        if not self._is_at_end():
            self._playhead_s = min(self._playhead_s + dt_s, self._last_playhead_s())
            self._has_ended |= self._is_at_end()
            return self._wanted()
        if self.loop:
            self.loops += 1
            self._playhead_s = 0.0
            self._enter(self._seek_s)
        elif self._at_end == "hold":
            self._hold(self._ease_s)
        else:
            self.leave()
        return self._advance(self._blend, dt_s) if self._blend is not None else self._sent

    def _advance(self, blend: _Blend, dt_s: float) -> Floats:
        moved = replace(blend, elapsed_s=blend.elapsed_s + dt_s)
        self._blend = moved
        if moved.is_over:
            self._blend = None
            if self._phase == "entering":
                self._phase = "playing"
            elif self._phase == "leaving":
                self._phase = "done"
        return moved.value()

    def _enter(self, duration_s: float) -> None:
        self._phase = "entering"
        self._begin_blend(self._wanted(), duration_s)

    def _hold(self, duration_s: float) -> None:
        self._phase = "paused"
        self._begin_blend(self._standing_still(), duration_s)

    def _begin_blend(self, end: Floats, duration_s: float) -> None:
        """Blend from what was sent last; a blend under way is not made faster by the one that takes its place."""
        least_s = self._blend.remaining_s if self._blend else 0.0
        self._blend = _Blend(self._sent, end, max(duration_s, least_s))
        self.blends += 1

    def _wanted(self) -> Floats:
        return self._command.encode(self._motion.at(self.time_s), self._motion.joint_names)

    def _standing_still(self) -> Floats:
        zero = np.zeros(3)
        still = replace(self._motion.at(self.time_s), root_lin_vel=zero, root_ang_vel=zero)
        return self._command.encode(still, self._motion.joint_names)

    def _last_playhead_s(self) -> float:
        return max(self._motion.duration_s - self._lead_s, 0.0)

    def _is_at_end(self) -> bool:
        return self._playhead_s >= self._last_playhead_s() - _ROUNDING
