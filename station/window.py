"""MuJoCo's own window over a model: opened only where there is a display, closed before its process ends."""

from __future__ import annotations

import threading
import warnings
from typing import Any

from station.errors import StationError

_CLOSE_S = 5.0


class Window:
    """A passive viewer.

    Args:
        model, data: The ``MjModel`` and ``MjData`` that are shown.

    Raises:
        StationError: there is no display.
    """

    def __init__(self, model: Any, data: Any) -> None:
        if not can_open():  # asked first, since the viewer would end the whole process
            raise StationError("no viewer window: no display can be opened; run without it, or use `station view`")
        import mujoco.viewer

        before = set(threading.enumerate())
        self._viewer: Any = mujoco.viewer.launch_passive(model, data, show_left_ui=False, show_right_ui=False)
        self._threads = set(threading.enumerate()) - before

    @property
    def is_open(self) -> bool:
        """Whether the user has not closed it."""
        return bool(self._viewer.is_running())

    def sync(self) -> None:
        """Show the present state of the data."""
        self._viewer.sync()

    def close(self) -> None:
        """Close it and wait for its thread: one that still draws while the process ends takes the process down."""
        self._viewer.close()
        for thread in self._threads - {threading.current_thread()}:
            thread.join(_CLOSE_S)


def can_open() -> bool:
    """Whether a window can be opened here."""
    import glfw

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # GLFW says in a warning what our error says
        return bool(glfw.init())
