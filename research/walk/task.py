"""What a policy of velocities learns: to follow those of sticks, keys and scripts as its teacher would."""

from __future__ import annotations

import numpy as np

from adapters.commands import twist2
from adapters.policies.follower import clipped, gravity
from adapters.policies.walk.policy import SPEED_SCALE, WalkPolicy
from research.crowd import CONTROL_DT_S, States
from research.tracker.streams import ARMS, wandering
from research.walk.recipe import Recipe
from research.walk.teachers import FalconTeacher, Go1Teacher
from station.protocols import Floats, Floats32
from station.rotations import from_rotation_vector, roll_pitch_yaw, rotate_inverse, tilt

LEAN_RAD, LOW = 0.8, 0.6
"""An episode ends when the root leans this far, or is lower than this part of its height at the start."""
STILL = 0.04
"""Below it in each number a velocity asks for standing [m/s, rad/s]: else an operator's drift would have it step."""
MOST = 0.35
"""How much more than is wanted a teacher is asked for at most [m/s, rad/s]."""
Teacher = Go1Teacher | FalconTeacher


class WalkTask:
    """Implements `research.collector.Task`.

    Args:
        policy: Whose network it becomes: frames, gains, default pose and range.
        teacher: Gives the labels.
        recipe: What is asked for.
        height_m: Of the root at the start [m].
    """

    error = "mean_velocity_error_m_s"

    def __init__(self, policy: type[WalkPolicy], teacher: Teacher, recipe: Recipe, height_m: float) -> None:
        self._policy, self._teacher, self._recipe = policy, teacher, recipe
        self.frames, self.frame, self.actions = policy.FRAMES, policy.FRAME, policy.ACTIONS
        self._lower, self._upper = np.array(policy.RANGE).T
        self._lowest_m = LOW * height_m
        self._joints = len(policy.JOINTS)
        self._more, self._before = np.zeros((2, recipe.crowd.robots, 3))

    def draw(self, rng: np.random.Generator, steps: int) -> tuple[str, Floats]:
        """Return the kind of an episode and its commands: velocity, then positions of the arms that are commanded."""
        if rng.random() < 0.1:
            kind, rows = "stand", np.zeros((steps, 3))
        else:
            kind, rows = "walk", velocities(rng, steps, self._lower, self._upper, self._recipe.stands)
        if self.actions == self._joints:
            return kind, rows
        arms = np.tile(self._policy.DEFAULT_Q[self.actions :], (steps, 1))
        if rng.random() < self._recipe.arms:
            kind, arms = f"{kind}-arms", moved(rng, steps, arms[0])
        return kind, np.concatenate([rows, arms], axis=1)

    def see(self, states: States, commands: Floats, actions: Floats32) -> Floats32:
        """Return frames, as `WalkPolicy` makes them, shape (n, frame)."""
        return np.concatenate(
            [states.gyro, gravity(states), commands[:, :3], states.q - self._policy.DEFAULT_Q, states.dq * SPEED_SCALE,
             clipped(actions)], axis=1,
        ).astype(np.float32)  # fmt: skip

    def noise(self, amounts: tuple[float, float, float, float]) -> Floats32:
        """Return the amplitude of sensor noise of each number of a frame, shape (frame,)."""
        joint, speed, gyro, lean = amounts
        scales = [gyro, lean, 0.0, joint, speed * SPEED_SCALE, 0.0]
        return np.repeat(np.array(scales, dtype=np.float32), [3, 3, 3, self._joints, self._joints, self.actions])

    def label(self, newest: Floats32, states: States, commands: Floats) -> Floats32:
        """Return the teacher's outputs, shape (n, actions)."""
        told = commands.copy()
        told[:, :3] = self._corrected(states, commands[:, :3])
        return self._teacher(states, told, newest[:, -self.actions :])

    def forget(self, robot: int) -> None:
        """Begin anew with one robot."""
        self._teacher.forget(robot)
        self._more[robot] = self._before[robot] = 0.0

    def _corrected(self, states: States, wanted: Floats) -> Floats:
        """Return what the teacher is asked for, shape (n, 3): what is wanted, and the sum of what was missing of it."""
        # What made up for one velocity is little use for another.
        self._more *= np.maximum(0.0, 1.0 - np.abs(wanted - self._before))
        self._before = wanted.copy()
        went = np.concatenate([in_heading(states)[:, :2], states.gyro[:, 2:]], axis=1)
        self._more += self._recipe.corrects_per_s * CONTROL_DT_S * (wanted - went)
        self._more = np.clip(self._more, -MOST, MOST)
        stands = (np.abs(wanted) < STILL).all(axis=1, keepdims=True)
        self._more = np.where(stands, 0.0, self._more)
        return np.where(stands, 0.0, np.clip(wanted + self._more, 1.2 * self._lower, 1.2 * self._upper))

    def targets(self, actions: Floats32, commands: Floats) -> Floats:
        """Return the targets of all joints, those of the arms as commanded, shape (n, m) [rad]."""
        driven = self._policy.DEFAULT_Q[: self.actions] + self._policy.SCALE * clipped(actions)
        return np.concatenate([driven, commands[:, 3:]], axis=1)

    def measure(self, states: States, commands: Floats) -> Floats:
        """Return how far the velocity in the plane is from the one commanded, shape (n,) [m/s]; a gait sways."""
        return np.asarray(np.linalg.norm(in_heading(states)[:, :2] - commands[:, :2], axis=1))

    def is_down(self, states: States, commands: Floats) -> np.ndarray:
        """Return which robots lean or sag too far, or are no longer simulated soundly."""
        is_up = (tilt(states.quat_wxyz) < LEAN_RAD) & (states.root_pos[:, 2] > self._lowest_m)
        return np.asarray(~is_up)


