"""The camera server: pictures of one camera, as JPEG files on the bus, and its depth beside them as PNG files.

One process per camera. What a camera is, an adapter knows (`adapters.cameras`, found by the setting `source`). A
runbook starts several under names of their own:

    - start: head
      server: camera
      with: {source: uvc, options: {device: /dev/video0}}

It moves nothing, so it may be started again by itself, and it stands back behind whatever else this machine does.
"""

from __future__ import annotations

import os
import re
from typing import Annotated, Any

import msgspec

from station import config as configs
from station import libraries, registry
from station.camera.serve import serve_camera
from station.camera.source import CameraKind, Newest, PictureSettings
from station.config import to_plain
from station.episode.storage.pictures import DEPTH_ENDING
from station.life.server import Life, ServerKind
from station.optics import Intrinsics, Mount, Optics

_NAME = re.compile(r"[a-z0-9_]+")
_JPEG_BYTES_PER_PIXEL = 0.2  # USB cameras gave 40 to 90 kB for 640x480 at quality 90; what is simulated needs half
_DEPTH_BYTES_PER_PIXEL = 1.0  # a sensor's noise gave 250 to 310 kB for 640x480; what is simulated needs a fiftieth


class CameraConfig(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Configuration of the camera server.

    Attributes:
        source: Where the pictures come from: ``uvc``, ``files``, ``mujoco``, ``realsense``, ``zmq``, or as it is
            registered.
        options: The source's.
        name: Of the camera, in its key ``camera_image_NAME``; "" for the server's own name.
        fps: Pictures per second [Hz]; None for the source's own: 30, or as files or senders have it.
        width, height: Size of the pictures [px]; None for the source's own: 640x480, or as files or senders have it.
        quality: JPEG quality of pictures that are encoded here, 1 to 100.
        depth: Whether to publish depth beside the pictures, in its key ``camera_depth_NAME``: 16-bit PNG in
            millimetres, 0 where there is none; the sources ``realsense`` and ``mujoco`` have it.
        intrinsics: Of the camera, at the size of its pictures: width, height, fx, fy, cx, cy [px], distortion
            (``none``, ``plumb_bob``, ``rational_polynomial``, ``kannala_brandt``), coefficients; None for what the
            source knows.
        mount: Where it is fixed: parent (a body of the robot, or ``world``), position_m, quat_wxyz, for axes x right,
            y down, z forward; None for what the source knows.
        niceness: How far the process stands back behind others, 0 to 19: pictures may wait, a robot may not.
    """

    source: Annotated[str, registry.named("camera")] = "uvc"
    options: dict[str, Any] = {}
    name: str = ""
    fps: float | None = None
    width: int | None = None
    height: int | None = None
    quality: int = 90
    depth: bool = False
    intrinsics: Intrinsics | None = None
    mount: Mount | None = None
    niceness: int = 5

    def __post_init__(self) -> None:
        registry.expect("camera", self.source)
        if self.name and not _NAME.fullmatch(self.name):
            raise ValueError(f"name is {self.name!r}; expected small letters, digits and _, for example left_wrist")
        if self.name.endswith(DEPTH_ENDING):
            raise ValueError(
                f"name is {self.name!r}, which is what the depth of a camera is called; choose another end"
            )
        if self.depth and not self.kind.has_depth:
            known = (name for name in registry.names("camera") if registry.find("camera", name).has_depth)
            raise ValueError(
                f"depth is true, and the source {self.source} gives none; those that do: {', '.join(known)}"
            )
        if self.fps is not None and not 0.1 <= self.fps <= 240.0:
            raise ValueError(f"fps is {self.fps:g}; expected 0.1 to 240 Hz")
        for field, value in (("width", self.width), ("height", self.height)):
            if value is not None and not 16 <= value <= 8192:
                raise ValueError(f"{field} is {value}; expected 16 to 8192 px")
        if not 1 <= self.quality <= 100:
            raise ValueError(f"quality is {self.quality}; expected 1 to 100")
        if not 0 <= self.niceness <= 19:
            raise ValueError(f"niceness is {self.niceness}; expected 0 to 19")
        self.typed_options()

    @property
    def kind(self) -> CameraKind:
        """The kind of its source."""
        found: CameraKind = registry.find("camera", self.source)
        return found

    @property
    def option_types(self) -> dict[str, type[msgspec.Struct]]:
        """Types of the settings that are mappings, by name."""
        return {"options": self.kind.options}

    def typed_options(self) -> Any:
        """Return the options as the source's type has them.

        Raises:
            ValueError: they are none of its options; the message names the field.
        """
        return configs.build_options(self.kind.options, self.options, where=f"options of the source {self.source}")

    def picture_bytes_per_s(self) -> float:
        """Return about how much its pictures need [bytes/s]; where a source decides, 640x480 at 30 Hz counts."""
        of_a_pixel = _JPEG_BYTES_PER_PIXEL + (_DEPTH_BYTES_PER_PIXEL if self.depth else 0.0)
        return (self.width or 640) * (self.height or 480) * of_a_pixel * (self.fps or 30.0)

    @property
    def settings(self) -> PictureSettings:
        """What is wanted of the pictures."""
        return PictureSettings(
            fps=self.fps, width=self.width, height=self.height, quality=self.quality, depth=self.depth
        )


def main(config: CameraConfig, life: Life) -> int:
    """Publish pictures until asked to stop; return the exit code."""
    kind, options = config.kind, config.typed_options()
    os.nice(config.niceness)
    if config.depth:
        life.bus.open_bulk()  # so that one that is not there is told now
    watched = kind.keys(options)
    if not watched:
        return _serve(config, life, kind, options, lambda _key: None)
    with life.bus.watch(watched) as watch:
        return _serve(config, life, kind, options, watch.latest)


def _serve(config: CameraConfig, life: Life, kind: CameraKind, options: Any, newest: Newest) -> int:
    return serve_camera(
        life,
        lambda: kind.open(options, config.settings, newest),
        name=config.name or life.name,
        facts={"source": config.source, "config": to_plain(config)},
        fps=config.fps,
        optics=Optics(config.intrinsics, config.mount),
    )


KIND = ServerKind(
    name="camera",
    role="sensor",
    summary="pictures of a camera: USB, files, simulated, or TWIST2's stream",
    config=CameraConfig,
    main=main,
    expect=lambda config: libraries.expect(f"camera source {config.source}", config.kind.library, config.kind.extra),
)
