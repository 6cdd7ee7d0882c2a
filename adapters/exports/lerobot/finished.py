"""A finished data set, read to add episodes to it: what it was made of, and what its statistics are made of."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec

from adapters.exports.arrow_library import pq
from adapters.exports.lerobot import parquet, stats
from adapters.exports.lerobot.features import features
from adapters.exports.lerobot.parquet import Columns
from adapters.exports.lerobot.plan import IMAGES, VERSION, Plan
from station.errors import BadFile, UsageError
from station.export.kind import Shard, ShardResult, SkippedEpisode, Source
from station.export.shards import place

PROVENANCE = "meta/station.json"
PIXELS = "meta/pixel_counts.json"

_OF_AN_EPISODE = ("episode_index", "episode_id", "rows")
_CARD = "README.md"


class _Provenance(msgspec.Struct, frozen=True, kw_only=True):
    """What of `PROVENANCE` is read again."""

    plan: Plan
    software: dict[str, Any]
    episodes: list[dict[str, Any]]
    left_out: list[dict[str, str]]
    added: list[dict[str, Any]] = []


@dataclass(frozen=True, kw_only=True, slots=True)
class Finished:
    """A data set of an earlier export.

    Attributes:
        folder: Where it lies.
        plan: What it was made as.
        shards: Its episodes with their facts; the folders of these are gone.
        left_out: What was not good enough for it, or failed.
        software: What made it.
        added: What has added to it since, and from which episode on.
        pixels: Brightness of all its pictures by column.
    """

    folder: Path
    plan: Plan
    shards: tuple[Shard, ...]
    left_out: tuple[SkippedEpisode, ...]
    software: dict[str, Any]
    added: tuple[dict[str, Any], ...]
    pixels: Mapping[str, stats.PixelCounts]

    def stats(self) -> Iterator[dict[str, stats.Stats]]:
        """Yield the statistics of each episode by column, without pictures."""
        if self.plan.layout == "v2.1":
            with (self.folder / "meta/episodes_stats.jsonl").open(encoding="utf-8") as lines:
                for line in lines:
                    found = json.loads(line)["stats"]
                    yield {column: found[column] for column in found if not column.startswith(IMAGES)}
            return
        for file in sorted((self.folder / "meta/episodes").rglob("*.parquet")):
            table = pq.ParquetFile(file)
            wanted = [name.rpartition("/") for name in table.schema_arrow.names if name.startswith("stats/")]
            numbers = [(column, name) for column, _, name in wanted if not column.startswith(f"stats/{IMAGES}")]
            for group in range(table.num_row_groups):
                for row in table.read_row_group(group, [f"{column}/{name}" for column, name in numbers]).to_pylist():
                    each: dict[str, stats.Stats] = {}
                    for column, name in numbers:
                        each.setdefault(column.removeprefix("stats/"), {})[name] = row[f"{column}/{name}"]
                    yield each

    def rows(self) -> Iterator[Columns]:
        """Yield its rows, some at a time."""
        for file in sorted((self.folder / "data").rglob("*.parquet")):
            yield from parquet.read_parts(file)

    def carry(self, folder: Path) -> None:
        """Give all its files a place in the folder of the new data set.

        Those that will be written over are copies, the others links: rows and videos cost no space twice, and who has
        them open reads on.
        """
        rewritten = self.folder / "meta"

        def carried(source: str, target: str) -> None:
            file = Path(source)
            if file.parent == rewritten or file == self.folder / _CARD:
                shutil.copyfile(file, target)
            else:
                place(file.resolve(), Path(target))

        shutil.copytree(self.folder, folder, copy_function=carried, dirs_exist_ok=True)


def read(folder: Path) -> Finished:
    """Read what a data set is.

    Raises:
        BadFile: it is none that this version made, or was changed since, or none that can be added to; says which.
    """
    try:
        document = json.loads((folder / PROVENANCE).read_bytes())
        info = json.loads((folder / "meta/info.json").read_bytes())
        made_by = document.get("format", 0)
        if made_by != VERSION:
            raise BadFile(
                _anew(folder, f"its rows are of version {made_by} of the format, this station's of {VERSION}")
            )
        found = msgspec.convert(document, _Provenance)
        counts = json.loads((folder / PIXELS).read_bytes())
        pixels = {column: stats.PixelCounts(**counted) for column, counted in counts.items()}
        shards = tuple(_shard(each, found.plan) for each in found.episodes)
        expected = {"total_episodes": len(shards), "total_frames": sum(shard.made.rows for shard in shards),
                    "fps": found.plan.fps, "features": features(found.plan)}  # fmt: skip
        for name, value in expected.items():
            if info[name] != value:
                raise BadFile(_anew(folder, f"changed since: {_difference(name, info[name], value)}"))
    except FileNotFoundError as error:
        raise BadFile(
            f"{folder}: no LeRobot data set of this station, it has no {Path(error.filename).relative_to(folder)}; "
            "name one that `station export lerobot` made"
        ) from error
    except (ValueError, KeyError, TypeError, AttributeError) as error:  # json's and msgspec's are ValueErrors
        raise BadFile(_anew(folder, f"{PROVENANCE} or meta/info.json holds something else: {error!r}")) from error
    if found.plan.val:
        raise BadFile(_anew(folder, f"made with --val {found.plan.val:g}, so its last episodes are set aside"))
    return Finished(
        folder=folder,
        plan=found.plan,
        shards=shards,
        left_out=tuple(SkippedEpisode(source=_source(each), reason=each["reason"]) for each in found.left_out),
        software=found.software,
        added=tuple(found.added),
        pixels=pixels,
    )


def expect_options(had: Finished, given: Mapping[str, Any]) -> None:
    """Refuse options that the data set was not made with.

    Raises:
        UsageError: one of those given is another; names the first.
    """
    plan, common = had.plan, had.plan.common
    made = msgspec.structs.asdict(plan) | {
        "robot": common.robot,
        "state": tuple(one.key for one in common.state),
        "action": tuple(one.key for one in common.action),
        "camera": tuple(camera.name for camera in common.cameras),
        "depth": common.has_depth,
    }
    for name, value in given.items():
        if name in made and value != made[name]:
            raise UsageError(
                f"{had.folder}: made with --{name} {_said(made[name])}, and --{name} {_said(value)} is asked for; "
                "leave the option out, or export into another folder"
            )


def signals_sha256(shard: Shard) -> str:
    """Return the sha256 of the signals that an episode was made of."""
    digests: Mapping[str, str] = shard.made.facts["sha256"]
    return next((digest for name, digest in digests.items() if name.startswith("signals")), "")


def _shard(each: Mapping[str, Any], plan: Plan) -> Shard:
    facts = {name: value for name, value in each.items() if name not in _OF_AN_EPISODE}
    made = ShardResult(seconds=each["rows"] / plan.fps, rows=each["rows"], facts=facts)
    return Shard(_source(each), Path(), made)


def _source(each: Mapping[str, Any]) -> Source:
    return Source(episode_id=each["episode_id"], folder="")


def _anew(folder: Path, why: str) -> str:
    return f"{folder}: cannot be added to: {why}; export all its episodes again into another folder"


def _difference(name: str, found: Any, made: Any) -> str:
    if not isinstance(found, dict) or not isinstance(made, dict):
        return f"{name} in meta/info.json is {found}, the station made {made}"
    differing = next(key for key in (*made, *found) if found.get(key) != made.get(key))
    return f"column {differing!r} in meta/info.json is not the one that the station made"


def _said(value: Any) -> str:
    if isinstance(value, Sequence) and not isinstance(value, str):
        return ",".join(value) or "none"
    return str(value)
