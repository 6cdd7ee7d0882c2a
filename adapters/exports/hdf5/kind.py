"""The format as `station export` sees it: its options, and its three steps; what is heavy is imported by the steps."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

from msgspec import Meta

from adapters.exports.hdf5.arrays import described
from adapters.exports.hdf5.plan import Encoding, Layout, Plan
from adapters.exports.lerobot import kind as lerobot
from adapters.exports.lerobot_rows import RowOptions, rows_plan
from station.errors import UsageError
from station.export.kind import Shard, ShardResult, SkippedEpisode, Source

_LAYOUT = "robomimic: one file with all episodes; act: a file per episode, as ALOHA and ACT have it."
_ENCODING = "Pictures as pixels, or as the camera's own JPEG files.  [default: rgb for robomimic, jpeg for act]"


class Hdf5Options(RowOptions, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What the files can be asked to be.

    Attributes:
        layout: Whose files they are.
        encoding: How pictures stand in them; None for what the layout's readers expect.
        val, seed: As in `LeRobotOptions`.
    """

    layout: Annotated[Layout, Meta(description=_LAYOUT)] = "robomimic"
    encoding: Annotated[Encoding | None, Meta(description=_ENCODING)] = None
    val: Annotated[float, Meta(ge=0.0, lt=1.0, description="Share of the episodes that is set aside.")] = 0.0
    seed: Annotated[int, Meta(description="Decides which episodes are set aside.")] = 0


def prepare(sources: Sequence[Source], options: Hdf5Options) -> Plan:
    """Return what all episodes have in common; see `ExportKind.prepare`."""
    from adapters.exports.hdf5 import h5py_library  # noqa: F401 -- that it lacks is told before any work is done

    encoding: Encoding = options.encoding or ("rgb" if options.layout == "robomimic" else "jpeg")
    if options.layout == "robomimic" and encoding == "jpeg":
        raise UsageError("--encoding jpeg: robomimic reads pixels only; leave it out, or use --layout act")
    return Plan(
        layout=options.layout, encoding=encoding, rows=rows_plan(sources, options, val=options.val, seed=options.seed)
    )


def columns(plan: Plan) -> list[str]:
    """Return a line for each array; see `ExportKind.columns`."""
    return described(plan)


def inspect(source: Source, plan: Plan) -> list[str]:
    """Check whether an episode fits; see `ExportKind.inspect`."""
    return lerobot.inspect(source, plan.rows)


def convert(source: Source, plan: Plan, folder: Path) -> ShardResult:
    """Write the file of one episode; see `ExportKind.convert`."""
    from adapters.exports.hdf5 import episode

    return episode.convert(source, plan, folder)


def join(shards: Sequence[Shard], left_out: Sequence[SkippedEpisode], plan: Plan, folder: Path) -> dict[str, Any]:
    """Make the result of all; see `ExportKind.join`."""
    from adapters.exports.hdf5 import dataset

    return dataset.join(shards, left_out, plan, folder)
