"""Data of a crowd: what the student saw, and what the teacher would have done there."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from adapters.policies.tracker.policy import FRAMES
from adapters.policies.tracker.training.crowd import CONTROL_DT_S, Crowd, States
from adapters.policies.tracker.training.frames import Histories, frames, noise_scales
from adapters.policies.tracker.training.gated import gated
from adapters.policies.tracker.training.recipe import Recipe
from adapters.policies.tracker.training.streams import HEAD, Streams
from adapters.policies.tracker.training.tutor import Tutor
from adapters.policies.twist2 import ACTION_CLIP, ACTION_SCALE, DEFAULT_Q, FRAME
from adapters.robots.g1.mujoco_g1 import START_Q
from station.protocols import Floats, Floats32
from station.rotations import from_rotation_vector, multiply, tilt

Act = Callable[[Floats32], Floats32]
LEAN_RAD, SAG_M = 0.6, 0.22
"""An episode ends when the root leans, or hangs lower, this much more than commanded: what follows teaches nothing."""


@dataclass
class Score:
    """How the robots of one driver did.

    Attributes:
        steps, falls: By the kind of the first stream of the episode.
        error: Sum over steps of the mean |q - commanded q| [rad], likewise.
    """

    steps: Counter[str] = field(default_factory=Counter)
    falls: Counter[str] = field(default_factory=Counter)
    error: Counter[str] = field(default_factory=Counter)

    def told(self) -> str:
        """One line: seconds per fall and mean joint error, in all and by kind."""
        total = sum(self.steps.values()) * CONTROL_DT_S
        parts = [f"{sum(self.falls.values())} falls in {total:.0f} s"]
        for kind, steps in sorted(self.steps.items()):
            parts.append(f"{kind} {self.falls[kind]}/{steps * CONTROL_DT_S:.0f}s {self.error[kind] / steps:.3f}")
        return ", ".join(parts)


class Collector:
    """Lets robots follow commands, now driven by the student and now by the teacher.

    Args:
        crowd: The robots.
        tutor: Gives the labels.
        streams: Give the commands.
        recipe: Noise, pushes, delays and episodes.
        rng: Draws them.
    """

    def __init__(self, crowd: Crowd, tutor: Tutor, streams: Streams, recipe: Recipe, rng: np.random.Generator) -> None:
        self._crowd, self._tutor, self._streams, self._rng = crowd, tutor, streams, rng
        self._config = recipe.crowd
        count, self._steps = len(crowd), round(self._config.episode_s / CONTROL_DT_S)
        self._noise_scales = noise_scales(self._config.noise)
        self._seen = Histories(count, FRAMES)
        self._commands: Floats = np.zeros((count, self._steps, 35))
        self._pushes: Floats = np.zeros((count, self._steps, 2))
        self._noise, self._late = np.zeros((count, 1), dtype=np.float32), np.zeros(count)
        self._bias: Floats32 = np.zeros((count, FRAME), dtype=np.float32)
        self._kinds = [""] * count
        self._tick = np.zeros(count, dtype=np.intp)
        self._action: Floats32 = np.zeros((count, 29), dtype=np.float32)
        self._targets: Floats = np.tile(np.array(START_Q, dtype=np.float64), (count, 1))
        self._older = self._targets.copy()
        self.student, self.teacher = Score(), Score()
        for robot in range(count):
            self._begin(robot)
        self._tick[:] = 0

    def collect(self, steps: int, act: Act | None) -> tuple[Floats32, Floats32]:
        """Return observations (steps x n, 635) of the student and actions (steps x n, 29) of the teacher.

        Args:
            steps: Control steps of each robot.
            act: The student; None lets the teacher drive every robot.
        """
        count = len(self._crowd)
        observations = np.empty((steps, count, FRAMES * FRAME), dtype=np.float32)
        labels = np.empty((steps, count, 29), dtype=np.float32)
        is_teachers = np.arange(count) < (count if act is None else self._config.teacher_drives * count)
        for step in range(steps):
            command = self._commands[np.arange(count), self._tick]
            states = self._crowd.read()
            newest = frames(states, command, self._action)
            labels[step] = self._tutor(newest, states, command)
            self._seen.push(newest + self._disturbance())
            observations[step] = self._seen.flat
            action = (
                labels[step] if act is None else np.where(is_teachers[:, None], labels[step], act(observations[step]))
            )
            self._move(action)
            self._judge(command, is_teachers)
        return observations.reshape(steps * count, -1), labels.reshape(steps * count, -1)

    def _disturbance(self) -> Floats32:
        white = self._rng.uniform(-1, 1, self._bias.shape).astype(np.float32)
        return (white * self._noise + self._bias) * self._noise_scales

    def _move(self, action: Floats32) -> None:
        rows = np.arange(len(self._crowd))
        for robot in np.flatnonzero(self._pushes[rows, self._tick].any(axis=1)):
            self._crowd.push(int(robot), self._pushes[robot, self._tick[robot]])
        targets = np.clip(action.astype(np.float64), -ACTION_CLIP, ACTION_CLIP) * ACTION_SCALE + DEFAULT_Q
        # Later than one period: the targets before the last are still in force at the beginning of this one.
        is_later = (self._late > 1.0)[:, None]
        before, now = np.where(is_later, self._older, self._targets), np.where(is_later, self._targets, targets)
        self._crowd.step(before, now, np.where(self._late > 1.0, self._late - 1.0, self._late))
        self._older, self._targets, self._action = self._targets, targets, np.asarray(action, dtype=np.float32)

    def _judge(self, command: Floats, is_teachers: np.ndarray) -> None:
        states = self._crowd.read()
        error = np.abs(states.q - command[:, HEAD:]).mean(axis=1)
        is_down = _is_down(states, command)
        self._tick += 1
        for robot in range(len(self._crowd)):
            score, kind = self.teacher if is_teachers[robot] else self.student, self._kinds[robot]
            score.steps[kind] += 1
            score.error[kind] += error[robot]
            score.falls[kind] += int(is_down[robot])
            if is_down[robot] or self._tick[robot] >= self._steps:
                self._begin(robot)

    def _begin(self, robot: int) -> None:
        """Begin an episode with new commands, pushes, noise and delay."""
        rng, config = self._rng, self._config
        kinds: list[str] = []

        def draw() -> Floats:
            kind, stream = self._streams.draw(rng)
            kinds.append(kind)
            return stream

        self._commands[robot] = gated(draw, rng, self._steps)
        self._kinds[robot] = kinds[0] if kinds else "stand"
        self._pushes[robot] = _pushes(rng, self._steps, config.push_m_s, config.push_every_s)
        self._noise[robot] = rng.uniform(0, 1) if rng.random() < 0.7 else 0.0
        self._bias[robot] = self._noise[robot] * rng.uniform(-0.5, 0.5, FRAME)
        self._late[robot] = rng.uniform(0, config.late_steps) if rng.random() < 0.5 else 0.0
        if config.undisturbed and rng.random() < config.undisturbed:
            for disturbance in (self._pushes, self._noise, self._bias, self._late):
                disturbance[robot] = 0.0
        self._tick[robot] = 0
        self._tutor.forget(robot)
        self._seen.clear(robot)
        self._action[robot] = 0.0
        self._targets[robot] = self._older[robot] = START_Q
        self._crowd.restart(robot)


def _pushes(rng: np.random.Generator, steps: int, greatest_m_s: float, every_s: float) -> Floats:
    pushes = np.zeros((steps, 2))
    if rng.random() < 0.5:
        struck = np.flatnonzero(rng.random(steps) < CONTROL_DT_S / every_s)
        angle, speed = rng.uniform(0, 2 * np.pi, len(struck)), rng.uniform(0, greatest_m_s, len(struck))
        pushes[struck] = np.stack([speed * np.cos(angle), speed * np.sin(angle)], axis=1)
    return pushes


def _is_down(states: States, command: Floats) -> np.ndarray:
    """Return which robots lean or sag much more than they are commanded to, or are no longer simulated soundly."""
    asked = multiply(_turn(command[:, 4], 1), _turn(command[:, 3], 0))
    leans = tilt(states.quat_wxyz) > tilt(asked) + LEAN_RAD
    return np.asarray(leans | (states.root_pos[:, 2] < command[:, 2] - SAG_M))


def _turn(angle: Floats, axis: int) -> Floats:
    vectors = np.zeros((len(angle), 3))
    vectors[:, axis] = angle
    return from_rotation_vector(vectors)
