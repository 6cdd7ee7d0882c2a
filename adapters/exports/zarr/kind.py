"""The format as `station export` sees it: its options, and its steps; what is heavy is imported by the steps."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Any

from msgspec import Meta

from adapters.exports.lerobot import kind as lerobot
from adapters.exports.lerobot_rows import RowOptions, rows_plan
from adapters.exports.zarr.plan import Plan, Store, described
from station.export.kind import Shard, ShardResult, SkippedEpisode, Source

if TYPE_CHECKING:
    from pathlib import Path

_STORE = "A folder with a file per picture, as diffusion_policy has it; or all in one zip file, as UMI has it."


class ZarrOptions(RowOptions, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What the buffer can be asked to be.

    Attributes:
        store: Where its chunks lie.
    """

    store: Annotated[Store, Meta(description=_STORE)] = "folder"


def prepare(sources: Sequence[Source], options: ZarrOptions) -> Plan:
    """Return what all episodes have in common; see `ExportKind.prepare`."""
    from adapters.exports.zarr import zarr_library  # noqa: F401 -- that it lacks is told before any work is done

    return Plan(store=options.store, rows=rows_plan(sources, options))


def columns(plan: Plan) -> list[str]:
    """Return a line for each array; see `ExportKind.columns`."""
    return list(described(plan))


def inspect(source: Source, plan: Plan) -> list[str]:
    """Check whether an episode fits; see `ExportKind.inspect`."""
    return lerobot.inspect(source, plan.rows)


def convert(source: Source, plan: Plan, folder: Path) -> ShardResult:
    """Write the buffer of one episode; see `ExportKind.convert`."""
    from adapters.exports.zarr import episode

    return episode.convert(source, plan, folder)


def join(shards: Sequence[Shard], left_out: Sequence[SkippedEpisode], plan: Plan, folder: Path) -> dict[str, Any]:
    """Make the buffer of all; see `ExportKind.join`."""
    from adapters.exports.zarr import dataset

    return dataset.join(shards, left_out, plan, folder)
