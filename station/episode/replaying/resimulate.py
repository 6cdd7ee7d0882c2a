"""Replaying an episode to a simulation: recorded commands, fresh robot, fresh policy, fresh gate, step by step.

A lock-step episode comes out the same to the last bit with the same versions. So does, as a rule, one recorded by the
wall clock: the instants of the gate are found again from the ages it reported, to the rounding of a difference.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import msgspec
import numpy as np

from station import registry
from station.bus import codec, keys
from station.control.command_validator import CommandSample
from station.control.control import ControlStep, StepRecord
from station.control.gate import GateConfig
from station.control.policy_switch import PolicySwitch
from station.control.rig import Rig, RigConfig, build
from station.episode.reading.reader import EpisodeReader, Message
from station.episode.reading.steps import Step, StepJoiner, timing_row
from station.episode.replaying.gate_audit import stated_envelopes
from station.episode.replaying.recorded_policy import recorded_policies
from station.episode.storage import layout
from station.errors import EpisodeError, Refused, UnknownName
from station.life.server import ServerKind

_REMEMBERED = 1000  # commands; a step uses the newest or, after refusals, one not much older
_ENDS = ("robot-reset", "operator-reset", "estop")  # what an operator or the server did to the robot is no command
_TICK, _SEQ, _WRITTEN, _ARRIVED, _READ = range(5)  # of `keys.policy_timing`


class Resimulation(msgspec.Struct, kw_only=True):
    """How the new run compares with the recorded one.

    Attributes:
        episode_id, robot: What was replayed.
        lock_step: Whether it was recorded in lock-step; only then equality is promised.
        warm_up_steps: Steps that were run without commands because the recording begins after them.
        steps: Steps that were compared.
        without_state: Steps that were run and not compared: the state that they answered to is not in the file. In
            lock-step that is the first one, where its robot had waited for longer than the recording's pre-roll.
        different: Steps whose measured joint positions differ in any bit.
        first_different: Number of the first of them, from 0 in the file; None when none does.
        max_q_difference_rad: Greatest difference of a joint position.
        max_root_difference_m: Greatest difference of the root's position; None without ground truth in the file.
        gates_different: Steps in which the gate was in another state.
        fell, recorded_falls: Whether the new run had a fall, and how many the recorded one reported.
        ended_by: Event at which the comparison ended, because it is no command; "" for the end of the file.
        notes: What is not as it was recorded: versions, model, configuration.
        seconds: Time that it took [s].
        speed_x_realtime: Simulated time over that.
    """

    episode_id: str
    robot: str
    lock_step: bool
    warm_up_steps: int = 0
    steps: int = 0
    without_state: int = 0
    different: int = 0
    first_different: int | None = None
    max_q_difference_rad: float = 0.0
    max_root_difference_m: float | None = None
    gates_different: int = 0
    fell: bool = False
    recorded_falls: int = 0
    ended_by: str = ""
    notes: list[str] = []
    seconds: float = 0.0
    speed_x_realtime: float = 0.0


def to_sim(
    reader: EpisodeReader, *, changes: Mapping[str, Any] | None = None, robot: str | None = None
) -> Resimulation:
    """Run the recorded commands through a fresh simulation of the recorded configuration, and compare.

    Args:
        reader: The episode.
        changes: Fields of `station.control.rig.RigConfig`, or settings of the robot, that shall not be as recorded,
            for a what-if.
        robot: Suffix of the robot; needed only when the episode has several.

    Raises:
        EpisodeError: no policy steps, no stated configuration, or another checkpoint than the recorded one.
        StationError: policy or robot model cannot be loaded.
    """
    suspects = recorded_policies(reader, robot)
    suffix = next(iter(suspects.values())).robot
    facts = facts_of(reader, suffix)
    config = configuration(reader, facts)
    recorded = config.rig.headless()
    fields = {name: value for name, value in (changes or {}).items() if name in RigConfig.__struct_fields__}
    options = {name: value for name, value in (changes or {}).items() if name not in fields}
    changed = {"envelope": "none"} | fields | {"robot_options": recorded.robot_options | options}
    rig = build(msgspec.structs.replace(recorded, **changed))
    if "envelope" not in fields:  # that of then, wherever its file is now
        rig = msgspec.structs.replace(rig, envelopes=stated_envelopes(facts))
    try:
        if "policy" not in (changes or {}) and "checkpoint" not in (changes or {}):
            _same_checkpoints(reader, {name: each.sha256 for name, each in suspects.items()}, rig)
        report = Resimulation(
            episode_id=reader.episode_id,
            robot=suffix,
            lock_step=facts.get("rates", {}).get("pace") == "command",
            notes=[
                *_other_than_recorded(facts, rig),
                *(f"{name}: changed to {v}" for name, v in (changes or {}).items()),
            ],
        )
        _compare(reader, rig.control(gate=config.gate, is_armed=config.is_armed), rig, report)
    finally:
        rig.robot.close()
    return report


def _same_checkpoints(reader: EpisodeReader, recorded: Mapping[str, str], rig: Rig) -> None:
    specs = rig.policy.specs if isinstance(rig.policy, PolicySwitch) else {"": rig.policy.spec}
    for name, spec in specs.items():
        sha256 = recorded.get(name)
        if sha256 and spec.sha256 != sha256:
            raise EpisodeError(
                f"episode {reader.episode_id}: ran checkpoint sha256 {sha256[:12]}…, {spec.checkpoint} is "
                f"{spec.sha256[:12]}…; put the file that ran in its place, or change the checkpoint on purpose"
            )


def _other_than_recorded(facts: Mapping[str, Any], rig: Rig) -> Iterator[str]:
    recorded = {**facts.get("robot_facts", {}), "runtime": facts.get("policy", {}).get("runtime")}
    present = {**rig.robot.facts(), "runtime": rig.policy.spec.runtime}
    for name in ("mujoco", "model_sha256", "mass_kg", "physics_dt_s", "control_dt_s", "runtime"):
        if recorded.get(name) is not None and recorded[name] != present.get(name):
            yield f"{name}: recorded {recorded[name]}, here {present.get(name)}"


def _compare(reader: EpisodeReader, control: ControlStep, rig: Rig, report: Resimulation) -> None:
    run = _Run(control, rig.period_s, report)
    joiner = StepJoiner(report.robot, results=(keys.policy_timing, keys.command_gate))
    if len(control.commanded.paths) > 1:
        raise EpisodeError(
            f"episode {reader.episode_id}: the parts of {report.robot} were commanded apart, and are not simulated "
            "again; `station audit` derives what its policy did"
        )
    key = control.commanded.command_format.key
    began = time.perf_counter()
    for message in reader.messages(joiner.topics | {key, keys.EVENT}):
        if message.topic == key:
            run.on_command(message)
        elif message.topic == keys.EVENT and run.ends_with(message):
            break
        step = joiner.feed(message)
        if step is not None:
            run.on_step(step)
    for step in joiner.finish():
        run.on_step(step)
    report.seconds = time.perf_counter() - began
    report.speed_x_realtime = (run.count + report.warm_up_steps) * rig.period_s / max(report.seconds, 1e-9)


@dataclass
class _Run:
    """The new run, one recorded step at a time."""

    control: ControlStep
    period_s: float
    report: Resimulation
    _commands: dict[int, bytes] = field(default_factory=dict)
    _foreign: bytes | None = None
    _sample: CommandSample | None = None
    count: int = 0

    def on_command(self, message: Message) -> None:
        """Add a recorded command."""
        if not message.channel.is_native:
            self._foreign = message.data
            return
        self._commands[message.sequence] = message.data
        if len(self._commands) > _REMEMBERED:
            del self._commands[next(iter(self._commands))]

    def ends_with(self, message: Message) -> bool:
        """Whether an event is one that no command explains; counts the recorded falls."""
        name = codec.parse_facts(message.data).get("name")
        self.report.recorded_falls += name == "fall"
        if name in _ENDS:
            self.report.ended_by = str(name)
        return name in _ENDS

    def on_step(self, step: Step) -> None:
        """Run one step on what the recorded one was given, and compare the states before it."""
        timing = timing_row(step.values.get(keys.policy_timing(self.report.robot)))
        if timing is None:
            return
        gate = codec.parse_facts(step.values.get(keys.command_gate(self.report.robot)))
        self._switch(gate, is_at_once=self.count == 0)
        if self.count == 0:
            self._warm_up(timing[_TICK] - 1)
        now_s = self._now_s(timing, gate)
        state = self.control.sense()
        record = self.control.step(state, self._heard(timing, now_s), now_s)
        self._compare(step, record)
        self.count += 1

    def _switch(self, gate: Mapping[str, Any], *, is_at_once: bool) -> None:
        """Hand over as the recorded step began to, or as had been done where the file begins."""
        policies, wanted = self.control.policies, gate.get("next_policy") or gate.get("policy")
        if policies is None or wanted not in policies.names or wanted in (policies.next, policies.driving):
            return
        with contextlib.suppress(Refused):  # the new run differs by then, which is what is compared
            policies.switch(wanted)
        if is_at_once:
            policies.reset()

    def _now_s(self, timing: list[int], gate: Mapping[str, Any]) -> float:
        """Return the time that the gate was given [s]: the tick's, or from the command age that it reported."""
        if self.report.lock_step:
            return (timing[_TICK] - 1) * self.period_s
        age_s = gate.get("age_s")
        if timing[_ARRIVED] and isinstance(age_s, (int, float)):
            return timing[_ARRIVED] * 1e-9 + age_s
        return timing[_READ] * 1e-9

    def _warm_up(self, steps: int) -> None:
        for tick in range(steps):
            self.control.step(self.control.sense(), None, tick * self.period_s if self.report.lock_step else 0.0)
        self.report.warm_up_steps = steps

    def _heard(self, timing: list[int], now_s: float) -> CommandSample | None:
        """Return the command that the recorded step used: the same object as before when it was the same."""
        seq, arrived_ns = timing[_SEQ], timing[_ARRIVED]
        value = self._commands.get(seq) if seq else self._foreign
        if value is None or (not seq and not arrived_ns):
            return self._sample
        before = self._sample
        if before is None or (before.seq, before.arrived_ns, before.value) != (seq, arrived_ns, value):
            arrived_s = now_s if self.report.lock_step else arrived_ns * 1e-9
            written_ns = timing[_WRITTEN]
            is_known = written_ns > 0 and not self.report.lock_step
            self._sample = CommandSample(
                value,
                arrived_s if arrived_ns else None,
                delay_s=(arrived_ns - written_ns) * 1e-9 if is_known else None,
                written_ns=written_ns,
                arrived_ns=arrived_ns,
                seq=seq,
            )
        return self._sample

    def _compare(self, step: Step, record: StepRecord) -> None:
        report, robot = self.report, self.report.robot
        report.fell = report.fell or record.fall is not None
        gate = codec.parse_facts(step.values.get(keys.command_gate(robot)))
        report.gates_different += gate.get("state") != record.decision.state
        recorded = step.values.get(keys.robot_state(robot))
        if recorded is None:
            report.without_state += 1
            return
        q = codec.parse_f64(recorded)[: len(record.state.q)]
        report.steps += 1
        if q.tobytes() != record.state.q.tobytes():
            report.different += 1
            report.first_different = self.count if report.first_different is None else report.first_different
            report.max_q_difference_rad = max(report.max_q_difference_rad, float(np.abs(q - record.state.q).max()))
        truth = step.values.get(keys.sim_qpos(robot))
        if truth is not None and record.state.root_pos is not None:
            gap = float(np.abs(codec.parse_f64(truth)[:3] - record.state.root_pos).max())
            report.max_root_difference_m = max(report.max_root_difference_m or 0.0, gap)


