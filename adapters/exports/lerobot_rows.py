"""What formats on the rows of a LeRobot data set share: their options, what plan these make, the page of the result."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Annotated

from msgspec import Meta

from adapters.exports.lerobot import kind as lerobot
from adapters.exports.lerobot.plan import Plan
from station.export import trim as trims
from station.export.kind import ExportOptions, Shard, SkippedEpisode, Source
from station.export.resample import RULES, PictureRule
from station.export.trim import Trim

_AS_LEROBOT = "As in `station export lerobot`."
_MOST_TOLD = 200  # episodes in the page; a page of thousands is read by nobody


class RowOptions(ExportOptions, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What decides the rows; all as in `LeRobotOptions`, but that depth goes in unasked."""

    fps: Annotated[int, Meta(ge=1, le=1000, description=_AS_LEROBOT)] | None = None
    state: Annotated[tuple[str, ...], Meta(description=_AS_LEROBOT)] = ()
    action: Annotated[tuple[str, ...], Meta(description=_AS_LEROBOT)] = ()
    robot: Annotated[str, Meta(description=_AS_LEROBOT)] = ""
    camera: Annotated[tuple[str, ...], Meta(description=_AS_LEROBOT)] = ()
    depth: Annotated[bool, Meta(description="Depth of the cameras, beside their pictures.")] = True
    pictures: Annotated[PictureRule, Meta(description=_AS_LEROBOT)] = "nearest"
    trim: Annotated[Trim, Meta(description=_AS_LEROBOT)] = "waiting"


def rows_plan(sources: Sequence[Source], options: RowOptions, *, val: float = 0.0, seed: int = 0) -> Plan:
    """Return what the rows of all episodes have in common; see `ExportKind.prepare`."""
    wish = lerobot.LeRobotOptions(
        min_quality=options.min_quality, success=options.success, fps=options.fps, state=options.state,
        action=options.action, robot=options.robot, camera=options.camera, depth=options.depth,
        pictures=options.pictures,
        trim=options.trim, val=val, seed=seed,
    )  # fmt: skip
    return lerobot.prepare(sources, wish)


def page(
    what: str, how: Iterable[str], described: Iterable[str], shards: Sequence[Shard],
    left_out: Sequence[SkippedEpisode], rows: Plan,
) -> str:  # fmt: skip
    """Return the README of a result.

    Args:
        what: Format and reader, for example "HDF5 as ACT reads it".
        how: Lines on how it is read.
        described: A line ``ARRAY: what stands in it`` for each array.
        shards, left_out, rows: The episodes in their order, what is not there, and what a row is.
    """
    picture = "picture" if rows.pictures == "nearest" else "newest picture"
    length = f"{len(shards)} episodes, {sum(shard.made.rows for shard in shards)} rows at {rows.fps} Hz"
    lines = [
        f"# {rows.common.robot or 'unknown'}: {length}",
        "",
        f"{what}, exported from recordings by Teleop Station. `station.json` says where each episode comes from, with "
        "hashes, and what was left out and why.",
        "",
        "A row is an instant: " + RULES["clock"] + ".",
        f"Observation: {RULES['newest']}. Action: {RULES['step']}. Picture: {RULES[picture]}.",
        f"Rows of an episode (`--trim {rows.trim}`): {trims.RULES[rows.trim]}.",
        "",
        *how,
        "",
        "| array of an episode | what stands in it |",
        "|---|---|",
        *(f"| `{path}` | {told} |" for path, _, told in (line.partition(": ") for line in described)),
        "",
        "| number | episode | task | rows |",
        "|---|---|---|---|",
        *(
            f"| {number} | {shard.source.episode_id} | {shard.made.facts['task']} | {shard.made.rows} |"
            for number, shard in enumerate(shards[:_MOST_TOLD])
        ),
        "",
        *([f"`station.json` has the other {len(shards) - _MOST_TOLD}.", ""] if len(shards) > _MOST_TOLD else []),
        *(f"Left out: {each.reason}" for each in left_out[:_MOST_TOLD]),
    ]
    return "\n".join(lines).rstrip() + "\n"
