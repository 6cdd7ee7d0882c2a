"""A whole export: episodes in, one folder out, resumed where an earlier run of it ended."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from station import registry
from station.episode.quality.rule_file import RuleBook
from station.errors import StationError, UsageError
from station.export import shards, verdict
from station.export.jobs import Attempt, DiskRefuses, map_episodes
from station.export.kind import ExportKind, ExportOptions, Reopened, SkippedEpisode, Source

Told = Callable[[shards.Outcome], None]


@dataclass(frozen=True, kw_only=True, slots=True)
class Workers:
    """Where the work is done: `jobs` processes here (0: one per core), or a Ray cluster as of `jobs.map_episodes`."""

    jobs: int = 0
    ray_address: str | None = None


@dataclass(frozen=True, kw_only=True, slots=True)
class Exported:
    """What an export made.

    Attributes:
        out: The folder.
        episodes: Episodes that this export put into it.
        kept: How many of them an earlier run had converted.
        had: Episodes that were in it before: of one that was added to.
        there: Which of the episodes that were asked for were among those.
        left_out: Episodes that are not good enough, and why.
        failed: Episodes that could not be converted, and why.
        seconds: Robot time in it [s].
        rows: Rows in it.
        size_bytes, files: Of the folder.
        took_s: How long it took [s].
        facts: What the format says of it.
    """

    out: Path
    episodes: int
    kept: int
    had: int
    there: tuple[str, ...]
    left_out: tuple[SkippedEpisode, ...]
    failed: tuple[SkippedEpisode, ...]
    seconds: float
    rows: int
    size_bytes: int
    files: int
    took_s: float
    facts: dict[str, Any]


@dataclass(frozen=True, kw_only=True, slots=True)
class Preview:
    """What an export would be.

    Attributes:
        sources: Episodes that would go in.
        left_out: Those that would not, and why.
        plan: The format's; None where no episode is good enough.
        notes: What the result would lack of the episodes, a line each.
        there: Ids of episodes that are in the result already.
    """

    sources: tuple[Source, ...]
    left_out: tuple[SkippedEpisode, ...]
    plan: Any
    notes: tuple[str, ...] = ()
    there: tuple[str, ...] = ()


def export(
    kind: ExportKind, sources: Sequence[Source], options: ExportOptions, out: Path, *, where: Workers,
    append: Mapping[str, Any] | None = None, on_done: Told | None = None,
) -> Exported:  # fmt: skip
    """Export episodes into a folder.

    Killed at any moment, or out of disk, it goes on where it was when it is called again with the same arguments.

    Args:
        kind: The format.
        sources: The episodes, at least one.
        options: Of the type that the format asks for.
        out: Folder to make; may exist if it is empty.
        where: Where the work is done.
        append: None, or `out` is a finished result that the episodes are added to, and these are the options that were
            asked for: the result must have been made with them. Until the end it stays as it is, and then has all.
        on_done: Called with what became of each episode, in any order.

    Raises:
        StationError: nothing can be exported so, or the disk is full; one line.
    """
    began_s, outcomes = time.monotonic(), list[shards.Outcome]()

    def on_outcome(outcome: shards.Outcome) -> None:
        outcomes.append(outcome)
        if on_done is not None:
            on_done(outcome)

    def on_result(attempt: Attempt[shards.Task, shards.Outcome]) -> None:
        on_outcome(_outcome(attempt))

    book = verdict.rule_book(options.min_quality)
    plan = kind.prepare(sources, options) if append is None else None
    out = out if append is None else out.resolve()
    hint = "add to it with --append, " if kind.reopen is not None else ""
    with shards.open_work(out, is_added_to=append is not None, hint=hint) as work:
        had = None if append is None else reopen(kind, out, append)
        if had is not None:
            plan = had.plan
            for outcome in shards.sort_out(had, sources):
                on_outcome(outcome)
        decided = {outcome.source.episode_id for outcome in outcomes}
        tasks = [
            shards.Task(
                format=kind.name, source=source, plan=plan, min_quality=options.min_quality, success=options.success,
                work=str(work), book=book,
            )
            for source in sources
            if source.episode_id not in decided
        ]  # fmt: skip
        before = list(outcomes)
        try:
            done = map_episodes(
                shards.make_shard, tasks, jobs=where.jobs, ray_address=where.ray_address, on_done=on_result
            )
            facts = shards.finish(kind, plan, [*before, *map(_outcome, done)], work, out, had)
        except (DiskRefuses, OSError) as error:
            raise _full(error, out, sum(outcome.made is not None for outcome in outcomes), len(sources)) from error
    return _exported(out, outcomes, had, facts, time.monotonic() - began_s)


def reopen(kind: ExportKind, out: Path, given: Mapping[str, Any]) -> Reopened:
    """Return a finished result that is to be added to.

    Raises:
        StationError: the format cannot, or the result is not one of these options; one line.
    """
    if kind.reopen is None:
        raise UsageError(f"export {kind.name}: cannot add to what is there; name another folder with --out")
    return kind.reopen(out, given)


def _full(error: DiskRefuses | OSError, out: Path, safe: int, tasks: int) -> StationError:
    if isinstance(error, DiskRefuses):
        why = f"{error.item.source.episode_id}: {error}" if isinstance(error.item, shards.Task) else str(error)
    else:
        why = f"{error.filename or out}: {error.strerror or error}"
    return StationError(
        f"{why}; {safe} of {tasks} episodes are converted and kept beside {out}: make room, then run the same "
        "command again"
    )


def preview(
    kind: ExportKind, sources: Sequence[Source], options: ExportOptions, *, where: Workers,
    had: Reopened | None = None, on_done: Callable[[], None] | None = None,
) -> Preview:  # fmt: skip
    """Return what an export would be, with `had` the result that it would add to, and write nothing.

    Raises:
        StationError: nothing can be exported so; one line.
    """
    decided = [] if had is None else shards.sort_out(had, sources)
    left_out = [SkippedEpisode(source=each.source, reason=each.reason) for each in decided if each.is_lost]
    there = tuple(each.source.episode_id for each in decided if not each.is_lost)
    names = {each.source.episode_id for each in decided}
    for _ in decided:
        if on_done is not None:
            on_done()
    look = _Look(options, verdict.rule_book(options.min_quality))
    attempts = map_episodes(
        look, [source for source in sources if source.episode_id not in names],
        jobs=where.jobs, ray_address=where.ray_address, on_done=None if on_done is None else lambda _: on_done(),
    )  # fmt: skip
    left_out += [SkippedEpisode(source=each.item, reason=each.error) for each in attempts if each.error]
    good = [each.item for each in attempts if not each.error]
    if not good:
        return Preview(sources=(), left_out=tuple(left_out), plan=had and had.plan, there=there)
    plan = kind.prepare(good, options) if had is None else had.plan
    looks = map_episodes(_Fits(kind.name, plan), good, jobs=where.jobs, ray_address=where.ray_address)
    left_out += [SkippedEpisode(source=each.item, reason=each.error) for each in looks if each.error]
    return Preview(
        sources=tuple(each.item for each in looks if not each.error),
        left_out=tuple(left_out),
        plan=plan,
        notes=tuple(note for each in looks for note in each.result or ()),
        there=there,
    )


class _Look:
    """Looks whether an episode is good enough; an object of a class, since it travels to other processes."""

    def __init__(self, options: ExportOptions, book: RuleBook | None) -> None:
        self._least, self._success, self._book = options.min_quality, options.success, book

    def __call__(self, source: Source) -> None:
        verdict.expect(source, self._least, self._book, success=self._success)


class _Fits:
    """Looks whether a format could convert an episode, likewise."""

    def __init__(self, format: str, plan: Any) -> None:
        self._format, self._plan = format, plan

    def __call__(self, source: Source) -> Sequence[str]:
        kind: ExportKind = registry.find("export", self._format)
        return kind.inspect(source, self._plan) if kind.inspect is not None else ()


def _outcome(attempt: Attempt[shards.Task, shards.Outcome]) -> shards.Outcome:
    """Return what became of an episode, also of one whose process died."""
    if attempt.result is not None:
        return attempt.result
    source = attempt.item.source
    return shards.Outcome(source=source, status="failed", reason=f"{source.episode_id}: {attempt.error}")


def _exported(
    out: Path, outcomes: Sequence[shards.Outcome], had: Reopened | None, facts: dict[str, Any], took_s: float
) -> Exported:
    def those(status: str) -> tuple[SkippedEpisode, ...]:
        found = [SkippedEpisode(source=each.source, reason=each.reason) for each in outcomes if each.status == status]
        return tuple(sorted(found, key=lambda each: each.source.episode_id))

    made = [each.made for each in outcomes if each.made is not None]
    sizes = [path.stat().st_size for path in out.rglob("*") if path.is_file()]
    return Exported(
        out=out,
        episodes=len(made),
        kept=sum(each.status == "kept" for each in outcomes),
        had=len(had.episodes) if had is not None else 0,
        there=tuple(each.source.episode_id for each in outcomes if each.status == "there"),
        left_out=those("left-out"),
        failed=those("failed"),
        seconds=sum(each.seconds for each in made),
        rows=sum(each.rows for each in made),
        size_bytes=sum(sizes),
        files=len(sizes),
        took_s=took_s,
        facts=facts,
    )
