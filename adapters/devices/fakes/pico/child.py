"""A fake PC service in a process of its own; it ends with the process that started it."""

from __future__ import annotations

import contextlib
import subprocess
from collections.abc import Iterator
from pathlib import Path

from adapters.devices.fakes.pico.script import load
from station import python_child
from station.errors import NotReady

_ENDS_S = 5.0


class Child:
    """It, from when it listens.

    Attributes:
        port: Its TCP port on 127.0.0.1.
    """

    def __init__(self, process: subprocess.Popen[bytes], port: int) -> None:
        self._process, self.port = process, port

    def begin(self) -> None:
        """Let the script begin."""
        assert self._process.stdin is not None
        with contextlib.suppress(BrokenPipeError):  # it is gone: the headset is lost, and says so
            self._process.stdin.write(b"go\n")
            self._process.stdin.flush()


@contextlib.contextmanager
def child(script: Path, start_s: float) -> Iterator[Child]:
    """Start a fake PC service whose script will begin at a time of its own [s].

    Raises:
        BadFile: the script cannot be read; the message names file and field.
        NotReady: it does not listen.
    """
    load(script)  # a mistake in it is told here, in one line, and not by a child
    arguments = [str(script), "--port", "0", "--as-child", "--start-s", repr(start_s)]
    command = python_child.command("-m", "adapters.devices.fakes.pico", *arguments)
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        try:
            words = process.stdout.readline().split()
            if len(words) != 2:
                raise NotReady(f"the fake PC service ended before it was listening (exit code {process.wait()})")
            yield Child(process, int(words[1]))
        finally:
            with contextlib.suppress(BrokenPipeError):
                process.stdin.close()
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(_ENDS_S)
            process.kill()
