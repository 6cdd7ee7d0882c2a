"""The format as `station export` sees it: its options, and its three steps; what is heavy is imported by the steps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Annotated, Any

from msgspec import Meta

from adapters.exports.lerobot import plan as plans
from adapters.exports.lerobot.av_library import Codec
from adapters.exports.lerobot.plan import Layout, Plan, Subtasks
from station.errors import UsageError
from station.export import trim as trims
from station.export.kind import ExportOptions, Reopened, Shard, ShardResult, SkippedEpisode, Source
from station.export.resample import PictureRule
from station.export.trim import Trim

NO_CAMERA = "none"

_STATE = (
    "Keys of observation.state.  [default: robot_state of the episodes' robot, state_joints of an arm; and the state "
    "of each hand and of the neck that moves in the first episode]"
)
_ACTION = (
    "Keys of action.  [default: command_used of the episodes' robot, the command that the policy was given; and the "
    "command of each hand and of the neck that moves in the first episode]"
)
_FPS = f"Rows per second.  [default: the rate that the slowest camera states, else {plans.DEFAULT_FPS}]"
_ROBOT = "Robot that the default keys are of, by the end of its keys.  [default: the only one in the episodes]"
_CODEC = "Of the video; av1, LeRobot's own: better pictures, several times slower to make, files as large or larger."
_GOP = (
    "Pictures of a video from one key frame to the next. To read one at random, half as many are decoded on average, "
    "all at most; 2, as LeRobot has it: 1.5, in files several times as large."
)
_TRIM = (
    "Rows that are left out: waiting, before the gate first followed a command and after it last tracked one; idle, "
    f"the still ends too; marks, outside the operator's marks `{trims.START}` and `{trims.STOP}`; none."
)
_PICTURES = (
    "Which picture a row shows: the nearest to its instant, or the newest taken by then, as a running policy has it."
)
_SUBTASKS = "The text of the operator's newest mark as LeRobot's subtask of each row, or none."
_CAMERA = f"Cameras; `{NO_CAMERA}` for no pictures.  [default: all]"
_DEPTH = (
    "Depth of the cameras too, as LeRobot 0.6 has it: video of 12 bits, in steps of 1.5 mm at 1 m and 4.4 mm at 10 m. "
    "Its own policies take every picture for one of three colours: leave depth out for them."
)


class LeRobotOptions(ExportOptions, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What a LeRobot data set can be asked to be.

    Attributes:
        fps: Rows per second; None for what `plan.rate` finds.
        state, action: Keys whose numbers stand one behind the other in a column; empty for the defaults.
        robot: Suffix of the keys of the robot that the defaults are of; "" for the only one.
        camera: Names of cameras; empty for all, `NO_CAMERA` alone for none.
        depth: Whether the depth of these cameras goes in, as `adapters.exports.lerobot.depth_codes` has it.
        layout: Version of the format.
        pictures: Which one a row shows.
        trim: Which rows are left out at the ends of an episode; `station.export.trim` has the rules.
        subtasks: Where a subtask of each row comes from.
        codec: Of the video.
        gop: Pictures from one key frame of the video to the next.
        val: Share of the episodes that is set aside for validation, 0 to below 1.
        seed: Which ones: the same seed sets the same episodes aside.
    """

    fps: Annotated[int, Meta(ge=1, le=1000, description=_FPS)] | None = None
    state: Annotated[tuple[str, ...], Meta(description=_STATE)] = ()
    action: Annotated[tuple[str, ...], Meta(description=_ACTION)] = ()
    robot: Annotated[str, Meta(description=_ROBOT)] = ""
    camera: Annotated[tuple[str, ...], Meta(description=_CAMERA)] = ()
    depth: Annotated[bool, Meta(description=_DEPTH)] = False
    layout: Annotated[Layout, Meta(description="v3.0 for LeRobot; v2.1 for GR00T and openpi.")] = "v3.0"
    pictures: Annotated[PictureRule, Meta(description=_PICTURES)] = "nearest"
    trim: Annotated[Trim, Meta(description=_TRIM)] = "waiting"
    subtasks: Annotated[Subtasks, Meta(description=_SUBTASKS)] = "none"
    codec: Annotated[Codec, Meta(description=_CODEC)] = "h264"
    gop: Annotated[int, Meta(ge=1, le=10000, description=_GOP)] = 30
    val: Annotated[float, Meta(ge=0.0, lt=1.0, description="Share of the episodes that is set aside.")] = 0.0
    seed: Annotated[int, Meta(description="Decides which episodes are set aside.")] = 0


