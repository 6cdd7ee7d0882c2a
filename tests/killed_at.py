"""A process that dies at a chosen operation on files: what it leaves must be good at every one of them."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable
from pathlib import Path

_EVENTS = ("os.rename", "os.link", "os.mkdir", "os.remove", "os.rmdir", "open")


def killed_at(step: int, work: Callable[[], object], *, within: Path | None = None) -> bool:
    """Have a process do something and kill it at an operation on files; return False when there are no more.

    Args:
        step: Which operation, from 1.
        work: What it does.
        within: Folder; operations elsewhere do not count. None for all, those by a name within an open folder too.
    """
    child = os.fork()
    if child:
        status = os.waitpid(child, 0)[1]
        assert os.WIFSIGNALED(status) or not os.WEXITSTATUS(status)
        return os.WIFSIGNALED(status)
    seen, code = 0, 1

    def count(event: str, arguments: tuple[object, ...]) -> None:
        nonlocal seen
        if event in _EVENTS and (within is None or str(within) in str(arguments[0])):
            seen += 1
            if seen == step:
                os.kill(os.getpid(), signal.SIGKILL)

    sys.addaudithook(count)
    try:
        work()
        code = 0
    finally:
        os._exit(code)