class LowLevelConfig(msgspec.Struct):
    """What a replay needs of the configuration of a low-level server."""

    rig: RigConfig
    gate: GateConfig
    is_armed: bool


def facts_of(reader: EpisodeReader, robot: str) -> dict[str, Any]:
    """Return what the low-level server of a robot has stated.

    Raises:
        EpisodeError: none has.
    """
    for facts in reader.manifest.servers.values():
        if facts.get("role") == "low-level" and facts.get("robot") == robot:
            return facts
    raise EpisodeError(
        f"episode {reader.episode_id}: no low-level server has stated its configuration for {robot!r}, "
        "so the simulation cannot be set up as it was"
    )


def configuration(reader: EpisodeReader, facts: Mapping[str, Any]) -> LowLevelConfig:
    """Read the configuration that a server stated as the type of its kind.

    Raises:
        EpisodeError: its kind is not installed here, or is an arm's, or has another configuration by now.
    """
    # Servers told their name alone, once: that of their kind, unless they were given another with --name.
    name, is_told = str(facts.get("kind", facts.get("server"))), "kind" in facts
    hint = "" if is_told else f"; if that name was given with --name, write `kind: KIND` into {_place(reader, facts)}"
    try:
        kind: ServerKind = registry.find("server", name)
        config: Any = msgspec.convert(facts.get("config"), kind.config)
    except UnknownName as error:
        what = "of a kind that is not installed here" if is_told else "called like no kind that is installed here"
        raise EpisodeError(
            f"episode {reader.episode_id}: its low-level server is {what}: {error}; "
            f"install the package that has it{hint}"
        ) from error
    except msgspec.ValidationError as error:
        raise EpisodeError(
            f"episode {reader.episode_id}: the configuration of its {kind.name} server is none of this version: "
            f"{error}{hint}"
        ) from error
    if not hasattr(config, "rig"):
        raise EpisodeError(
            f"episode {reader.episode_id}: an arm's controller keeps its own time, so its motion is not computed "
            f"again; `station audit` derives its targets, and `station serve {kind.name}` with `station replay "
            "--to bus --allow-live` moves a simulated one"
        )
    return LowLevelConfig(config.rig, config.gate, config.is_armed)


def _place(reader: EpisodeReader, facts: Mapping[str, Any]) -> str:
    """Return where a server stands in the manifest, for a person."""
    name = next((name for name, each in reader.manifest.servers.items() if each is facts), facts.get("server"))
    return f"servers.{name} of {reader.folder / layout.MANIFEST}"
