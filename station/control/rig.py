"""A robot, a policy and its command format, put together from their registered names."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from station import assets, libraries, registry
from station.bus import codec, keys
from station.clock import SYSTEM, Clock
from station.command_formats import command_format
from station.control import envelope
from station.control.control import ControlStep
from station.control.envelope import Envelope
from station.control.gate import GateConfig
from station.control.policy_switch import BLEND_S, BlendS, PolicySwitch, needs_root_velocity
from station.errors import AssetMissing, BadFile, ConfigError, did_you_mean
from station.protocols import CommandFormat, Policy, PolicySpec, Robot, RobotState
from station.robot_kind import RobotKind


class PolicyChoice(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True):
    """A policy that may take over while the robot moves.

    Attributes:
        policy: Registered name of the policy family; "" for the name that it is asked for with.
        checkpoint: Its file, a path or ``collection:path``; "" for the robot's, else the family's default.
        policy_options: Further keyword arguments of the policy.
    """

    policy: str = ""
    checkpoint: str = ""
    policy_options: dict[str, Any] = {}


class RigConfig(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What drives what.

    Attributes:
        robot: Registered name of the robot; "" for the default one.
        robot_options: Its settings, for example ``model`` and ``physics_dt_s`` of a simulation.
        policy: Registered name of the policy family; "" for the robot's.
        checkpoint: Its file, a path or ``collection:path``; "" for the robot's, else the family's default.
        policy_options: Further keyword arguments of the policy, for example ``wrist_gains: real``.
        policies: Others that may take over while the robot moves, by the names that they are asked for with.
        blend_s: How long the targets of two policies are blended when one takes over [s].
        rate_hz: Rate of the policy [Hz]; 0 for the rate it was trained at.
        envelope: Which commands the policies get: ``auto`` for those within the envelope beside each one's checkpoint,
            all where there is none; a file, for one beside no checkpoint; ``none`` for all, at your own risk.
    """

    robot: str = ""
    robot_options: dict[str, Any] = {}
    policy: str = ""
    checkpoint: str = ""
    policy_options: dict[str, Any] = {}
    policies: dict[str, PolicyChoice] = {}
    blend_s: BlendS = BLEND_S
    rate_hz: float = 0.0
    envelope: str = "auto"

    @property
    def choices(self) -> dict[str, PolicyChoice]:
        """The policy that drives at the start, then those that may take over; each says its family.

        Raises:
            ConfigError: one is called like the first.
        """
        first = self.policy or self.kind.policy
        if first in self.policies:
            raise ConfigError(
                f"policies: {first!r} is the name of the policy that drives at the start; give the other one a name of "
                f"its own, and its family with `policy: {self.policies[first].policy or first}`"
            )
        found = {first: PolicyChoice(policy=first, checkpoint=self.checkpoint, policy_options=self.policy_options)}
        for name, choice in self.policies.items():
            found[name] = msgspec.structs.replace(choice, policy=choice.policy or name)
        return found

    @property
    def kind(self) -> RobotKind:
        """The robot's.

        Raises:
            UnknownName: it is not registered.
        """
        return robot_kind(self.robot)

    def headless(self) -> RigConfig:
        """Return the same without a window."""
        if "viewer" not in self.kind.options.__struct_fields__:
            return self
        return msgspec.structs.replace(self, robot_options=self.robot_options | {"viewer": False})


class Rig(msgspec.Struct, frozen=True):
    """What a `RigConfig` names, loaded; `period_s` is the control period [s], `envelopes` those of its policies."""

    kind: RobotKind
    robot: Robot
    policy: Policy
    command_format: CommandFormat
    period_s: float
    envelopes: tuple[Envelope, ...] = ()

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
            self.robot,
            self.policy,
            self.command_format,
            gate=gate,
            is_armed=is_armed,
            reset_after_s=reset_after_s,
            envelopes=self.envelopes,
            clock=clock,
        )

    def state_values(self, state: RobotState) -> dict[str, bytes]:
        """Return what is published at the start of a tick, by key: the state, what stock programs read, the truth."""
        name = self.command_format.robot
        values = {keys.robot_state(name): codec.f64(np.concatenate([state.q, state.dq, state.quat_wxyz, state.gyro]))}
        if state.root_lin_vel is not None and needs_root_velocity(self.policy):
            values[keys.root_velocity(name)] = codec.f64(state.root_lin_vel)
        if self.kind.values is not None:
            driving = self.policy.policy if isinstance(self.policy, PolicySwitch) else self.policy
            values |= self.kind.values(state, driving, name)
        # What `SelfChecking` and `HasGroundTruth` have; `isinstance` would take five times as long in each tick.
        if (measured := getattr(self.robot, "values", None)) is not None:
            values |= {keys.state(f"{stream}_{name}"): value for stream, value in measured().items()}
        if (qpos := getattr(self.robot, "qpos", None)) is not None:
            values[keys.sim_qpos(name)] = codec.f64(qpos)
        return values


def robot_kind(name: str) -> RobotKind:
    """Return a robot by its registered name, the default one for "".

    Raises:
        UnknownName: it is not registered.
        ConfigError: none is named, and none is the default.
    """
    names = [name] if name else [each for each in registry.names("robot") if registry.is_ours("robot", each)]
    for each in names:
        found: RobotKind = registry.find("robot", each)
        if name or found.is_default:
            return found
    raise ConfigError(f"robot: name one; there are {', '.join(registry.names('robot')) or 'none'}")


