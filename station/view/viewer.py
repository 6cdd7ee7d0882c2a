"""Rerun's viewer: a process of ours that listens on loopback alone, and that nothing waits for without end."""

from __future__ import annotations

import contextlib
import importlib.util
import os
import re
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

import rerun as rr

from station.errors import StationError

BINARY_VARIABLE = "RERUN_CLI_PATH"
"""Names another binary of the viewer; Rerun's own command obeys it too."""

_LOOPBACK = "127.0.0.1"  # Rerun's default is every interface
_DISPLAYS = ("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET")
_INSTEAD = (
    "--save FILE.rrd writes a file to open elsewhere, `station view EPISODE --contact-sheet --plot` draws pictures"
)
_START_S = 30.0
_SETTLED_S = 2.0  # it listens before it has a window; where it gets none, it ends within half a second of that
_DELIVERY_S = 120.0
_LOOK_S = 0.1
_COLOURS = re.compile(r"\x1b\[[0-9;]*m")
_LONGEST = 300  # characters of its last words


def expect_display() -> None:
    """Refuse to open a window where there is no display.

    Raises:
        StationError: there is none; says what to do.
    """
    if sys.platform == "linux" and not any(os.environ.get(name) for name in _DISPLAYS):
        raise StationError(f"no display for Rerun's viewer ($DISPLAY and $WAYLAND_DISPLAY are not set); {_INSTEAD}")


def _nothing() -> None:
    pass


@contextmanager
def open_viewer(recording: rr.RecordingStream, *, on_end: Callable[[], None] = _nothing) -> Iterator[Viewer]:
    """Open a viewer that shows a recording from now on.

    An error or an interrupt inside ends its process; else it goes on until the user closes its window.

    Args:
        recording: What to show.
        on_end: Called in a thread of its own when the process ends.

    Raises:
        StationError: there is no display or no viewer, or it does not start; one line.
    """
    expect_display()
    binary, port = _binary(), _free_port()
    with tempfile.TemporaryFile() as log:  # no pipe: the viewer outlives us, and must be able to write
        try:
            process = subprocess.Popen(
                [binary, "--bind", _LOOPBACK, "--port", str(port), "--expect-data-soon"],
                stdin=subprocess.DEVNULL, stdout=log, stderr=log,
                env={**os.environ, "RERUN_APP_ONLY": "true"},  # no question about analytics, as Rerun's own spawn
                start_new_session=True,  # Ctrl-C in the terminal is ours to hear
            )  # fmt: skip
        except OSError as error:
            raise StationError(f"{binary}: Rerun's viewer cannot be started: {error.strerror}; {_INSTEAD}") from error
        try:
            viewer = Viewer(process, log, on_end)
            viewer.wait_until_it_listens(port)
            recording.connect_grpc(f"rerun+http://{_LOOPBACK}:{port}/proxy")
            yield viewer
        except BaseException:
            process.kill()
            process.wait()
            raise


class Viewer:
    """The process of a viewer.

    Args:
        process: It has just been started.
        log: What it writes.
        on_end: Called in a thread of its own when it ends.
    """

    def __init__(self, process: subprocess.Popen[bytes], log: IO[bytes], on_end: Callable[[], None]) -> None:
        self._process, self._log = process, log
        self._started_s = time.monotonic()

        def reap() -> None:
            process.wait()
            on_end()

        threading.Thread(target=reap, name="viewer", daemon=True).start()

    @property
    def is_closed(self) -> bool:
        """Whether the user closed its window."""
        return self._process.poll() == 0

    def deliver(self, recording: rr.RecordingStream) -> None:
        """Wait until the viewer has all that was logged, and long enough to know that it got its window.

        Raises:
            StationError: it ended, or takes nothing.
        """
        deadline_s = time.monotonic() + _DELIVERY_S
        problems: list[str] = []
        # In a thread: with a frozen viewer Rerun's flush heeds neither its own timeout nor Ctrl-C.
        flusher = threading.Thread(target=_flush, args=(recording, problems), name="flush", daemon=True)
        flusher.start()
        while flusher.is_alive():
            if time.monotonic() > deadline_s:
                raise StationError(f"Rerun's viewer did not take all data within {_DELIVERY_S:.0f} s; {_INSTEAD}")
            flusher.join(_LOOK_S)
        self._expect_running(max(_LOOK_S, self._started_s + _SETTLED_S - time.monotonic()))
        if problems:
            raise StationError(f"Rerun's viewer did not take all data: {problems[0]}; {_INSTEAD}")

    def wait_until_it_listens(self, port: int) -> None:
        """Wait until it can be connected to; raises `StationError` where it ends, or takes too long."""
        while not _is_listening(port):
            self._expect_running(_LOOK_S)
            if time.monotonic() > self._started_s + _START_S:
                raise StationError(f"Rerun's viewer did not start within {_START_S:.0f} s; {_INSTEAD}")

    def _expect_running(self, for_s: float) -> None:
        with contextlib.suppress(subprocess.TimeoutExpired):
            code = self._process.wait(for_s)
            how = f"signal {signal.Signals(-code).name}" if code < 0 else f"exit code {code}{self._last_words()}"
            raise StationError(f"Rerun's viewer ended ({how}); {_INSTEAD}")

    def _last_words(self) -> str:
        self._log.seek(0)
        text = _COLOURS.sub("", self._log.read().decode(errors="replace"))
        lines = [line.strip() for line in text.splitlines() if line.strip()]
        return f": {lines[-1].removeprefix('Error: ')[:_LONGEST]}" if lines else ""


def _binary() -> str:
    """Return the path of the viewer.

    Raises:
        StationError: it is not installed.
    """
    if path := os.environ.get(BINARY_VARIABLE):
        return path
    found = importlib.util.find_spec("rerun_cli")
    if found is None or found.origin is None:
        raise StationError(f"Rerun's viewer is not installed; pip install rerun-sdk, or: {_INSTEAD}")
    return str(Path(found.origin).with_name("rerun"))


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind((_LOOPBACK, 0))
        return int(probe.getsockname()[1])


def _is_listening(port: int) -> bool:
    try:
        socket.create_connection((_LOOPBACK, port), timeout=_LOOK_S).close()
    except OSError:
        return False
    return True


def _flush(recording: rr.RecordingStream, problems: list[str]) -> None:
    try:
        recording.flush()
    except RuntimeError as error:
        problems.append(str(error))
