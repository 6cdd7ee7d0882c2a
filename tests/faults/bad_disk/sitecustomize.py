"""Makes the disk under one folder bad, in any Python process that has this folder on its PYTHONPATH.

``BAD_DISK`` names a folder of orders: a file ``fdatasync`` that holds ``wait 0.2`` makes each such call take so much
longer, ``fail EROFS`` makes it fail, ``hang`` holds it up until the order is gone. ``BAD_DISK_DATA`` names the folder
that it is about. Without the two nothing is changed.
"""

import errno
import os
import time

_DATA, _ORDERS = os.environ.get("BAD_DISK_DATA", ""), os.environ.get("BAD_DISK", "")


def _obey(call):
    path = os.path.join(_ORDERS, call)
    while True:
        try:
            with open(path, encoding="ascii") as file:
                order, *rest = file.read().split()
        except (FileNotFoundError, ValueError):  # none, or one that is being written
            return
        if order == "wait":
            time.sleep(float(rest[0]))
            return
        if order == "fail":
            number = getattr(errno, rest[0])
            raise OSError(number, os.strerror(number))
        time.sleep(0.01)


def _is_meant(where):
    try:
        path = os.readlink(f"/proc/self/fd/{where}") if isinstance(where, int) else os.fspath(where)
    except OSError:
        return False
    return str(path).startswith(_DATA)


def _spoil(call):
    sound = getattr(os, call)

    def spoilt(where, *rest, **named):
        is_reading = call == "open" and not (rest and rest[0] & (os.O_WRONLY | os.O_RDWR))
        if not is_reading and _is_meant(where):
            _obey(call)
        return sound(where, *rest, **named)

    setattr(os, call, spoilt)


if _DATA and _ORDERS:
    for name in ("write", "fsync", "fdatasync", "statvfs", "open", "mkdir", "replace", "unlink"):
        _spoil(name)
