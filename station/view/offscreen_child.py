"""``python -m station.view.offscreen_child FOLDER``: draws what `station.view.offscreen` asks for, then ends.

Scene and light are ours, whatever the model brings: a pale floor with half-metre squares, so that one sees a robot
walk, and a background that disappears into the page.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from station.protocols import Floats
from station.view.offscreen import PICTURES, REQUEST, Pictures

_FINER = 2  # drawn at twice the size and averaged: edges are smooth where a driver has no multisampling
_SEEN_M, _CENTRE_M = 1.62, 0.68  # height of the scene that fills a picture, and of its middle above a walking robot
_ROOT_SIZE = 7
_FOV_DEG, _AZIMUTH_DEG, _ELEVATION_DEG = 28.0, -142.0, -11.0
_SQUARE_M = 0.5
_SKY = (0.87, 0.895, 0.92)
_FLOOR = ((0.80, 0.825, 0.85), (0.72, 0.75, 0.78))
_KEY_LIGHT, _FILL_LIGHT = (-0.45, -0.25, -1.0), (-0.3, 0.9, -0.4)  # directions; the first casts the shadow
_KEY, _LAMP_M, _SHADOW = 0, 4.0, 0.35  # which light it is, its height above the robot, and how much of its cone
_GEOMS = 2000


def draw(model: Path, root: Floats, joints: list[str], q: Floats, width: int, height: int) -> Pictures:
    """Return pictures of a robot, shape (n, height, width, 3)."""
    spec = _scene(model, width * _FINER, height * _FINER)
    compiled = spec.compile()
    floats = compiled.njnt > 0 and int(compiled.jnt_type[0]) == int(mujoco.mjtJoint.mjJNT_FREE)
    centre = (0.0, 0.0, _CENTRE_M) if floats else tuple(compiled.stat.center)
    data, addresses = mujoco.MjData(compiled), _addresses(compiled, joints)
    known = [column for column, address in enumerate(addresses) if address is not None]
    pictures = np.empty((len(root), height, width, 3), dtype=np.uint8)
    with mujoco.Renderer(compiled, height * _FINER, width * _FINER, max_geom=_GEOMS) as renderer:
        for index in range(len(root)):
            data.qpos[:] = compiled.qpos0
            if floats:
                data.qpos[:_ROOT_SIZE] = root[index]
            compiled.light_pos[_KEY] = (root[index, 0], root[index, 1], 0.0) - _LAMP_M * np.array(_KEY_LIGHT)
            data.qpos[[addresses[column] for column in known]] = q[index, known]
            mujoco.mj_forward(compiled, data)
            renderer.update_scene(data, _camera((root[index, 0] + centre[0], root[index, 1] + centre[1], centre[2])))
            renderer.scene.flags[mujoco.mjtRndFlag.mjRND_FOG] = 1
            renderer.scene.flags[mujoco.mjtRndFlag.mjRND_REFLECTION] = 0
            pictures[index] = _averaged(renderer.render())
    return pictures


def _scene(path: Path, width: int, height: int) -> Any:
    spec = mujoco.MjSpec.from_file(str(path))
    visual = spec.visual
    visual.global_.offwidth, visual.global_.offheight, visual.global_.fovy = width, height, _FOV_DEG
    visual.quality.shadowsize, visual.quality.offsamples = 2048, 0  # _FINER smooths edges, in half the time
    visual.headlight.ambient, visual.headlight.diffuse, visual.headlight.specular = [0.46] * 3, [0.26] * 3, [0.0] * 3
    # Lengths of the camera are in extents: with one of a metre they are metres.
    spec.stat.extent, visual.rgba.fog = 1.0, [*_SKY, 1.0]
    visual.map.fogstart, visual.map.fogend = 3.6, 11.0
    visual.map.shadowscale = _SHADOW
    for old in [*spec.lights, *(t for t in spec.textures if t.type == mujoco.mjtTexture.mjTEXTURE_SKYBOX)]:
        spec.delete(old)
    # A spot throws the shadow: that of a directional light is speckled on a floor without end.
    spot, directional = mujoco.mjtLightType.mjLIGHT_SPOT, mujoco.mjtLightType.mjLIGHT_DIRECTIONAL
    spec.worldbody.add_light(type=spot, dir=_KEY_LIGHT, cutoff=70, exponent=0, attenuation=[1, 0, 0],
                             diffuse=[0.46] * 3, specular=[0.12] * 3, castshadow=True)  # fmt: skip
    spec.worldbody.add_light(type=directional, dir=_FILL_LIGHT, diffuse=[0.2] * 3, specular=[0] * 3, castshadow=False)
    spec.add_texture(name="station_sky", type=mujoco.mjtTexture.mjTEXTURE_SKYBOX, width=64, height=384,
                     builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT, rgb1=_SKY, rgb2=_SKY)  # fmt: skip
    _lay_floor(spec)
    return spec


def _lay_floor(spec: Any) -> None:
    """Give the model's ground our squares; lay one where there is none."""
    spec.add_texture(name="station_squares", type=mujoco.mjtTexture.mjTEXTURE_2D, width=256, height=256,
                     builtin=mujoco.mjtBuiltin.mjBUILTIN_CHECKER, rgb1=_FLOOR[0], rgb2=_FLOOR[1])  # fmt: skip
    material = spec.add_material(name="station_floor", texrepeat=[0.5 / _SQUARE_M] * 2, texuniform=True, specular=0.0)
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "station_squares"
    grounds = [geom for geom in spec.worldbody.geoms if geom.type == mujoco.mjtGeom.mjGEOM_PLANE]
    for ground in grounds or [spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 0.05])]:
        ground.material, ground.rgba, ground.size, ground.group = "station_floor", [1, 1, 1, 1], [0, 0, 0.05], 0


def _addresses(model: Any, joints: list[str]) -> list[int | None]:
    """Return where each joint stands in qpos; the wire leaves out MJCF's ``_joint``."""
    found = {model.joint(index).name: int(model.jnt_qposadr[index]) for index in range(model.njnt)}
    return [found.get(name, found.get(f"{name}_joint")) for name in joints]


def _camera(looks_at: tuple[float, float, float]) -> Any:
    camera = mujoco.MjvCamera()
    camera.lookat[:] = looks_at
    camera.distance = _SEEN_M / 2 / np.tan(np.radians(_FOV_DEG / 2))
    camera.azimuth, camera.elevation = _AZIMUTH_DEG, _ELEVATION_DEG
    return camera


def _averaged(picture: Pictures) -> Pictures:
    """Return a picture at the size asked for, each pixel the mean of those that were drawn."""
    height, width, _ = picture.shape
    blocks = picture.reshape(height // _FINER, _FINER, width // _FINER, _FINER, 3)
    return np.asarray(blocks.mean(axis=(1, 3)).round(), dtype=np.uint8)


def main(folder: Path) -> None:
    """Draw what stands in a folder, and leave the pictures there."""
    with np.load(folder / REQUEST) as asked:
        width, height = (int(size) for size in asked["size"])
        pictures = draw(Path(str(asked["model"])), asked["root"], asked["joints"].tolist(), asked["q"], width, height)
    part = folder / f".{PICTURES}"
    with part.open("wb") as file:
        np.save(file, pictures)
    part.replace(folder / PICTURES)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
    sys.stderr.flush()
    os._exit(0)  # some drivers crash while they are unloaded; the pictures are on disk
