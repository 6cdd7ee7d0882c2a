"""A USB camera, or any other capture device of Video4Linux."""

from __future__ import annotations

import errno
import select
import time
from importlib import metadata
from pathlib import Path
from typing import Any, Literal

from adapters.cameras import jpeg, v4l2
from adapters.cameras.encode import Encoder
from station.camera.source import CameraError, Drops, Picture, Wishes

Form = Literal["auto", "MJPG", "YUYV"]

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
        self, device: str, serial: str, form: Form, wishes: Wishes, *, devices: Path = v4l2.DEVICES
    ) -> None:  # fmt: skip
        self.drops = Drops()
        self._video = v4l2.video()
        self._found = v4l2.choose(device, serial, devices)
        self._device = v4l2.open_device(self._video, self._found.path)
        self._capture: Any = None
        self._is_streaming = False
        self._number: int | None = None
        self._heard_s = 0.0
        self._is_stamped = True
        try:
            self._mode = self._set_up(form, wishes)
        except OSError as error:
            self.close()
            raise self._error(error) from error
        except CameraError:
            self.close()
            raise

    def read(self, timeout_s: float) -> Picture | None:
        """Return the newest picture; see `Camera.read`."""
        try:
            self._start()
            if not select.select([self._device], [], [], timeout_s)[0]:
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
        info = self._device.info
        passes = self._mode.form == "MJPG"
        facts: dict[str, Any] = {
            "width": self._mode.width,
            "height": self._mode.height,
            "fps": self._rate,
            "format": self._mode.form,
            "is_passed_through": passes,
            "device": str(self._found.path),
            "card": info.card,
            "bus_info": info.bus_info,
            "driver": f"{info.driver} {info.version}",
            "serial": self._found.serial,
            "capture": "the driver's time stamp of the buffer, monotonic clock",
            "exposure": self._exposure(),
            "library": f"linuxpy {metadata.version('linuxpy')}",
        }
        return facts if passes else facts | {"quality": self._encoder.quality}

    def close(self) -> None:
        """Stop the stream and let go of the device."""
        capture, self._capture = self._capture, None
        if capture is not None:
            if self._is_streaming:
                v4l2.quietly(capture.stream_off)
            if capture.buffer is not None:
                v4l2.quietly(capture.buffer.close)
        v4l2.quietly(self._device.close)

    def _set_up(self, form: Form, wishes: Wishes) -> v4l2.Mode:
        video, device = self._video, self._device
        if video.Capability.VIDEO_CAPTURE not in device.info.device_capabilities:
            raise CameraError(f"{self._found.path}: gives no pictures (a camera's second file is for metadata)")
        fps = wishes.fps or _FPS
        size = (wishes.width or _SIZE[0], wishes.height or _SIZE[1])
        forms = ("MJPG", "YUYV") if form == "auto" else (form,)
        mode = v4l2.pick(v4l2.modes(video, device, size, fps), forms, size, fps, self._found.path)
        if mode.form != "MJPG":
            self._encoder = Encoder(wishes.quality)
        self._capture = video.VideoCapture(device, size=_BUFFERS)
        self._capture.set_format(mode.width, mode.height, mode.form)
        self._rate = self._set_rate(fps)
        self._raw = video.get_raw_format(device, video.BufferType.VIDEO_CAPTURE).fmt.pix
        if (self._raw.width, self._raw.height) != size:
            raise CameraError(f"{self._found.path}: takes {self._raw.width}x{self._raw.height} for {size[0]}x{size[1]}")
        self._capture.arm()  # asks for buffers: who else reads the camera is found out here
        return mode

    def _set_rate(self, fps: float) -> float | None:
        """Ask for a rate; return what the camera will do, None where it does not say."""
        try:
            self._capture.set_fps(fps)
            return round(float(self._capture.get_fps()), 3)
        except OSError as error:
            if error.errno not in (errno.ENOTTY, errno.EINVAL):
                raise
            return None

    def _start(self) -> None:
        if not self._is_streaming:
            self._capture.stream_on()
            self._is_streaming, self._heard_s = True, time.monotonic()

    def _expect_life(self) -> None:
        if time.monotonic() - self._heard_s > _STALLED_S:
            raise CameraError(f"{self._found.path}: no picture for {_STALLED_S:g} s; it is opened anew")

    def _drain(self) -> list[Any]:
        """Return the pictures that the driver has, oldest first."""
        frames = []
        for _ in range(_BUFFERS):
            try:
                frames.append(self._capture.buffer.raw_read())
            except BlockingIOError:
                break
        return frames

    def _newest(self, frames: list[Any]) -> Picture | None:
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
                self.drops.lost += max(0, frame.frame_nb - self._number - 1)
            self._number = frame.frame_nb
        if frames:
            self._heard_s = time.monotonic()
        return picture

    def _file(self, frame: Any) -> bytes | None:
        """Return a picture as a JPEG file; None for one that is damaged."""
        if self._video.BufferFlag.ERROR in frame.flags:
            return None
        data = bytes(frame.data)
        if self._mode.form == "MJPG":
            known = jpeg.head(data)
            return None if known is None else jpeg.readable(data, known)
        stride = self._raw.bytesperline or 2 * self._mode.width
        if len(data) < stride * self._mode.height:
            return None
        return self._encoder.yuyv(data, self._mode.width, self._mode.height, stride, is_full_range=self._is_full_range)

    @property
    def _is_full_range(self) -> bool:
        """Whether luma is as in a JPEG file; by V4L2's rule, where the driver leaves it open."""
        if self._raw.quantization:
            return bool(self._raw.quantization == 1)
        return bool(self._raw.colorspace == self._video.raw.Colorspace.JPEG)

    def _captured_ns(self, frame: Any) -> int:
        now_ns, stamp = time.monotonic_ns(), frame.buff.timestamp
        stamp_ns = int(stamp.secs) * 1_000_000_000 + int(stamp.usecs) * 1000
        flags, video = int(frame.buff.flags), self._video
        is_monotonic = flags & video.BufferFlag.TIMESTAMP_MASK == video.BufferFlag.TIMESTAMP_MONOTONIC
        return stamp_ns if is_monotonic and 0 <= now_ns - stamp_ns < _OLDEST_NS else now_ns

    def _exposure(self) -> dict[str, Any] | None:
        """Return whether exposure is automatic and, where it is not, its time [s]; None where it is not known."""
        try:
            is_auto = self._video.get_control(self._device, _AUTO_EXPOSURE) not in _MANUAL
            time_s = self._video.get_control(self._device, _EXPOSURE) * _EXPOSURE_UNIT_S
        except OSError:  # a camera without these controls
            return None
        return {"is_auto": is_auto} if is_auto else {"is_auto": False, "time_s": time_s}

    def _error(self, error: OSError) -> CameraError:
        return CameraError(f"{self._found.path}: {v4l2.why(error, self._found.path)}")
