"""Shards: what one episode gives, made in a process of its own, whole or not there, and found again by a later run.

While an export is under way everything lies in ``.NAME.export`` beside the folder NAME that is asked for. NAME itself
appears by one rename, at the end; where episodes are added to it, the old and the new one exchange names. All of it is
on one file system, which workers on other machines must share.
"""

from __future__ import annotations

import errno
import fcntl
import hashlib
import os
import shutil
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Literal

import msgspec

from station import registry
from station.atomic_file import exchange, sync_folder, write_atomic
from station.episode.quality.finding_parts import RulesFile
from station.episode.quality.rule_file import RuleBook, of_user
from station.episode.storage import layout
from station.episode.storage.folder import signals_file
from station.episode.storage.manifest_copy import find_manifest
from station.errors import BadFile, EpisodeError, StationError
from station.export import verdict
from station.export.kind import ExportKind, MinQuality, Reopened, Shard, ShardResult, SkippedEpisode, Source, Success

_RECORD = "made.json"
_FILES = "files"
_SHARDS, _MAKING, _JOINED = "shards", "making", "joined"
_OF_AN_EPISODE = (layout.MANIFEST, *layout.SIGNALS_NAMES[:2], *layout.CAMERAS_NAMES[:2])


class Task(msgspec.Struct, frozen=True, kw_only=True):
    """One call of `make_shard`: picklable, complete, the same wherever it runs.

    Attributes:
        format: Registered name of the format.
        source: The episode.
        plan: What the format's `prepare` returned.
        min_quality, success: Least verdict that the episode needs, and what its operator shall have said.
        book: The rules for an episode that no check has judged; None: those of the user who runs it.
        work: From `open_work`.
    """

    format: str
    source: Source
    plan: Any
    min_quality: MinQuality
    work: str
    book: RuleBook | None = None
    success: Success = "any"


class Outcome(msgspec.Struct, frozen=True, kw_only=True):
    """What became of one episode.

    Attributes:
        source: The episode.
        status: ``made`` now, ``kept`` from an earlier run, ``there`` in the result that is added to, ``left-out``
            because it is not good enough, or ``failed``.
        reason: Why it is not there, in one line that names the episode.
        made: Of a shard that is there.
    """

    source: Source
    status: Literal["made", "kept", "there", "left-out", "failed"]
    reason: str = ""
    made: ShardResult | None = None

    @property
    def is_lost(self) -> bool:
        """Whether the result has nothing of it."""
        return self.status in ("left-out", "failed")


class _Record(msgspec.Struct, frozen=True, kw_only=True):
    """What stands beside a shard; `rules` as of `verdict.Judged`: with others its episode is judged again."""

    fingerprint: str
    rules: tuple[RulesFile, ...]
    made: ShardResult


