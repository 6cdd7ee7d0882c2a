"""What another recorder's format is; formats are found by name through the registry (entry points ``station.foreign``).

A format only reads: which recordings there are, and of each one what is known of it and its writes. What nobody knows
is left out and said, never made up.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple


class ForeignWrite(NamedTuple):
    """One value as the other recorder saw it: key of our bus (its own name where we have none), exact bytes, and when,
    counted from the first instant of the recording [ns]."""

    key: str
    value: bytes
    at_ns: int


@dataclass(frozen=True, kw_only=True)
class Times:
    """Where the times of a recording come from.

    Attributes:
        source: ``measured``: its recorder wrote them down; ``nominal``: there are none, places in the list stand for
            them at a rate that was not measured.
        note: What exactly, in a sentence.
        started_ns: Wall clock of the first instant [ns since the epoch]; None where nominal.
        rate_hz: The nominal rate [Hz]; None where measured.
    """

    source: str
    note: str
    started_ns: int | None = None
    rate_hz: float | None = None


@dataclass(frozen=True, kw_only=True)
class Recording:
    """One recording of another recorder.

    Attributes:
        path: Its folder or file.
        number: What it is called in its folder, for the id of the episode: digits or a word.
        sha256: Of the file that says everything; the same recording is known again by it.
        task: Name of the task as its recorder has it.
        operator: Who recorded, "" where nobody says.
        robot: Suffix of the robot's keys.
        times: Where its times come from.
        length_ns: From the first instant to the last [ns].
        cameras: What is known of each camera.
        facts: What else its recorder says, as it says it: plain values that YAML can hold.
        unknown: What a recording of ours would have and this one has not, in sentences.
        odd: What looks wrong in it, in sentences.
        writes: Gives the writes in order of time, one picture in memory at a time; raises `BadFile`.
    """

    path: Path
    number: str
    sha256: str
    task: str
    robot: str
    times: Times
    length_ns: int
    writes: Callable[[], Iterator[ForeignWrite]]
    operator: str = ""
    cameras: Sequence[dict[str, Any]] = ()
    facts: dict[str, Any] = field(default_factory=dict)
    unknown: Sequence[str] = ()
    odd: Sequence[str] = ()


@dataclass(frozen=True, kw_only=True)
class ForeignKind:
    """One format.

    Attributes:
        name: As it is registered, for example ``twist2``.
        summary: What it reads, in one line.
        recorder: What the recorder is called in an episode's manifest.
        find: Returns the recordings in a folder, which may be one itself, in order; none where there is none.
        read: Reads one. Raises `BadFile` with file and field where it is not of this format.
    """

    name: str
    summary: str
    recorder: str
    find: Callable[[Path], Sequence[Path]]
    read: Callable[[Path], Recording]
