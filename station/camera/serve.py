"""The loop that all cameras share: read the newest picture, publish, tell.

A picture is one atomic write of a whole JPEG file and its stamp, with the time of capture in it; of a camera that gives
depth, that is in the same write, of the same moment. The loop itself is `station.camera.feed`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from station.bus import keys
from station.camera.feed import Feed, Kind
from station.camera.source import Camera, CameraError, Picture
from station.life.server import Life
from station.optics import Optics

_UNKNOWN = Optics()


def serve_camera(
    life: Life,
    open_camera: Callable[[], Camera],
    *,
    name: str,
    facts: Mapping[str, Any],
    fps: float | None,
    optics: Optics = _UNKNOWN,
) -> int:
    """Open a camera and publish its pictures until the server is asked to stop; return the exit code.

    Args:
        life: The server's.
        open_camera: Opens the camera; called again after it was lost.
        name: Of the camera, in the key of its pictures.
        facts: What a manifest says of the server, beside what the camera itself says.
        fps: Pictures per second that are wanted [Hz]; None where the camera decides.
        optics: What is known of the camera's optics here; goes before what the camera itself says.

    Raises:
        CameraError: the camera cannot be opened at the start, or the optics are for pictures of another size.
    """
    key, depth_key = keys.camera_image(name), keys.camera_depth(name)

    def described(told: dict[str, Any]) -> dict[str, Any]:
        found = {**told, **optics.facts()}
        _expect_size(optics, found)
        if depth := found.get("depth"):
            found["depth"] = {"key": depth_key, **depth}
        return found

    def values(picture: Picture) -> dict[str, bytes]:
        return {key: picture.jpeg, **({depth_key: picture.depth} if picture.depth else {})}

    feed = Feed(
        life, open_camera, Kind("camera", "pictures", told_late="width"), key=key, described=described, values=values,
        head={"server": life.name, "role": "sensor", "camera": name, "key": key, "fps_wanted": fps, **facts},
    )  # fmt: skip
    return feed.run()


def _expect_size(optics: Optics, facts: Mapping[str, Any]) -> None:
    """Refuse intrinsics of pictures of another size; that of a stream is not known before its first picture."""
    inner, width, height = optics.intrinsics, facts.get("width"), facts.get("height")
    if inner is not None and None not in (width, height) and (inner.width, inner.height) != (width, height):
        raise CameraError(
            f"intrinsics are for pictures of {inner.width}x{inner.height}, the camera gives {width}x{height}; "
            "set width and height of the camera, or scale the intrinsics"
        )
