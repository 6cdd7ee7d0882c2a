"""The calls of Video4Linux: their numbers, and the layout of what they take and give.

Names and layouts are those of the kernel's ``linux/videodev2.h``; only what a camera of one plane needs is here.
Numbers are as on x86, Arm and RISC-V.
"""

from __future__ import annotations

import ctypes
from ctypes import c_char, c_int32, c_long, c_uint8, c_uint32, c_ulong, c_void_p
from typing import Any


class Capability(ctypes.Structure):
    """``v4l2_capability``: what a device is."""

    _fields_ = (
        ("driver", c_char * 16), ("card", c_char * 32), ("bus_info", c_char * 32), ("version", c_uint32),
        ("capabilities", c_uint32), ("device_caps", c_uint32), ("rest", c_uint32 * 3),
    )  # fmt: skip


class FormatDescription(ctypes.Structure):
    """``v4l2_fmtdesc``: one of the formats that a device offers."""

    _fields_ = (
        ("index", c_uint32), ("type", c_uint32), ("flags", c_uint32), ("description", c_char * 32),
        ("pixelformat", c_uint32), ("rest", c_uint32 * 4),
    )  # fmt: skip


class _Size(ctypes.Structure):
    _fields_ = (
        ("min_width", c_uint32), ("max_width", c_uint32), ("step_width", c_uint32),
        ("min_height", c_uint32), ("max_height", c_uint32), ("step_height", c_uint32),
    )  # fmt: skip


class SizeDescription(ctypes.Structure):
    """``v4l2_frmsizeenum``: one of the sizes of a format; a single one is the first two numbers of `range`."""

    _fields_ = (
        ("index", c_uint32), ("pixel_format", c_uint32), ("type", c_uint32), ("range", _Size),
        ("rest", c_uint32 * 2),
    )  # fmt: skip


class Fraction(ctypes.Structure):
    """``v4l2_fract``."""

    _fields_ = (("numerator", c_uint32), ("denominator", c_uint32))


class IntervalDescription(ctypes.Structure):
    """``v4l2_frmivalenum``: one of the times from picture to picture [s]; a single one is `least`."""

    _fields_ = (
        ("index", c_uint32), ("pixel_format", c_uint32), ("width", c_uint32), ("height", c_uint32), ("type", c_uint32),
        ("least", Fraction), ("most", Fraction), ("step", Fraction), ("rest", c_uint32 * 2),
    )  # fmt: skip


class PixelFormat(ctypes.Structure):
    """``v4l2_pix_format``: size and layout of a picture."""

    _fields_ = (
        ("width", c_uint32), ("height", c_uint32), ("pixelformat", c_uint32), ("field", c_uint32),
        ("bytesperline", c_uint32), ("sizeimage", c_uint32), ("colorspace", c_uint32), ("priv", c_uint32),
        ("flags", c_uint32), ("ycbcr_enc", c_uint32), ("quantization", c_uint32), ("xfer_func", c_uint32),
    )  # fmt: skip


class _FormatUnion(ctypes.Union):
    _fields_ = (("pix", PixelFormat), ("raw_data", c_uint8 * 200), ("alignment", c_void_p))  # others hold pointers


class Format(ctypes.Structure):
    """``v4l2_format``."""

    _fields_ = (("type", c_uint32), ("fmt", _FormatUnion))


class _Capture(ctypes.Structure):
    _fields_ = (
        ("capability", c_uint32), ("capturemode", c_uint32), ("timeperframe", Fraction), ("extendedmode", c_uint32),
        ("readbuffers", c_uint32), ("rest", c_uint32 * 4),
    )  # fmt: skip


class _ParametersUnion(ctypes.Union):
    _fields_ = (("capture", _Capture), ("raw_data", c_uint8 * 200))


class Parameters(ctypes.Structure):
    """``v4l2_streamparm``: the time from picture to picture [s]."""

    _fields_ = (("type", c_uint32), ("parm", _ParametersUnion))


class BufferRequest(ctypes.Structure):
    """``v4l2_requestbuffers``: how many buffers the driver is to have."""

    _fields_ = (
        ("count", c_uint32), ("type", c_uint32), ("memory", c_uint32), ("capabilities", c_uint32), ("rest", c_uint32),
    )  # fmt: skip


class _Time(ctypes.Structure):
    _fields_ = (("tv_sec", c_long), ("tv_usec", c_long))


class _Timecode(ctypes.Structure):
    _fields_ = (("type", c_uint32), ("flags", c_uint32), ("rest", c_uint8 * 8))


class _Memory(ctypes.Union):
    _fields_ = (("offset", c_uint32), ("userptr", c_ulong), ("planes", c_void_p), ("fd", c_int32))


class Buffer(ctypes.Structure):
    """``v4l2_buffer``: a buffer, empty or with a picture in it."""

    _fields_ = (
        ("index", c_uint32), ("type", c_uint32), ("bytesused", c_uint32), ("flags", c_uint32), ("field", c_uint32),
        ("timestamp", _Time), ("timecode", _Timecode), ("sequence", c_uint32), ("memory", c_uint32), ("m", _Memory),
        ("length", c_uint32), ("reserved2", c_uint32), ("request_fd", c_int32),
    )  # fmt: skip


class Control(ctypes.Structure):
    """``v4l2_control``: a setting, such as exposure."""

    _fields_ = (("id", c_uint32), ("value", c_int32))


def _call(number: int, argument: Any, *, reads: bool = True, writes: bool = True) -> int:
    """Return the number of a call: what it takes, its size, and which way it goes."""
    return reads << 31 | writes << 30 | ctypes.sizeof(argument) << 16 | ord("V") << 8 | number


QUERYCAP = _call(0, Capability, writes=False)
ENUM_FMT = _call(2, FormatDescription)
S_FMT = _call(5, Format)
REQBUFS, QUERYBUF = _call(8, BufferRequest), _call(9, Buffer)
QBUF, DQBUF = _call(15, Buffer), _call(17, Buffer)
STREAMON, STREAMOFF = _call(18, c_int32, reads=False), _call(19, c_int32, reads=False)
S_PARM = _call(22, Parameters)
G_CTRL = _call(27, Control)
ENUM_FRAMESIZES, ENUM_FRAMEINTERVALS = _call(74, SizeDescription), _call(75, IntervalDescription)