def checkpoint_of(policy: str, named: str = "", kind: RobotKind | None = None) -> str:
    """Return the checkpoint of a policy: the one that is named, else the robot's, else its own default; "" for none.

    Raises:
        UnknownName: it is not registered.
    """
    of_robot = kind.checkpoint if kind is not None and kind.policy == policy else ""
    return named or of_robot or str(getattr(registry.find("policy", policy), "CHECKPOINT", ""))


def expect(config: RigConfig) -> None:
    """Check, without loading anything, that what a configuration names is there, and its rate one that can be.

    Raises:
        UnknownName: a name that is not registered.
        ConfigError: an option that the robot does not know, no checkpoint, a rate that cannot be, or no envelope.
        AssetMissing, BadFile: the checkpoint, the robot's model or an envelope is not there.
        StationError: a library that the robot needs is not installed.
    """
    options = config.kind.typed(config.robot_options)
    libraries.expect(f"robot {config.kind.name}", config.kind.library, config.kind.extra)
    if config.rate_hz:
        _expect_rate(config.rate_hz)
    _envelopes(config.envelope, [_checkpoint(config, choice) for choice in config.choices.values()])
    if isinstance(model := getattr(options, "model", None), str) and model:
        assets.resolve(model)


def build(config: RigConfig, *, may_be_real: bool = False) -> Rig:
    """Load policy, command format and robot.

    Args:
        config: What drives what.
        may_be_real: Whether the robot may be a real one. Only its server drives one: a rehearsal or a replay goes
            through its steps as fast as it can, with no person beside it.

    Raises:
        UnknownName: a name that is not registered.
        ConfigError: an option that robot or policy do not know, no checkpoint, a rate that cannot be, or a real robot
            where none may be driven.
        AssetMissing, BadFile: a file that is not there or not usable.
    """
    kind = config.kind
    if not (kind.is_simulated or may_be_real):
        raise ConfigError(f"robot {kind.name!r} is a real one; only its server drives it: name a simulated one")
    options = kind.typed(config.robot_options)
    policies = {name: _policy(config, choice) for name, choice in config.choices.items()}
    policy = next(iter(policies.values()))
    envelopes = _envelopes(config.envelope, [each.spec.checkpoint for each in policies.values()])
    rate_hz = config.rate_hz or policy.spec.rate_hz
    _expect_rate(rate_hz)
    if len(policies) > 1:
        policy = PolicySwitch(policies, period_s=1.0 / rate_hz, blend_s=config.blend_s)
    followed = _command_format(kind, [each.spec for each in policies.values()])
    return Rig(kind, kind.make(options, 1.0 / rate_hz), policy, followed, 1.0 / rate_hz, envelopes)


def _envelopes(setting: str, checkpoints: Sequence[Path]) -> tuple[Envelope, ...]:
    """Return the envelopes of some policies, each once."""
    each = (envelope.found(setting, checkpoint) for checkpoint in dict.fromkeys(checkpoints))
    return tuple(dict.fromkeys(one for one in each if one is not None))


def _command_format(kind: RobotKind, specs: Sequence[PolicySpec]) -> CommandFormat:
    """Return the format of a robot's commands, within the range that all of its policies were trained on."""
    ranges = [
        None if not given else functools.reduce(narrower, given)
        for narrower, given in (
            (np.maximum, [spec.command_lower for spec in specs if spec.command_lower is not None]),
            (np.minimum, [spec.command_upper for spec in specs if spec.command_upper is not None]),
        )
    ]
    return command_format(specs[0].command, kind.robot_name, *ranges)


def _expect_rate(rate_hz: float) -> None:
    if not 1.0 <= rate_hz <= 1000.0:
        raise ConfigError(f"rate_hz {rate_hz:g}: expected 1 to 1000 Hz, or 0 for the policy's own")


def _checkpoint(config: RigConfig, choice: PolicyChoice) -> Path:
    reference = checkpoint_of(choice.policy, choice.checkpoint, config.kind)
    origin = str(getattr(registry.find("policy", choice.policy), "ORIGIN", ""))
    hint = f"; it is not part of the station: take it from {origin}" if origin else ""
    if not reference:
        raise ConfigError(f"policy {choice.policy!r} has no default checkpoint; name its file with `checkpoint`{hint}")
    try:
        return assets.resolve(reference)
    except (AssetMissing, BadFile) as error:
        raise type(error)(f"{error}{hint}") from None


def _policy(config: RigConfig, choice: PolicyChoice) -> Policy:
    checkpoint = _checkpoint(config, choice)
    make = registry.find("policy", choice.policy)
    known = [parameter for parameter in inspect.signature(make).parameters if parameter != "checkpoint"]
    for option in choice.policy_options:
        if option not in known:
            listed = ", ".join(known) or "none"
            raise ConfigError(
                f"policy_options: policy {choice.policy!r} has no option {option!r}{did_you_mean(option, known)}; "
                f"known: {listed}"
            )
    policy: Policy = make(checkpoint, **choice.policy_options)
    return policy
