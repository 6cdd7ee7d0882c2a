"""The format as `station export` sees it; rosbags is imported by the steps that need it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated

from msgspec import Meta

from adapters.exports.named_rows import Plan
from station.export.kind import ExportOptions, MinQuality, ShardResult, Source

if TYPE_CHECKING:
    from pathlib import Path


class BagOptions(ExportOptions, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What a bag can be asked.

    Attributes:
        min_quality: A bag is for looking at as much as for anything else, so any will do unless told otherwise.
        keys: Keys to export; none takes every key that has a topic.
    """

    min_quality: Annotated[MinQuality, Meta(description="Least verdict of `station check`.")] = "any"
    keys: Annotated[tuple[str, ...], Meta(description="Keys, with commas.  [default: all]")] = ()


def prepare(_sources: Sequence[Source], options: BagOptions) -> Plan:
    """Return the plan; see `ExportKind.prepare`."""
    from adapters.exports.ros2 import ros_types  # noqa: F401 -- that it lacks is told before any work is done

    return Plan(keys=options.keys)


def inspect(source: Source, plan: Plan) -> list[str]:
    """Check whether an episode can be converted, and say what a bag would lack; see `ExportKind.inspect`."""
    from adapters.exports.ros2 import episode

    _, found = episode.routes(source, plan)
    lacking = [f"left out: {key}: {why}" for key, why in sorted(found.left_out.items())]
    lacking += [f"no optics of {key}: {why}" for key, why in sorted(found.unfit_optics.items())]
    return [f"{source.episode_id}: {line}" for line in lacking]


def convert(source: Source, plan: Plan, folder: Path) -> ShardResult:
    """Write the bag of one episode; see `ExportKind.convert`."""
    from adapters.exports.ros2 import episode

    return episode.convert(source, plan, folder)
