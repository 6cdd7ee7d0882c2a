"""One recorded run as pictures need it: where the robot was, what it was asked, and what happened when.

Times are seconds since the start of the episode.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from station import rotations
from station.bus import keys
from station.episode.quality import falls
from station.episode.quality.check import velocity_curves
from station.episode.quality.findings import FallSeen
from station.episode.reading.messages import Message
from station.episode.reading.reader import EpisodeReader
from station.episode.reading.vectors import numbers
from station.protocols import Floats
from station.view import phases, poses
from station.view.phases import Span
from station.view.poses import Ints, Numbers, Posture

_JOINT = "_pos"  # end of the name of a joint's position in a contract


class Joints(NamedTuple):
    """Positions of m joints at n instants: times (n,) [s], their names, positions (n, m) [rad]."""

    times_s: Floats
    names: tuple[str, ...]
    q: Floats


@dataclass(frozen=True, kw_only=True)
class Run:
    """What pictures show of an episode.

    Attributes:
        episode_id: The episode.
        robot: Suffix of the robot, "" for none.
        policy, motion: Their short names, "" where the episode does not say; of several policies the one that followed
            longest.
        measured: Where the robot was; None where nothing tells.
        has_place: Whether its place and height were measured rather than assumed.
        commanded: Joints that it was asked for, after the gate where there was one; None where nothing tells.
        heights: Times [s] and commanded heights of the root [m]; None where the command has none.
        gate: States of the gate.
        phases: What was played: names of clips while a motion plays, else the phase; or what an operator moved.
        driving: Which policy drove, where several could.
        can_fall: Whether it is a robot that stands on its own.
        groups: Names of its joints by limb.
        falls_s: When the robot fell [s].
        velocities: How velocities were followed, `station.episode.quality.check.velocity_curves`, shape (n, 7).
        start_ns: Start of the episode on the clock of `measured` and `commanded` [ns].
    """

    episode_id: str
    robot: str
    policy: str = ""
    motion: str = ""
    measured: Posture | None = None
    has_place: bool = False
    commanded: Joints | None = None
    heights: tuple[Floats, Floats] | None = None
    gate: list[Span] = field(default_factory=list)
    phases: list[Span] = field(default_factory=list)
    driving: list[Span] = field(default_factory=list)
    can_fall: bool = True
    groups: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    falls_s: list[float] = field(default_factory=list)
    velocities: Floats = field(default_factory=lambda: np.empty((0, 7)))
    start_ns: int = 0

    @property
    def times_s(self) -> Floats:
        """Times of `measured` [s], shape (n,)."""
        return np.empty(0) if self.measured is None else _seconds(self.measured.times_ns, self.start_ns)

    @property
    def end_s(self) -> float:
        """Last instant that anything tells of [s]."""
        ends = [span.end_s for span in (*self.gate, *self.phases)]
        return max([*ends, *self.times_s[-1:], *([] if self.commanded is None else self.commanded.times_s[-1:])],
                   default=0.0)  # fmt: skip

    @property
    def joints(self) -> Joints | None:
        """Measured joints."""
        return None if self.measured is None else Joints(self.times_s, self.measured.joints, self.measured.q)


def read_run(reader: EpisodeReader, robot: str = "") -> Run:
    """Read from an episode what pictures show of a robot, see `phases.robot_of`, in one pass over its signals."""
    robot = phases.robot_of(reader, robot)
    description, recorded = reader.known.robot(robot), reader.recorded.values()
    states = poses.state_keys(robot, recorded, description)
    commands = poses.command_keys(robot, recorded, description)
    held = reader.collect({*states, *commands, keys.command_gate(robot), keys.command_source(robot), keys.EVENT})
    begin_ns = reader.start_ns
    find = _finder(held)
    measured = poses.measured(find, states, description)
    has_base = description is None or description.has_base
    name = phases.PhaseNames(phases.motion_facts(reader, robot))
    source = _objects(held[keys.command_source(robot)], begin_ns)
    gates = [
        (at_s, str(value.get("state", "")), str(value.get("policy") or ""))
        for at_s, value in _objects(held[keys.command_gate(robot)], begin_ns)
    ]
    return Run(
        episode_id=reader.episode_id,
        robot=robot,
        policy=_followed(gates) or reader.manifest.policy.name or "",
        motion=name.motion,
        measured=measured,
        has_place=has_base and find(keys.sim_qpos(robot)) is not None,
        commanded=_commanded(find, commands, begin_ns),
        heights=_heights(find, commands, begin_ns),
        gate=phases.spans((at_s, state) for at_s, state, _ in gates),
        driving=phases.spans((at_s, policy) for at_s, _, policy in gates),
        phases=phases.spans((at_s, name(value)) for at_s, value in source),
        can_fall=has_base,
        falls_s=_falls(held[keys.EVENT], robot, measured, begin_ns),
        velocities=velocity_curves(reader, robot),
        start_ns=begin_ns,
        groups=description.groups if description is not None else {},
    )


def _followed(gates: Sequence[tuple[float, str, str]]) -> str:
    """Return the policy that drove longest while a command was followed, where several could; else ""."""
    drove = Counter(policy for _, state, policy in gates if state == "tracking" and policy)
    return max(drove, key=drove.__getitem__, default="")


def _seconds(times_ns: Ints, start_ns: int) -> Floats:
    return np.asarray((times_ns - start_ns) * 1e-9, dtype=np.float64)


def _finder(held: Mapping[str, list[Message]]) -> Callable[[str], Numbers | None]:
    """Return a function that gives the numbers of a key, or None where it has none with names."""
    found: dict[str, Numbers | None] = {}

    def find(key: str) -> Numbers | None:
        if key not in found:
            contract = next((m.channel.contract for m in held[key] if m.channel.contract is not None), None)
            vectors = numbers(key, held[key])[0] if contract is not None and contract.elements else None
            has_values = vectors is not None and len(vectors.values) > 0
            found[key] = (
                Numbers(vectors.log_ns, np.asarray(vectors.values, dtype=np.float64), contract)
                if vectors is not None and contract is not None and has_values
                else None
            )
        return found[key]

    return find


def _first(find: poses.Find, commands: Iterable[str]) -> Numbers | None:
    """Return the command that the gate let through, else the one on the bus."""
    return next((found for key in commands if (found := find(key)) is not None), None)


def _commanded(find: poses.Find, commands: Iterable[str], start_ns: int) -> Joints | None:
    command = _first(find, commands)
    if command is None:
        return None
    columns = [index for index, name in enumerate(command.contract.names) if name.endswith(_JOINT)]
    names = tuple(command.contract.names[index].removesuffix(_JOINT) for index in columns)
    return Joints(_seconds(command.times_ns, start_ns), names, command.values[:, columns])


def _heights(find: poses.Find, commands: Iterable[str], start_ns: int) -> tuple[Floats, Floats] | None:
    command = _first(find, commands)
    if command is None or "root_height" not in command.contract.names:
        return None
    column = command.values[:, command.contract.names.index("root_height")]
    return _seconds(command.times_ns, start_ns), column


def _objects(messages: Iterable[Message], start_ns: int) -> Iterable[tuple[float, dict[str, Any]]]:
    """Yield each JSON object with its time [s]."""
    for message in messages:
        if (value := phases.parsed(message.data)) is not None:
            yield (message.log_ns - start_ns) * 1e-9, value


def _falls(messages: list[Message], robot: str, measured: Posture | None, start_ns: int) -> list[float]:
    """Return when the robot fell: as reported, and as its pose shows."""
    told = [
        FallSeen(at_s=at_s, robot=robot, tilt_rad=None, seen_by="event")
        for at_s, event in _objects(messages, start_ns)
        if event.get("name") == "fall"
    ]
    seen = []
    if measured is not None:
        whole = np.isfinite(measured.root).all(axis=1)
        times_s = _seconds(measured.times_ns[whole], start_ns)
        seen = falls.from_pose(robot, times_s, rotations.tilt(measured.root[whole, 3:]))
    return [fall.at_s for fall in falls.merged(told, seen)]
