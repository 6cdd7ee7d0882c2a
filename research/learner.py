"""DAgger (Ross, Gordon, Bagnell 2011): the student drives, the teacher says what it would have done, all is learned."""

from __future__ import annotations

import copy
import math
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch

from research.collector import Act, Collector, Score
from research.network import Student, load_onnx
from research.recipe import Run
from station import assets
from station.protocols import Floats32

_AVERAGE = 0.999  # of the weights, over gradient steps: the averaged student drives more steadily than the newest


@dataclass(frozen=True, slots=True)
class Round:
    """What one round gave: its number, the loss at its end, how both drivers did, seconds since the start."""

    number: int
    loss: float
    student: Score
    teacher: Score
    elapsed_s: float


class Learner:
    """The student, its averaged copy, and everything that was collected.

    Args:
        recipe: Sizes and rates.
        device: A torch device, ``cpu`` or ``cuda``.
        inputs, outputs: Sizes of the student.
    """

    def __init__(self, recipe: Run, device: str, inputs: int, outputs: int) -> None:
        torch.manual_seed(recipe.seed)
        self._recipe, self._device = recipe, device
        self._student = Student(inputs, recipe.hidden, outputs)
        if recipe.start:
            load_onnx(self._student, assets.resolve(recipe.start))
        self._student.to(device)
        self.average = copy.deepcopy(self._student)
        weights = [p for p in self._student.parameters() if p.requires_grad]
        self._optimizer = torch.optim.Adam(weights, lr=recipe.learning_rate)
        self._total = recipe.rounds * recipe.batches_per_round + recipe.polish_batches
        self._done, self._size = 0, 0
        capacity = recipe.rounds * recipe.steps_per_round * recipe.crowd.robots
        self._observations = np.empty((capacity, inputs), dtype=np.float16)  # 4 GB; far finer than the noise
        self._labels = np.empty((capacity, outputs), dtype=np.float32)
        self._rng = np.random.default_rng(recipe.seed + 1)

    def __len__(self) -> int:
        return self._size

    def add(self, observations: Floats32, labels: Floats32) -> None:
        """Remember labelled steps; the first ones give the scale of the inputs, unless a network brought it along."""
        if not self._size and not self._recipe.start:
            self._student.measure(observations)
            self.average.measure(observations)
        end = self._size + len(labels)
        self._observations[self._size : end] = observations
        self._labels[self._size : end] = labels
        self._size = end

    def learn(self, batches: int) -> float:
        """Take gradient steps; return the mean loss of the last hundred."""
        losses: list[float] = []
        for _ in range(batches):
            rows = self._rng.integers(0, self._size, self._recipe.batch)
            loss = self._step(self._to(self._observations[rows].astype(np.float32)), self._to(self._labels[rows]))
            losses.append(loss)
        return float(np.mean(losses[-100:])) if losses else math.nan

    def act(self, observations: Floats32) -> Floats32:
        """Return the averaged student's raw actions."""
        with torch.inference_mode():
            actions: Floats32 = self.average(self._to(observations)).cpu().numpy()
        return actions

    def _to(self, array: Floats32) -> torch.Tensor:
        return torch.from_numpy(array).to(self._device)

    def _step(self, observations: torch.Tensor, labels: torch.Tensor) -> float:
        progress = self._done / self._total
        rate = self._recipe.learning_rate * (0.05 + 0.95 * 0.5 * (1 + math.cos(math.pi * progress)))
        for group in self._optimizer.param_groups:
            group["lr"] = rate
        loss = torch.nn.functional.smooth_l1_loss(self._student(observations), labels)
        self._optimizer.zero_grad(set_to_none=True)
        loss.backward()
        self._optimizer.step()
        self._done += 1
        keep = min(_AVERAGE, self._done / (self._done + 10))
        with torch.no_grad():
            for mine, newest in zip(self.average.parameters(), self._student.parameters(), strict=True):
                mine.lerp_(newest, 1 - keep)
        return float(loss.detach())


def train(recipe: Run, learner: Learner, collector: Collector, on_round: Callable[[Round], None]) -> None:
    """Run all rounds and the polish at the end."""
    started_s = time.perf_counter()
    for number in range(1, recipe.rounds + 1):
        collector.student, collector.teacher = Score(), Score()
        act: Act | None = learner.act if len(learner) or recipe.start else None
        learner.add(*collector.collect(recipe.steps_per_round, act))
        loss = learner.learn(recipe.batches_per_round)
        elapsed_s = time.perf_counter() - started_s
        on_round(Round(number, loss, collector.student, collector.teacher, elapsed_s))
    left = recipe.polish_batches
    while left > 0:
        part = min(1000, left)
        loss = learner.learn(part)
        left -= part
        on_round(Round(recipe.rounds, loss, Score(), Score(), time.perf_counter() - started_s))
