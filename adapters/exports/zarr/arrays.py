"""The arrays of a buffer, of one episode or of all: type, chunks, and what their attributes say."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from adapters.exports.lerobot.plan import Camera
from adapters.exports.row_pixels import about_depth
from adapters.exports.zarr.plan import ACTION, STATE, TIME, Plan, picture_name
from adapters.exports.zarr.zarr_library import compressor
from station.export.columns import KeyColumns, unique_names

_CHUNK_BYTES = 1 << 20  # of numbers: a few files, each of them small to read for a window of rows


def create_numbers(data: Any, plan: Plan, count: int) -> dict[str, Any]:
    """Create the arrays of the numbers of some rows in a group; return them by name."""
    common = plan.rows.common
    return {
        STATE: _numbers(data, STATE, count, common.state),
        ACTION: _numbers(data, ACTION, count, common.action),
        TIME: _create(data, TIME, (count,), "int64", _CHUNK_BYTES // 8, {"unit": "ns", "since": "Unix epoch, UTC"}),
    }


def create_pictures(
    data: Any, plan: Plan, count: int, optics: Mapping[str, Mapping[str, Any]] = {}
) -> Iterator[tuple[Camera, Any]]:
    """Create the array of each camera, and its depth, for some rows in a group; a picture is a chunk: a row reads one.

    Args:
        data: The group.
        plan: Of the buffer.
        count: How many rows.
        optics: What is known of the optics of cameras, by name.
    """
    for camera in plan.rows.common.pictures:
        is_depth = camera.step_m is not None
        what = about_depth(camera) if is_depth else {"colour": "RGB"}
        about = {"key": camera.key, "camera": camera.name, **what, "rate_hz": camera.hz, **optics.get(camera.name, {})}
        shape = (count, camera.height, camera.width, *(() if is_depth else (3,)))
        yield camera, _create(data, picture_name(camera), shape, "uint16" if is_depth else "uint8", 1, about)


def _numbers(data: Any, name: str, count: int, keys: tuple[KeyColumns, ...]) -> Any:
    names = unique_names(keys)
    about = {
        "names": names,
        "units": [unit for one in keys for unit in one.units],
        "keys": [one.key for one in keys for _ in one.names],
    }
    return _create(data, name, (count, len(names)), "float32", max(1, _CHUNK_BYTES // (4 * len(names))), about)


def _create(data: Any, name: str, shape: tuple[int, ...], kind: str, rows: int, about: dict[str, Any]) -> Any:
    return data.create_array(
        name, shape=shape, dtype=kind, chunks=(min(rows, shape[0]), *shape[1:]), compressors=compressor(),
        fill_value=0, attributes=about,
    )  # fmt: skip
