"""The low-level server of a robot that a policy moves, whatever robot: commands through gate and policy to its joints.

`pace: wall` runs at a fixed rate. `pace: command` runs in lock-step with the commander: after each state it waits for
a newer command, and the gate's clock is that of the ticks, so a run is the same on a fast and on a slow machine.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Annotated, Any, Generic, Literal, TypeVar

import msgspec

from station import registry
from station.bus import keys
from station.config import to_plain
from station.control import rig as rigs
from station.control.control import ControlStep
from station.control.envelope import stated
from station.control.gate import GateConfig
from station.control.low_level import LowLevelLoop, result_values
from station.control.policy_switch import BLEND_S, BlendS, PolicySwitch
from station.control.rig import PolicyChoice, Rig, RigConfig, build
from station.errors import ConfigError, Refused, StationError
from station.life.controller_request import ControllerAnswer, ControllerRequest
from station.life.loop import Rate, real_time
from station.life.policy_request import PolicyAnswer, PolicyRequest
from station.life.request import OVERTAKEN, Asked, DoneRequests, parse
from station.life.server import Life
from station.parts import PartedCommand
from station.protocols import ForAnyRobot, PolicySpec
from station.software import software

AnswerT = TypeVar("AnswerT")
RequestT = TypeVar("RequestT", PolicyRequest, ControllerRequest)

_RESET_AFTER_S = 1.0  # so that a fall can be seen, and stands in the episode


class PolicyServerConfig(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of every server whose robot a policy moves.

    Attributes:
        policy: Registered name of the policy family; "" for the robot's.
        checkpoint: Its file; "" for the family's default.
        policy_options: Further arguments of the policy, for example ``wrist_gains: real``.
        policies: Others that may take over while the robot moves, by the names that `station policy switch` takes; each
            with ``policy``, ``checkpoint`` and ``policy_options`` of its own.
        blend_s: How long the targets of two policies are blended when one takes over [s].
        rate_hz: Rate of the loop [Hz]; 0 for the one that the policy was trained at.
        envelope: ``auto``: commands beyond the envelope beside a policy's checkpoint are kept from it, and that is
            told; ``none``: nothing is; or a file in place of that.
        pace: ``wall`` or ``command`` (lock-step).
        command_timeout_s: Longest wait for the next command in lock-step [s]; then ticks go on at `rate_hz`.
        gate: Times of the gate, how fast a command may move, and which writer to obey when two write it.
        start_armed: Whether targets go to the robot from the start; None: only in simulation. Otherwise `station arm`.
        on_fall: ``continue``, or ``reset``: a simulated robot is put back on its feet after a second.
        real_time_priority: SCHED_FIFO priority that is asked for with `pace: wall`; 0 does not ask.
    """

    policy: Annotated[str, registry.named("policy")] = ""
    checkpoint: str = ""
    policy_options: dict[str, Any] = {}
    policies: dict[str, PolicyChoice] = {}
    blend_s: BlendS = BLEND_S
    rate_hz: float = 0.0
    envelope: str = "auto"
    pace: Literal["wall", "command"] = "wall"
    command_timeout_s: float = 1.0
    gate: GateConfig = GateConfig()
    start_armed: bool | None = None
    on_fall: Literal["continue", "reset"] = "continue"
    real_time_priority: int = 50

    def rig_of(self, robot: str, options: dict[str, Any]) -> RigConfig:
        """Return what drives what, for a robot by its registered name, with its settings."""
        return RigConfig(
            robot=robot, robot_options=options, policy=self.policy, checkpoint=self.checkpoint,
            policy_options=self.policy_options, policies=self.policies, blend_s=self.blend_s, rate_hz=self.rate_hz,
            envelope=self.envelope,
        )  # fmt: skip

    def expect_policies(self) -> None:
        """Check that each policy family that is named is registered.

        Raises:
            UnknownName: one is not.
        """
        named = [choice.policy or name for name, choice in self.policies.items()]
        for family in [self.policy, *named] if self.policy else named:
            registry.expect("policy", family)

    @property
    def rig(self) -> RigConfig:
        """What drives what."""
        raise NotImplementedError

    @property
    def is_armed(self) -> bool:
        """Whether targets go to the robot from the start."""
        return self.rig.kind.is_simulated if self.start_armed is None else self.start_armed