def in_heading(states: States) -> Floats:
    """Return the velocity of each root in the frame of its heading, shape (n, 3) [m/s]."""
    turn = np.zeros_like(states.lin_vel)
    turn[:, 2] = roll_pitch_yaw(states.quat_wxyz)[:, 2]
    return np.asarray(rotate_inverse(from_rotation_vector(turn), states.lin_vel))


def velocities(rng: np.random.Generator, steps: int, lower: Floats, upper: Floats, stands: float) -> Floats:
    """Return vx, vy, yaw rate from segment to segment, with a ramp or at once between them, shape (steps, 3)."""
    rows, now, at = np.empty((steps, 3)), np.zeros(3), 0
    while at < steps:
        goal = rng.uniform(lower, upper)
        chance = rng.random()
        if chance < stands:
            goal[:] = 0.0
        elif chance < stands + 0.35:
            goal *= np.arange(3) == rng.integers(3)
        elif chance < stands + 0.45:
            goal = np.where(rng.random(3) < 0.5, lower, upper)
        ramp = int(rng.uniform(0.1, 1.0) / CONTROL_DT_S) if rng.random() < 0.7 else 1
        span = max(ramp, int(rng.uniform(0.5, 4.0) / CONTROL_DT_S))
        part = np.minimum(np.arange(1, span + 1) / ramp, 1.0)[:, None]
        rows[at : at + span] = (now + part * (goal - now))[: steps - at]
        now, at = goal, at + span
    return rows


def moved(rng: np.random.Generator, steps: int, pose: Floats) -> Floats:
    """Return positions of arms that swing about a pose or wander over their ranges, shape (steps, 14) [rad].

    In half of the swings each joint has its own rate and reach; in the others all have the same.
    """
    if rng.random() < 0.5:
        rates = 14 if rng.random() < 0.5 else 1  # arms that all swing at one rate rock the robot hardest
        rate_hz, reach = rng.uniform(0.2, 1.3, rates), rng.uniform(0.0, 0.6, rates)
        phase = 2 * np.pi * (rng.random(14) + rate_hz * np.arange(steps)[:, None] * CONTROL_DT_S)
        lower, upper = twist2.FORMAT.lower[ARMS], twist2.FORMAT.upper[ARMS]
        grown = np.minimum(np.arange(steps) * CONTROL_DT_S, 1.0)[:, None]
        return np.asarray(np.clip(pose + grown * reach * np.sin(phase), lower, upper))
    return wandering(rng, steps, ARMS, start=pose, reach=float(rng.choice([0.5, 1.0])))
