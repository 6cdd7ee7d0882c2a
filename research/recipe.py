"""What every training run has: the robots that collect, and how a network learns from what they saw."""

from __future__ import annotations

import msgspec


class Crowd(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The simulated robots that collect data side by side.

    Attributes:
        robots: Their number.
        teacher_drives: Share of them that the teacher drives itself, so that its own states stay in the data.
        bodies: Different bodies among them (masses, gains, friction), dealt out in turn.
        nominal: How many of these are as their file says.
        undisturbed: Share of the episodes without pushes, delays and noise.
        physics_dt_s: Physics step [s].
        episode_s: Longest episode [s].
        mass_spread, gain_spread: Greatest relative change of each link's mass, and of each joint's gains.
        payload_kg: Greatest mass added to the trunk [kg].
        com_shift_m: Greatest shift of the trunk's centre of mass along each axis [m].
        friction: Range of the friction between sole and floor.
        armature: Range of the rotor inertia of a body's joints [kg m^2], even in its logarithm; (0, 0) for the model's.
        push_m_s: Greatest sudden change of the root's velocity in the plane [m/s].
        push_every_s: Mean time between pushes in the half of the episodes that has them [s].
        late_steps: Greatest delay of a target, in control steps.
        noise: Sensor noise at full strength (uniform, ±): joints [rad], joint speeds [rad/s], gyro [rad/s], tilt [rad].
    """

    robots: int = 96
    teacher_drives: float = 0.1
    bodies: int = 24
    nominal: int = 2
    undisturbed: float = 0.0
    physics_dt_s: float = 0.002
    episode_s: float = 16.0
    mass_spread: float = 0.1
    gain_spread: float = 0.1
    payload_kg: float = 2.0
    com_shift_m: float = 0.02
    friction: tuple[float, float] = (0.6, 1.6)
    armature: tuple[float, float] = (0.0, 0.0)
    push_m_s: float = 0.6
    push_every_s: float = 3.0
    late_steps: float = 1.25
    noise: tuple[float, float, float, float] = (0.01, 0.5, 0.1, 0.02)


class Run(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A training run; with its seed, every number of it.

    Attributes:
        seed: Of everything that is drawn.
        start: A network to go on from, the ONNX file of a run before; "" begins with random weights.
        rounds: Of collecting and learning.
        steps_per_round: Control steps of each robot in a round.
        batches_per_round: Gradient steps after each round.
        polish_batches: Gradient steps at the end, on everything.
        batch: Labelled steps in a gradient step.
        learning_rate: At the start; it falls to a twentieth.
        hidden: Widths of the network's hidden layers.
        crowd: Who collects.
    """

    seed: int = 7
    start: str = ""
    rounds: int = 150
    steps_per_round: int = 200
    batches_per_round: int = 120
    polish_batches: int = 8000
    batch: int = 2048
    learning_rate: float = 1e-3
    hidden: tuple[int, ...] = (512, 256, 128)
    crowd: Crowd = Crowd()
