"""Everything that is measured of an episode in one pass: the meters, and who is fed with what."""

from __future__ import annotations

from typing import Any

from station.bus import codec, keys
from station.episode.quality import arms, interruptions, motion, pauses
from station.episode.quality.alignment import AlignmentMeter
from station.episode.quality.cameras import CameraMeter, stated_hz
from station.episode.quality.changes import ChangeCounter
from station.episode.quality.policy_steps import StepMeter
from station.episode.quality.presence import Heartbeats
from station.episode.quality.streams import StreamCounter
from station.episode.reading import frames, steps
from station.episode.reading.messages import Message
from station.episode.reading.reader import EpisodeReader
from station.episode.reading.steps import Step, StepJoiner


class Measuring:
    """The meters of an episode after they were fed with all of it.

    Attributes:
        start_ns: Instant that times are told from: the anchor of the episode, else its first message [ns since the
            epoch].
        counter: Counts every stream.
        steps, alignment: By robot.
        motion: One for each robot whose joints are told of.
        arms: One for each arm.
        cameras: Counts pictures.
        changes: Counts changes of keys that are no values in the file.
        heartbeats: Which servers lived.
        events: Every event with its time from the start [s].
        ends: Where commands ended because their server said so.
    """

    def __init__(self, reader: EpisodeReader) -> None:
        topics = reader.topics()
        self.start_ns = reader.start_ns
        self.counter = StreamCounter()
        self.steps = {robot: StepMeter(robot, self.start_ns, reader.contract) for robot in steps.robots(topics)}
        self.alignment = {
            robot: AlignmentMeter(robot, steps.state_key(robot, topics), reader.contract) for robot in self.steps
        }
        self.motion = motion.meters(reader)
        self.arms = [arms.ArmMeter(robot) for robot in arms.robots(topics)]
        self.cameras = CameraMeter(frames.cameras(reader), stated_hz(reader.manifest))
        self.changes = ChangeCounter(self.start_ns, reader.contract)
        self.heartbeats = Heartbeats(self.start_ns)
        self.events: list[tuple[float, dict[str, Any]]] = []
        self.ends: list[pauses.End] = []
        self._joiners = {robot: StepJoiner(robot, context=meter.context) for robot, meter in self.steps.items()}
        for message in reader.messages(stamps=self.cameras.is_needed):  # they tell when a picture was taken
            self._feed(message)
        for robot, joiner in self._joiners.items():
            for step in joiner.finish():
                self._feed_step(robot, step)

    def _feed(self, message: Message) -> None:
        self.counter.feed(message)
        self.cameras.feed(message)
        self.changes.feed(message)
        self.heartbeats.feed(message)
        for meter in self.motion:
            meter.feed(message)
        for arm in self.arms:
            arm.feed(message)
        if message.topic == keys.EVENT:
            self._feed_event(message)
        for robot, joiner in self._joiners.items():
            step = joiner.feed(message)
            if step is not None:
                self._feed_step(robot, step)

    def _feed_step(self, robot: str, step: Step) -> None:
        self.alignment[robot].feed(step, self.steps[robot].feed(step))

    def _feed_event(self, message: Message) -> None:
        event = codec.parse_facts(message.data)
        self.events.append(((message.log_ns - self.start_ns) * 1e-9 - interruptions.late_s(event), event))
        if (end := pauses.end_of(message, event)) is not None and len(self.ends) < pauses.MOST_ENDS:
            self.ends.append(end)
