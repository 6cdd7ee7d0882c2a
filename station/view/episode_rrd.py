"""An episode in Rerun: robot and reference, named curves, gate and motion, events, on one time line."""

from __future__ import annotations

import os
import time
from pathlib import Path

import msgspec
import rerun as rr

from station.episode.reading import frames
from station.episode.reading.reader import EpisodeReader
from station.episode.storage.pictures import camera_of
from station.errors import StationError
from station.view import layout, phases, poses, scene
from station.view.clouds import draw_clouds
from station.view.depth_pictures import draw_depth
from station.view.episode_curves import Source, draw_curves
from station.view.episode_story import draw_events, draw_states
from station.view.find_model import find_model
from station.view.model import RobotModel
from station.view.poses import Posture
from station.view.viewer import open_viewer

APPLICATION = "teleop-station"


class View(msgspec.Struct, kw_only=True):
    """What was drawn.

    Attributes:
        episode_id: The episode.
        path: The file, or None when a viewer shows it.
        robot: Suffix of the robot, "" when the episode has none.
        poses: Instants at which the robot is posed; 0 when it is not drawn.
        curves: Entities with curves.
        events: Lines in the log.
        warnings: What is missing and why, a line each.
        seconds: Time that it took [s].
    """

    episode_id: str
    path: str | None = None
    robot: str = ""
    poses: int = 0
    curves: list[str] = []
    events: int = 0
    warnings: list[str] = []
    seconds: float = 0.0


def save(reader: EpisodeReader, path: Path, *, robot: str = "", robot_model: str | Path | None = None) -> View:
    """Write an episode as a Rerun file; needs no display.

    Args:
        reader: The episode.
        path: The ``.rrd`` file; replaced as a whole, or not at all.
        robot: Suffix of the robot, see `station.view.phases.robot_of`.
        robot_model: MJCF of the robot, path or ``collection:path``; None for the one that the episode names.

    Raises:
        StationError: the file cannot be written.
        AssetMissing, BadFile: `robot_model` is not there, or is none.
    """
    if not path.absolute().parent.is_dir():
        raise StationError(f"{path}: there is no folder {path.parent}; make it, or name a file elsewhere")
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    recording = _recording(reader)
    try:
        recording.save(part)
        view = draw(reader, recording, robot=robot, robot_model=robot_model)
        recording.flush()
        recording.disconnect()
        os.replace(part, path)
    except (RuntimeError, OSError) as error:
        raise StationError(f"{path}: cannot be written ({error}); name a file in a folder of yours") from error
    finally:
        part.unlink(missing_ok=True)
    view.path = str(path)
    return view


def show(reader: EpisodeReader, *, robot: str = "", robot_model: str | Path | None = None) -> View:
    """Open Rerun's viewer on an episode; needs a display.

    Raises:
        StationError: there is no display, or the viewer does not start, or ends before it has everything.
    """
    recording = _recording(reader)
    with open_viewer(recording) as viewer:
        view = draw(reader, recording, robot=robot, robot_model=robot_model)
        viewer.deliver(recording)
    return view


def draw(
    reader: EpisodeReader, recording: rr.RecordingStream, *, robot: str = "", robot_model: str | Path | None = None
) -> View:
    """Send an episode to any Rerun recording."""
    began = time.perf_counter()
    source = Source(reader)
    view = View(episode_id=reader.episode_id, robot=phases.robot_of(reader, robot))
    drawn = draw_curves(recording, source, view.robot)
    view.curves = drawn.entities
    view.warnings += drawn.warnings
    placed: dict[str, str] = {}
    bodies: set[str] = set()
    view.warnings += _draw_robot(recording, source, view, robot_model, placed, bodies)
    depths = draw_depth(recording, source, placed)
    clouds = draw_clouds(recording, source, bodies)
    draw_states(recording, source, view.robot)
    view.events = draw_events(recording, source)
    arranged = layout.layout(drawn.contracts, has_robot=view.poses > 0, groups=drawn.groups, pictures=depths,
                             clouds=clouds)  # fmt: skip
    recording.send_blueprint(arranged)
    view.seconds = time.perf_counter() - began
    return view


def _recording(reader: EpisodeReader) -> rr.RecordingStream:
    recording = rr.RecordingStream(APPLICATION, recording_id=reader.episode_id)
    recording.send_recording_name(reader.episode_id)
    return recording


def _draw_robot(
    recording: rr.RecordingStream, source: Source, view: View, robot_model: str | Path | None, placed: dict[str, str],
    bodies: set[str],
) -> list[str]:  # fmt: skip
    """Draw robot and reference, put the entity of each camera that is drawn with it into `placed`, by its name.

    Names of the bodies that are drawn are put into `bodies`.
    """
    description, recorded = source.reader.known.robot(view.robot), source.contracts.values()
    where = poses.measured(source.vectors, poses.state_keys(view.robot, recorded, description), description)
    if where is None:
        return ["the robot is not drawn: the episode holds no pose of it"] if view.robot else []
    servers = source.reader.manifest.servers.values()
    model, warnings = find_model(servers, view.robot, robot_model)
    if model is None:
        return warnings
    view.poses = len(where.times_ns)
    bodies |= model.visible
    scene.log_shapes(recording, scene.ROBOT, model)
    (optics, why_not), depths = frames.optics(source.reader), frames.depths(source.reader).values()
    for key, one in optics.items():
        if one.mount is not None and one.mount.parent in model.visible and key not in depths:
            placed[camera_of(key)] = scene.log_camera(recording, scene.ROBOT, camera_of(key), one)
    warnings += [f"{key}: {why}; the camera is not drawn" for key, why in why_not.items()]
    _send(recording, scene.ROBOT, model, where, source)
    ghost = poses.asked(source.vectors, poses.command_keys(view.robot, recorded, description), where)
    if ghost is not None:
        scene.log_shapes(recording, scene.GHOST, model, is_ghost=True)
        _send(recording, scene.GHOST, model, ghost._replace(root=scene.beside(model, ghost.root)), source)
    unknown = [joint for joint in where.joints if not model.knows(joint)]
    return [*warnings, *([f"the model lacks the joints {', '.join(unknown)}"] if unknown else [])]


def _send(recording: rr.RecordingStream, root: str, model: RobotModel, posture: Posture, source: Source) -> None:
    positions, quats = model.poses(posture.root, posture.joints, posture.q)
    scene.send_poses(recording, root, model, source.index(posture.times_ns), positions, quats)
