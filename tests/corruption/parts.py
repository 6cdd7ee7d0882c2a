"""What recipes share: which keys of an episode are what, where it moves, and how harm is described."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from tests.corruption.files import ONE_S, DoesNotFit, Episode, Message, Stream

STATES = ("robot_state_", "state_joints_")
_LEAST_MOVED = 0.05  # rad or m: below that nothing moves


@dataclass(frozen=True)
class Harm:
    """What a recipe did, for whom reads what was said of it.

    Attributes:
        names: Any of these names what was harmed: a key, a camera, a joint, a file, a field of the manifest.
        from_s, to_s: When, from the start of the episode [s]; None for all of it.
    """

    names: tuple[str, ...]
    from_s: float | None = None
    to_s: float | None = None


class Robot:
    """Streams of the first robot of an episode.

    Attributes:
        name: Suffix of its keys.
        state: The key that tells most of its joints.
        states: All vectors of states of it; what a sensor tells wrongly is wrong in all of them.
        used, target, timing: The command after the gate, what the motors got, the instants of its steps.
    """

    def __init__(self, episode: Episode) -> None:
        self.streams = episode.streams()
        key = next((key for prefix in STATES for key in sorted(self.streams) if key.startswith(prefix)), None)
        if key is None:
            raise DoesNotFit("no state of a robot")
        self.state = self.streams[key]
        self.name = key.removeprefix(STATES[0]).removeprefix(STATES[1])
        self.states = [
            stream
            for key, stream in self.streams.items()
            if stream.role == "state" and stream.is_vector and key.endswith(self.name) and stream.names
        ]

    @property
    def used(self) -> Stream:
        return self.get(f"command_used_{self.name}")

    @property
    def target(self) -> Stream:
        return self.get(f"target_{self.name}")

    @property
    def timing(self) -> Stream:
        return self.get(f"policy_timing_{self.name}")

    @property
    def commands(self) -> list[Stream]:
        """Commands of its operator, that of most elements first: vectors that change."""
        found = [
            stream
            for key, stream in self.streams.items()
            if key.startswith("action_") and key.endswith(self.name) and stream.is_vector
        ]
        if not found:
            raise DoesNotFit("no command")
        return sorted(found, key=lambda stream: -len(stream.names))

    def get(self, key: str) -> Stream:
        if key not in self.streams:
            raise DoesNotFit(f"no {key}")
        return self.streams[key]

    def by_writer_of(self, stream: Stream) -> list[Stream]:
        return [each for each in self.streams.values() if each.source == stream.source]

    def edit(self, how: Callable[[np.ndarray, list[str], Stream], np.ndarray]) -> None:
        """Change the numbers of all its states by `how(values, names, stream)`."""
        for stream in self.states:
            stream.put(how(stream.values, stream.names, stream))

    def most_moved(self, suffix: str = "_pos") -> str:
        """Return the element of the state that moves most."""
        columns = self.state.columns(lambda name: name.endswith(suffix))
        ranges = np.ptp(self.state.values[:, columns], axis=0)
        if not len(columns) or ranges.max() < _LEAST_MOVED:
            raise DoesNotFit("nothing moves")
        return self.state.names[columns[int(ranges.argmax())]]

    def liveliest(self, seconds: float) -> tuple[int, int]:
        """Return from when to when it moves most, of so many seconds [ns]."""
        columns = self.state.columns(lambda name: name.endswith("_pos"))
        values, times = self.state.values[:, columns], self.state.times_ns
        moved = np.concatenate([[0.0], np.abs(np.diff(values, axis=0)).sum(axis=1).cumsum()])
        ends = np.searchsorted(times, times + round(seconds * ONE_S))
        sound = np.flatnonzero(ends < len(times))
        if not len(sound):
            raise DoesNotFit(f"shorter than {seconds:g} s")
        begin = int(sound[(moved[ends[sound]] - moved[sound]).argmax()])
        if moved[ends[begin]] - moved[begin] < _LEAST_MOVED:
            raise DoesNotFit("nothing moves")
        return int(times[begin]), int(times[begin]) + round(seconds * ONE_S)


def half_ns(messages: Iterable[Message]) -> int:
    """Return the middle of the time that some messages span [ns]."""
    times = [message.log_ns for message in messages]
    return (min(times) + max(times)) // 2


def keep(episode: Episode, streams: Iterable[Stream], wanted: Callable[[Message], bool]) -> None:
    """Delete those messages of streams that are not wanted."""
    listed = list(streams)
    gone = {id(one) for stream in listed for one in stream.messages if not wanted(one)}
    for recording in {id(stream.recording): stream.recording for stream in listed}.values():
        recording.replace(lambda one: [] if id(one) in gone else [one])


def renumber(episode: Episode, key: str, *, is_picture: bool = False) -> None:
    """Count what is left of a key as if nothing had been there in between."""
    recording = episode.cameras if is_picture else episode.signals
    stream = episode.streams(recording)[key]
    first = stream.messages[0].sequence
    for count, message in enumerate(stream.messages):
        message.number(first + count)


def luck(name: str) -> random.Random:
    """Return random numbers that are the same in every run."""
    return random.Random(f"corruption {name}")


def noise(name: str) -> np.random.Generator:
    return np.random.default_rng(luck(name).getrandbits(32))


def unit_scale(stream: Stream, unit: str, factor: float) -> np.ndarray:
    """Return a factor per element: `factor` for those of a unit, or of its rate, 1 for others."""
    return np.array([factor if each in (unit, f"{unit}/s") else 1.0 for each in stream.units])
