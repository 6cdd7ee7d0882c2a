"""What all episodes of a data set have in common, found out from the first one that fits."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import islice
from pathlib import Path
from typing import Literal

import msgspec

from adapters.exports.lerobot.av_library import Codec
from station import depth
from station.bus import keys
from station.episode.quality.cameras import stated_hz
from station.episode.reading import frames
from station.episode.reading.reader import EpisodeReader
from station.episode.reading.steps import keys_of_joints, state_key
from station.episode.storage.folder import signals_file
from station.errors import EpisodeError, StationError, did_you_mean
from station.export import verdict
from station.export.columns import KeyColumns, expect_same, key_columns, robot_of, unique_names
from station.export.kind import MinQuality, Source, Success
from station.export.parts import moving_parts
from station.export.resample import PictureRule, state_of_step
from station.export.trim import Trim

Layout = Literal["v3.0", "v2.1"]
Subtasks = Literal["none", "marks"]

STATE = "observation.state"
ACTION = "action"
IMAGES = "observation.images."
AGE = "age_s."
"""Before the name of a column: how old what stands there is. Names that begin with ``observation`` or ``action`` would
be taken for inputs and outputs of a policy by LeRobot, whatever they hold."""
TIME = "time_ns"
GATE = "gate"
COMMANDER = "commander"
SUBTASK = "subtask_index"
"""LeRobot's own name: loaders of its that know ``meta/subtasks.parquet`` give the text of each row as ``subtask``;
0.6.1 gives the number alone."""

DEFAULT_FPS = 50

VERSION = 5
"""Of the format, as `ExportKind.version`."""

_TRIED = 10  # pictures of a camera, for its size: the first may be torn


class Camera(msgspec.Struct, frozen=True, kw_only=True):
    """One camera: its name, its key, the size of its pictures as they are encoded [pixels], its stated rate [Hz].

    Or the depth `of` a camera, and what a step of that is [m]; "" and None for pictures in colour.
    """

    name: str
    key: str
    height: int
    width: int
    hz: float | None = None
    of: str = ""
    step_m: float | None = None

    @property
    def column(self) -> str:
        """Its name in the data set."""
        return IMAGES + self.name

    @property
    def age_column(self) -> str:
        """Name of the column with the ages of its pictures.

        Without ``image`` in it: of whatever has that in its name, LeRobot wants the statistics of pictures.
        """
        return f"{AGE}camera.{self.name.replace('image', 'picture')}"


class Common(msgspec.Struct, frozen=True, kw_only=True):
    """What every episode must have to be in the data set.

    Attributes:
        robot: Suffix of the robot's keys; where all keys were named, what the episode says, "" for nothing.
        state, action: Keys, in the order in which their numbers stand in a row.
        read: These, and the states of the policy steps that made the action.
        cameras: By name.
        depths: Depth of these, where the format takes any.
        has_depth: Whether it does.
        is_every_camera: Whether all cameras were meant, and these are those of the first episode.
        is_of_robot: Whether keys of `robot` are meant, so that an episode of another one does not fit ...
        is_robot_named: ... and whether it was named, so that an episode of several ones fits.
        is_every_part: Whether no keys were named, so that hands and neck are those that moved in the first episode.
    """

    robot: str
    state: tuple[KeyColumns, ...]
    action: tuple[KeyColumns, ...]
    read: tuple[KeyColumns, ...]
    cameras: tuple[Camera, ...]
    depths: tuple[Camera, ...] = ()
    has_depth: bool = False
    is_every_camera: bool = False
    is_of_robot: bool = False
    is_robot_named: bool = False
    is_every_part: bool = False

    @property
    def pictures(self) -> tuple[Camera, ...]:
        """Cameras, and their depth."""
        return *self.cameras, *self.depths

    @property
    def state_names(self) -> list[str]:
        """Names of the numbers of the state."""
        return unique_names(self.state)

    @property
    def action_names(self) -> list[str]:
        """Names of the numbers of the action."""
        return unique_names(self.action)


class Plan(msgspec.Struct, frozen=True, kw_only=True):
    """Everything that decides what a data set is, but for its episodes; as in `LeRobotOptions`.

    Attributes:
        fps_as: What the rate follows, in words.
    """

    layout: Layout
    fps: int
    fps_as: str
    pictures: PictureRule
    trim: Trim
    subtasks: Subtasks
    codec: Codec
    gop: int
    val: float
    seed: int
    common: Common


class PlanRequest(msgspec.Struct, frozen=True, kw_only=True):
    """What was asked for: keys, empty for the defaults; cameras, None for all; robot, "" for the only one; verdicts.

    With `has_depth`, the depth of these cameras too.
    """

    state: tuple[str, ...] = ()
    action: tuple[str, ...] = ()
    cameras: tuple[str, ...] | None = None
    has_depth: bool = False
    robot: str = ""
    min_quality: MinQuality = "any"
    success: Success = "any"


def common(sources: Sequence[Source], wish: PlanRequest) -> Common:
    """Return what the data set is made of, by the first episode that is good enough and has all that is asked for.

    Raises:
        StationError: there is no such episode; the reason of the first one.
    """
    first: StationError | None = None
    book = verdict.rule_book(wish.min_quality)
    for source in sources:
        try:
            verdict.expect(source, wish.min_quality, book, success=wish.success)
            return _of(open_source(source), wish)
        except StationError as error:
            first = first or error
    more = f" (nor any of {len(sources) - 1} others)" if len(sources) > 1 else ""
    raise EpisodeError(f"nothing to export{more}: {first}") from first


def open_source(source: Source) -> EpisodeReader:
    """Open an episode.

    Raises:
        EpisodeError: it cannot be read.
    """
    return EpisodeReader(signals_file(Path(source.folder)))


def expect_fit(reader: EpisodeReader, plan: Plan) -> dict[str, str]:
    """Refuse an episode that cannot be in a data set; return the key of each of its cameras, and depths, by name.

    Raises:
        EpisodeError: a key or a camera is missing, or holds something else than the data set; names it.
    """
    common = plan.common
    named = common.robot if common.is_robot_named else ""
    if common.is_of_robot and (robot := robot_of(reader, named)) != common.robot:
        raise EpisodeError(
            f"{reader.episode_id}: another robot ({robot}) than the data set has ({common.robot}); "
            f"export it apart, with --robot {robot}"
        )
    expect_same(reader, common.read)
    found = cameras_of(reader, [camera.name for camera in common.pictures], has_depth=common.has_depth)
    for camera in common.pictures:
        one = _camera(reader, camera.name, found[camera.name])
        if (one.height, one.width) != (camera.height, camera.width):
            raise EpisodeError(
                f"{reader.episode_id}: camera {camera.name!r}: pictures of {one.width}x{one.height} pixels, the data "
                f"set has {camera.width}x{camera.height}; export these episodes apart"
            )
    return found


def missed(reader: EpisodeReader, plan: Plan) -> dict[str, list[str]]:
    """Return what an episode has and the data set lacks, though all was meant: cameras; hands and neck that moved.

    Beside these, ``depth``: of which cameras the format has no place for it.
    """
    common = plan.common
    taken = {camera.name for camera in common.pictures}
    has = {one.key for one in (*common.state, *common.action)}
    parts = moving_parts(reader, common.robot) if common.is_every_part else []
    return {
        "cameras": sorted(_shown(reader, common.has_depth).keys() - taken) if common.is_every_camera else [],
        "depth": [] if common.has_depth else sorted(frames.depths(reader).keys() & taken),
        "parts": [part.name for part in parts if not {part.action, part.state} - {None} <= has],
    }


def cameras_of(reader: EpisodeReader, names: Sequence[str], *, has_depth: bool = False) -> dict[str, str]:
    """Return the key of each named camera; of its depth too, where that counts.

    Raises:
        EpisodeError: the episode lacks one; names it.
    """
    found = _shown(reader, has_depth)
    for name in names:
        if name not in found:
            has = f"it has {', '.join(found)}" if found else "it has none"
            raise EpisodeError(
                f"{reader.episode_id}: no camera {name!r} in it{did_you_mean(name, found)}; {has}; "
                "leave it out with --camera, or export this episode apart"
            )
    return {name: found[name] for name in names}


def _of(reader: EpisodeReader, wish: PlanRequest) -> Common:
    robot = "" if wish.state and wish.action and not wish.robot else robot_of(reader, wish.robot)
    _expect_defaults(reader, wish, robot)
    parts = moving_parts(reader, robot) if robot else []
    topics = reader.topics()
    states = wish.state or (state_key(robot, topics), *(part.state for part in parts if part.state))
    actions = wish.action or (keys.command_used(robot), *(part.action for part in parts if part.action))
    state = tuple(key_columns(reader, key) for key in states)
    action = tuple(key_columns(reader, key) for key in actions)
    chosen = {one.key: one for one in (*state, *action)}
    steps = {state_of_step(one.key, topics) for one in action if one.role == "policy"}
    paces = {key: key_columns(reader, key) for key in sorted(key for key in steps if key and key not in chosen)}
    wanted = list(frames.cameras(reader)) if wish.cameras is None else wish.cameras
    depths = frames.depths(reader) if wish.has_depth else {}
    chosen_depths = {depths[name] for name in wanted if name in depths}
    return Common(
        robot=robot or reader.manifest.robot.suffix,
        state=state,
        action=action,
        read=tuple({**chosen, **paces}.values()),
        cameras=tuple(_camera(reader, name, key) for name, key in cameras_of(reader, wanted).items()),
        depths=tuple(_camera(reader, name, key) for name, key in _shown(reader, True).items() if key in chosen_depths),
        has_depth=wish.has_depth,
        is_every_camera=wish.cameras is None,
        is_of_robot=bool(robot),
        is_robot_named=bool(wish.robot),
        is_every_part=not wish.state and not wish.action,
    )


def rate(common: Common) -> tuple[int, str]:
    """Return the default rows per second, and what sets them: more would repeat pictures of the slowest camera."""
    known = [camera for camera in common.pictures if camera.hz]
    if not known:
        return DEFAULT_FPS, "no camera that states its rate"
    slowest = min(known, key=lambda camera: camera.hz or 0.0)
    rates = [one.rate_hz for one in common.state if one.rate_hz]
    if rates and max(rates) < (slowest.hz or 0.0):
        return max(1, int(max(rates))), "the state, slower than any camera"
    return max(1, round(slowest.hz or 0.0)), f"camera {slowest.name}, the slowest"


def _expect_defaults(reader: EpisodeReader, wish: PlanRequest, robot: str) -> None:
    """Refuse an episode without the default keys, such as one of stock scripts, and name the keys that it has."""
    topics = reader.topics()
    sides = (("--state", wish.state, state_key(robot, topics), "state"),
             ("--action", wish.action, keys.command_used(robot), "command"))  # fmt: skip
    lacking = [default for _, named, default, _ in sides if not named and default not in topics]
    others = {role: keys_of_joints(reader, robot, role, ())[:1] for role in ("state", "command")}
    told = " ".join(f"{option} {key}" for option, named, _, role in sides if not named for key in others[role])
    if lacking and told:
        raise EpisodeError(f"{reader.episode_id}: no {' and no '.join(lacking)} in it; name other keys, such as {told}")


def _shown(reader: EpisodeReader, has_depth: bool) -> dict[str, str]:
    return frames.all_pictures(reader) if has_depth else frames.cameras(reader)


def _camera(reader: EpisodeReader, name: str, key: str) -> Camera:
    from adapters.exports.lerobot.av_library import Decoder

    of = next((camera for camera, topic in frames.depths(reader).items() if topic == key), "")
    read = depth.head if of else Decoder().picture
    sizes = (read(frame.data) for frame in islice(frames.frames(reader, key), _TRIED))
    picture = next((picture for picture in sizes if picture is not None), None)
    if picture is None:
        form = "PNG of 16 bits" if of else "JPEG"
        raise EpisodeError(
            f"{reader.episode_id}: none of the first {_TRIED} pictures of camera {name!r} is a {form} that can be read"
        )
    hz = stated_hz(reader.manifest).get(key)
    if of:
        step_m = frames.step_m(reader, key)
        return Camera(name=name, key=key, height=picture.height, width=picture.width, hz=hz, of=of, step_m=step_m)
    return Camera(name=name, key=key, height=picture.height // 2 * 2, width=picture.width // 2 * 2, hz=hz)
