"""A capture device of Video4Linux, by the kernel's own calls: what it offers, what it is set to, and its pictures."""

from __future__ import annotations

import contextlib
import ctypes
import errno
import fcntl
import mmap
import os
import select
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from adapters.cameras import v4l2_calls as calls

_CAPTURE, _MAPPED, _DISCRETE = 1, 1, 1
_CAN_CAPTURE, _HAS_DEVICE_CAPS = 0x1, 0x80000000
_DAMAGED, _TIME_MASK, _TIME_IS_MONOTONIC = 0x40, 0xE000, 0x2000
_FULL_RANGE, _COLOURS_OF_JPEG = 1, 7
_MOST = 1000  # of a list; a driver that never ends one must not hold us
_NO_MORE = (errno.EINVAL, errno.ENOTTY)  # behind the last of a list; a driver that has no list

T = TypeVar("T", bound=ctypes.Structure)
Size = tuple[int, int]


class Info(NamedTuple):
    """What a device says of itself; `driver` with its version."""

    card: str
    driver: str
    bus: str
    captures: bool


class Layout(NamedTuple):
    """How a picture lies in memory: size [px], bytes from row to row (0 where it has none), and how bright white is."""

    form: str
    width: int
    height: int
    stride: int
    is_full_range: bool


class Frame(NamedTuple):
    """A picture: its bytes, the driver's number and time of it [ns], on the monotonic clock; None for another one."""

    data: bytes
    number: int
    taken_ns: int | None
    is_damaged: bool


