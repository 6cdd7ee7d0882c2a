"""What an export format is; formats are found by name through the registry (entry points ``station.exports``).

An export goes through four steps, whatever the format. Only the second is heavy, and it is one call per episode:

1. ``prepare(sources, options)`` looks at as few episodes as it can and returns a *plan*: everything that must be the
   same in all of them (columns, rate, size of pictures). Here a request that fits no episode is refused.
2. ``convert(source, plan, folder)`` writes what one episode gives, its *shard*, into an empty folder, and returns
   `ShardResult`. It runs in a process of its own, possibly on another machine, one episode at a time. An episode that
   cannot be converted raises `StationError` with one line that names the key; it is left out and told of, nothing else
   stops.
3. `station.export.shards` gives a whole shard its name by one rename. A shard is known by its episode, the plan and the
   version of the format, so an export that was killed goes on with what is missing. The verdict that a check wrote of
   an episode stands, so other rules change nothing; where the export itself judged, a shard is kept for those rules.
4. ``join(shards, plan, folder)`` makes the result of all shards in an empty folder, which then gets its final name by
   one rename: nothing half is ever visible. A format without a join has the files of all shards as its result, so
   their names must differ: begin them with the episode's id.

A format that can add to its own finished result has a ``reopen``. Then the plan is that of the result, the result with
the new episodes is made beside it, and the two folders exchange their names in one step.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec

MinQuality = Literal["good", "usable", "any"]
Success = Literal["yes", "no", "any"]

SUCCESS = "Only episodes that the operator called a success (yes) or a failure (no)."


class ExportOptions(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What every format can be asked; a format's own options extend it.

    Each field is one option of the command line: its name with dashes, its ``Meta(description=…)`` as help, a
    `Literal` as a choice, a ``tuple[str, ...]`` as names with commas between them. A field that the type or
    ``__post_init__`` refuses raises `ValueError`, which `station.config.build` turns into one line.

    Attributes:
        min_quality: Least verdict of `station check` that an episode needs: the one in its manifest; one that was never
            measured is measured, by the rules of the user who exports.
        success: What the operator must have said of it; any takes those too of which nobody said anything.
    """

    min_quality: Annotated[MinQuality, msgspec.Meta(description="Least verdict of `station check`.")] = "usable"
    success: Annotated[Success, msgspec.Meta(description=SUCCESS)] = "any"


class Source(msgspec.Struct, frozen=True, kw_only=True):
    """One episode to be exported.

    Attributes:
        episode_id: Its id; no two sources of an export have the same.
        folder: Its folder, absolute.
    """

    episode_id: str
    folder: str


class ShardResult(msgspec.Struct, frozen=True, kw_only=True):
    """What `convert` says of the shard that it wrote; it is kept as JSON beside the shard.

    Attributes:
        seconds: Length of the robot's time in it [s].
        rows: Rows (messages, where a format has no rows).
        facts: Anything that `join` needs without reading the shard again; plain values that JSON can hold. `join` finds
            ``verdict`` among them, that of the files as they are, "" for none.
    """

    seconds: float
    rows: int
    facts: dict[str, Any] = {}


@dataclass(frozen=True, slots=True)
class Shard:
    """A whole shard: the episode it is of, its folder with the files that `convert` wrote, and what that said."""

    source: Source
    folder: Path
    made: ShardResult


class SkippedEpisode(msgspec.Struct, frozen=True, kw_only=True):
    """An episode that is not in the result, and why in one line that names the episode."""

    source: Source
    reason: str


@dataclass(frozen=True, slots=True)
class Reopened:
    """A finished result that episodes can be added to.

    Attributes:
        plan: What all its episodes have in common; those that are added must have it too.
        episodes: Ids of those in it, each with the sha256 of its recording of signals.
        join: ``(shards, left_out, folder) -> facts``: makes the result with these shards behind its own episodes, as
            `ExportKind.join` does; what it leaves as it is it may link (`station.export.shards.place`).
    """

    plan: Any
    episodes: Mapping[str, str]
    join: Callable[[Sequence[Shard], Sequence[SkippedEpisode], Path], dict[str, Any]]


Prepare = Callable[[Sequence[Source], Any], msgspec.Struct]
Convert = Callable[[Source, Any, Path], ShardResult]
Inspect = Callable[[Source, Any], Sequence[str]]
Join = Callable[[Sequence[Shard], Sequence[SkippedEpisode], Any, Path], dict[str, Any]]
Reopen = Callable[[Path, Mapping[str, Any]], Reopened]


@dataclass(frozen=True, slots=True)
class ExportKind:
    """One format.

    Attributes:
        name: As it is registered, for example ``lerobot``.
        summary: What it makes, in one line, for ``station export --help``.
        options: Type of its options.
        prepare: ``(sources, options) -> plan``. The plan is a `msgspec.Struct` that survives pickling and JSON (it is
            part of a shard's fingerprint, so it holds no times and no paths of the output). `sources` is never empty.
            Raises `StationError` when no source can be exported so: one line that names key and cure.
        convert: ``(source, plan, folder) -> Made``. A function of a module (workers import it by the format's name);
            `folder` exists and is empty. It holds no more than this one episode in memory, pictures one at a time.
            Raises `StationError` for an episode that does not fit, `OSError` when the disk refuses.
        join: ``(shards, left_out, plan, folder) -> facts``, or None. Shards come in the order of their sources;
            `folder` exists and is empty; shards are not to be changed (`station.export.shards.place` links a file
            instead of copying it). Returns facts of the result for people and programs, plain values; each line of
            ``notes`` among them is told. Never called without shards.
        columns: ``(plan) -> lines``, or None: a line for each column of the result that says what stands in it, for
            ``--dry-run``. Without it the keys of the plan are told, with names and units.
        inspect: ``(source, plan) -> notes``, or None: for ``--dry-run``, all the checks of `convert` that need no
            output, by the same code; raises the same `StationError`. Each note is a line on what the result would lack.
        reopen: ``(folder, given) -> Reopened``, or None where nothing can be added to a result. `given` has the options
            that were asked for, no defaults. Raises `StationError` where the folder is no result of this format, or was
            made with other options than those: one line that names the first difference.
        version: Counted up when the same episode and plan give other bytes; then older shards are made anew.
    """

    name: str
    summary: str
    options: type[ExportOptions]
    prepare: Prepare
    convert: Convert
    join: Join | None = None
    columns: Callable[[Any], Sequence[str]] | None = None
    inspect: Inspect | None = None
    reopen: Reopen | None = None
    version: int = 1
