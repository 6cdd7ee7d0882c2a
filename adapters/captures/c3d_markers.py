"""C3D: the places of markers, read by the library ``c3d`` (extra ``c3d``), with the labels of Plug-in Gait.

Read are the 3-D points, as floats or as scaled integers of any processor, their labels, rate and unit
(``POINT:LABELS``, ``POINT:RATE``, ``POINT:UNITS``); analog channels, events and force plates are not. Labels may have
a subject in front (``Ada:LASI``). A marker that was not seen is bridged for up to half a second; beyond that, the ends
of a capture are cut to where all markers are known.

``c3d`` is written in Python: a damaged file raises an error, where a compiled reader ended the process.
"""

from __future__ import annotations

import importlib
import io
import itertools
import struct
import warnings
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from adapters.captures import plug_in_gait
from adapters.captures.captured import UNITS_M
from adapters.captures.joints import FASTEST_HZ, MOST_FRAMES, Joints
from adapters.motions import raw
from station.errors import BadFile, StationError
from station.protocols import Floats

LONGEST_BRIDGE_S = 0.5
"""Longest time for which a marker may be hidden between two sights of it [s]."""

_UNITS_M: dict[str, float] = {"in": 0.0254} | {name: size for name, size in UNITS_M.items()}
_DAMAGED = (
    ArithmeticError, AssertionError, AttributeError, EOFError, LookupError, MemoryError, NameError, RuntimeError,
    TypeError, ValueError, struct.error,
)  # fmt: skip
"""What the library raises of a file that is damaged."""


def load(path: Path, *, height_m: float | None = None) -> Joints:
    """Read a person; markers are as far apart as they were, and need no height.

    Raises:
        BadFile: missing, too large, no C3D, or without the markers that are needed.
        StationError: the extra ``c3d`` is not installed.
    """
    del height_m
    labels, points, rate_hz, unit = _read(path, raw.read_bytes(path))
    markers = _of_one_person(path, labels, points)
    plug_in_gait.expect(path, markers)
    filled, first, notes = _filled(path, markers, rate_hz)
    places, turns = plug_in_gait.joints(filled)
    if first:
        notes = (*notes, f"begins {first / rate_hz:.2f} s later, where all markers are known")
    return Joints(path=path, fps=rate_hz, places=places, turns=turns, unit_m=_UNITS_M.get(unit), notes=notes)


def _read(path: Path, data: bytes) -> tuple[list[str], Floats, float, str]:
    """Return labels, points (n, markers, 3) with NaN where a marker was not seen, rate [Hz] and unit."""
    library = _library()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of parameters that are not read here
            reader = library.Reader(io.BytesIO(data))
            labels = [label.strip() for label in reader.point_labels]
            unit = reader.get("POINT:UNITS")
            frames = itertools.islice(reader.read_frames(copy=True, analog_transform=False), MOST_FRAMES)
            table = np.array([points[:, :4] for _, points, _ in frames], dtype=np.float64)
            rate_hz = float(reader.point_rate)
    except _DAMAGED as error:
        reason = " ".join(str(error).split())[:100] or type(error).__name__
        raise BadFile(f"{path}: not a readable C3D file ({reason}); export it again") from error
    if table.ndim != 3 or table.shape[1] == 0 or not 0.0 < rate_hz <= FASTEST_HZ:
        raise BadFile(f"{path}: {table.shape[0]} frames of markers at {rate_hz:g} Hz; expected markers at a rate")
    points, residual = table[..., :3], table[..., 3]
    unseen = (residual < 0.0) | ~np.isfinite(points).all(axis=-1) | (points == 0.0).all(axis=-1)
    points[unseen] = np.nan
    return labels[: points.shape[1]], points, rate_hz, "" if unit is None else unit.string_value.strip().lower()


def _of_one_person(path: Path, labels: list[str], points: Floats) -> dict[str, Floats]:
    """Return the markers that are read, by their labels without the subject's name."""
    markers: dict[str, Floats] = {}
    named: dict[str, str] = {}
    for index, label in enumerate(labels):
        name = label.rpartition(":")[2].upper()
        if name not in plug_in_gait.LABELS:
            continue
        if (other := named.setdefault(name, label)) != label or name in markers:
            raise BadFile(f"{path}: marker {name} is there twice, as {other} and {label}; expected those of one person")
        markers[name] = points[:, index]
    return markers


def _filled(path: Path, markers: dict[str, Floats], rate_hz: float) -> tuple[dict[str, Floats], int, tuple[str, ...]]:
    """Bridge what is hidden for a short while and cut the ends; return markers, the first frame, and what to tell.

    A marker that may be absent is left out where it cannot be bridged.
    """
    most = int(LONGEST_BRIDGE_S * rate_hz)
    count = len(next(iter(markers.values())))
    seen = {name: np.isfinite(points[:, 0]) for name, points in markers.items()}
    for name in [name for name in markers if name not in plug_in_gait.NEEDED and not seen[name].all()]:
        if not seen[name].any() or _longest(~seen[name])[1] > most:
            del markers[name], seen[name]
            plug_in_gait.expect(path, markers)
    known = {name: np.flatnonzero(each) for name, each in seen.items()}
    if lost := [name for name, frames in known.items() if not len(frames)]:
        raise BadFile(f"{path}: marker {lost[0]} is seen in no frame; it is needed")
    first = max(int(frames[0]) for frames in known.values())
    last = min(int(frames[-1]) for frames in known.values())
    if last <= first:
        raise BadFile(f"{path}: there is no time in which all of {', '.join(sorted(markers))} are known")
    bridged = []
    for name, frames in known.items():
        start, long = _longest(~seen[name][first : last + 1])
        if long > most:
            raise BadFile(
                f"{path}: marker {name} is hidden for {long / rate_hz:.2f} s, {(first + start) / rate_hz:.2f} s in; "
                f"at most {LONGEST_BRIDGE_S:g} s are bridged: fill it where it was captured, or cut the file"
            )
        if long:
            bridged.append(f"{name} {long / rate_hz:.2f} s")
            every = np.arange(count)
            markers[name] = np.column_stack(
                [np.interp(every, frames, markers[name][frames, axis]) for axis in range(3)]
            )
    cut = {name: points[first : last + 1] for name, points in markers.items()}
    return cut, first, (f"hidden markers bridged, at the longest: {', '.join(bridged)}",) if bridged else ()


def _longest(hidden: NDArray[np.bool_]) -> tuple[int, int]:
    """Return where the longest run begins, and its length."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], hidden, [False]]).astype(int)))
    if not len(edges):
        return 0, 0
    lengths = edges[1::2] - edges[::2]
    return int(edges[::2][lengths.argmax()]), int(lengths.max())


def _library() -> Any:
    try:
        return importlib.import_module("c3d")
    except ImportError as error:
        raise StationError(
            f"a C3D file needs {error.name}; install the extra: pip install 'teleop-station[c3d]'"
        ) from error
