"""A program tied to its starter: the kernel kills it with the thread that did, ``kill -9`` included.

The wish is the child's to tell the kernel. Code of ours between fork and exec could do that, but in a process with
threads no such code is safe, nor are the fork handlers of the libraries that a program has loaded by then. So this file
also runs as a script of its own, which tells the kernel and becomes the program.
"""

from __future__ import annotations

import ctypes
import os
import signal
import sys
from collections.abc import Sequence

_PR_SET_PDEATHSIG = 1  # linux/prctl.h
_CANNOT_RUN = 126  # as a shell's


def tied(arguments: Sequence[str]) -> list[str]:
    """Return the command line that runs one tied to the calling thread; only Linux can, elsewhere it is unchanged."""
    if not sys.platform.startswith("linux"):
        return list(arguments)
    return [sys.executable, "-I", "-S", __file__, str(os.getpid()), *arguments]


def _become(parent: int, arguments: list[str]) -> None:
    # SIGKILL is sure to work, also on what is frozen.
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, int(signal.SIGKILL), 0, 0, 0)
    if os.getppid() != parent:  # it died before the kernel knew
        sys.exit(1)
    try:
        os.execv(arguments[0], arguments)
    except OSError as error:
        sys.stderr.write(f"{arguments[0]} cannot be started: {error.strerror}\n")
        sys.exit(_CANNOT_RUN)


if __name__ == "__main__":
    _become(int(sys.argv[1]), sys.argv[2:])
