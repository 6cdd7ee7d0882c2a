"""What the tracker learns: to follow streams of TWIST2's commands as its tutor would."""

from __future__ import annotations

import numpy as np

from adapters.policies.tracker.policy import ACTIONS, FRAMES
from adapters.policies.twist2 import ACTION_CLIP, ACTION_SCALE, DEFAULT_Q, FRAME
from research.crowd import States
from research.tracker.frames import frames, noise_scales
from research.tracker.gated import gated
from research.tracker.streams import HEAD, Streams
from research.tracker.tutor import Tutor
from station.protocols import Floats, Floats32
from station.rotations import from_rotation_vector, multiply, tilt

LEAN_RAD, SAG_M = 0.6, 0.22
"""An episode ends when the root leans, or hangs lower, this much more than commanded."""


class TrackerTask:
    """Implements `research.collector.Task`.

    Args:
        tutor: Gives the labels.
        streams: Give the commands.
    """

    frames, frame, actions = FRAMES, FRAME, ACTIONS
    error = "mean_joint_error_rad"

    def __init__(self, tutor: Tutor, streams: Streams) -> None:
        self._tutor, self._streams = tutor, streams

    def draw(self, rng: np.random.Generator, steps: int) -> tuple[str, Floats]:
        """Return the kind of the first stream of an episode, and what the gate lets through, shape (steps, 35)."""
        kinds: list[str] = []

        def draw() -> Floats:
            kind, stream = self._streams.draw(rng)
            kinds.append(kind)
            return stream

        commands = gated(draw, rng, steps)
        return kinds[0] if kinds else "stand", commands

    def see(self, states: States, commands: Floats, actions: Floats32) -> Floats32:
        """Return frames, shape (n, 127)."""
        return frames(states, commands, actions)

    def noise(self, amounts: tuple[float, float, float, float]) -> Floats32:
        """Return the amplitude of sensor noise of each number of a frame, shape (127,)."""
        return noise_scales(amounts)

    def label(self, newest: Floats32, states: States, commands: Floats) -> Floats32:
        """Return the tutor's outputs, shape (n, 29)."""
        return self._tutor(newest, states, commands)

    def forget(self, robot: int) -> None:
        """Begin anew with one robot."""
        self._tutor.forget(robot)

    def targets(self, actions: Floats32, commands: Floats) -> Floats:
        """Return the targets of the joints, shape (n, 29) [rad]."""
        return np.clip(actions.astype(np.float64), -ACTION_CLIP, ACTION_CLIP) * ACTION_SCALE + DEFAULT_Q

    def measure(self, states: States, commands: Floats) -> Floats:
        """Return the mean |q - commanded q|, shape (n,) [rad]."""
        return np.asarray(np.abs(states.q - commands[:, HEAD:]).mean(axis=1))

    def is_down(self, states: States, commands: Floats) -> np.ndarray:
        """Return which robots lean or sag much more than they are commanded to, or are no longer simulated soundly."""
        asked = multiply(_turn(commands[:, 4], 1), _turn(commands[:, 3], 0))
        leans = tilt(states.quat_wxyz) > tilt(asked) + LEAN_RAD
        return np.asarray(leans | (states.root_pos[:, 2] < commands[:, 2] - SAG_M))


def _turn(angle: Floats, axis: int) -> Floats:
    vectors = np.zeros((len(angle), 3))
    vectors[:, axis] = angle
    return from_rotation_vector(vectors)
