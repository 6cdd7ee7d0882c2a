"""What a motion asks for, shown while it plays: in MuJoCo's window, or as a Rerun file where there is no display.

Drawing takes milliseconds and now and then far more, so a thread of its own does it; the loop that plays the motion
only leaves the time behind. A preview that fails ends with a reason, the motion goes on.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol

import mujoco
import numpy as np

from station.errors import StationError
from station.protocols import Floats, Motion
from station.view.model import RobotModel
from station.window import Window, can_open

_PERIOD_S = 0.04  # 25 pictures a second
_CLOSED = "the window was closed"


class Preview:
    """Shows the reference of a motion.

    Args:
        motion: What is shown.
        model: MJCF of the robot, with a free joint at its root.
        file: Where the Rerun recording goes when there is no display.
        on_end: Called once, from another thread, with the reason why there is nothing more to see.

    Raises:
        StationError: no window can be opened, or no file written.
        BadFile: the model cannot be read.
    """

    def __init__(self, motion: Motion, model: Path, file: Path, *, on_end: Callable[[str], None]) -> None:
        self._motion, self._on_end = motion, on_end
        self._screen: _Screen = _Window(model) if can_open() else _RerunFile(model, file)
        self.where = self._screen.where
        self._time_s: float | None = None
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._run, name="preview", daemon=True)
        self._thread.start()

    def show(self, time_s: float) -> None:
        """Show the reference at a motion time [s], soon."""
        self._time_s = time_s

    def close(self) -> None:
        """Stop showing; a second call does nothing."""
        self._closed.set()
        self._thread.join(2.0)

    def _run(self) -> None:
        try:
            shown_s: float | None = None
            while not self._closed.wait(_PERIOD_S):
                if self._time_s is not None and self._time_s != shown_s:
                    shown_s = self._time_s
                    self._draw(shown_s)
        except (StationError, RuntimeError, OSError) as error:
            self._on_end(str(error))
        finally:
            self._screen.close()

    def _draw(self, time_s: float) -> None:
        reference = self._motion.at(time_s)
        root = np.concatenate([reference.root_pos, reference.root_quat_wxyz])
        self._screen.draw(time_s, root, self._motion.joint_names, reference.q)


class _Screen(Protocol):
    where: str

    def draw(self, time_s: float, root: Floats, joints: tuple[str, ...], q: Floats) -> None: ...

    def close(self) -> None: ...


class _Window:
    """MuJoCo's own viewer."""

    where = "a window"

    def __init__(self, path: Path) -> None:
        model: Any = mujoco.MjModel.from_xml_path(str(path))
        self._addresses = {model.joint(i).name: int(model.jnt_qposadr[i]) for i in range(model.njnt)}
        self._model, self._data = model, mujoco.MjData(model)
        self._window = Window(model, self._data)

    def draw(self, time_s: float, root: Floats, joints: tuple[str, ...], q: Floats) -> None:
        if not self._window.is_open:
            raise StationError(_CLOSED)
        self._data.qpos[:7] = root
        for name, position in zip(joints, q, strict=True):
            address = self._addresses.get(f"{name}_joint", self._addresses.get(name))
            if address is not None:
                self._data.qpos[address] = position
        mujoco.mj_forward(self._model, self._data)
        self._window.sync()

    def close(self) -> None:
        self._window.close()


class _RerunFile:
    """A Rerun recording, to be opened when one likes."""

    def __init__(self, path: Path, file: Path) -> None:
        import rerun as rr

        from station.view import scene

        self.where = str(file)
        self._scene, self._model = scene, RobotModel(path)
        self._recording: Any = rr.RecordingStream("teleop-station preview")
        try:
            file.parent.mkdir(parents=True, exist_ok=True)
            self._recording.save(file)
        except (OSError, RuntimeError) as error:
            raise StationError(
                f"preview: {file} cannot be written ({error}); name another with preview_file"
            ) from error
        scene.log_shapes(self._recording, scene.GHOST, self._model, is_ghost=True)

    def draw(self, time_s: float, root: Floats, joints: tuple[str, ...], q: Floats) -> None:
        positions, quats = self._model.poses(root[None], joints, q[None])
        self._recording.set_time("motion", duration=time_s)
        self._scene.log_pose(self._recording, self._scene.GHOST, self._model, positions[0], quats[0])

    def close(self) -> None:
        self._recording.flush()
        self._recording.disconnect()
