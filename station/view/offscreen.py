"""Pictures of a robot in given postures without a display, each try in a process of its own.

Which of MuJoCo's ways to draw works shows only when it is tried, and one that does not may raise when MuJoCo is
imported, when a context is made, or end its process. A child takes that upon itself; PyOpenGL, moreover, keeps the
first platform that a process asked for. So every way gets a fresh child, and the caller a picture or a reason.
"""

from __future__ import annotations

import os
import signal
import subprocess
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from station import python_child
from station.errors import StationError
from station.protocols import Floats

VARIABLE = "MUJOCO_GL"
REQUEST, PICTURES = "request.npz", "pictures.npy"
"""Files through which the child is asked and answers."""

Pictures = NDArray[np.uint8]

_BY_ITSELF = ("", "enable", "enabled", "on", "true", "1")  # what MuJoCo takes for "choose one"
_WAYS = ("egl", "osmesa", "glfw")  # the first needs no display, the second no graphics driver either
_LIMIT_S = 120.0  # a meshed robot compiles in seconds; software rendering takes a tenth of a second a picture
_NO_LIBRARY = "'NoneType' object has no attribute 'gl"  # how PyOpenGL says it
_LONGEST = 120  # characters of a reason


class CannotRender(StationError):
    """This machine has no working way to draw."""


def render(
    model: Path, root: Floats, joints: Sequence[str], q: Floats, *, width: int, height: int, gl: str | None = None
) -> Pictures:
    """Return a picture of a robot per posture, seen from its left front, shape (n, height, width, 3), RGB.

    Args:
        model: MJCF file with a free joint at its root.
        root: Position [m] and quaternion wxyz of the root, shape (n, 7).
        joints: Names of m joints.
        q: Their positions, shape (n, m) [rad].
        width, height: Size of a picture [px].
        gl: How MuJoCo draws: ``egl``, ``osmesa``, ``glfw``, or "" to try them in turn; None takes ``$MUJOCO_GL``.

    Raises:
        CannotRender: none of the ways works here; the message has each one's reason.
    """
    reasons = []
    for way in _ways(os.environ.get(VARIABLE, "") if gl is None else gl):
        with tempfile.TemporaryDirectory(prefix="station-pictures-") as name:
            folder = Path(name)
            np.savez(folder / REQUEST, model=str(model.absolute()), root=root, joints=np.array(joints, dtype=np.str_),
                     q=q, size=np.array([width, height]))  # fmt: skip
            reason = _try(way, folder)
            if reason is None:
                pictures: Pictures = np.load(folder / PICTURES)
                return pictures
        reasons.append(f"{way}: {reason}")
    raise CannotRender(f"this machine cannot render ({'; '.join(reasons)}); install libegl1 or libosmesa6")


def _ways(wanted: str) -> Sequence[str]:
    """Return the ways to try, in order.

    Raises:
        CannotRender: what is wanted is none of them.
    """
    chosen = wanted.strip().lower()
    if chosen in _WAYS:
        return (chosen,)
    if chosen not in _BY_ITSELF:
        raise CannotRender(f"this machine cannot render (${VARIABLE} is {wanted!r}; expected {', '.join(_WAYS)})")
    has_display = bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
    return _WAYS if has_display else _WAYS[:-1]


def _try(way: str, folder: Path) -> str | None:
    """Let a child draw; return why it did not, or None."""
    try:
        done = subprocess.run(
            python_child.command("-m", "station.view.offscreen_child", str(folder)),
            check=False, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
            errors="replace",
            timeout=_LIMIT_S, env=_environment(way), start_new_session=True,  # Ctrl-C is ours to hear, and kills it
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return f"nothing after {_LIMIT_S:.0f} s"
    if done.returncode == 0 and (folder / PICTURES).is_file():
        return None
    if done.returncode < 0:
        return f"killed by {signal.Signals(-done.returncode).name}"
    lines = [line.strip() for line in done.stderr.splitlines() if line.strip()]
    return _short(lines[-1]) if lines else f"ended with code {done.returncode}"


def _environment(way: str) -> Mapping[str, str]:
    kept = {name: value for name, value in os.environ.items() if name != "PYOPENGL_PLATFORM"}
    return {**kept, VARIABLE: way}


def _short(text: str) -> str:
    """Return the first sentence of a reason, no longer than a line of the terminal."""
    if _NO_LIBRARY in text:
        return "its library is not installed"
    sentence = text.split(". ", maxsplit=1)[0].rstrip(".")
    return sentence if len(sentence) <= _LONGEST else sentence[: _LONGEST - 1] + "…"
