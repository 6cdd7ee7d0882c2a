"""Which robot an episode is about, and in which phases it went: clips of a motion, or what an operator moved."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

from station.bus import codec
from station.episode.reading import steps
from station.episode.reading.reader import EpisodeReader
from station.errors import EpisodeError
from station.view import clips

PLAYING, TRACKING = "playing", "tracking"
"""The phase of a motion, and the state of the gate, in which a robot is to follow."""
RELEASED = "released"
"""What a robot is driven by while its operator moves nothing."""
_LONGEST_NAME = 80  # characters; an episode says what it likes


class Span(NamedTuple):
    """Something that lasted [s]."""

    start_s: float
    end_s: float
    name: str


class Spans:
    """Joins equal neighbours among states; a state lasts until the next one begins.

    Args:
        most: How many are held, and the last of them then stands for all beyond; None for all.
    """

    def __init__(self, most: int | None = None) -> None:
        self._found: list[Span] = []
        self._most = most

    def add(self, at_s: float, name: str) -> None:
        """Add the state at an instant, in order of time."""
        found = self._found
        if found:
            found[-1] = found[-1]._replace(end_s=at_s)
        if (not found or found[-1].name != name) and (self._most is None or len(found) < self._most):
            found.append(Span(at_s, at_s, name))

    @property
    def named(self) -> list[Span]:
        """Those that have a name, in order."""
        return [span for span in self._found if span.name]


def spans(states: Iterable[tuple[float, str]]) -> list[Span]:
    """Return the named spans of states with their times [s]."""
    found = Spans()
    for at_s, name in states:
        found.add(at_s, name)
    return found.named


def robot_of(reader: EpisodeReader, wanted: str = "") -> str:
    """Return the suffix of the robot that an episode is about, "" for none.

    That is the one that is wanted; else one that a policy or an operator drove, the manifest's own where there are
    several; else one whose state or command is there (stock scripts, no robot).

    Raises:
        EpisodeError: the one that is wanted is not in it.
    """
    if wanted:
        if wanted not in (known := steps.robots_of(reader)):
            raise EpisodeError(f"{reader.episode_id}: no robot {wanted!r} in it; it has {', '.join(known) or 'none'}")
        return wanted
    if reader.manifest.robot.suffix in steps.robots(reader.topics()):
        return reader.manifest.robot.suffix
    return next(iter(steps.robots_of(reader)), "")


def motion_facts(reader: EpisodeReader, robot: str) -> Mapping[str, Any]:
    """Return what the server that commanded a robot said of its motion; nothing where none did."""
    stated = (facts.get("motion") for facts in reader.manifest.servers.values() if facts.get("robot") == robot)
    return next((motion for motion in stated if isinstance(motion, Mapping)), {})


class PhaseNames:
    """Names what a robot is driven by: a clip of a motion that plays, the phase of one, or what an operator moves.

    Args:
        facts: What a manifest says of the motion.

    Attributes:
        motion: What a person calls the motion, "" for none.
    """

    def __init__(self, facts: Mapping[str, Any]) -> None:
        self.motion = clips.short_name(str(facts.get("file", "")))[:_LONGEST_NAME]
        self._clips = clips.clips(facts)

    def __call__(self, source: Mapping[str, Any]) -> str:
        """Return the phase that a value of `keys.command_source` tells, "" for none."""
        return self._name(source)[:_LONGEST_NAME]

    def _name(self, source: Mapping[str, Any]) -> str:
        phase, time_s = driven_by(source), codec.number(source.get("time_s"))
        if phase != PLAYING:
            return phase if phase != RELEASED else ""
        clip = clips.name_at(self._clips, time_s) if time_s is not None else ""
        return clip or self.motion or phase


def driven_by(source: Mapping[str, Any]) -> str:
    """Return the phase of the motion that a value of `keys.command_source` tells, or what an operator moves."""
    if source.get("kind") == "operator":
        return str(source.get("mode") or source.get("driver") or "") if source.get("engaged") else RELEASED
    return str(source.get("phase", ""))


def parsed(data: bytes) -> dict[str, Any] | None:
    """Return the JSON object that bytes hold, None where they hold none; `check` counts those."""
    try:
        value = codec.parse_json(data)
    except codec.BadValue:
        return None
    return value if isinstance(value, dict) else None
