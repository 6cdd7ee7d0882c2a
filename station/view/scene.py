"""A robot in Rerun: its shapes once, then one pose per body and instant."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from station.optics import Optics
from station.protocols import Floats
from station.view.model import RobotModel
from station.view.shapes import Shape

WORLD = "world"
ROBOT = f"{WORLD}/robot"
GHOST = f"{WORLD}/reference"

GHOST_TINT = (80, 160, 255)
GHOST_ALPHA = 70
_PYRAMID_M = 0.15
_BESIDE_M = np.array([0.0, 0.9, 0.0])

_XYZW = [1, 2, 3, 0]


def beside(model: RobotModel, root: Floats) -> Floats:
    """Return where a reference is drawn: beside a robot that walks, an arm's length to the left of where it started; in
    one that stands fast."""
    placed = root.copy()
    placed[:, :3] += _BESIDE_M if model.floats else 0.0
    return placed


def log_shapes(recording: rr.RecordingStream, root: str, model: RobotModel, *, is_ghost: bool = False) -> None:
    """Log what a robot looks like, below an entity; a ghost is tinted and translucent.

    Args:
        recording: Where to.
        root: Entity of the robot, `ROBOT` or `GHOST`.
        model: The robot.
        is_ghost: Whether it is the reference.
    """
    recording.log(WORLD, rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    counts: dict[str, int] = {}
    for shape in model.shapes:
        number = counts[shape.body] = counts.get(shape.body, 0) + 1
        colour = (*GHOST_TINT, GHOST_ALPHA) if is_ghost else tuple(int(part) for part in shape.rgba)
        entity = f"{_entity(root, shape.body)}/shape{number}"
        recording.log(entity, _placed(shape), *_drawn(shape, colour), static=True)


def log_camera(recording: rr.RecordingStream, root: str, name: str, optics: Optics) -> str:
    """Log where a camera of a robot is and what it sees, as the pyramid that viewers draw, and return its entity.

    Needs both; "" where one is not known.
    """
    inner, mount = optics
    if inner is None or mount is None:
        return ""
    w, x, y, z = mount.quat_wxyz
    entity = f"{_entity(root, mount.parent)}/{name}"
    recording.log(
        entity,
        rr.Transform3D(translation=mount.position_m, quaternion=[x, y, z, w]),
        rr.Pinhole(
            image_from_camera=np.reshape(inner.matrix, (3, 3)), resolution=[inner.width, inner.height],
            camera_xyz=rr.ViewCoordinates.RDF, image_plane_distance=_PYRAMID_M,
        ),
        static=True,
    )  # fmt: skip
    return entity


def log_pose(recording: rr.RecordingStream, root: str, model: RobotModel, positions: Floats, quats: Floats) -> None:
    """Log where every body is now: positions, shape (bodies, 3) [m], and quaternions wxyz, shape (bodies, 4)."""
    for body, position, quat in zip(model.bodies, positions, quats, strict=True):
        if body in model.visible:
            pose = rr.Transform3D(translation=position, quaternion=quat[_XYZW])
            recording.log(_entity(root, body), pose)


def send_poses(
    recording: rr.RecordingStream,
    root: str,
    model: RobotModel,
    index: Sequence[Any],
    positions: Floats,
    quats: Floats,
) -> None:
    """Send a whole motion at once.

    Args:
        recording: Where to.
        root: Entity of the robot.
        model: The robot.
        index: Time columns of n instants.
        positions: Shape (n, bodies, 3) [m].
        quats: Shape (n, bodies, 4), wxyz.
    """
    for number, body in enumerate(model.bodies):
        if body in model.visible:
            columns = rr.Transform3D.columns(
                translation=positions[:, number].astype(np.float32),
                quaternion=quats[:, number][:, _XYZW].astype(np.float32),
            )
            recording.send_columns(_entity(root, body), index, columns)


def _entity(root: str, body: str) -> str:
    return f"{root}/{body}"


def _placed(shape: Shape) -> rr.Transform3D:
    return rr.Transform3D(translation=shape.pos, quaternion=shape.quat_wxyz[_XYZW])


def _drawn(shape: Shape, colour: tuple[int, ...]) -> list[Any]:
    """Return the Rerun archetypes that draw a shape in its own frame."""
    colours: NDArray[np.uint8] = np.array([colour], dtype=np.uint8)
    radius, half_length = shape.size[0], shape.size[1]
    if shape.kind == "mesh":
        mesh = rr.Mesh3D(
            vertex_positions=shape.vertices.astype(np.float32),
            vertex_normals=shape.normals.astype(np.float32),
            triangle_indices=shape.faces.astype(np.uint32),
            albedo_factor=colours[0],
        )
        return [mesh]
    if shape.kind == "box":
        return [rr.Boxes3D(half_sizes=[shape.size], colors=colours, fill_mode="solid")]
    if shape.kind == "cylinder":
        return [rr.Cylinders3D(lengths=[2 * half_length], radii=[radius], colors=colours, fill_mode="solid")]
    if shape.kind == "capsule":
        # Rerun's capsule begins at its origin and goes up; MuJoCo's is centred.
        start = [[0.0, 0.0, -half_length]]
        return [
            rr.Capsules3D(
                lengths=[2 * half_length], radii=[radius], translations=start, colors=colours, fill_mode="solid"
            )
        ]
    return [rr.Ellipsoids3D(half_sizes=[shape.size], colors=colours, fill_mode="solid")]
