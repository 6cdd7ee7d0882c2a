"""What a MuJoCo model looks like: plain shapes, each fixed to one body."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from station.protocols import Floats

Kind = Literal["ellipsoid", "capsule", "cylinder", "box", "mesh"]

_KINDS: dict[int, Kind] = {
    int(mujoco.mjtGeom.mjGEOM_SPHERE): "ellipsoid",
    int(mujoco.mjtGeom.mjGEOM_ELLIPSOID): "ellipsoid",
    int(mujoco.mjtGeom.mjGEOM_CAPSULE): "capsule",
    int(mujoco.mjtGeom.mjGEOM_CYLINDER): "cylinder",
    int(mujoco.mjtGeom.mjGEOM_BOX): "box",
    int(mujoco.mjtGeom.mjGEOM_MESH): "mesh",
}
_CELL_M = 0.006  # the G1's meshes carry 200 000 vertices; a 6 mm grid leaves a sixth and looks the same at arm's length


@dataclass(frozen=True, slots=True)
class Shape:
    """One shape in the frame of its body.

    Attributes:
        body: Name of the body it moves with.
        kind: What it is.
        pos: Its centre in the body frame, shape (3,) [m].
        quat_wxyz: Its orientation in the body frame, shape (4,).
        size: Half extents; radius and half length of a capsule or cylinder, shape (3,) [m].
        rgba: Colour, shape (4,), 0..255.
        vertices: Corners of a mesh in the shape's frame, shape (v, 3) [m]; empty for others.
        normals: Outward normals at them, shape (v, 3).
        faces: Triangles as indices of vertices, shape (f, 3).
    """

    body: str
    kind: Kind
    pos: Floats
    quat_wxyz: Floats
    size: Floats
    rgba: NDArray[np.uint8]
    vertices: Floats
    normals: Floats
    faces: NDArray[np.int64]


def shapes(model: Any) -> list[Shape]:
    """Return what is to be seen of a `mujoco.MjModel`: a body's visual geometry, or what it collides with."""
    return [shape for body in range(model.nbody) for shape in _of_body(model, body)]


def _of_body(model: Any, body: int) -> Iterator[Shape]:
    first, count = int(model.body_geomadr[body]), int(model.body_geomnum[body])
    geoms = [g for g in range(first, first + count) if int(model.geom_type[g]) in _KINDS]
    visual = [g for g in geoms if not model.geom_contype[g] and not model.geom_conaffinity[g]]
    for geom in visual or geoms:
        yield _shape(model, geom)


def _shape(model: Any, geom: int) -> Shape:
    kind = _KINDS[int(model.geom_type[geom])]
    size = np.array(model.geom_size[geom], dtype=np.float64)
    if int(model.geom_type[geom]) == int(mujoco.mjtGeom.mjGEOM_SPHERE):
        size = np.full(3, size[0])
    mesh = _mesh(model, int(model.geom_dataid[geom])) if kind == "mesh" else _NO_MESH
    material = int(model.geom_matid[geom])
    rgba = model.mat_rgba[material] if material >= 0 else model.geom_rgba[geom]
    return Shape(
        body=model.body(int(model.geom_bodyid[geom])).name,
        kind=kind,
        pos=np.array(model.geom_pos[geom]),
        quat_wxyz=np.array(model.geom_quat[geom]),
        size=size,
        rgba=np.asarray(np.clip(rgba, 0, 1) * 255).astype(np.uint8),
        vertices=mesh.vertices,
        normals=mesh.normals,
        faces=mesh.faces,
    )


class Mesh(NamedTuple):
    """Corners, shape (v, 3) [m], outward normals at them, and triangles as indices of corners, shape (f, 3)."""

    vertices: Floats
    normals: Floats
    faces: NDArray[np.int64]


_NO_MESH = Mesh(np.empty((0, 3)), np.empty((0, 3)), np.empty((0, 3), dtype=np.int64))


def _mesh(model: Any, mesh: int) -> Mesh:
    start, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
    first, number = int(model.mesh_faceadr[mesh]), int(model.mesh_facenum[mesh])
    vertices = np.array(model.mesh_vert[start : start + count], dtype=np.float64)
    faces = np.array(model.mesh_face[first : first + number], dtype=np.int64)
    return clustered(Mesh(vertices, _normals(vertices, faces), faces), _CELL_M)


def clustered(mesh: Mesh, cell_m: float) -> Mesh:
    """Merge the vertices that share a cell of a grid, edge [m], and drop the triangles that vanish with that.

    A vertex becomes the mean of its cell, and so does its normal: light falls as on the mesh it came from.
    """
    cells = np.floor(mesh.vertices / cell_m).astype(np.int64)
    _, owner = np.unique(cells, axis=0, return_inverse=True)
    owner = owner.reshape(-1)
    counts = np.bincount(owner)[:, None]
    vertices, normals = (
        np.stack([np.bincount(owner, weights=values[:, axis]) for axis in range(3)], axis=1) / counts
        for values in (mesh.vertices, mesh.normals)
    )
    kept = owner[mesh.faces]
    a, b, c = kept.T
    kept = kept[(a != b) & (b != c) & (a != c)]
    return Mesh(vertices, _unit(normals), np.unique(kept, axis=0) if len(kept) else kept)


def _normals(vertices: Floats, faces: NDArray[np.int64]) -> Floats:
    """Return the area-weighted normal at each vertex, shape (v, 3)."""
    total = np.zeros_like(vertices)
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    across = np.cross(b - a, c - a)
    for corner in range(3):
        np.add.at(total, faces[:, corner], across)
    return _unit(total)


def _unit(vectors: Floats) -> Floats:
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.asarray(np.divide(vectors, length, out=np.zeros_like(vectors), where=length > 0))
