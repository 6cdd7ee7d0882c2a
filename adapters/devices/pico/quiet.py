"""Keeping a library that writes to the standard output, without line ends and from threads of its own, off ours."""

from __future__ import annotations

import ctypes
import os
import sys
from typing import TextIO

_STDOUT = 1


class QuietStdout:
    """From its construction to `restore` only Python writes to the standard output.

    File descriptor 1 leads to nowhere meanwhile; what Python writes goes on to where it led before.
    """

    def __init__(self) -> None:
        self._python: TextIO | None = None
        self._saved: int | None = None
        try:
            saved = os.dup(_STDOUT)
        except OSError:  # it is closed, as in some services: there is nothing to keep clean
            return
        sys.stdout.flush()
        self._saved = saved
        if _leads_to(sys.stdout, _STDOUT):
            self._python, sys.stdout = sys.stdout, os.fdopen(os.dup(saved), "w", buffering=1)
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, _STDOUT)
        os.close(nowhere)

    def restore(self) -> None:
        """Give the standard output back; a second call does nothing."""
        if self._saved is None:
            return
        ctypes.CDLL(None).fflush(None)  # what the C library still holds back must not come out afterwards
        os.dup2(self._saved, _STDOUT)
        os.close(self._saved)
        self._saved = None
        if self._python is not None:
            sys.stdout.close()
            sys.stdout, self._python = self._python, None


def _leads_to(stream: TextIO, descriptor: int) -> bool:
    try:
        return stream.fileno() == descriptor
    except (OSError, AttributeError):  # no file: a test's or a notebook's
        return False
