"""What happened when in one episode, and its joints, in one pass that holds no more than a plot shows."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from itertools import islice
from typing import Any, NamedTuple

import numpy as np

from station.bus import codec, keys
from station.contract import Contract
from station.episode.quality import interruptions
from station.episode.quality.check import velocity_curves
from station.episode.reading import steps
from station.episode.reading.messages import Message
from station.episode.reading.reader import EpisodeReader
from station.episode.reading.steps import Step, StepJoiner
from station.protocols import LARGEST_JOINT_ERROR_RAD, Floats
from station.view import phases
from station.view.phases import PhaseNames, Span, Spans

POINTS = 1200
"""Of a curve, at least where there are as many steps, and not twice as many."""
MOST_SPANS, MOST_EVENTS = 400, 400
_JOINT = "_pos"
_LONGEST_TEXT, _LONGEST_STATE = 300, 40


class EventRow(NamedTuple):
    """An event: when [s], its name, severity and source, and its numbers as a text."""

    at_s: float
    name: str
    severity: str
    source: str
    text: str


class Tracks(NamedTuple):
    """Joints as asked and as measured.

    Attributes:
        times_s: n instants, shape (n,).
        mean_rad, most_rad: Mean and greatest |measured - asked| over the joints, of all steps that an instant stands
            for, shape (n,).
        joints: Names of m joints.
        asked, measured: Positions, shape (n, m) [rad].
    """

    times_s: Floats
    mean_rad: Floats
    most_rad: Floats
    joints: tuple[str, ...]
    asked: Floats
    measured: Floats


@dataclass
class Story:
    """What happened in an episode.

    Attributes:
        robot: Suffix of the robot that it is about, "" for none.
        first_s, last_s: First and last message, from the start of the episode [s].
        gate: States of the gate.
        phases: Clips that played, else the phase of the motion; or what an operator moved.
        events: The first events, and `events_in_all` how many there are.
        tracks: How well it was tracked; None where nothing tells.
        contracts: What each key holds, as it was recorded.
        velocities: How velocities were followed, `station.episode.quality.check.velocity_curves`, shape (n, 7).
    """

    robot: str = ""
    first_s: float = 0.0
    last_s: float = 0.0
    gate: list[Span] = field(default_factory=list)
    phases: list[Span] = field(default_factory=list)
    events: list[EventRow] = field(default_factory=list)
    events_in_all: int = 0
    tracks: Tracks | None = None
    contracts: dict[str, Contract] = field(default_factory=dict)
    velocities: Floats = field(default_factory=lambda: np.empty((0, 7)))


def read(reader: EpisodeReader) -> Story:
    """Read what happened in an episode.

    Raises:
        EpisodeError: a chunk in the middle of the file is damaged.
    """
    streams = [stream for stream in reader.streams() if stream.count]
    begin_ns = reader.start_ns
    story = Story(robot=phases.robot_of(reader))
    story.first_s = (min((stream.first_ns for stream in streams), default=begin_ns) - begin_ns) * 1e-9
    story.last_s = (max((stream.last_ns for stream in streams), default=begin_ns) - begin_ns) * 1e-9
    story.contracts = {s.channel.topic: s.channel.contract for s in streams if s.channel.contract is not None}
    publisher = _StoryBuilder(reader, story, begin_ns)
    for message in reader.messages(publisher.topics):
        publisher.feed(message)
    publisher.finish()
    story.velocities = velocity_curves(reader, story.robot)
    return story


class _StoryBuilder:
    """Takes the messages of an episode, and puts what they tell into a story."""

    def __init__(self, reader: EpisodeReader, story: Story, begin_ns: int) -> None:
        robot, self._story, self._begin_ns = story.robot, story, begin_ns
        self._gate_key, self._source_key = keys.command_gate(robot), keys.command_source(robot)
        self._joiner = StepJoiner(robot)
        self._phase_of = PhaseNames(phases.motion_facts(reader, robot))
        self._gate, self._phases = Spans(MOST_SPANS), Spans(MOST_SPANS)
        count = sum(stream.count for stream in reader.streams() if stream.channel.topic == keys.command_used(robot))
        self._tracker = _Tracker(robot, story.contracts, max(1, count // POINTS), begin_ns)
        self.topics = (self._joiner.topics | {self._source_key} if robot else set()) | {keys.EVENT}

    def feed(self, message: Message) -> None:
        at_s = (message.log_ns - self._begin_ns) * 1e-9
        if message.topic == keys.EVENT:
            self._add_event(at_s, codec.parse_facts(message.data))
        elif message.topic == self._source_key:
            self._phases.add(at_s, self._phase_of(codec.parse_facts(message.data)))
        else:
            if message.topic == self._gate_key:
                self._gate.add(at_s, str(codec.parse_facts(message.data).get("state", ""))[:_LONGEST_STATE])
            step = self._joiner.feed(message)
            if step is not None:
                self._tracker.feed(step)

    def finish(self) -> None:
        for step in self._joiner.finish():
            self._tracker.feed(step)
        self._story.gate, self._story.phases = self._gate.named, self._phases.named
        self._story.tracks = self._tracker.result()

    def _add_event(self, at_s: float, event: Mapping[str, Any]) -> None:
        self._story.events_in_all += 1
        if len(self._story.events) >= MOST_EVENTS:
            return
        detail = event.get("detail")
        pairs = islice(detail.items(), 20) if isinstance(detail, Mapping) else ()
        shown = ", ".join(
            f"{key} {value:.4g}" if isinstance(value, float) else f"{key} {value}" for key, value in pairs
        )
        name, severity, source = (str(event.get(part, ""))[:_LONGEST_TEXT] for part in ("name", "severity", "source"))
        when_s = at_s - interruptions.late_s(event)
        self._story.events.append(EventRow(when_s, name, severity, source, shown[:_LONGEST_TEXT]))


class _Tracker:
    """Gathers the distance of the joints from the command, a point for each `stride` steps."""

    def __init__(self, robot: str, recorded: Mapping[str, Contract], stride: int, begin_ns: int) -> None:
        self._stride, self._begin_ns = stride, begin_ns
        self._state_key, self._asked_key = steps.state_key(robot, recorded), keys.command_used(robot)
        described = (recorded.get(key) for key in (self._state_key, self._asked_key))
        state, asked = (() if contract is None else contract.names for contract in described)
        shared = [name for name in state if name.endswith(_JOINT) and name in asked]
        self._sizes = 8 * len(state), 8 * len(asked)
        self._columns = [state.index(name) for name in shared], [asked.index(name) for name in shared]
        self._joints = tuple(name.removesuffix(_JOINT) for name in shared)
        self._points: list[tuple[float, float, float]] = []
        self._curves: list[tuple[Floats, Floats]] = []
        self._held: list[tuple[float, float]] = []

    def feed(self, step: Step) -> None:
        state, asked = step.values.get(self._state_key, b""), step.values.get(self._asked_key, b"")
        if (len(state), len(asked)) != self._sizes or not self._joints:
            return
        q, wanted = codec.parse_f64(state)[self._columns[0]], codec.parse_f64(asked)[self._columns[1]]
        with np.errstate(all="ignore"):
            errors = np.abs(q - wanted)
        if not (errors <= LARGEST_JOINT_ERROR_RAD).all():
            return
        self._held.append((float(errors.mean()), float(errors.max())))
        if len(self._held) >= self._stride:
            means, mosts = zip(*self._held, strict=True)
            self._points.append(((step.at_ns - self._begin_ns) * 1e-9, sum(means) / len(means), max(mosts)))
            self._curves.append((q, wanted))
            self._held = []

    def result(self) -> Tracks | None:
        if not self._points:
            return None
        times, means, mosts = (np.array(column) for column in zip(*self._points, strict=True))
        measured, asked = (np.array(column) for column in zip(*self._curves, strict=True))
        return Tracks(times, means, mosts, self._joints, asked, measured)


def lasting(spans: Iterable[Span]) -> list[Span]:
    """Return the spans that lasted."""
    return [span for span in spans if span.end_s > span.start_s]
