"""The format as `station export` sees it: its options, and its three steps; what is heavy is imported by the steps."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

from msgspec import Meta

from adapters.exports.lerobot import plan as plans
from adapters.exports.lerobot.av_library import Codec
from adapters.exports.lerobot.plan import Layout, Plan
from station.export.kind import ExportOptions, Shard, ShardResult, SkippedEpisode, Source

NO_CAMERA = "none"

_STATE = (
    "Keys of observation.state.  [default: robot_state of the episodes' robot, state_joints of an arm; and the state "
    "of each hand and of the neck that moves in the first episode]"
)
_ACTION = (
    "Keys of action.  [default: command_used of the episodes' robot, the command that the policy was given; and the "
    "command of each hand and of the neck that moves in the first episode]"
)
_CODEC = "Of the video; av1, LeRobot's own, is slower to make and about as large, with better pictures."
_CAMERA = f"Cameras; `{NO_CAMERA}` for no pictures.  [default: all]"


class LeRobotOptions(ExportOptions, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What a LeRobot data set can be asked to be.

    Attributes:
        fps: Rows per second.
        state, action: Keys whose numbers stand one behind the other in a column; empty for the defaults.
        camera: Names of cameras; empty for all, `NO_CAMERA` alone for none.
        layout: Version of the format.
        codec: Of the video.
        val: Share of the episodes that is set aside for validation, 0 to below 1.
        seed: Which ones: the same seed sets the same episodes aside.
    """

    fps: Annotated[int, Meta(ge=1, le=1000, description="Rows per second.")] = 50
    state: Annotated[tuple[str, ...], Meta(description=_STATE)] = ()
    action: Annotated[tuple[str, ...], Meta(description=_ACTION)] = ()
    camera: Annotated[tuple[str, ...], Meta(description=_CAMERA)] = ()
    layout: Annotated[Layout, Meta(description="v3.0 for LeRobot; v2.1 for GR00T and openpi.")] = "v3.0"
    codec: Annotated[Codec, Meta(description=_CODEC)] = "h264"
    val: Annotated[float, Meta(ge=0.0, lt=1.0, description="Share of the episodes that is set aside.")] = 0.0
    seed: Annotated[int, Meta(description="Decides which episodes are set aside.")] = 0


def prepare(sources: Sequence[Source], options: LeRobotOptions) -> Plan:
    """Return what all episodes of the data set have in common; see `ExportKind.prepare`."""
    wish = plans.PlanRequest(
        state=options.state,
        action=options.action,
        cameras=() if options.camera == (NO_CAMERA,) else options.camera or None,
        min_quality=options.min_quality,
    )
    common = plans.common(sources, wish)
    return Plan(
        layout=options.layout, fps=options.fps, codec=options.codec, val=options.val, seed=options.seed, common=common
    )


def columns(plan: Plan) -> list[str]:
    """Return a line for each column; see `ExportKind.columns`."""
    common = plan.common
    sides = ((plans.STATE, common.state), (plans.ACTION, common.action))
    ages = ", ".join([*(plans.AGE + column for column, _ in sides), *(camera.age_column for camera in common.cameras)])
    return [
        *(f"{column}: {one.key}, {one}" for column, keys in sides for one in keys),
        *(f"{camera.column}: {camera.key}, {camera.width}x{camera.height}" for camera in common.cameras),
        f"{ages}: how old the values of a row are [s]",
        f"{plans.TIME}: the instant of a row [ns since the epoch]",
    ]


def inspect(source: Source, plan: Plan) -> list[str]:
    """Check whether an episode fits; see `ExportKind.inspect`."""
    from adapters.exports.lerobot import episode

    return episode.inspect(source, plan)


def convert(source: Source, plan: Plan, folder: Path) -> ShardResult:
    """Write rows and video of one episode; see `ExportKind.convert`."""
    from adapters.exports.lerobot import episode

    return episode.convert(source, plan, folder)


def join(shards: Sequence[Shard], left_out: Sequence[SkippedEpisode], plan: Plan, folder: Path) -> dict[str, Any]:
    """Make the data set; see `ExportKind.join`."""
    from adapters.exports.lerobot import dataset

    return dataset.join(shards, left_out, plan, folder)
