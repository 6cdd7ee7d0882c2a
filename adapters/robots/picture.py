"""Pictures of a MuJoCo model without a window: EGL, OSMesa or GLFW, whichever this machine has."""

from __future__ import annotations

import importlib
import os
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from station.errors import StationError, UnknownName
from station.protocols import Floats32

_BACKENDS = ("egl", "osmesa", "glfw")  # the first needs no display, the second no graphics driver either
_GEOM_LIMIT = 2000

Picture = NDArray[np.uint8]


class Camera:
    """Renders one size of picture of one model; belongs to the thread that made it.

    Args:
        model: The model; its off-screen buffer is enlarged when needed.
        width, height: Size of the pictures [px].

    Raises:
        StationError: no way to render on this machine.
    """

    def __init__(self, model: mujoco.MjModel, width: int, height: int) -> None:
        visual = getattr(model.vis, "global_")  # noqa: B009 - spelled so that type checkers let it pass
        visual.offwidth, visual.offheight = max(visual.offwidth, width), max(visual.offheight, height)
        self._model, self.width, self.height = model, width, height
        self._gl = _gl_context(width, height)
        self._gl.make_current()
        self._context = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_150)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._context)
        self._context.readDepthMap = mujoco.mjtDepthMap.mjDEPTH_ZEROFAR  # keeps its precision far away
        self._scene = mujoco.MjvScene(model, maxgeom=_GEOM_LIMIT)
        self._options = mujoco.MjvOption()

    def capture(self, data: mujoco.MjData, camera: str) -> Picture:
        """Return a picture, shape (height, width, 3), RGB, uint8.

        Args:
            data: State of the model.
            camera: Name of a camera of the model.

        Raises:
            UnknownName: no such camera; the message lists those there are.
        """
        view = self._named(camera)
        self._gl.make_current()
        mujoco.mjv_updateScene(
            self._model, data, self._options, None, view, mujoco.mjtCatBit.mjCAT_ALL.value, self._scene
        )
        frame = mujoco.MjrRect(0, 0, self.width, self.height)
        mujoco.mjr_render(frame, self._scene, self._context)
        picture = np.empty((self.height, self.width, 3), dtype=np.uint8)
        mujoco.mjr_readPixels(picture, None, frame, self._context)
        return np.flipud(picture)  # OpenGL counts rows from the bottom

    def depth_m(self) -> Floats32:
        """Return the depth of the picture that was captured last, shape (height, width), along the optical axis [m].

        What is not drawn is as far as the model draws at all: its far plane.
        """
        self._gl.make_current()
        read = np.empty((self.height, self.width), dtype=np.float32)
        mujoco.mjr_readPixels(None, read, mujoco.MjrRect(0, 0, self.width, self.height), self._context)
        near, far = (plane * self._model.stat.extent for plane in (self._model.vis.map.znear, self._model.vis.map.zfar))
        return np.flipud(np.float32(near * far) / (np.float32(near) + read * np.float32(far - near)))

    def close(self) -> None:
        """Release the graphics memory; a second call does nothing."""
        if self._gl is not None:
            self._gl.make_current()
            self._context.free()
            self._gl.free()
            self._gl = None

    def _named(self, name: str) -> mujoco.MjvCamera:
        view = mujoco.MjvCamera()
        view.fixedcamid = mujoco.mj_name2id(self._model, mujoco.mjtObj.mjOBJ_CAMERA, name)
        if view.fixedcamid < 0:
            raise UnknownName("camera", name, [self._model.camera(i).name for i in range(self._model.ncam)])
        view.type = mujoco.mjtCamera.mjCAMERA_FIXED
        return view


def _gl_context(width: int, height: int) -> Any:
    wanted = os.environ.get("MUJOCO_GL", "").lower()
    reasons = []
    for backend in (wanted,) if wanted in _BACKENDS else _BACKENDS:
        try:
            return importlib.import_module(f"mujoco.{backend}").GLContext(width, height)
        # Drivers that are missing show as ImportError, AttributeError (PyOpenGL without its library), RuntimeError
        # or the backend's own errors; each only means: try the next one.
        except Exception as error:  # noqa: BLE001
            reasons.append(f"{backend}: {type(error).__name__} {error}".strip())
    raise StationError(
        f"no picture: this machine has no working OpenGL ({'; '.join(reasons)}); install libegl1 or libosmesa6"
    )
