"""An Intel RealSense's colour camera, and its depth, through its SDK, with the factory's intrinsics; or a recording.

Depth is aligned to colour by the SDK, so that a pixel of the one sees what that of the other sees, and comes in
millimetres whatever the step of the camera is.

A time of capture is the SDK's where it is on this machine's clock (its domains global and system time); else a picture
counts as taken when it arrives. A recording of the SDK is played in real time and begins anew at its end.
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np

from adapters.cameras.encode import Encoder, library
from station import depth
from station.camera.source import CameraError, Drops, Picture, PictureSettings
from station.contract import DEPTH_STEP_M
from station.optics import Distortion, Intrinsics, Optics

_SIZE, _FPS = (640, 480), 30
_DEPTH_SIZE = (640, 480)  # before it is aligned, which gives it the size of the colour; every depth camera has it
_STALLED_S = 5.0
_OLDEST_NS = 1_000_000_000  # a time that is older, or in the future, is on another clock
_QUEUED = 32  # pictures that the SDK may hold: more are not taken at once

_MODELS: dict[str, tuple[Distortion, int]] = {
    "none": ("none", 0),
    "brown_conrady": ("plumb_bob", 5),
    "kannala_brandt4": ("kannala_brandt", 4),
}
"""The SDK's models that are OpenCV's, and how many of its five coefficients count. Coefficients of its other ones (the
inverse one turns a pixel into a ray) mean something else, and have no place here."""


class RealSenseCamera:
    """Reads a colour stream, and depth where that is wanted; implements `station.camera.source.Camera`.

    Args:
        serial: Of the camera; "" for the only one.
        file: A recording of the SDK in place of a camera; None for none.
        settings: 640x480 at 30 Hz unless they say otherwise; of a recording its own.

    Raises:
        CameraError: no SDK, no such camera or recording, or it does not offer what is wanted.
    """

    def __init__(self, serial: str, file: Path | None, settings: PictureSettings) -> None:
        self.drops = Drops()
        self._sdk = library("pyrealsense2", "pyrealsense2", "the source realsense", extra="realsense")
        self._encoder = Encoder(settings.quality)
        self._align: Any = None  # of depth to colour, where that is wanted
        self._step_m = DEPTH_STEP_M  # of the camera's own depth
        self._what = str(file) if file is not None else f"RealSense {serial or 'camera'}"
        self._config = self._sdk.config()
        self._pipeline = self._sdk.pipeline()
        self._is_running = False
        self._number: int | None = None
        self._heard_s = 0.0
        if file is not None:
            self._choose_file(file, settings)
        else:
            self._choose_device(serial, settings)
        try:
            profile = self._config.resolve(self._sdk.pipeline_wrapper(self._pipeline))
            self._video = profile.get_stream(self._sdk.stream.color).as_video_stream_profile()
            self._device = {name: self._said(profile.get_device(), name) for name in _TOLD}
            if settings.depth:
                profile.get_stream(self._sdk.stream.depth)
                self._step_m = float(profile.get_device().first_depth_sensor().get_depth_scale())
                self._align = self._sdk.align(self._sdk.stream.color)
        except RuntimeError as error:
            streams = "colour and depth streams" if settings.depth else "a colour stream"
            raise CameraError(f"{self._what}: {_line(error)}; expected a camera with such {streams}") from None

    def read(self, timeout_s: float) -> Picture | None:
        """Return the newest picture; see `Camera.read`."""
        try:
            if not self._is_running:
                self._pipeline.start(self._config)
                self._is_running, self._heard_s = True, time.monotonic()
            is_there, frames = self._pipeline.try_wait_for_frames(max(1, round(timeout_s * 1e3)))
            if not is_there:
                self._expect_life()
                return None
            return self._newest(frames)
        except RuntimeError as error:
            raise CameraError(f"{self._what}: {_line(error)}; is it plugged in?") from error

    def why_silent(self) -> str:
        """Return what may keep a camera silent."""
        return f"{self._what}: gives no pictures; is it on a USB 3 port, and does no other program use it?"

    def facts(self) -> dict[str, Any]:
        """Return the device, the mode, and the factory's intrinsics."""
        optics, why_not = self._optics()
        return {
            "width": self._video.width(),
            "height": self._video.height(),
            "fps": float(self._video.fps()),
            "format": "RGB8",
            "is_passed_through": False,
            "quality": self._encoder.quality,
            "device": self._device["name"] or self._what,
            **{name: said for name, said in self._device.items() if name != "name"},
            "capture": "the SDK's time of the frame, on this machine's clock; else its arrival, monotonic clock",
            "exposure": None,
            **optics.facts(),
            **({"intrinsics_why_not": why_not} if why_not else {}),
            **({"depth": self._depth_facts()} if self._align is not None else {}),
        }

    def close(self) -> None:
        """Stop the stream and let go of the device."""
        if self._is_running:
            self._is_running = False
            self._pipeline.stop()

    def _choose_file(self, file: Path, settings: PictureSettings) -> None:
        if (settings.width, settings.height, settings.fps) != (None, None, None):
            raise CameraError(f"{file}: a recording has its own size and rate; leave out width, height and fps")
        if not file.is_file():
            raise CameraError(f"{file}: no such file; expected a recording of the RealSense SDK")
        try:
            self._config.enable_device_from_file(str(file), repeat_playback=True)
        except RuntimeError as error:
            raise CameraError(f"{file}: {_line(error)}; expected a recording of the RealSense SDK") from None

    def _choose_device(self, serial: str, settings: PictureSettings) -> None:
        known = plugged_in(self._sdk)
        if serial not in known if serial else len(known) != 1:
            wanted = (
                f"no RealSense with serial number {serial}" if serial else f"{len(known) or 'no'} RealSense cameras"
            )
            told = "; ".join(f"{number}: {name}" for number, name in known.items()) or "none is plugged in"
            raise CameraError(f"{wanted}: {told}; set options.serial to one of them")
        self._what = f"RealSense {serial or next(iter(known))}"
        self._config.enable_device(serial or next(iter(known)))
        width, height = settings.width or _SIZE[0], settings.height or _SIZE[1]
        fps = round(settings.fps or _FPS)
        self._config.enable_stream(self._sdk.stream.color, width, height, self._sdk.format.rgb8, fps)
        if settings.depth:
            self._config.enable_stream(self._sdk.stream.depth, *_DEPTH_SIZE, self._sdk.format.z16, fps)

    def _newest(self, frames: Any) -> Picture | None:
        """Return the newest picture of what the SDK holds; count the others."""
        now_ns, newest, beside = time.monotonic_ns(), None, None
        for _ in range(_QUEUED):
            frame = frames.get_color_frame()
            if frame:
                self.drops.skipped += newest is not None
                newest, beside = frame, frames
                self._count(frame.get_frame_number())
            frames = self._pipeline.poll_for_frames()
            if not frames.size():
                break
        if newest is None:
            return None
        self._heard_s = time.monotonic()
        jpeg = self._encoder.rgb(np.asanyarray(newest.get_data()))
        return Picture(jpeg, self._captured_ns(newest, now_ns), self._depth_of(beside))

    def _depth_of(self, frames: Any) -> bytes:
        """Return the depth of a set of frames, aligned; b"" where none is wanted, or none came with this picture."""
        frame = self._align.process(frames).get_depth_frame() if self._align is not None else None
        if not frame:
            return b""
        return depth.encoded(depth.rescaled(np.asanyarray(frame.get_data()), self._step_m))

    def _depth_facts(self) -> dict[str, Any]:
        return {"step_m": DEPTH_STEP_M, "camera_step_m": self._step_m, "range_m": None, "is_aligned": True}

    def _count(self, number: int) -> None:
        if self._number is not None:
            self.drops.lost += max(0, number - self._number - 1)
        self._number = number

    def _captured_ns(self, frame: Any, now_ns: int) -> int:
        """Return when a frame was taken, on the monotonic clock; when it arrived, where its clock is another."""
        domain = self._sdk.timestamp_domain
        if frame.frame_timestamp_domain not in (domain.global_time, domain.system_time):
            return now_ns
        age_ns = time.time_ns() - round(frame.get_timestamp() * 1e6)
        taken_ns = time.monotonic_ns() - age_ns
        return taken_ns if 0 <= age_ns < _OLDEST_NS else now_ns

    def _expect_life(self) -> None:
        if time.monotonic() - self._heard_s > _STALLED_S:
            raise CameraError(f"{self._what}: no picture for {_STALLED_S:g} s; it is opened anew")

    def _optics(self) -> tuple[Optics, str]:
        """Return the factory's intrinsics; nothing, and why, where they follow a model that is not OpenCV's."""
        inner = self._video.intrinsics
        coefficients = [float(value) for value in inner.coeffs]
        model = str(inner.model).rpartition(".")[2] if any(coefficients) else "none"
        if model not in _MODELS:
            return Optics(), f"the factory's are of the model {model}, {coefficients}, which is none of OpenCV's"
        distortion, count = _MODELS[model]
        found = Intrinsics(
            width=inner.width, height=inner.height, fx=inner.fx, fy=inner.fy, cx=inner.ppx, cy=inner.ppy,
            distortion=distortion, coefficients=tuple(coefficients[:count]), source="factory, by the SDK",
        )  # fmt: skip
        return Optics(found), ""

    def _said(self, device: Any, name: str) -> str:
        what = getattr(self._sdk.camera_info, _TOLD[name])
        return str(device.get_info(what)) if device.supports(what) else ""


_TOLD = {"name": "name", "serial": "serial_number", "firmware": "firmware_version", "usb": "usb_type_descriptor"}


def plugged_in(sdk: Any) -> dict[str, str]:
    """Return the name of each camera by its serial number."""
    info = sdk.camera_info
    return {each.get_info(info.serial_number): each.get_info(info.name) for each in sdk.context().query_devices()}


def _line(error: RuntimeError) -> str:
    return " ".join(str(error).split())