class RobotConfig(PolicyServerConfig, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Configuration of the server of any robot that a policy moves; the rest is as in `PolicyServerConfig`.

    Attributes:
        robot: Registered name of the robot.
        robot_options: Its settings.
    """

    robot: Annotated[str, registry.named("robot")]
    robot_options: dict[str, Any] = {}

    def __post_init__(self) -> None:
        registry.expect("robot", self.robot)
        self.expect_policies()
        try:
            self.rig.kind.typed(self.robot_options)
        except ConfigError as error:
            raise ValueError(str(error)) from None

    @property
    def rig(self) -> RigConfig:
        """What drives what."""
        return self.rig_of(self.robot, self.robot_options)

    @property
    def option_types(self) -> dict[str, type[msgspec.Struct]]:
        """Types of the settings that are mappings, by name."""
        return {"robot_options": self.rig.kind.options}


def expect(config: PolicyServerConfig) -> None:
    """Check that what a configuration names is on this machine (`station.control.rig.expect`)."""
    rigs.expect(config.rig)


def serve(config: PolicyServerConfig, life: Life) -> int:
    """Run a robot until the server is asked to stop; return the exit code.

    Args:
        config: The server's; what it states of itself holds it in plain values.
        life: The server's.
    """
    rig = build(config.rig, may_be_real=True)
    suffix = rig.command_format.robot
    try:
        if config.pace == "command" and isinstance(rig.command_format, PartedCommand):
            raise ConfigError(
                f"pace: command waits for one command; the parts of {suffix} are commanded apart, so run it by wall"
            )
        reset_after_s = _RESET_AFTER_S if config.on_fall == "reset" else None
        control = rig.control(gate=config.gate, is_armed=config.is_armed, reset_after_s=reset_after_s,
                              clock=life.clock)  # fmt: skip
        releases = ReleaseRequests(control, suffix)
        requests = PolicyRequests(control, suffix, lambda: life.configured(facts(config, life.name, rig)))
        with LowLevelLoop(
            life,
            control,
            state_values=rig.state_values,
            result_values=lambda record, answer: result_values(
                suffix, record, control.commanded, answer, requests.poll(), releases.poll()
            ),
            period_s=rig.period_s,
            requests={keys.POLICY: requests.on_request, keys.CONTROLLER: releases.on_request},
            acts_first=control.checks is not None,
        ) as loop:
            life.configured(facts(config, life.name, rig))
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
        rig.robot.close()
    return 0


class RobotRequests(ABC, Generic[RequestT, AnswerT]):
    """Requests to one robot whose answer takes several control periods: each is done once, however often it is written.

    Args:
        control: The step of the robot.
        robot: Suffix of its keys; requests to other robots are none of ours.
        kind: Type of the requests.
        what: What they are, for errors: ``a request for a policy``.
    """

    def __init__(self, control: ControlStep, robot: str, kind: type[RequestT], what: str) -> None:
        self._control, self._robot, self._what = control, robot, what
        self._kind: type[RequestT] = kind
        self._note = control.commanded.add_event
        self._under_way: RequestT | None = None
        self._answer: AnswerT | None = None
        self._done = DoneRequests[AnswerT]()

    def on_request(self, asked: Asked) -> None:
        """Begin what came on the key of requests."""
        try:
            request = parse(asked.data, self._kind, self._what)
        except Refused as error:
            self._note("request-refused", "warning", reason=str(error))
            return
        if request.robot != self._robot or (self._under_way is not None and request.id == self._under_way.id != ""):
            return
        if (known := self._done.get(request.id)) is not None:  # its asker has not seen the answer yet
            self._answer = known
            return
        refused = OVERTAKEN if self._done.begin(asked.first_ns(request.late_s)) else self._begin(request)
        if refused:
            self._on_refused(request, refused)
            self._reply(request, refused)
        else:
            self._under_way = request

    def poll(self) -> AnswerT | None:
        """Answer what is done by now; return the newest answer."""
        if self._under_way is not None and (outcome := self._outcome()) is not None:
            request, self._under_way = self._under_way, None
            self._reply(request, outcome)
        return self._answer

    @abstractmethod
    def _begin(self, request: RequestT) -> str:
        """Begin to do it; return why not, or ""."""

    @abstractmethod
    def _outcome(self) -> str | None:
        """Return why the one under way came to nothing, or ""; None while it goes on."""

    @abstractmethod
    def _on_refused(self, request: RequestT, reason: str) -> None:
        """Publish that a request was refused."""

    @abstractmethod
    def _answer_of(self, request: RequestT, refused: str) -> AnswerT:
        """Return the answer to a request."""

    def _reply(self, request: RequestT, refused: str) -> None:
        self._answer = self._answer_of(request, refused)
        self._done.put(request.id, self._answer)


class PolicyRequests(RobotRequests[PolicyRequest, PolicyAnswer]):
    """Has another policy drive the robot when that is asked for.

    Args:
        control, robot: As in `RobotRequests`.
        on_switched: Called when another policy drives, to state that.
    """

    def __init__(self, control: ControlStep, robot: str, on_switched: Callable[[], None]) -> None:
        super().__init__(control, robot, PolicyRequest, "a request for a policy")
        self._policies, self._on_switched = control.policies, on_switched
        self._driving = self._policies.driving if self._policies is not None else ""

    def poll(self) -> PolicyAnswer | None:
        """Answer what is done by now; return the newest answer."""
        if self._policies is not None and self._driving != self._policies.driving:
            self._driving = self._policies.driving
            self._on_switched()
        return super().poll()

    def _begin(self, request: PolicyRequest) -> str:
        if self._policies is None:
            return "this robot's server has one policy alone; name others in its settings, `policies`"
        try:
            self._policies.switch(request.policy, request.who)
        except StationError as error:
            return str(error)
        return ""

    def _outcome(self) -> str | None:
        return None if self._policies is None or self._policies.is_switching else self._policies.refusal

    def _on_refused(self, request: PolicyRequest, reason: str) -> None:
        self._note("policy-switch-refused", "warning", policy=request.policy, reason=reason, who=request.who)

    def _answer_of(self, request: PolicyRequest, refused: str) -> PolicyAnswer:
        return PolicyAnswer(id=request.id, policy=request.policy, refused=refused)


class ReleaseRequests(RobotRequests[ControllerRequest, ControllerAnswer]):
    """Has a controller of the robot's own let go of the motors when that is asked for.

    Args:
        control, robot: As in `RobotRequests`.
    """

    def __init__(self, control: ControlStep, robot: str) -> None:
        super().__init__(control, robot, ControllerRequest, "a request to a controller")

    def _begin(self, request: ControllerRequest) -> str:
        checks = self._control.checks
        if request.action != "release" or checks is None:
            return "this robot has no controller of its own that could do that"
        if self._control.arming.state != "disarmed":
            return "it is armed; disarm it first"
        self._note("controller-release", "warning", who=request.who)
        checks.release()
        return ""

    def _outcome(self) -> str | None:
        if self._control.checks is None:
            return None
        is_releasing, refused = self._control.checks.releasing()
        return None if is_releasing else refused

    def _on_refused(self, request: ControllerRequest, reason: str) -> None:
        self._note("controller-refused", "warning", reason=reason, who=request.who)

    def _answer_of(self, request: ControllerRequest, refused: str) -> ControllerAnswer:
        return ControllerAnswer(id=request.id, action=request.action, refused=refused)


def _warn_of_rate(life: Life, rig: Rig) -> None:
    """Say when the policy runs at another rate than in training: TWIST2 at 100 Hz falls in two of ten walks."""
    rate_hz, trained_hz = 1.0 / rig.period_s, rig.policy.spec.rate_hz
    if abs(rate_hz - trained_hz) > 0.01 * trained_hz:
        life.event("rate-differs", severity="warning", rate_hz=rate_hz, trained_hz=trained_hz)


def facts(config: PolicyServerConfig, name: str, rig: Rig) -> dict[str, Any]:
    """What a recording must know of this server."""
    code = software()
    robot_facts = rig.robot.facts()
    physics = {"physics_dt_s": robot_facts["physics_dt_s"]} if "physics_dt_s" in robot_facts else {}
    specs = rig.policy.specs if isinstance(rig.policy, PolicySwitch) else {"": rig.policy.spec}
    policies = {
        called: _policy_facts(spec, choice.policy_options)
        for (called, spec), choice in zip(specs.items(), config.rig.choices.values(), strict=True)
    }
    driving = rig.policy.driving if isinstance(rig.policy, PolicySwitch) else ""
    return {
        "server": name,
        "role": "low-level",
        "robot": rig.command_format.robot,
        **(
            {"parts": [part.robot for part in rig.command_format.parts]}
            if isinstance(rig.command_format, PartedCommand)
            else {}
        ),
        "description": to_plain(rig.kind.describe(rig.command_format)),
        "robot_facts": robot_facts,
        **(
            {"command_range": {"lower": rig.command_format.lower.tolist(), "upper": rig.command_format.upper.tolist()}}
            if isinstance(rig.command_format, ForAnyRobot)
            else {}
        ),
        "policy": policies[driving] | ({"called": driving} if driving else {}),
        **({"policies": policies} if driving else {}),
        "rates": {"control_hz": 1.0 / rig.period_s, "pace": config.pace, **physics},
        "gate": to_plain(config.gate),
        "envelopes": [stated(envelope) for envelope in rig.envelopes],
        "software": {"version": code.version, "revision": code.revision, "dirty": code.dirty},
        "config": to_plain(config),
    }


def _policy_facts(spec: PolicySpec, options: dict[str, Any]) -> dict[str, Any]:
    return {
        "name": spec.name,
        "checkpoint": str(spec.checkpoint),
        "sha256": spec.sha256,
        "runtime": spec.runtime,
        "rate_hz": spec.rate_hz,
        "command": spec.command,
        **({"part": spec.part} if spec.part else {}),
        "options": options,
        "kp": spec.kp.tolist(),
        "kd": spec.kd.tolist(),
        "default_q": spec.default_q.tolist(),
        "joint_names": list(spec.joint_names),
    }
