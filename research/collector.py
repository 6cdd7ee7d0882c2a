"""Data of a crowd: what the student saw, and what the teacher would have done there."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from research import recipe
from research.crowd import CONTROL_DT_S, Crowd, States
from station.protocols import Floats, Floats32

Act = Callable[[Floats32], Floats32]


class Task(Protocol):
    """What n robots learn: what they are asked, what they see, and what the teacher would do.

    Attributes:
        frames: How many of the newest frames the student sees.
        frame: Numbers in a frame.
        actions: Numbers of an output.
        error: What `error` gives, for the log.
    """

    frames: int
    frame: int
    actions: int
    error: str

    def draw(self, rng: np.random.Generator, steps: int) -> tuple[str, Floats]:
        """Return the kind of an episode and its commands, shape (steps, c)."""
        ...

    def see(self, states: States, commands: Floats, actions: Floats32) -> Floats32:
        """Return a frame each, shape (n, frame), of states, commands and previous outputs, free of noise."""
        ...

    def noise(self, amounts: tuple[float, float, float, float]) -> Floats32:
        """Return the amplitude of sensor noise of each number of a frame, shape (frame,)."""
        ...

    def label(self, newest: Floats32, states: States, commands: Floats) -> Floats32:
        """Return the teacher's outputs for this step, shape (n, actions)."""
        ...

    def forget(self, robot: int) -> None:
        """Begin anew with one robot."""
        ...

    def targets(self, actions: Floats32, commands: Floats) -> Floats:
        """Return the targets of all joints, shape (n, m) [rad]."""
        ...

    def measure(self, states: States, commands: Floats) -> Floats:
        """Return how far each robot is from its command, shape (n,)."""
        ...

    def is_down(self, states: States, commands: Floats) -> np.ndarray:
        """Return which robots are past saving, shape (n,): what follows teaches nothing."""
        ...


@dataclass
class Score:
    """How the robots of one driver did.

    Attributes:
        steps, falls: By the kind of the episode.
        error: Sum over steps of the error of the task, likewise.
    """

    steps: Counter[str] = field(default_factory=Counter)
    falls: Counter[str] = field(default_factory=Counter)
    error: Counter[str] = field(default_factory=Counter)

    def told(self) -> str:
        """One line: seconds per fall and mean error, in all and by kind."""
        total = sum(self.steps.values()) * CONTROL_DT_S
        parts = [f"{sum(self.falls.values())} falls in {total:.0f} s"]
        for kind, steps in sorted(self.steps.items()):
            parts.append(f"{kind} {self.falls[kind]}/{steps * CONTROL_DT_S:.0f}s {self.error[kind] / steps:.3f}")
        return ", ".join(parts)


class Histories:
    """The newest frames of every robot, oldest first.

    Args:
        robots, count, size: Numbers of robots, of frames kept, and of numbers in a frame.
    """

    def __init__(self, robots: int, count: int, size: int) -> None:
        self.rows: Floats32 = np.zeros((robots, count, size), dtype=np.float32)

    def push(self, newest: Floats32) -> None:
        """Append a frame to each, shape (n, size)."""
        self.rows[:, :-1] = self.rows[:, 1:]
        self.rows[:, -1] = newest

    def clear(self, robot: int) -> None:
        """Forget what one robot saw."""
        self.rows[robot] = 0.0

    @property
    def flat(self) -> Floats32:
        """All frames of each robot in one row, shape (n, count x size)."""
        return self.rows.reshape(len(self.rows), -1)