class VideoDevice:
    """A device, open for calls that do not block; every method raises `OSError` as the kernel does.

    A camera that was torn out answers ENODEV, or EIO for a picture that was on its way.

    Args:
        path: Its file.

    Raises:
        OSError: it cannot be opened; ENOTTY where it is no video device.
    """

    def __init__(self, path: Path) -> None:
        self._file = os.open(path, os.O_RDWR | os.O_NONBLOCK)
        self._memory: list[mmap.mmap] = []
        self._is_streaming = False
        try:
            self.info = self._ask()
        except OSError:
            self.close()
            raise

    def forms(self) -> list[str]:
        """Return the formats that it offers, by their four letters."""
        listed = self._listed(calls.ENUM_FMT, calls.FormatDescription, type=_CAPTURE)
        return [_letters(found.pixelformat) for found in listed]

    def sizes(self, form: str) -> list[tuple[Size, Size]]:
        """Return the sizes of a format [px], each as least and greatest; a driver may not say."""
        listed = self._listed(calls.ENUM_FRAMESIZES, calls.SizeDescription, pixel_format=_code(form))
        return [_sizes(found) for found in listed]

    def rates(self, form: str, size: Size) -> list[tuple[float, float]]:
        """Return the rates of a format and size [Hz], each as least and greatest; a driver may not say."""
        listed = self._listed(calls.ENUM_FRAMEINTERVALS, calls.IntervalDescription, pixel_format=_code(form),
                              width=size[0], height=size[1])  # fmt: skip
        return [_rates(found) for found in listed]

    def set_format(self, form: str, size: Size) -> Layout:
        """Ask for a format and size; return what it takes."""
        asked = calls.Format(type=_CAPTURE)
        asked.fmt.pix.pixelformat = _code(form)
        asked.fmt.pix.width, asked.fmt.pix.height = size
        pix = self._call(calls.S_FMT, asked).fmt.pix
        is_full = pix.quantization == _FULL_RANGE if pix.quantization else pix.colorspace == _COLOURS_OF_JPEG
        return Layout(_letters(pix.pixelformat), pix.width, pix.height, pix.bytesperline, is_full)

    def set_rate(self, fps: float) -> float | None:
        """Ask for a rate [Hz]; return what it will do, None where it does not say."""
        asked = calls.Parameters(type=_CAPTURE)
        interval = asked.parm.capture.timeperframe
        interval.numerator, interval.denominator = 1000, round(fps * 1000)
        try:
            return _rate(self._call(calls.S_PARM, asked).parm.capture.timeperframe) or None
        except OSError as error:
            if error.errno not in _NO_MORE:
                raise
            return None

    def control(self, number: int) -> int:
        """Return the value of a setting."""
        return int(self._call(calls.G_CTRL, calls.Control(id=number)).value)

    def request(self, count: int) -> int:
        """Have the driver make buffers, and give it all of them; return how many it made.

        Who else reads the camera is found out here: EBUSY.
        """
        made = self._call(calls.REQBUFS, calls.BufferRequest(count=count, type=_CAPTURE, memory=_MAPPED)).count
        for index in range(made):
            buffer = self._call(calls.QUERYBUF, _buffer(index))
            self._memory.append(mmap.mmap(self._file, buffer.length, offset=buffer.m.offset))
            self._call(calls.QBUF, _buffer(index))
        return int(made)

    def start(self) -> None:
        """Begin to take pictures; a second call does nothing."""
        if not self._is_streaming:
            self._call(calls.STREAMON, ctypes.c_int32(_CAPTURE))
            self._is_streaming = True

    def wait(self, timeout_s: float) -> bool:
        """Wait for a picture; whether one came in time."""
        poll = select.poll()
        poll.register(self._file, select.POLLIN)
        events = poll.poll(timeout_s * 1e3)
        if events and not events[0][1] & select.POLLIN:
            self._ask()  # one that was torn out says so
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        return bool(events)

    def read_frame(self) -> Frame | None:
        """Return the oldest picture that is ready, and give its buffer back; None when none is."""
        try:
            buffer = self._call(calls.DQBUF, _buffer(0))
        except BlockingIOError:
            return None
        is_monotonic = buffer.flags & _TIME_MASK == _TIME_IS_MONOTONIC
        taken_ns = buffer.timestamp.tv_sec * 1_000_000_000 + buffer.timestamp.tv_usec * 1000
        is_damaged = bool(buffer.flags & _DAMAGED)
        frame = Frame(
            self._memory[buffer.index][: buffer.bytesused], buffer.sequence, taken_ns if is_monotonic else None,
            is_damaged,
        )  # fmt: skip
        self._call(calls.QBUF, _buffer(buffer.index))
        return frame

    def close(self) -> None:
        """Stop, and let go of the device; a second call does nothing."""
        if self._file < 0:
            return
        if self._is_streaming:
            _quietly(lambda: self._call(calls.STREAMOFF, ctypes.c_int32(_CAPTURE)))
        for memory in self._memory:
            memory.close()
        _quietly(lambda: os.close(self._file))
        self._file, self._memory, self._is_streaming = -1, [], False

    def _ask(self) -> Info:
        found = self._call(calls.QUERYCAP, calls.Capability())
        can = found.device_caps if found.capabilities & _HAS_DEVICE_CAPS else found.capabilities
        version = ".".join(str(found.version >> shift & 0xFF) for shift in (16, 8, 0))
        return Info(
            card=_text(found.card),
            driver=f"{_text(found.driver)} {version}",
            bus=_text(found.bus_info),
            captures=bool(can & _CAN_CAPTURE),
        )

    def _listed(self, call: int, kind: type[T], **asked: int) -> Iterator[Any]:
        """Yield what a call lists, until it says that there is no more."""
        for index in range(_MOST):
            try:
                yield self._call(call, kind(index=index, **asked))
            except OSError as error:
                if error.errno not in _NO_MORE:
                    raise
                return

    def _call(self, call: int, argument: Any) -> Any:
        """Make a call; return its argument, in which the kernel has put its answer."""
        while True:
            with contextlib.suppress(InterruptedError):  # by a signal: the call has done nothing yet
                fcntl.ioctl(self._file, call, argument, True)
                return argument


def _buffer(index: int) -> calls.Buffer:
    return calls.Buffer(index=index, type=_CAPTURE, memory=_MAPPED)


def _sizes(found: calls.SizeDescription) -> tuple[Size, Size]:
    size = found.range
    if found.type == _DISCRETE:
        return (size.min_width, size.max_width), (size.min_width, size.max_width)  # its width and height
    return (size.min_width, size.min_height), (size.max_width, size.max_height)


def _rates(found: calls.IntervalDescription) -> tuple[float, float]:
    most = found.least if found.type == _DISCRETE else found.most
    return _rate(most), _rate(found.least)  # the longest time is the least rate


def _rate(interval: calls.Fraction) -> float:
    return float(interval.denominator / interval.numerator) if interval.numerator else 0.0


def _code(letters: str) -> int:
    return int.from_bytes(letters.encode().ljust(4), "little")


def _letters(code: int) -> str:
    return (code & 0x7FFFFFFF).to_bytes(4, "little").decode("ascii", "replace").rstrip()


def _text(data: bytes) -> str:
    return data.decode("utf-8", "replace")


def _quietly(act: Callable[[], object]) -> None:
    """Do what a device that is gone refuses."""
    with contextlib.suppress(OSError):  # it is let go of either way
        act()