def prepare(sources: Sequence[Source], options: LeRobotOptions) -> Plan:
    """Return what all episodes of the data set have in common; see `ExportKind.prepare`."""
    if options.depth and options.layout != "v3.0":
        raise UsageError(f"--depth: LeRobot knows depth in layout v3.0 alone, not in {options.layout}; leave one out")
    wish = plans.PlanRequest(
        state=options.state,
        action=options.action,
        cameras=() if options.camera == (NO_CAMERA,) else options.camera or None,
        has_depth=options.depth,
        robot=options.robot,
        min_quality=options.min_quality,
        success=options.success,
    )
    common = plans.common(sources, wish)
    fps, fps_as = (options.fps, "--fps") if options.fps is not None else plans.rate(common)
    return Plan(
        layout=options.layout,
        fps=fps,
        fps_as=fps_as,
        pictures=options.pictures,
        trim=options.trim,
        subtasks=options.subtasks,
        codec=options.codec,
        gop=options.gop,
        val=options.val,
        seed=options.seed,
        common=common,
    )


def columns(plan: Plan) -> list[str]:
    """Return a line for each column; see `ExportKind.columns`."""
    common = plan.common
    sides = ((plans.STATE, common.state), (plans.ACTION, common.action))
    ages = ", ".join([*(plans.AGE + column for column, _ in sides), *(camera.age_column for camera in common.pictures)])
    return [
        *(f"{column}: {one.key}, {one}" for column, keys in sides for one in keys),
        *(f"{camera.column}: {camera.key}, {camera.width}x{camera.height}" for camera in common.pictures),
        f"{ages}: how old the values of a row are [s]",
        f"{plans.TIME}: the instant of a row [ns since the epoch]",
        f"{plans.GATE}: state of the gate, {plans.COMMANDER}: who commands, as numbers; names in meta/names.json",
        *([f"{plans.SUBTASK}: the operator's newest mark, text in meta/subtasks"] if plan.subtasks == "marks" else []),
        f"rows: {plan.fps} per second, as {plan.fps_as}; trim {plan.trim}: {trims.RULES[plan.trim]}",
    ]


def inspect(source: Source, plan: Plan) -> list[str]:
    """Check whether an episode fits; see `ExportKind.inspect`."""
    from adapters.exports.lerobot import episode

    return episode.inspect(source, plan)


def convert(source: Source, plan: Plan, folder: Path) -> ShardResult:
    """Write rows and video of one episode; see `ExportKind.convert`."""
    from adapters.exports.lerobot import episode

    return episode.convert(source, plan, folder)


def reopen(folder: Path, given: Mapping[str, Any]) -> Reopened:
    """Read what a data set is, to add to it; see `ExportKind.reopen`."""
    from adapters.exports.lerobot import dataset, finished

    had = finished.read(folder)
    finished.expect_options(had, _with_no_camera(given))
    episodes = {shard.source.episode_id: finished.signals_sha256(shard) for shard in had.shards}
    return Reopened(had.plan, episodes, partial(dataset.join_to, had))


def _with_no_camera(given: Mapping[str, Any]) -> dict[str, Any]:
    return {name: () if name == "camera" and value == (NO_CAMERA,) else value for name, value in given.items()}


def join(shards: Sequence[Shard], left_out: Sequence[SkippedEpisode], plan: Plan, folder: Path) -> dict[str, Any]:
    """Make the data set; see `ExportKind.join`."""
    from adapters.exports.lerobot import dataset

    return dataset.join(shards, left_out, plan, folder)
