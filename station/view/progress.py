"""How a run is going, for a person who looks on: motion, robot, policy and recorder, read from the bus."""

from __future__ import annotations

import statistics
from collections import deque
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from station import rotations
from station.bus import codec, keys
from station.bus.client import Bus
from station.bus.contracts import Contracts
from station.bus.sample import Sample
from station.contract import TIMING_STAGES, Contract
from station.episode.storage.request import RecorderState
from station.life.server import Health, read_health
from station.protocols import Floats
from station.view import clips

_MEDIAN_OF = 25  # looks; a single step says little of a latency
_FIRST_STAGE = 2  # of a timing, after tick and command_seq
_INFERENCE = TIMING_STAGES.index("observed"), TIMING_STAGES.index("inferred")
_WHOLE = TIMING_STAGES.index("command_written"), TIMING_STAGES.index("sent")


@dataclass(frozen=True, kw_only=True)
class MotionProgress:
    """What is being played: short name, clip within it, phase, and how far [s]."""

    name: str
    clip: str
    phase: str
    time_s: float
    duration_s: float


@dataclass(frozen=True, kw_only=True)
class RobotProgress:
    """How the robot stands: lean of its root [rad], its height [m] where known, falls so far, state of the gate."""

    tilt_rad: float
    height_m: float | None
    falls: int
    gate: str


@dataclass(frozen=True, kw_only=True)
class PolicyProgress:
    """What drives it: name (of several, as the settings call it), rate [Hz], medians of the inference and of the way
    from command to joints [s]."""

    name: str
    rate_hz: float | None
    inference_s: float | None
    latency_s: float | None


@dataclass(frozen=True, kw_only=True)
class ArmProgress:
    """How an arm behind a controller of its own is doing.

    Attributes:
        gate, reason: State of the gate, and why.
        backend, profile: What the session talks to, and how it tracks.
        sync_hz, send_hz: Heartbeats heard and targets sent, lately [Hz]; None before two looks.
    """

    gate: str
    reason: str
    backend: str
    profile: str
    sync_hz: float | None = None
    send_hz: float | None = None


@dataclass(frozen=True, kw_only=True)
class Progress:
    """What a look at the bus shows; None for what is not there (yet)."""

    servers: list[Health]
    motion: MotionProgress | None = None
    robot: RobotProgress | None = None
    arm: ArmProgress | None = None
    policy: PolicyProgress | None = None
    recorder: RecorderState | None = None


class ProgressReader:
    """Looks at a bus now and then.

    Args:
        bus: Where to look.
        names: Servers that belong to the run.
    """

    def __init__(self, bus: Bus, names: Collection[str]) -> None:
        self._bus, self._names = bus, names
        self._stated: dict[str, tuple[bytes, Mapping[str, Any]]] = {}
        self._inference_s: deque[float] = deque(maxlen=_MEDIAN_OF)
        self._latency_s: deque[float] = deque(maxlen=_MEDIAN_OF)
        self._last_timing = b""

    def poll(self) -> Progress:
        """Return how things are now.

        Raises:
            BusError: the bus is lost.
        """
        servers = [health for health in read_health(self._bus) if health.name in self._names and _is_of_now(health)]
        facts = self._facts([health.name for health in servers])
        active = {health.role: health for health in servers if health.state == "active" and health.name in facts}
        low_level, command = active.get("low-level"), active.get("command")
        driven = low_level or command
        suffix = str(facts[driven.name].get("robot", "")) if driven is not None else ""
        held = self._bus.read([*_wanted(suffix), keys.RECORDER])
        return Progress(
            servers=servers,
            motion=_motion(facts[command.name], held.get(keys.command_source(suffix))) if command else None,
            robot=_robot(low_level, suffix, held, Contracts(facts.values())) if low_level else None,
            arm=_arm(low_level) if low_level else None,
            policy=self._policy(low_level, facts, held.get(keys.policy_timing(suffix))) if low_level else None,
            recorder=_recorder(held.get(keys.RECORDER)),
        )

    def _facts(self, names: Sequence[str]) -> dict[str, Mapping[str, Any]]:
        """Return what servers stated that they run, each decoded once."""
        found = self._bus.read([keys.server_config(name) for name in names])
        for key, sample in found.items():
            known = self._stated.get(key)
            if known is None or known[0] != sample.value:
                self._stated[key] = (sample.value, codec.parse_facts(sample.value))
        return {name: self._stated[key][1] for name in names if (key := keys.server_config(name)) in found}

    def _policy(
        self, health: Health, facts: Mapping[str, Mapping[str, Any]], sample: Sample | None
    ) -> PolicyProgress | None:
        if "backend" in health.detail:  # an arm: what decides its motion is the gate
            return None
        if sample is not None and sample.value != self._last_timing:
            self._last_timing = sample.value
            self._add_timing(sample.value)
        stated = facts[health.name].get("policy")
        return PolicyProgress(
            name=str(stated.get("called") or stated.get("name", "")) if isinstance(stated, Mapping) else "",
            rate_hz=health.rate_hz,
            inference_s=statistics.median(self._inference_s) if self._inference_s else None,
            latency_s=statistics.median(self._latency_s) if self._latency_s else None,
        )

    def _add_timing(self, data: bytes) -> None:
        try:
            instants = codec.parse_json_vector(data)[_FIRST_STAGE:]
        except codec.BadValue:
            return
        for (start, end), kept in ((_INFERENCE, self._inference_s), (_WHOLE, self._latency_s)):
            if len(instants) > end and instants[start] > 0 and instants[end] > 0:
                kept.append(float(instants[end] - instants[start]) * 1e-9)


