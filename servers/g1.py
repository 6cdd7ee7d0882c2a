"""The low-level server of a Unitree G1: reads commands from the bus, runs the policy, moves the robot.

`pace: wall` runs at a fixed rate. `pace: command` runs in lock-step with the commander: after each state it waits for
a newer command, and the gate's clock is that of the ticks, so a run is the same on a fast and on a slow machine.
"""

from __future__ import annotations

from typing import Any, Literal

import msgspec

from adapters.robots.g1 import description, wire
from station import registry
from station.config import to_plain
from station.control.gate import GateConfig
from station.control.low_level import LowLevelLoop, result_values
from station.control.rig import DEFAULT_POLICY, DEFAULT_ROBOT_MODEL, Rig, RigConfig, build
from station.life.loop import Rate, real_time
from station.life.server import Life, ServerKind
from station.software import software

_RESET_AFTER_S = 1.0  # so that a fall can be seen, and stands in the episode


class G1Config(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Configuration of the G1 server.

    Attributes:
        backend: ``mujoco``; others as they are registered (robot ``g1-<backend>``).
        robot_model: Model of a simulated robot, a path or ``collection:path``.
        policy: Registered name of the policy family.
        checkpoint: Its file; "" for the family's default.
        policy_options: Further arguments of the policy, for example ``wrist_gains: real``.
        rate_hz: Rate of the loop [Hz].
        physics_dt_s: Physics step of a simulation [s].
        pace: ``wall`` or ``command`` (lock-step).
        command_timeout_s: Longest wait for the next command in lock-step [s]; then ticks go on at `rate_hz`.
        gate: Times of the gate, how fast a command may move, and whom to obey when two write it.
        start_armed: Whether targets go to the robot from the start; None: only in simulation. Otherwise `station arm`.
        viewer: Whether a simulation opens a window.
        on_fall: ``continue``, or ``reset``: a simulated robot is put back on its feet after a second.
        real_time_priority: SCHED_FIFO priority that is asked for with `pace: wall`; 0 does not ask.
    """

    backend: str = "mujoco"
    robot_model: str = DEFAULT_ROBOT_MODEL
    policy: str = DEFAULT_POLICY
    checkpoint: str = ""
    policy_options: dict[str, Any] = {}
    rate_hz: float = 50.0
    physics_dt_s: float = 0.001
    pace: Literal["wall", "command"] = "wall"
    command_timeout_s: float = 1.0
    gate: GateConfig = GateConfig()
    start_armed: bool | None = None
    viewer: bool = False
    on_fall: Literal["continue", "reset"] = "continue"
    real_time_priority: int = 50

    def __post_init__(self) -> None:
        registry.expect("policy", self.policy)
        registry.expect("robot", f"g1-{self.backend}")

    @property
    def rig(self) -> RigConfig:
        """What drives what."""
        return RigConfig(
            robot=f"g1-{self.backend}", robot_model=self.robot_model, policy=self.policy, checkpoint=self.checkpoint,
            policy_options=self.policy_options, rate_hz=self.rate_hz, physics_dt_s=self.physics_dt_s,
            viewer=self.viewer,
        )  # fmt: skip

    @property
    def is_armed(self) -> bool:
        """Whether targets go to the robot from the start."""
        return self.backend == "mujoco" if self.start_armed is None else self.start_armed


def main(config: G1Config, life: Life) -> int:
    """Run until asked to stop."""
    rig = build(config.rig)
    robot, policy, suffix = rig.robot, rig.policy, rig.form.robot
    try:
        reset_after_s = _RESET_AFTER_S if config.on_fall == "reset" else None
        control = rig.control(gate=config.gate, is_armed=config.is_armed, reset_after_s=reset_after_s,
                              clock=life.clock)  # fmt: skip
        with LowLevelLoop(
            life,
            control,
            state_values=lambda state: wire.state_values(suffix, state, policy=policy, robot=robot),
            result_values=lambda record, answer: result_values(suffix, record, control.commanded, answer),
            period_s=rig.period_s,
        ) as loop:
            life.configured(_facts(config, life.name, rig))
            if not life.ready():
                return 0
            _warn_of_rate(life, rig)
            if config.pace == "command":
                loop.run_in_lock_step(config.command_timeout_s)
            else:
                if config.real_time_priority:
                    life.report(scheduling=real_time(config.real_time_priority))
                loop.run_at(Rate(1.0 / rig.period_s, life.clock))
    finally:
        robot.close()
    return 0


def _warn_of_rate(life: Life, rig: Rig) -> None:
    """Say when the policy runs at another rate than in training: TWIST2 at 100 Hz falls in two of ten walks."""
    rate_hz, trained_hz = 1.0 / rig.period_s, rig.policy.spec.rate_hz
    if abs(rate_hz - trained_hz) > 0.01 * trained_hz:
        life.event("rate-differs", severity="warning", rate_hz=rate_hz, trained_hz=trained_hz)


def _facts(config: G1Config, name: str, rig: Rig) -> dict[str, Any]:
    """What a recording must know of this server."""
    spec = rig.policy.spec
    code = software()
    return {
        "server": name,
        "role": KIND.role,
        "robot": rig.form.robot,
        "description": to_plain(description.of_server(rig.form)),
        "robot_facts": rig.robot.facts(),
        "policy": {
            "name": spec.name,
            "checkpoint": str(spec.checkpoint),
            "sha256": spec.sha256,
            "runtime": spec.runtime,
            "rate_hz": spec.rate_hz,
            "command": spec.command,
            "options": config.policy_options,
            "kp": spec.kp.tolist(),
            "kd": spec.kd.tolist(),
            "default_q": spec.default_q.tolist(),
            "joint_names": list(spec.joint_names),
        },
        "rates": {"control_hz": 1.0 / rig.period_s, "pace": config.pace, "physics_dt_s": config.physics_dt_s},
        "gate": to_plain(config.gate),
        "software": {"version": code.version, "revision": code.revision, "dirty": code.dirty},
        "config": to_plain(config),
    }


KIND = ServerKind(
    name="g1",
    role="low-level",
    summary="Unitree G1, simulated: commands through the gate and the policy to the joints",
    config=G1Config,
    main=main,
)
