"""A USB camera, or any other capture device of Video4Linux."""

from __future__ import annotations

import time
from itertools import islice
from pathlib import Path
from typing import Any, Literal

from adapters.cameras import v4l2
from adapters.cameras.encode import Encoder
from adapters.cameras.v4l2_device import Frame, Layout
from station import jpeg
from station.camera.source import CameraError, Drops, Picture, PictureSettings

Form = Literal["auto", "MJPG", "YUYV"]

_JPEG = "MJPG"
_SIZE, _FPS = (640, 480), 30.0
_BUFFERS = 4  # of the driver's: at 30 Hz it waits for us a tenth of a second before it drops one
_STALLED_S = 5.0
_OLDEST_NS = 1_000_000_000  # a time stamp that is older, or in the future, is on another clock
_AUTO_EXPOSURE, _EXPOSURE = 0x009A0901, 0x009A0902  # control ids of V4L2; 100 us
_MANUAL = (1, 2)  # by time, or time and iris
_EXPOSURE_UNIT_S = 1e-4


class UvcCamera:
    """Reads a camera through Video4Linux; implements `station.camera.source.Camera`.

    Times of capture are the driver's, on the monotonic clock. Its buffers are emptied at every read, and only the
    newest picture is encoded; holes in the driver's numbering are pictures that it had no buffer for, or that USB
    lost.

    Args:
        device, serial: Which camera, where there are several: its file or a part of its name, its serial number.
        form: ``MJPG``, ``YUYV``, or ``auto`` for the first that fits.
        wishes: 640x480 at 30 Hz unless they say otherwise.
        devices: Folder with the files of the devices.

    Raises:
        CameraError: no such camera, no permission, busy, or it does not offer what is wanted.
    """

    def __init__(
        self, device: str, serial: str, form: Form, settings: PictureSettings, *, devices: Path = v4l2.DEVICES
    ) -> None:  # fmt: skip
        self.drops = Drops()
        self._found = v4l2.choose(device, serial, devices)
        self._device = v4l2.open_device(self._found.path)
        self._number: int | None = None
        self._heard_s: float | None = None
        try:
            self._layout = self._set_up(form, settings)
        except OSError as error:
            self.close()
            raise self._error(error) from error
        except CameraError:
            self.close()
            raise

    def read(self, timeout_s: float) -> Picture | None:
        """Return the newest picture; see `Camera.read`."""
        try:
            self._device.start()
            if not self._device.wait(timeout_s):
                self._expect_life()
                return None
            return self._newest(self._drain())
        except OSError as error:
            raise self._error(error) from error

    def why_silent(self) -> str:
        """Return what is known of a camera that gives nothing."""
        if self.drops.torn:
            return f"{self._found.path}: no whole picture; try another cable or port, or a smaller size"
        return f"{self._found.path}: gives no pictures; is it covered by a switch, or is the USB bus full?"

    def facts(self) -> dict[str, Any]:
        """Return the device, the mode that was set, and the exposure."""
        info, layout = self._device.info, self._layout
        passes = layout.form == _JPEG
        facts: dict[str, Any] = {
            "width": layout.width,
            "height": layout.height,
            "fps": self._rate,
            "format": layout.form,
            "is_passed_through": passes,
            "device": str(self._found.path),
            "card": info.card,
            "bus_info": info.bus,
            "driver": info.driver,
            "serial": self._found.serial,
            "capture": "the driver's time stamp of the buffer, monotonic clock",
            "exposure": self._exposure(),
        }
        return facts if passes else facts | {"quality": self._encoder.quality}

    def close(self) -> None:
        """Stop the stream and let go of the device."""
        self._device.close()

    def _set_up(self, form: Form, settings: PictureSettings) -> Layout:
        path, device = self._found.path, self._device
        if not device.info.captures:
            raise CameraError(f"{path}: gives no pictures (a camera's second file is for metadata)")
        fps = settings.fps or _FPS
        size = (settings.width or _SIZE[0], settings.height or _SIZE[1])
        forms = (_JPEG, "YUYV") if form == "auto" else (form,)
        mode = v4l2.pick(v4l2.modes(device, size, fps), forms, size, fps, path)
        if mode.form != _JPEG:
            self._encoder = Encoder(settings.quality)
        layout = device.set_format(mode.form, size)
        if (layout.form, layout.width, layout.height) != (mode.form, *size):
            taken = f"{layout.form} {layout.width}x{layout.height}"
            raise CameraError(f"{path}: takes {taken} for {mode.form} {size[0]}x{size[1]}")
        rate = device.set_rate(fps)
        self._rate = None if rate is None else round(rate, 3)
        device.request(_BUFFERS)
        return layout

    def _expect_life(self) -> None:
        now_s = time.monotonic()
        self._heard_s = self._heard_s or now_s
        if now_s - self._heard_s > _STALLED_S:
            raise CameraError(f"{self._found.path}: no picture for {_STALLED_S:g} s; it is opened anew")

    def _drain(self) -> list[Frame]:
        """Return the pictures that the driver has, oldest first."""
        return list(islice(iter(self._device.read_frame, None), _BUFFERS))

    def _newest(self, frames: list[Frame]) -> Picture | None:
        """Return the newest whole picture of some; count the others."""
        picture = None
        for frame in reversed(frames):
            if picture is not None:
                self.drops.skipped += 1
            elif (data := self._file(frame)) is None:
                self.drops.torn += 1
            else:
                picture = Picture(data, self._captured_ns(frame))
        for frame in frames:
            if self._number is not None:
                self.drops.lost += max(0, frame.number - self._number - 1)
            self._number = frame.number
        if frames:
            self._heard_s = time.monotonic()
        return picture

    def _file(self, frame: Frame) -> bytes | None:
        """Return a picture as a JPEG file; None for one that is damaged."""
        if frame.is_damaged:
            return None
        layout, data = self._layout, frame.data
        if layout.form == _JPEG:
            known = jpeg.head(data)
            return None if known is None else jpeg.readable(data, known)
        stride = layout.stride or 2 * layout.width
        if len(data) < stride * layout.height:
            return None
        return self._encoder.yuyv(data, layout.width, layout.height, stride, is_full_range=layout.is_full_range)

    @staticmethod
    def _captured_ns(frame: Frame) -> int:
        now_ns = time.monotonic_ns()
        is_plausible = frame.taken_ns is not None and 0 <= now_ns - frame.taken_ns < _OLDEST_NS
        return frame.taken_ns if frame.taken_ns is not None and is_plausible else now_ns

    def _exposure(self) -> dict[str, Any] | None:
        """Return whether exposure is automatic and, where it is not, its time [s]; None where it is not known."""
        try:
            is_auto = self._device.control(_AUTO_EXPOSURE) not in _MANUAL
            time_s = self._device.control(_EXPOSURE) * _EXPOSURE_UNIT_S
        except OSError:  # a camera without these controls
            return None
        return {"is_auto": is_auto} if is_auto else {"is_auto": False, "time_s": time_s}

    def _error(self, error: OSError) -> CameraError:
        return CameraError(f"{self._found.path}: {v4l2.why(error, self._found.path)}")