def _is_of_now(health: Health) -> bool:
    """Whether a server lives, or said farewell in this run; what an earlier one left behind is neither."""
    return health.is_alive or health.state == "finalized"


def _wanted(suffix: str) -> Iterator[str]:
    families = (keys.sim_qpos, keys.robot_state, keys.policy_timing, keys.command_gate, keys.command_source)
    return (family(suffix) for family in families)


def _motion(facts: Mapping[str, Any], sample: Sample | None) -> MotionProgress | None:
    stated, now = facts.get("motion"), codec.parse_facts(sample.value) if sample is not None else {}
    if not isinstance(stated, Mapping):
        return None
    at_s = codec.number(now.get("time_s")) or 0.0
    return MotionProgress(
        name=clips.short_name(str(stated.get("file", ""))),
        clip=clips.name_at(clips.clips(stated), at_s),
        phase=str(now.get("phase", "")),
        time_s=at_s,
        duration_s=codec.number(stated.get("duration_s")) or 0.0,
    )


def _robot(health: Health, suffix: str, held: Mapping[str, Sample], known: Contracts) -> RobotProgress | None:
    for key in (keys.sim_qpos(suffix), keys.robot_state(suffix)):
        values = _named(known.get(key), held.get(key))
        if "root_quat_w" in values:
            quat = [values[f"root_quat_{axis}"] for axis in "wxyz"]
            gate = held.get(keys.command_gate(suffix))
            return RobotProgress(
                tilt_rad=float(rotations.tilt(quat)),
                height_m=values.get("root_z"),
                falls=int(codec.number(health.detail.get("falls")) or 0),
                gate=str(codec.parse_facts(gate.value).get("state", "")) if gate is not None else "",
            )
    return None


def _arm(health: Health) -> ArmProgress | None:
    said = health.detail
    if "backend" not in said:
        return None
    return ArmProgress(
        gate=str(said.get("gate", "")),
        reason=str(said.get("gate_reason", "")),
        backend=str(said["backend"]),
        profile=str(said.get("profile", "")),
        sync_hz=codec.number(said.get("sync_hz")),
        send_hz=codec.number(said.get("send_hz")),
    )


def _named(contract: Contract | None, sample: Sample | None) -> dict[str, float]:
    """Return the numbers of a vector by their names; none when it does not fit its contract."""
    if sample is None or contract is None or len(sample.value) != 8 * len(contract.elements):
        return {}
    numbers: Floats = codec.parse_f64(sample.value)
    return dict(zip(contract.names, numbers.tolist(), strict=True))


def _recorder(sample: Sample | None) -> RecorderState | None:
    if sample is None:
        return None
    try:
        return codec.parse_struct(sample.value, RecorderState)
    except codec.BadValue:
        return None
