"""Become another program on what it takes for another machine: ``machine.py AHEAD_S BOOT COMMAND...``.

Its monotonic clock is that much ahead of this machine's, and its boot has another name: a time namespace, and a file
mounted over the kernel's. The wall clock is the same one. Whoever judges from outside knows both clocks exactly. Needs
root; run as a file, with the standard library alone.
"""

from __future__ import annotations

import ctypes
import os
import sys
import tempfile

_CLONE_NEWNS, _CLONE_NEWTIME = 0x00020000, 0x00000080  # linux/sched.h
_MS_BIND, _MS_REC, _MS_PRIVATE = 4096, 16384, 1 << 18  # linux/mount.h
_BOOT_ID = "/proc/sys/kernel/random/boot_id"

_libc = ctypes.CDLL(None, use_errno=True)


def prefix(ahead_s: int, boot: str) -> tuple[str, ...]:
    """Return what a command line begins with; `boot` has eight hex digits."""
    return (sys.executable, "-I", "-S", __file__, str(ahead_s), boot)


def main(words: list[str]) -> None:
    ahead_s, boot, command = words[0], words[1], words[2:]
    _checked(_libc.unshare(_CLONE_NEWTIME | _CLONE_NEWNS))
    with open("/proc/self/timens_offsets", "w") as offsets:
        offsets.write(f"monotonic {ahead_s} 0\n")
    theirs = os.open("/proc/self/ns/time_for_children", os.O_RDONLY | os.O_CLOEXEC)
    _checked(_libc.setns(theirs, _CLONE_NEWTIME))
    with tempfile.NamedTemporaryFile("w") as name:
        name.write(f"{boot}-0000-4000-8000-000000000000\n")
        name.flush()
        _checked(_libc.mount(b"none", b"/", None, _MS_REC | _MS_PRIVATE, None))
        _checked(_libc.mount(name.name.encode(), _BOOT_ID.encode(), None, _MS_BIND, None))
    os.execvp(command[0], command)


def _checked(result: int) -> None:
    if result != 0:
        code = ctypes.get_errno()
        raise OSError(code, os.strerror(code))


if __name__ == "__main__":
    main(sys.argv[1:])