class Collector:
    """Lets robots follow commands, now driven by the student and now by the teacher.

    Args:
        crowd: The robots.
        task: What they learn.
        config: Noise, pushes, delays and episodes.
        rng: Draws them.
    """

    def __init__(self, crowd: Crowd, task: Task, config: recipe.Crowd, rng: np.random.Generator) -> None:
        self._crowd, self._task, self._config, self._rng = crowd, task, config, rng
        count, self._steps = len(crowd), round(config.episode_s / CONTROL_DT_S)
        self._noise_scales = task.noise(config.noise)
        self._seen = Histories(count, task.frames, task.frame)
        self._commands: list[Floats] = [np.empty(0)] * count
        self._pushes: Floats = np.zeros((count, self._steps, 2))
        self._noise, self._late = np.zeros((count, 1), dtype=np.float32), np.zeros(count)
        self._bias: Floats32 = np.zeros((count, task.frame), dtype=np.float32)
        self._kinds = [""] * count
        self._tick = np.zeros(count, dtype=np.intp)
        self._action: Floats32 = np.zeros((count, task.actions), dtype=np.float32)
        self._targets: Floats = np.tile(crowd.start_q, (count, 1))
        self._older = self._targets.copy()
        self.student, self.teacher = Score(), Score()
        for robot in range(count):
            self._begin(robot)

    def collect(self, steps: int, act: Act | None) -> tuple[Floats32, Floats32]:
        """Return observations (steps x n, inputs) of the student and outputs (steps x n, actions) of the teacher.

        Args:
            steps: Control steps of each robot.
            act: The student; None lets the teacher drive every robot.
        """
        count, task = len(self._crowd), self._task
        observations = np.empty((steps, count, task.frames * task.frame), dtype=np.float32)
        labels = np.empty((steps, count, task.actions), dtype=np.float32)
        is_teachers = np.arange(count) < (count if act is None else self._config.teacher_drives * count)
        for step in range(steps):
            command = np.array([rows[tick] for rows, tick in zip(self._commands, self._tick, strict=True)])
            states = self._crowd.read()
            newest = task.see(states, command, self._action)
            labels[step] = task.label(newest, states, command)
            self._seen.push(newest + self._disturbance())
            observations[step] = self._seen.flat
            action = (
                labels[step] if act is None else np.where(is_teachers[:, None], labels[step], act(observations[step]))
            )
            self._move(action, command)
            self._judge(command, is_teachers)
        return observations.reshape(steps * count, -1), labels.reshape(steps * count, -1)

    def _disturbance(self) -> Floats32:
        white = self._rng.uniform(-1, 1, self._bias.shape).astype(np.float32)
        return (white * self._noise + self._bias) * self._noise_scales

    def _move(self, action: Floats32, command: Floats) -> None:
        rows = np.arange(len(self._crowd))
        for robot in np.flatnonzero(self._pushes[rows, self._tick].any(axis=1)):
            self._crowd.push(int(robot), self._pushes[robot, self._tick[robot]])
        targets = self._task.targets(action, command)
        # Later than one period: the targets before the last are still in force at the beginning of this one.
        is_later = (self._late > 1.0)[:, None]
        before, now = np.where(is_later, self._older, self._targets), np.where(is_later, self._targets, targets)
        self._crowd.step(before, now, np.where(self._late > 1.0, self._late - 1.0, self._late))
        self._older, self._targets, self._action = self._targets, targets, np.asarray(action, dtype=np.float32)

    def _judge(self, command: Floats, is_teachers: np.ndarray) -> None:
        states = self._crowd.read()
        error, is_down = self._task.measure(states, command), self._task.is_down(states, command)
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
        self._kinds[robot], self._commands[robot] = self._task.draw(rng, self._steps)
        self._pushes[robot] = _pushes(rng, self._steps, config.push_m_s, config.push_every_s)
        self._noise[robot] = rng.uniform(0, 1) if rng.random() < 0.7 else 0.0
        self._bias[robot] = self._noise[robot] * rng.uniform(-0.5, 0.5, self._bias.shape[1])
        self._late[robot] = rng.uniform(0, config.late_steps) if rng.random() < 0.5 else 0.0
        if config.undisturbed and rng.random() < config.undisturbed:
            for disturbance in (self._pushes, self._noise, self._bias, self._late):
                disturbance[robot] = 0.0
        self._tick[robot] = 0
        self._task.forget(robot)
        self._seen.clear(robot)
        self._action[robot] = 0.0
        self._targets[robot] = self._older[robot] = self._crowd.start_q
        self._crowd.restart(robot)


def _pushes(rng: np.random.Generator, steps: int, greatest_m_s: float, every_s: float) -> Floats:
    pushes = np.zeros((steps, 2))
    if rng.random() < 0.5:
        struck = np.flatnonzero(rng.random(steps) < CONTROL_DT_S / every_s)
        angle, speed = rng.uniform(0, 2 * np.pi, len(struck)), rng.uniform(0, greatest_m_s, len(struck))
        pushes[struck] = np.stack([speed * np.cos(angle), speed * np.sin(angle)], axis=1)
    return pushes