@contextmanager
def open_work(out: Path, *, is_added_to: bool = False, hint: str = "") -> Iterator[Path]:
    """Claim an output folder for this process; give the folder in which the export works, kept when it is left.

    Args:
        out: The output.
        is_added_to: Whether it is a finished result, whose place the one with more episodes takes; else it must not be
            there, or be empty.
        hint: What else can be done with an output that is there.

    Raises:
        BadFile: the output is there already and not empty, or is to be added to and is not there; another process
            exports to it; or it cannot be made.
    """
    out = out.absolute()
    is_there = out.exists() and (not out.is_dir() or any(out.iterdir()))
    if is_there and not is_added_to:
        raise BadFile(f"{out}: is there already and not empty; remove it, {hint}or name another folder with --out")
    if is_added_to and not is_there:
        raise BadFile(f"{out}: nothing there to add to; without --append it is made")
    work = out.parent / f".{out.name}.export"
    try:
        (work / _SHARDS).mkdir(parents=True, exist_ok=True)
        descriptor = os.open(work / "lock", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
    except OSError as error:
        raise BadFile(f"{out}: cannot export there: {error.strerror}; name another folder with --out") from error
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise BadFile(f"{out}: another export to it is under way; wait for it, or name another folder") from None
        shutil.rmtree(work / _MAKING, ignore_errors=True)  # of a run that was killed
        shutil.rmtree(work / _JOINED, ignore_errors=True)
        try:
            if is_added_to:
                _expect_exchange(work, out)
            yield work
        finally:
            _leave_nothing_empty(work)
    finally:
        os.close(descriptor)


def _expect_exchange(work: Path, out: Path) -> None:
    """Try what adding ends with, before hours of work."""
    one, other = work / _JOINED, work / _MAKING
    try:
        if out.stat().st_dev != work.stat().st_dev:
            raise OSError(errno.EXDEV, "it is mounted there")
        one.mkdir()
        other.mkdir()
        exchange(one, other)
    except OSError as error:
        raise BadFile(
            f"{out}: nothing can be added there, since its file system does not exchange two folders in one step "
            f"({error.strerror}); export all episodes into another folder"
        ) from error
    finally:
        for each in (one, other):
            shutil.rmtree(each, ignore_errors=True)


def _leave_nothing_empty(work: Path) -> None:
    """Remove a folder in which no shard was made: there is nothing that a later run could go on from."""
    with suppress(OSError):  # it holds shards, or is gone: the export was finished
        (work / _SHARDS).rmdir()
        shutil.rmtree(work, ignore_errors=True)


def make_shard(task: Task) -> Outcome:
    """Make the shard of one episode, or find it made; what is wrong with an episode is told, not raised.

    Raises:
        OSError: the disk refuses, which is not the episode's fault; a later run goes on here.
    """
    kind: ExportKind = registry.find("export", task.format)
    place = Path(task.work) / _SHARDS / task.source.episode_id
    try:
        before = _fingerprint(kind, task)
        record = _record(place)
        if record is not None and record.fingerprint == before and _are_those(task, record.rules):
            return Outcome(source=task.source, status="kept", made=record.made)
        judged = verdict.expect(task.source, task.min_quality, task.book, success=task.success)
        made = _make(kind, task, place, before, judged)
    except verdict.NotWanted as error:
        return Outcome(source=task.source, status="left-out", reason=str(error))
    except StationError as error:
        return Outcome(source=task.source, status="failed", reason=_named(task.source, str(error)))
    return Outcome(source=task.source, status="made", made=made)


def sort_out(had: Reopened, sources: Sequence[Source]) -> list[Outcome]:
    """Return what becomes of the episodes that need no conversion: a result has them, or another one of their id."""
    found: list[Outcome] = []
    for source in sources:
        if source.episode_id not in had.episodes:
            continue
        try:
            digest, other = _digest(Path(source.folder)), had.episodes[source.episode_id]
        except (EpisodeError, OSError) as error:
            found.append(Outcome(source=source, status="failed", reason=_named(source, str(error))))
            continue
        why = (
            f"{source.episode_id}: the data set has another recording of this id (signals of sha256 {other[:12]}, this "
            f"one {digest[:12]}); give the folder of one another name"
        )
        is_same = digest == other
        found.append(Outcome(source=source, status="there" if is_same else "failed", reason="" if is_same else why))
    return found


def _digest(folder: Path) -> str:
    """Return the sha256 of a recording of signals: as its manifest says of a file of its size, else measured."""
    signals = signals_file(folder)
    size = signals.stat().st_size
    stated = (file for file in find_manifest(folder).manifest.files if (file.name, file.bytes) == (signals.name, size))
    return next((file.sha256 for file in stated if file.sha256), "") or _sha256(signals)


def _sha256(path: Path) -> str:
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def finish(
    kind: ExportKind, plan: Any, outcomes: Sequence[Outcome], work: Path, out: Path, had: Reopened | None = None
) -> dict[str, Any]:
    """Join all shards, give the result its name, and remove what the export worked in; return the result's facts.

    A result that is added to, `had`, is exchanged for the new one; where nothing is new it stays as it is.

    Raises:
        EpisodeError: not one episode could be converted; names the first reason.
        OSError: the disk refuses; the shards stay for a later run.
    """
    left_out = [SkippedEpisode(source=o.source, reason=o.reason) for o in outcomes if o.is_lost]
    shards = [
        Shard(outcome.source, work / _SHARDS / outcome.source.episode_id / _FILES, outcome.made)
        for outcome in outcomes
        if outcome.made is not None
    ]
    if not shards and len(left_out) < len(outcomes):
        for outcome in outcomes:  # of a run that was killed after the exchange
            shutil.rmtree(work / _SHARDS / outcome.source.episode_id, ignore_errors=True)
        return {}
    if not shards:
        more = f" (and {len(left_out) - 1} more)" if len(left_out) > 1 else ""
        why = left_out[0].reason if left_out else "none was named"
        raise EpisodeError(f"no episode could be {'exported' if had is None else 'added'}; {why}{more}")
    joined = work / _JOINED
    shutil.rmtree(joined, ignore_errors=True)
    joined.mkdir()
    if had is not None:
        facts = had.join(shards, left_out, joined)
    else:
        facts = kind.join(shards, left_out, plan, joined) if kind.join else _all_files(shards, joined)
    _sync(joined)
    if had is not None:
        exchange(joined, out)
    else:
        if out.is_dir():
            out.rmdir()  # empty, or this refuses
        os.replace(joined, out)
    sync_folder(out.absolute().parent)
    shutil.rmtree(work, ignore_errors=True)
    return facts


def place(file: Path, target: Path) -> None:
    """Give a shard's file a place in the result too: by a link, or a copy where the file system has none."""
    target.parent.mkdir(parents=True, exist_ok=True)
    try:
        os.link(file, target)
    except OSError as error:
        if error.errno not in (errno.EPERM, errno.EOPNOTSUPP, errno.EMLINK, errno.EXDEV):
            raise
        shutil.copyfile(file, target)


def _are_those(task: Task, rules: tuple[RulesFile, ...]) -> bool:
    """Whether the rules that let an episode in are today's; where its manifest did, they are not asked."""
    return not rules or rules == (task.book or of_user()).files


def _make(kind: ExportKind, task: Task, place: Path, before: str, judged: verdict.VerdictCheck) -> ShardResult:
    making = Path(task.work) / _MAKING / f"{task.source.episode_id}.{os.getpid()}"
    shutil.rmtree(making, ignore_errors=True)
    (making / _FILES).mkdir(parents=True)
    try:
        made = kind.convert(task.source, task.plan, making / _FILES)
        made = msgspec.structs.replace(made, facts=made.facts | {"verdict": judged.verdict or ""})
        if _fingerprint(kind, task) != before:
            raise EpisodeError("changed while it was read; export it again when it is written no more")
        _sync(making)
        record = _Record(fingerprint=before, rules=judged.rules, made=made)
        write_atomic(making / _RECORD, msgspec.json.encode(record))
        shutil.rmtree(place, ignore_errors=True)  # an older one, of other options
        os.replace(making, place)
    finally:
        shutil.rmtree(making, ignore_errors=True)
    return made


def _fingerprint(kind: ExportKind, task: Task) -> str:
    """Name an episode as it is now, a verdict in its manifest included, with what is asked for and made of it."""
    folder = Path(task.source.folder)
    files = sorted(path for pattern in _OF_AN_EPISODE for path in folder.glob(pattern))
    if not files:
        raise EpisodeError(f"{folder}: no episode any more; was it moved?")
    manifest = folder / layout.MANIFEST
    facts = [
        kind.name, kind.version, task.min_quality, task.success, task.plan,
        [(path.name, path.stat().st_size, path.stat().st_mtime_ns) for path in files if path != manifest],
        hashlib.sha256(manifest.read_bytes()).hexdigest() if manifest in files else "",
    ]  # fmt: skip
    return hashlib.sha256(msgspec.json.encode(facts)).hexdigest()


def _record(place: Path) -> _Record | None:
    """Return what stands beside a shard; one that cannot be read is none."""
    try:
        return msgspec.json.decode((place / _RECORD).read_bytes(), type=_Record)
    except (OSError, msgspec.DecodeError):
        return None


def _all_files(shards: Iterable[Shard], folder: Path) -> dict[str, Any]:
    count = 0
    for shard in shards:
        for file in sorted(path for path in shard.folder.rglob("*") if path.is_file()):
            place(file, folder / file.relative_to(shard.folder))
            count += 1
    return {"files": count}


def _named(source: Source, text: str) -> str:
    return text if source.episode_id in text else f"{source.episode_id}: {text}"


def _sync(folder: Path) -> None:
    """Wait until every file of a folder is on the disk."""
    for path in sorted(folder.rglob("*")):
        if path.is_file():
            descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
            try:
                os.fsync(descriptor)
            finally:
                os.close(descriptor)
        else:
            sync_folder(path)
    sync_folder(folder)
