"""A robot, a policy and its command format, put together from their registered names."""

from __future__ import annotations

import inspect
from typing import Any

import msgspec

from station import assets, registry
from station.clock import SYSTEM, Clock
from station.control.control import ControlStep
from station.control.gate import GateConfig
from station.errors import ConfigError, did_you_mean
from station.protocols import CommandFormat, Policy, Robot

DEFAULT_ROBOT_MODEL = "builtin:g1.xml"

DEFAULT_POLICY = "tracker"

DEFAULT_CHECKPOINTS = {"tracker": "builtin:tracker.onnx", "twist2": "twist2:ckpts/twist2_1017_20k.onnx"}
"""Checkpoint of a policy family when none is named."""


class RigConfig(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What drives what.

    Attributes:
        robot: Registered name of the robot.
        robot_model: Its model, a path or ``collection:path``.
        policy: Registered name of the policy family.
        checkpoint: Its file, a path or ``collection:path``; "" for the family's default.
        policy_options: Further keyword arguments of the policy, for example ``wrist_gains: real``.
        rate_hz: Rate of the policy [Hz]; 0 for the rate it was trained at.
        physics_dt_s: Physics step of a simulated robot [s].
        viewer: Whether a simulated robot opens a window.
    """

    robot: str = "g1-mujoco"
    robot_model: str = DEFAULT_ROBOT_MODEL
    policy: str = DEFAULT_POLICY
    checkpoint: str = ""
    policy_options: dict[str, Any] = {}
    rate_hz: float = 0.0
    physics_dt_s: float = 0.001
    viewer: bool = False


class Rig(msgspec.Struct, frozen=True):
    """What a `RigConfig` names, loaded; `period_s` is the control period [s]."""

    robot: Robot
    policy: Policy
    form: CommandFormat
    period_s: float

    def control(
        self,
        *,
        gate: GateConfig | None = None,
        is_armed: bool = True,
        reset_after_s: float | None = None,
        clock: Clock = SYSTEM,
    ) -> ControlStep:
        """Return the control step over this rig; its arguments are those of `ControlStep`."""
        return ControlStep(
            self.robot, self.policy, self.form, gate=gate, is_armed=is_armed, reset_after_s=reset_after_s, clock=clock
        )


def build(config: RigConfig) -> Rig:
    """Load policy, command format and robot.

    Raises:
        UnknownName: a name that is not registered.
        ConfigError: an option that the policy does not know, no checkpoint, or a rate that cannot be.
        AssetMissing, BadFile: a file that is not there or not usable.
    """
    policy = _policy(config)
    rate_hz = config.rate_hz or policy.spec.rate_hz
    if not 1.0 <= rate_hz <= 1000.0:
        raise ConfigError(f"rate_hz {config.rate_hz}: expected 1 to 1000 Hz, or 0 for the policy's own")
    form = registry.find("command", policy.spec.command)
    make_robot = registry.find("robot", config.robot)
    robot = make_robot(
        assets.resolve(config.robot_model),
        physics_dt_s=config.physics_dt_s,
        control_dt_s=1.0 / rate_hz,
        viewer=config.viewer,
    )
    return Rig(robot, policy, form, 1.0 / rate_hz)


def _policy(config: RigConfig) -> Policy:
    make = registry.find("policy", config.policy)
    reference = config.checkpoint or DEFAULT_CHECKPOINTS.get(config.policy, "")
    if not reference:
        raise ConfigError(f"policy {config.policy!r} has no default checkpoint; name its file with `checkpoint`")
    known = [name for name in inspect.signature(make).parameters if name != "checkpoint"]
    for name in config.policy_options:
        if name not in known:
            listed = ", ".join(known) or "none"
            raise ConfigError(
                f"policy_options: policy {config.policy!r} has no option {name!r}"
                f"{did_you_mean(name, known)}; known: {listed}"
            )
    policy: Policy = make(assets.resolve(reference), **config.policy_options)
    return policy
