"""Measuring an envelope: from the motions that a policy tracks without a fall, what it was seen to survive.

A range of each element alone is not enough: the corners of ranges are poses that no motion has. So the directions are
found in which the motions' commands spread (the principal ones of what differs from standing, each element divided by
half of its range, and some between those), and how far they go in each: at once, and averaged over some times.
Shoulders and elbows may reach out beyond the motions, to the format's ranges, while the rest stands: there nothing
fell. Wrists are left alone.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np

from station import side_by_side
from station.atomic_file import write_atomic
from station.contract import names_of
from station.control.envelope import Envelope, Ranges, Span
from station.control.rig import RigConfig, build
from station.control.tracking import VELOCITIES
from station.errors import UsageError
from station.protocols import CommandFormat, Floats
from station.rehearse import Rehearsal, rehearse_named
from station.suite.commands import REACHING, WRIST
from station.suite.promise import JOINT_ERROR_RAD

OVER_S = (0.0, 0.5, 2.0, 5.0)
"""Over how long sums are averaged [s]. A motion has a speed for a moment that its robot does not hold for a second, and
turns on legs that step: the tracker turns on legs that are held still for some seconds, and then falls."""

CHANGES_S = (0.1,)
"""Over how long that average is from which sums may differ by so much [s]. The tracker falls when it has to rise from a
squat as fast as a knee moves in a step."""

_BETWEEN = 90
"""How many directions between two to four principal ones, by chance, each weighted by how far motions spread in it.
They cut corners off: with 30 of them wild commands made the tracker fall more often; 200 were no better."""

_ROOM = 0.01  # beyond what was seen, as a share of it: ticks of a real clock are not those of a rehearsal
_RATE_ROOM = 0.02
_ACROSS_S = 1.0
_LEAST = 1e-3  # what never moves may move by so much
_NO_SPREAD = 1e-9  # keeps a direction without any from an infinite weight
_DIGITS = 6


class Survived(NamedTuple):
    """A motion that was played: how it went, and the commands that the policy got, shape (steps, m)."""

    rehearsal: Rehearsal
    commands: Floats


class PolicyCommands(NamedTuple):
    """The commands of a policy: their format, the time between two [s], and the sha256 of its network."""

    command: CommandFormat
    period_s: float
    sha256: str


def commands_of(config: RigConfig) -> PolicyCommands:
    """Return what an envelope of a policy is measured of.

    Raises:
        StationError: the robot or the policy cannot be loaded, or they do not fit.
        UsageError: the policy follows velocities.
    """
    rig = build(config)
    rig.robot.close()
    if set(VELOCITIES) <= set(names_of(rig.command_format.elements)):
        raise UsageError(
            f"policy {config.policy!r} follows velocities: motions do not show which of them it survives; "
            "--suite --only envelope tries it"
        )
    return PolicyCommands(rig.command_format, rig.period_s, rig.policy.spec.sha256)


def play(motions: Sequence[str], config: RigConfig, *, holes: str = "refuse", jobs: int = 0,
         on_done: Callable[[Survived], None] | None = None) -> list[Survived]:  # fmt: skip
    """Rehearse motions without an envelope: arguments and errors as of `station.rehearse.rehearse_all`."""
    free = msgspec.structs.replace(config, envelope="none")
    return list(side_by_side.run(_play, [(motion, free, holes) for motion in motions], jobs=jobs, on_done=on_done))


def is_survived(played: Survived) -> bool:
    """Whether a motion was tracked to its end, as closely as the suite asks for."""
    error = played.rehearsal.mean_joint_error_rad
    return not played.rehearsal.fell and error is not None and error <= JOINT_ERROR_RAD


def measured(survived: Sequence[Floats], command: CommandFormat, period_s: float) -> Envelope:
    """Return the envelope of commands that a policy survived.

    Args:
        survived: Streams of commands, shape (steps, m) each.
        command: Format of the commands.
        period_s: Time between two [s].

    Raises:
        UsageError: there are none.
    """
    names = names_of(command.elements)
    bounded = [index for index, name in enumerate(names) if not any(word in name for word in REACHING + WRIST)]
    reaching = [index for index, name in enumerate(names) if any(word in name for word in REACHING)]
    streams = [each - command.default for each in survived]
    if not streams or not bounded:
        raise UsageError("no motion was tracked without a fall; an envelope is made of those that are")
    changes = [each[:, bounded] for each in streams]
    weights = _directions(changes)
    sums = [each @ weights.T for each in changes]
    return Envelope(
        bounded=_ranges(command, bounded, streams, period_s),
        reaching=_ranges(command, reaching, streams, period_s, width=(command.upper - command.lower)[reaching]),
        sums=tuple(_numbers(row) for row in weights),
        spans=tuple(_span(over_s, sums, period_s) for over_s in OVER_S)
        + tuple(_span(over_s, sums, period_s, is_change=True) for over_s in CHANGES_S),
    )


def _directions(changes: Sequence[Floats]) -> Floats:
    """Return weights of the principal directions of changes, and of directions between them, shape (k, e)."""
    lower, upper = _ends(changes)
    half = (upper - lower) / 2.0
    everything = np.concatenate(changes) / half
    _, spread, principal = np.linalg.svd(everything, full_matrices=False)
    alike = principal / (spread[:, None] / math.sqrt(len(everything)) + _NO_SPREAD)
    random, between = np.random.default_rng(0), []
    for _ in range(_BETWEEN):
        some = random.choice(len(alike), min(int(random.integers(2, 5)), len(alike)), replace=False)
        row = random.choice([-1.0, 1.0], len(some)) @ alike[some]
        between.append(row / np.linalg.norm(row))
    found: Floats = (np.vstack([principal, *between]) / half).round(_DIGITS)
    return found


def write(envelope: Envelope, file: Path, motions: Sequence[str], *, by: str = "station rehearse --envelope") -> None:
    """Write an envelope as YAML, and above it of which motions it is, and what measured it; whole, or not at all."""
    lines = [f"# What the policy survives, measured by `{by}` from {len(motions)} motions:"]
    lines += [f"# {motion}" for motion in motions]
    for name in ("bounded", "reaching"):
        lines.append(f"{name}:")
        lines += [f"  {key}: {_row(value)}" for key, value in msgspec.structs.asdict(getattr(envelope, name)).items()]
    lines += ["sums:", *(f"- {_row(row)}" for row in envelope.sums), "spans:"]
    for span in envelope.spans:
        lines += [f"- over_s: {span.over_s:g}", f"  lower: {_row(span.lower)}", f"  upper: {_row(span.upper)}"]
        lines += ["  is_change: true"] if span.is_change else []
    write_atomic(file, ("\n".join(lines) + "\n").encode())


def _ranges(
    command: CommandFormat, own: list[int], streams: Sequence[Floats], period_s: float, *, width: Floats | None = None
) -> Ranges:
    """Return the ranges and rates of some elements in streams of changes from standing, shape (steps, m) each.

    An element is at least fast enough to cross its range, or a given width, in `_ACROSS_S`: it has to come back too.
    """
    changes = [each[:, own] for each in streams]
    lower, upper = _ends(changes)
    fastest = np.max([np.abs(np.diff(each, axis=0)).max(axis=0) for each in changes], axis=0) / period_s
    least = (upper - lower if width is None else width) / _ACROSS_S
    return Ranges(
        elements=tuple(command.elements[index].name for index in own),
        lower=_numbers(command.default[own] + lower),
        upper=_numbers(command.default[own] + upper),
        rate=_numbers(np.maximum(fastest * (1.0 + _RATE_ROOM), least)),
    )


def _span(over_s: float, sums: Sequence[Floats], period_s: float, *, is_change: bool = False) -> Span:
    """Return between what sums, shape (steps, k) each, were."""
    averages = [_averaged(each, period_s / over_s) if over_s else each for each in sums]
    lower, upper = _ends(
        [each - average for each, average in zip(sums, averages, strict=True)] if is_change else averages
    )
    return Span(over_s=over_s, lower=_numbers(lower), upper=_numbers(upper), is_change=is_change)


def _ends(changes: Sequence[Floats]) -> tuple[Floats, Floats]:
    """Return the least and greatest of each column, and some room; standing, 0, is inside."""
    lower = np.min([each.min(axis=0) for each in changes], axis=0)
    upper = np.max([each.max(axis=0) for each in changes], axis=0)
    return np.minimum(lower * (1.0 + _ROOM), -_LEAST), np.maximum(upper * (1.0 + _ROOM), _LEAST)


def _averaged(sums: Floats, part: float) -> Floats:
    averages, average = np.empty_like(sums), np.zeros(sums.shape[1])
    for step, each in enumerate(sums):
        average = average + part * (each - average)
        averages[step] = average
    return averages


def _row(values: Sequence[float | str]) -> str:
    """Return a list in YAML, for which 1e-06 is no number."""
    words = [each if isinstance(each, str) else np.format_float_positional(each, trim="0") for each in values]
    return f"[{', '.join(words)}]"


def _numbers(values: Floats) -> tuple[float, ...]:
    return tuple(values.round(_DIGITS).tolist())


def _play(task: tuple[str, RigConfig, str]) -> Survived:
    motion, config, holes = task
    made: list[Floats] = []
    rehearsal = rehearse_named(
        motion, config, holes=holes, on_step=lambda _, record: made.append(record.decision.vector)
    )
    return Survived(rehearsal, np.array(made))
