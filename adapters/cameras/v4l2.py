"""The capture devices of Video4Linux: which there are, what they offer, and what to tell whoever asked for another."""

from __future__ import annotations

import errno
import grp
import os
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from adapters.cameras.v4l2_device import Size, VideoDevice
from station.camera.source import CameraError

DEVICES = Path("/dev")
_SYSFS = Path("/sys/class/video4linux")
_SAME_RATE = 0.01  # 29.97 is 30
_GONE = (errno.ENODEV, errno.ENXIO, errno.ENOENT)


@dataclass(frozen=True, kw_only=True)
class CaptureDevice:
    """A capture device.

    Attributes:
        path: Its file.
        card: What it calls itself.
        serial: Its serial number; "" for none.
        bus: Where it is plugged in.
        why_not: Why it cannot be used, or "".
    """

    path: Path
    card: str = ""
    serial: str = ""
    bus: str = ""
    why_not: str = ""

    def __str__(self) -> str:
        if self.why_not:
            return f"{self.path} ({self.why_not})"
        return f"{self.path} {self.card}" + (f" (serial {self.serial})" if self.serial else "")


def found(folder: Path = DEVICES) -> list[CaptureDevice]:
    """Return the capture devices that can be seen, in the order of their numbers."""
    seen: list[CaptureDevice] = []
    for path in sorted(folder.glob("video*"), key=lambda path: (len(path.name), path.name)):
        if path.is_char_device():
            seen += _inspect(path)
    return seen


def choose(wanted: str, serial: str, folder: Path) -> CaptureDevice:
    """Return the one camera that is there, or the one of several that was asked for.

    Args:
        wanted: Its file, or a part of its name; "" for any.
        serial: Its serial number; "" for any.
        folder: Where the files of the devices are.

    Raises:
        CameraError: there is none, none that fits, or more than one.
    """
    if wanted.startswith("/"):
        return _named(Path(wanted), folder)
    cameras = found(folder)
    fitting = [camera for camera in cameras if wanted.lower() in camera.card.lower() and serial in ("", camera.serial)]
    if len(fitting) == 1:
        return fitting[0]
    wish = " and ".join(filter(None, [wanted and f"name {wanted!r}", serial and f"serial {serial!r}"]))
    if not fitting:
        raise CameraError(f"no camera{f' with {wish}' if wish else ''} found; {_there(cameras)}")
    raise CameraError(f"{len(fitting)} cameras{f' with {wish}' if wish else ''}; {_there(fitting)}; choose one with "
                      "options.device or options.serial")  # fmt: skip


def _named(path: Path, folder: Path) -> CaptureDevice:
    if not path.exists():
        raise CameraError(f"{path}: no such device; {_there(found(folder))}")
    if not path.is_char_device():
        raise CameraError(f"{path}: no video device; {_there(found(folder))}")
    return CaptureDevice(path=path, serial=_serial(path))


def _there(cameras: Sequence[CaptureDevice]) -> str:
    if not cameras:
        return "none is there: plug one in (`lsusb` lists it)"
    return "there are " + ", ".join(map(str, cameras))


def _inspect(path: Path) -> Iterator[CaptureDevice]:
    try:
        with closing(open_device(path)) as device:
            if device.info.captures:  # the others give metadata
                yield CaptureDevice(path=path, card=device.info.card, serial=_serial(path), bus=device.info.bus)
    except CameraError as error:
        yield CaptureDevice(path=path, why_not=str(error).removeprefix(f"{path}: ").split(";")[0])


def open_device(path: Path) -> VideoDevice:
    """Open a device.

    Raises:
        CameraError: it cannot be opened, or is no video device.
    """
    try:
        return VideoDevice(path)
    except OSError as error:
        raise CameraError(f"{path}: {why(error, path)}") from error


def why(error: OSError, path: Path) -> str:
    """Return what an error of a call means, and what to do."""
    if error.errno in (errno.EACCES, errno.EPERM):
        group = _group(path)
        return f"permission denied; add yourself to the group {group} and log in again: sudo usermod -aG {group} $USER"
    if error.errno == errno.EBUSY:
        return f"busy: another program reads it; `fuser -v {path}` names it"
    if error.errno in _GONE:
        return "gone; plug it in again"
    if error.errno == errno.ENOTTY:
        return "no video device"
    if error.errno == errno.EIO:
        return "the line to it fails; try another cable or port"
    return error.strerror or str(error)


def _group(path: Path) -> str:
    try:
        return grp.getgrgid(path.stat().st_gid).gr_name
    except (KeyError, OSError):
        return "video"


def _serial(path: Path) -> str:
    """Return the serial number of the USB device that a video device belongs to, or ""."""
    try:
        return (_SYSFS / os.path.basename(os.path.realpath(path)) / "device" / ".." / "serial").read_text().strip()
    except OSError:  # it has none, or is none of USB's
        return ""


@dataclass(frozen=True)
class Mode:
    """A format, size and rate that a camera offers; fps 0 where it does not say."""

    form: str
    width: int
    height: int
    fps: tuple[float, ...]

    def has_rate(self, fps: float) -> bool:
        """Whether it gives that many pictures per second."""
        return not self.fps or any(abs(offered - fps) <= _SAME_RATE * fps for offered in self.fps)

    def __str__(self) -> str:
        rates = "/".join(f"{fps:g}" for fps in sorted(self.fps, reverse=True))
        return f"{self.form} {self.width}x{self.height}" + (f"@{rates}" if rates else "")


def modes(device: VideoDevice, wanted: Size, fps: float) -> list[Mode]:
    """Return what a camera offers; where it takes a size or rate from a range, or does not say, what is wanted."""
    return [
        Mode(form, *size, _rates(device.rates(form, size), fps))
        for form in device.forms()
        for size in _sizes(device.sizes(form), wanted)
    ]


def _sizes(offered: Sequence[tuple[Size, Size]], wanted: Size) -> Iterator[Size]:
    if not offered:
        yield wanted
    for least, most in offered:
        fits = all(low <= want <= high for low, want, high in zip(least, wanted, most, strict=True))
        yield wanted if fits else most


def _rates(offered: Sequence[tuple[float, float]], fps: float) -> tuple[float, ...]:
    rates = (fps if least <= fps <= most else most for least, most in offered)
    return tuple(rate for rate in rates if rate > 0)


def pick(offered: Sequence[Mode], forms: Sequence[str], size: tuple[int, int], fps: float, path: Path) -> Mode:
    """Return the first mode with one of the formats, in their order, that has the size and the rate.

    Raises:
        CameraError: the camera offers none; the message lists what it offers.
    """
    for form in forms:
        for mode in offered:
            if mode.form == form and (mode.width, mode.height) == size and mode.has_rate(fps):
                return mode
    listed = ", ".join(str(mode) for mode in offered if mode.form in ("MJPG", "YUYV")) or ", ".join(map(str, offered))
    raise CameraError(
        f"{path}: offers no {' or '.join(forms)} {size[0]}x{size[1]}@{fps:g}; it offers {listed or 'no pictures'}; "
        "set width, height and fps to one of these"
    )
