"""Which rows of an episode are worth training with: where it begins and where it ends for a data set."""

from __future__ import annotations

from typing import Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from station.bus import keys
from station.control.gate import MOVING
from station.episode.quality.motion import moving_span
from station.episode.reading.messages import Ints
from station.episode.reading.reader import EpisodeReader
from station.export.resample import NANOSECONDS, Table
from station.export.tracks import Words
from station.export.verdict import NotWanted

Trim = Literal["none", "idle", "waiting", "marks"]

RULES: dict[Trim, str] = {
    "none": "every row that can be made",
    "waiting": "from the first row whose gate was entering or tracking a command to the last that was tracking one",
    "idle": "as waiting, and without the beginning and the end in which neither state nor command moved, as "
    "`station check` measures them",
    "marks": "from the operator's first mark `start` to the last mark `stop`; without such labels from the first mark "
    "to the last",
}
"""Which rows are kept, in words, for people who train with them."""

START, STOP = "start", "stop"
"""Labels of marks between which an operator means an episode."""

_TRACKING = "tracking"


class Trimmed(msgspec.Struct, frozen=True, kw_only=True):
    """What was cut of an episode's rows.

    Attributes:
        head_s, tail_s: Rows at the beginning and at the end [s].
        why_not: Why the rule had nothing to go by, so that it cut nothing; "" where it had.
    """

    head_s: float = 0.0
    tail_s: float = 0.0
    why_not: str = ""


def trimmed(reader: EpisodeReader, table: Table, rule: Trim, robot: str, gates: Words | None) -> tuple[Table, Trimmed]:
    """Cut the rows at both ends of an episode by a rule of `RULES`.

    Args:
        reader: The episode.
        table: All its rows.
        rule: What is kept.
        robot: Suffix of the robot's keys.
        gates: What its gate said, None where that was not recorded.

    Raises:
        NotWanted: no row is left: the robot followed no command, or nothing moved, or the marks are elsewhere.
    """
    kept, why_not = np.ones(len(table.ticks_ns), dtype=np.bool_), ""
    if rule in ("waiting", "idle"):
        followed, why_not = _followed(table, robot, gates)
        kept &= _filled(followed)
    if rule == "idle":
        kept, why_not = kept & _moved(reader, table.ticks_ns, robot), ""
    if rule == "marks":
        (begin_ns, end_ns), why_not = marked(reader)
        kept &= (table.ticks_ns >= begin_ns) & (table.ticks_ns <= end_ns)
    rows = np.flatnonzero(kept)
    if not len(rows):
        raise NotWanted(f"{reader.episode_id}: {_NOTHING[rule]}; leave it out, or keep all its rows with --trim none")
    begin, end = int(rows[0]), int(rows[-1]) + 1
    head_ns, tail_ns = table.ticks_ns[begin] - table.ticks_ns[0], table.ticks_ns[-1] - table.ticks_ns[end - 1]
    cut = Trimmed(head_s=float(head_ns) / NANOSECONDS, tail_s=float(tail_ns) / NANOSECONDS, why_not=why_not)
    return table.part(begin, end), cut


_NOTHING: dict[Trim, str] = {
    "waiting": "its gate tracked no command, so no row is left",
    "idle": "nothing moves in it while a command is followed, so no row is left",
    "marks": "no row lies between its marks",
}


def marked(reader: EpisodeReader) -> tuple[tuple[int, int], str]:
    """Return the instants between which an operator meant an episode [ns since the epoch], and why they are none."""
    whole = (0, np.iinfo(np.int64).max)
    marks = sorted((reader.start_ns + round(mark.at_s * NANOSECONDS), mark.label) for mark in reader.manifest.marks)
    starts, stops = ([at_ns for at_ns, label in marks if label == wanted] for wanted in (START, STOP))
    if starts or stops:
        return (min(starts, default=whole[0]), max(stops, default=whole[1])), ""
    if len(marks) < 2:
        return whole, f"it has {'one mark only' if marks else 'no marks'}"
    return (marks[0][0], marks[-1][0]), ""


def _followed(table: Table, robot: str, gates: Words | None) -> tuple[NDArray[np.bool_], str]:
    """Return the rows in which a command was followed; all where nothing says, and why."""
    if gates is None:
        return np.ones(len(table.ticks_ns), dtype=np.bool_), "nothing of its gate was recorded"
    states = np.array([*gates.names, ""])[table.words[keys.command_gate(robot)]]
    follows, tracks = np.isin(states, MOVING), states == _TRACKING
    if tracks.any():
        follows[np.flatnonzero(tracks)[-1] + 1 :] = False
    return follows, ""


def _moved(reader: EpisodeReader, ticks_ns: Ints, robot: str) -> NDArray[np.bool_]:
    """Return the rows from the first to the last movement; all where nothing tells of joints."""
    span = moving_span(reader, robot)
    if span is None:
        return np.ones(len(ticks_ns), dtype=np.bool_)
    return np.asarray((ticks_ns >= span[0]) & (ticks_ns <= span[1]))


def _filled(rows: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the rows from the first to the last true one."""
    found = np.zeros(len(rows), dtype=np.bool_)
    true = np.flatnonzero(rows)
    if len(true):
        found[true[0] : true[-1] + 1] = True
    return found


def subtasks(reader: EpisodeReader) -> Words:
    """Return the operator's marks as words that hold until the next; `START` and `STOP` name no subtask."""
    marks = sorted(reader.manifest.marks, key=lambda mark: mark.at_s)
    labels = ["" if mark.label in (START, STOP) else " ".join(mark.label.split()) for mark in marks]
    names = list(dict.fromkeys(labels))
    times = [reader.start_ns + round(mark.at_s * NANOSECONDS) for mark in marks]
    codes = [names.index(label) for label in labels]
    return Words(np.array(times, dtype=np.int64), np.array(codes, dtype=np.int64), tuple(names))
