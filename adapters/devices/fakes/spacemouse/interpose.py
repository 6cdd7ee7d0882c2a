"""Puts functions of ours in place of those that a loaded library calls, as LD_PRELOAD does, without a compiler.

A shared library of Linux calls every exported function, its own included, through a table of addresses (the "global
offset table"), which the loader fills in and which an earlier library in the search order may claim. Here the entries
are found as the loader finds them, in the library's dynamic section, and written.
"""

from __future__ import annotations

import ctypes
import mmap
import struct
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from station.operator.device import DeviceError

_PT_DYNAMIC = 2
_SYMTAB, _STRTAB, _RELA, _RELASZ, _JMPREL, _PLTRELSZ = 6, 5, 7, 8, 23, 2
_RELA_ENTRY = struct.Struct("<QQq")
_SYMBOL_BYTES = 24


class Interposed:
    """Functions of a loaded library that are ours until `undo`.

    Args:
        library: The file of the library.
        functions: What to call instead, by the name of the C function; kept alive as long as this object.

    Raises:
        DeviceError: this system is not a 64-bit Linux, or the library does not call what is to be replaced.
    """

    def __init__(self, library: Path, functions: Mapping[str, Any]) -> None:
        if sys.platform != "linux" or ctypes.sizeof(ctypes.c_void_p) != 8:
            raise DeviceError("this fake replaces C functions, which works on 64-bit Linux only")
        self._functions = dict(functions)
        self._before: dict[int, int] = {}
        found = set()
        for name, place in _entries(_base(library)):
            if name in self._functions:
                found.add(name)
                address = ctypes.cast(self._functions[name], ctypes.c_void_p).value or 0
                self._before[place] = _swap(place, address)
        if missing := sorted(self._functions.keys() - found):
            self.undo()
            raise DeviceError(f"{library.name} does not call {', '.join(missing)}; this fake needs the hidapi wheel")

    def undo(self) -> None:
        """Put the library's own functions back; a second call does nothing."""
        for place, address in self._before.items():
            _swap(place, address)
        self._before.clear()


def _base(library: Path) -> int:
    """Return where the loader has put a library."""
    for line in Path("/proc/self/maps").read_text().splitlines():
        fields = line.split(maxsplit=5)
        if len(fields) == 6 and fields[5] == str(library) and int(fields[2], 16) == 0:
            return int(fields[0].split("-")[0], 16)
    raise DeviceError(f"{library} is not loaded")


def _entries(base: int) -> Iterator[tuple[str, int]]:
    """Yield the name and the place of every address that the loader fills in by name."""
    tags = _dynamic_section(base)

    def at(tag: int) -> int:
        value = tags.get(tag, 0)
        return value if value >= base else base + value  # glibc has made them absolute; others leave them as offsets

    for start, size in ((_JMPREL, _PLTRELSZ), (_RELA, _RELASZ)):
        if start not in tags:
            continue
        for offset, info, _ in _RELA_ENTRY.iter_unpack(ctypes.string_at(at(start), tags[size])):
            symbol = info >> 32
            if symbol:
                (name,) = struct.unpack("<I", ctypes.string_at(at(_SYMTAB) + symbol * _SYMBOL_BYTES, 4))
                yield ctypes.string_at(at(_STRTAB) + name).decode(), base + offset


def _dynamic_section(base: int) -> dict[int, int]:
    header = ctypes.string_at(base, 64)
    (table,) = struct.unpack_from("<Q", header, 32)
    entry_bytes, count = struct.unpack_from("<HH", header, 54)
    for index in range(count):
        entry = ctypes.string_at(base + table + index * entry_bytes, entry_bytes)
        kind, _, _, address, _, _, size, _ = struct.unpack("<IIQQQQQQ", entry)
        if kind == _PT_DYNAMIC:
            return dict(struct.iter_unpack("<QQ", ctypes.string_at(base + address, size)))
    raise DeviceError("a library without a dynamic section cannot be interposed")


def _swap(place: int, address: int) -> int:
    """Write an address into the table; return the one that stood there."""
    page = place & -mmap.PAGESIZE
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.mprotect(ctypes.c_void_p(page), ctypes.c_size_t(mmap.PAGESIZE), mmap.PROT_READ | mmap.PROT_WRITE) != 0:
        raise DeviceError(f"the table of addresses cannot be written (errno {ctypes.get_errno()})")
    entry = ctypes.c_uint64.from_address(place)
    before, entry.value = entry.value, address
    return before
