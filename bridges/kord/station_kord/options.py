"""What a session is opened with: the arm's limits, and how the simulated controller behaves."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from station_kord.errors import BadOption

JOINTS = 7
TICK_S = 0.004
"""Period of the controller [s]: 250 Hz."""

Vector = tuple[float, ...]
Clock = Literal["wall", "virtual"]
Order = Literal["send-first", "fetch-first"]
Preset = Literal["narrative", "final"]


def seven(name: str, values: Sequence[float] | NDArray[np.float64]) -> Vector:
    """Return seven finite numbers, one per joint.

    Raises:
        BadOption: There are more, fewer, or one of them is not finite.
    """
    numbers = tuple(float(value) for value in values)
    if len(numbers) != JOINTS or not all(math.isfinite(number) for number in numbers):
        raise BadOption(f"{name}: {JOINTS} finite numbers are needed, one per joint; these are {list(numbers)}")
    return numbers


@dataclass(frozen=True, kw_only=True)
class Limits:
    """What the arm may be asked for; checked once more in C++, behind whatever checks the caller makes.

    Angles are never wrapped: joints that turn by ±360° are at another place at 370° than at 10°.

    Attributes:
        q_min, q_max: Joint positions, shape (7,) [rad].
        qd_max: Joint speeds, shape (7,) [rad/s], positive.
        qdd_max: Joint accelerations, shape (7,) [rad/s²], positive; how fast `velocity_j` and `direct_j` may change
            their speed.

    Raises:
        BadOption: A value is not finite, a range is empty, or a speed or acceleration is not positive.
    """

    q_min: Vector
    q_max: Vector
    qd_max: Vector
    qdd_max: Vector

    def __post_init__(self) -> None:
        for name in ("q_min", "q_max", "qd_max", "qdd_max"):
            object.__setattr__(self, name, seven(f"limits.{name}", getattr(self, name)))
        for joint in range(JOINTS):
            if self.q_min[joint] >= self.q_max[joint]:
                raise BadOption(
                    f"limits: joint {joint + 1} has no range: q_min {self.q_min[joint]:g} rad must be below q_max"
                    f" {self.q_max[joint]:g} rad"
                )
            if self.qd_max[joint] <= 0.0 or self.qdd_max[joint] <= 0.0:
                raise BadOption(f"limits: joint {joint + 1}: qd_max and qdd_max must be positive")


@dataclass(frozen=True, kw_only=True)
class SimOptions:
    """How the simulated controller behaves; the defaults are those of ``docs/kassow.md``.

    Attributes:
        clock: ``wall``: 250 Hz of real time. ``virtual``: time stands until `KordBridge.step`; exact and repeatable.
        preset: Which of two planner costs for ``joint-speed`` targets holds: ``narrative`` 8.4 ms each, at which 125 Hz
            overflows after 25 s; ``final`` 6.0 ms, at which it is stable.
        q_start: Joints at the start, shape (7,) [rad].
        q_min, q_max: The controller's own position limits, shape (7,) [rad]; beyond them is event 2005.
        qd_max_radps, qdd_max_radps2: The controller's own speed and acceleration limit of every joint.
        window_us: How long after a heartbeat a command still acts in the next tick [µs].
        fetch_closes_window: Whether `fetchData` ends that time.
        buffer_len: How many moves may wait to be planned; one more is event 3001.
        planner_time_ms, planner_speed_ms: What planning a ``time`` or ``joint-speed`` move costs [ms]; None for the
            `preset`'s.
        torque_deviation_rad: How far a direct command may be from the expected reference [rad]; beyond is event 1010.
        late_fault_ticks: Late commands in a row, in motion, that are event 1010.
        ack_ticks: How long a cleared alarm takes to take effect [ticks].
        watchdog_ticks: Ticks without a waitSync, in motion, that are event 3001.
        ceased_is_fault: Whether commands that cease in motion are event 3001: direct ones; and via-points that no other
            has followed for 16 ms while the arm still goes 1e-6 rad a tick (``on_movej_cmd_ceased_span`` of KORD.ini).
        speed_noise_radps: Greatest error of a measured joint speed, to either side [rad/s]: the speeds that the bridge
            reads, also of a joint that stands, and not those of `Simulator.trace`. The same in every run.
        noise_seed: Chooses another course of the same noise.
        opaque: Whether it tells no more than kord-api does, so that the bridge knows of no queue and no late command.
        queues_after_stop_point: Whether a via-point waits until a stop-point move that runs has ended, instead of
            replacing the rest of it.
        order: ``fetch-first`` lets the bridge make the mistake of reading before it sends; for demonstrations.
        resend_targets: Let the bridge send its target at every turn though it is unchanged; for demonstrations.
    """

    clock: Clock = "wall"
    preset: Preset = "final"
    q_start: Vector = (0.0,) * JOINTS
    q_min: Vector = (-2 * math.pi, -math.radians(70), -2 * math.pi, -math.radians(70), *(-2 * math.pi,) * 3)
    q_max: Vector = (2 * math.pi, math.pi, 2 * math.pi, math.pi, *(2 * math.pi,) * 3)
    qd_max_radps: float = math.radians(225)
    qdd_max_radps2: float = math.radians(10_000)
    window_us: int = 1500
    fetch_closes_window: bool = True
    buffer_len: int = 150
    planner_time_ms: float = 5.0
    planner_speed_ms: float | None = None
    torque_deviation_rad: float = 0.0006
    late_fault_ticks: int = 3
    ack_ticks: int = 4
    watchdog_ticks: int = 20
    ceased_is_fault: bool = False
    speed_noise_radps: float = 0.0
    noise_seed: int = 1
    opaque: bool = False
    queues_after_stop_point: bool = False
    order: Order = "send-first"
    resend_targets: bool = False

    def __post_init__(self) -> None:
        for name in ("q_start", "q_min", "q_max"):
            object.__setattr__(self, name, seven(f"sim.{name}", getattr(self, name)))
        for name, known in (
            ("clock", ("wall", "virtual")),
            ("preset", ("narrative", "final")),
            ("order", ("send-first", "fetch-first")),
        ):
            if getattr(self, name) not in known:
                raise BadOption(f"sim.{name}: {' or '.join(known)} is expected, not {getattr(self, name)!r}")
        if not (math.isfinite(self.speed_noise_radps) and self.speed_noise_radps >= 0.0 and self.noise_seed >= 0):
            raise BadOption(
                "sim.speed_noise_radps and sim.noise_seed: 0 or more is expected, not "
                f"{self.speed_noise_radps:g} and {self.noise_seed}"
            )

    @property
    def planner_speed_cost_ms(self) -> float:
        """What planning a ``joint-speed`` move costs [ms]."""
        if self.planner_speed_ms is not None:
            return self.planner_speed_ms
        return {"narrative": 8.4, "final": 6.0}[self.preset]
