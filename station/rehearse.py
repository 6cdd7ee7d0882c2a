"""Offline rehearsal: a motion through playback, gate, policy and robot, as fast as the machine allows.

It is the live station without its processes: the commands go through their JSON text, the gate runs on the time of
the ticks, and control is the very step that the low-level server runs. A lock-step station gives the same figures.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from functools import lru_cache

import msgspec

from station import registry, side_by_side
from station.contract import names_of
from station.control.control import ControlStep, Resettable, StepRecord
from station.control.envelope import Envelope
from station.control.gate import GateConfig
from station.control.parted_path import samples_of
from station.control.rig import Rig, RigConfig, build
from station.control.tracking import TrackingError, VelocityFound, VelocityTracking
from station.motion.playback import Frame, Playback
from station.protocols import CommandFormat, Motion, Policy, Robot


class Rehearsal(msgspec.Struct, frozen=True, kw_only=True):
    """How a motion went.

    Attributes:
        motion: What was rehearsed, as the user named it.
        fell: Whether the robot fell; the run ends there.
        fell_at_s: Motion time of the fall [s], or None.
        mean_joint_error_rad: As in `station.control.tracking`; None when it fell before the motion played.
        mean_root_height_error_m: Likewise [m].
        velocity: Likewise; None where no velocity of the base is commanded.
        seconds: Simulated time, blends included [s].
        speed_x_realtime: Simulated time over wall time, loading left out.
    """

    motion: str
    fell: bool
    fell_at_s: float | None
    mean_joint_error_rad: float | None
    mean_root_height_error_m: float | None
    velocity: VelocityFound | None
    seconds: float
    speed_x_realtime: float


OnStep = Callable[[Frame, StepRecord], None]


def rehearse(
    motion: Motion,
    policy: Policy,
    robot: Robot,
    command_format: CommandFormat,
    *,
    name: str = "",
    period_s: float = 0.02,
    lead_s: float = 0.02,
    gate: GateConfig | None = None,
    envelopes: Sequence[Envelope] = (),
    on_step: OnStep | None = None,
) -> Rehearsal:
    """Run a motion to its end, or to a fall.

    Args:
        motion: What the robot shall do.
        policy, robot: Fresh, or used before: both are reset.
        command_format: The policy's command format.
        name: What the result calls the motion; its own name when "".
        period_s: Control period, that of the robot's `write` [s].
        lead_s: How far ahead the motion is sampled [s]; as the motion server does by itself.
        gate: Times of the gate.
        envelopes: Of the policy.
        on_step: Sees every step.
    """
    policy.reset()
    if isinstance(robot, Resettable):
        robot.reset()
    control = ControlStep(robot, policy, command_format, gate=gate, envelopes=envelopes)
    playback = Playback(motion, command_format, lead_s=lead_s)
    error = TrackingError(names_of(command_format.elements), robot.joint_names)
    velocity = VelocityTracking(names_of(command_format.elements), period_s)
    started_s = time.perf_counter()
    tick, fell_at_s = 0, None
    while not playback.is_done and fell_at_s is None:
        # As the motion server in lock-step: its first command is due before time has passed.
        frame, record = _step(control, playback, tick * period_s, period_s if tick else 0.0)
        tick += 1
        if frame.phase == "playing" and record.decision.state == "tracking":
            root = record.state.root_pos
            error.add(record.state.q, record.decision.vector, None if root is None else float(root[2]))
            if root is not None:
                velocity.add(tick, tick * period_s, record.decision.vector, root, record.state.quat_wxyz)
        if record.fall is not None:
            fell_at_s = frame.time_s
        if on_step is not None:
            on_step(frame, record)
    return Rehearsal(
        motion=name or motion.name,
        fell=fell_at_s is not None,
        fell_at_s=fell_at_s,
        mean_joint_error_rad=error.mean_joint_error_rad,
        mean_root_height_error_m=error.mean_root_height_error_m,
        velocity=velocity.found(),
        seconds=tick * period_s,
        speed_x_realtime=tick * period_s / (time.perf_counter() - started_s),
    )


def rehearse_all(
    motions: Sequence[str],
    config: RigConfig,
    *,
    holes: str = "refuse",
    jobs: int = 0,
    on_done: Callable[[Rehearsal], None] | None = None,
) -> list[Rehearsal]:
    """Rehearse several motions, side by side in processes of their own.

    Args:
        motions: Paths or ``collection:path``.
        config: What drives what.
        holes: What is done with bad frames inside a motion: ``refuse`` or ``bridge``.
        jobs: Processes; 0 for one per core, 1 for this process alone.
        on_done: Called with each result as it comes, in any order.

    Returns:
        The results, in the order of `motions`.

    Raises:
        StationError: a motion, the policy or the robot model cannot be loaded; the first problem ends the rest.
    """
    tasks = [(motion, config, holes) for motion in motions]
    return side_by_side.run(_rehearse_task, tasks, jobs=jobs, on_done=on_done)


def rehearse_named(
    motion: str, config: RigConfig, *, holes: str = "refuse", on_step: OnStep | None = None
) -> Rehearsal:
    """Rehearse a motion by its name: arguments and errors as of `rehearse_all`, `on_step` as of `rehearse`."""
    clip = registry.find("loader", "motion")(motion, holes=holes)
    rig = _rig(msgspec.json.encode(config))
    return rehearse(
        clip, rig.policy, rig.robot, rig.command_format, name=motion, period_s=rig.period_s, envelopes=rig.envelopes,
        on_step=on_step,
    )  # fmt: skip


def _step(control: ControlStep, playback: Playback, now_s: float, dt_s: float) -> tuple[Frame, StepRecord]:
    state = control.sense()
    frame = playback.step(dt_s)
    return frame, control.step(state, samples_of(control.commanded.command_format, frame.command, now_s), now_s)


def _rehearse_task(task: tuple[str, RigConfig, str]) -> Rehearsal:
    motion, config, holes = task
    return rehearse_named(motion, config, holes=holes)


@lru_cache(maxsize=1)
def _rig(config: bytes) -> Rig:
    """Load once per process; both ends of a rig are reset before each run."""
    return build(msgspec.json.decode(config, type=RigConfig))
