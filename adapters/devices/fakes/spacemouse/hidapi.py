"""The C functions of hidapi, played by fake interfaces under the real Python library.

What the adapter calls is the real ``hid``; the functions that it calls in turn, down to a kernel that has no such
device, are these.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Protocol

from adapters.devices.fakes.spacemouse.interpose import Interposed

_FAILED = -1
_NO_DATA = 0


class FakeInterface(Protocol):
    """One HID interface."""

    path: str
    vendor_id: int
    product_id: int
    name: str
    serial: str
    number: int
    usage: tuple[int, int]
    denied: bool

    @property
    def is_there(self) -> bool:
        """Whether it is plugged in."""
        ...

    def next_report(self) -> bytes | None:
        """Return the oldest report that was not read, b"" when there is none, None when it is torn out."""
        ...


class _Info(ctypes.Structure):
    """``struct hid_device_info`` of hidapi 0.13 and later."""


_Info._fields_ = [
    ("path", ctypes.c_char_p),
    ("vendor_id", ctypes.c_ushort),
    ("product_id", ctypes.c_ushort),
    ("serial_number", ctypes.c_wchar_p),
    ("release_number", ctypes.c_ushort),
    ("manufacturer_string", ctypes.c_wchar_p),
    ("product_string", ctypes.c_wchar_p),
    ("usage_page", ctypes.c_ushort),
    ("usage", ctypes.c_ushort),
    ("interface_number", ctypes.c_int),
    ("next", ctypes.POINTER(_Info)),
    ("bus_type", ctypes.c_int),
]

_POINTER, _INT, _TEXT = ctypes.c_void_p, ctypes.c_int, ctypes.c_void_p  # a text is returned as its address
_SIGNATURES: dict[str, tuple[Any, ...]] = {
    "hid_init": (_INT,),
    "hid_enumerate": (_POINTER, ctypes.c_ushort, ctypes.c_ushort),
    "hid_free_enumeration": (None, _POINTER),
    "hid_open_path": (_POINTER, ctypes.c_char_p),
    "hid_close": (None, _POINTER),
    "hid_set_nonblocking": (_INT, _POINTER, _INT),
    "hid_read": (_INT, _POINTER, _POINTER, ctypes.c_size_t),
    "hid_error": (_TEXT, _POINTER),
}


_INSTALLED: list[FakeHidapi] = []
"""Kept alive: the library calls them whether or not anybody else remembers them."""


class FakeHidapi:
    """The C functions, from `install` to `remove`.

    Args:
        interfaces: What is on the bus.
    """

    def __init__(self, interfaces: Sequence[FakeInterface]) -> None:
        self._interfaces = interfaces
        self._open: dict[int, FakeInterface] = {}
        self._opened = 0
        self._error = ctypes.create_unicode_buffer("Success", 200)
        self._listed: list[_Info] = []  # kept alive while Python reads it
        self._interposed: Interposed | None = None

    def install(self, hid: Any) -> None:
        """Take the place of the library's C functions under a loaded module."""
        functions: dict[str, Callable[..., Any]] = {name: getattr(self, f"_{name}") for name in _SIGNATURES}
        self._interposed = Interposed(
            Path(hid.__file__), {name: ctypes.CFUNCTYPE(*_SIGNATURES[name])(call) for name, call in functions.items()}
        )
        _INSTALLED.append(self)

    def remove(self) -> None:
        """Put the C functions back; whatever was opened must be closed by then."""
        if self._interposed is not None:
            self._interposed.undo()
            self._interposed = None
            _INSTALLED.remove(self)

    def _hid_init(self) -> int:
        return 0

    def _hid_enumerate(self, vendor_id: int, product_id: int) -> int | None:
        self._listed = [
            _Info(
                path=each.path.encode(), vendor_id=each.vendor_id, product_id=each.product_id,
                serial_number=each.serial, manufacturer_string="3Dconnexion", product_string=each.name,
                usage_page=each.usage[0], usage=each.usage[1], interface_number=each.number, bus_type=1,
            )
            for each in self._interfaces
            if each.is_there and vendor_id in (0, each.vendor_id) and product_id in (0, each.product_id)
        ]  # fmt: skip
        for one, following in zip(self._listed, self._listed[1:], strict=False):
            one.next = ctypes.pointer(following)
        return ctypes.addressof(self._listed[0]) if self._listed else None

    def _hid_free_enumeration(self, _first: int | None) -> None:
        self._listed = []

    def _hid_open_path(self, path: bytes) -> int | None:
        for each in self._interfaces:
            if each.path.encode() == path and each.is_there:
                if each.denied:
                    break
                self._opened += 1
                self._open[self._opened] = each
                return self._opened
        why = "Permission denied" if any(each.path.encode() == path for each in self._interfaces) else "No such file"
        self._error.value = f"Failed to open a device with path '{path.decode()}': {why}"
        return None

    def _hid_close(self, handle: int | None) -> None:
        self._open.pop(handle or 0, None)

    def _hid_set_nonblocking(self, _handle: int | None, _on: int) -> int:
        return 0

    def _hid_read(self, handle: int | None, buffer: int, length: int) -> int:
        interface = self._open.get(handle or 0)
        report = interface.next_report() if interface is not None else None
        if report is None:
            return _FAILED
        if not report:
            return _NO_DATA
        ctypes.memmove(buffer, report[:length], min(len(report), length))
        return min(len(report), length)

    def _hid_error(self, _handle: int | None) -> int:
        return ctypes.addressof(self._error)
