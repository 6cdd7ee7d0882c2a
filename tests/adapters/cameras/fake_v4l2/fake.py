"""The test's side of the fake camera: plugged in and out, and what it takes when."""

from __future__ import annotations

import contextlib
import os
import shutil
import socket
import struct
import subprocess
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import pytest

_SOURCE = Path(__file__).with_name("fake_v4l2.c")
_MOST_MODES = 16
_MONOTONIC, _ERROR = 0x2000, 0x40
_PROFILE, _MODE, _HEAD = struct.Struct("=iiiIIII32s"), struct.Struct("=4sIII"), struct.Struct("=IIIIQQ")
DEADLINE_S = 60.0


class Mode(NamedTuple):
    """What the camera offers."""

    form: str = "MJPG"
    width: int = 160
    height: int = 120
    fps: int = 30


def build(folder: Path) -> Path:
    """Return the compiled library; skip where there is no compiler."""
    compiler = shutil.which("cc") or shutil.which("gcc")
    if compiler is None:
        pytest.skip("no C compiler (cc or gcc), which the fake camera under Video4Linux needs")
    library = folder / "fake_v4l2.so"
    command = [compiler, "-O1", "-shared", "-fPIC", "-Wall", "-o", str(library), str(_SOURCE), "-ldl"]
    subprocess.run(command, check=True, capture_output=True, text=True)
    return library


class FakeCamera:
    """A camera at a path; one program may read it.

    Args:
        library: What `build` made.
        folder: Of the device files, with a short path.
        modes: What it offers.
        open_errno, format_errno, buffers_errno: What the driver answers; 0: it does as asked.
        quantization: Range of YUYV by V4L2's number: 0 left open, 1 full, 2 limited.
        is_exposure_known: Whether it has the controls of exposure.
        is_range: Whether it offers sizes up to those of its modes and rates from 1 Hz, instead of these alone.
    """

    def __init__(
        self, library: Path, folder: Path, modes: Sequence[Mode] = (Mode(),), *, card: str = "Fake Cam",
        number: int = 0, open_errno: int = 0, format_errno: int = 0, buffers_errno: int = 0, quantization: int = 0,
        is_exposure_known: bool = False, is_range: bool = False,
    ) -> None:  # fmt: skip
        self.path = folder / f"video{number}"
        self._library = library
        padded = [*modes, *[Mode("", 0, 0, 0)] * (_MOST_MODES - len(modes))]
        self._profile = _PROFILE.pack(
            open_errno,
            format_errno,
            buffers_errno,
            quantization,
            len(modes),
            is_exposure_known,
            is_range,
            card.encode(),
        ) + b"".join(_MODE.pack(mode.form.encode(), *mode[1:]) for mode in padded)
        self._changed = threading.Condition()
        self._line: socket.socket | None = None
        self._door: socket.socket | None = None
        self.sequence = 0
        self.plug_in()

    @property
    def environment(self) -> Mapping[str, str]:
        """What a process needs that shall see it."""
        return {"LD_PRELOAD": str(self._library), "FAKE_V4L2": str(self.path)}

    def plug_in(self) -> None:
        """Have it appear."""
        self._door = socket.socket(socket.AF_UNIX)
        address = f"{self.path}.sock"
        Path(address).unlink(missing_ok=True)
        self._door.bind(address)
        self._door.listen()
        threading.Thread(target=self._welcome, args=(self._door,), daemon=True).start()
        self.path.symlink_to("/dev/null")  # a device file for whoever looks; who opens it gets to us

    def unplug(self) -> None:
        """Tear it out."""
        self.path.unlink(missing_ok=True)
        with self._changed:
            for end in (self._door, self._line):
                if end is not None:
                    with contextlib.suppress(OSError):
                        end.shutdown(socket.SHUT_RDWR)
                    end.close()
            self._door = self._line = None
        self.sequence = 0

    def take(self, data: bytes, *, age_s: float = 0.0, is_damaged: bool = False, is_stamped: bool = True) -> int:
        """Give the reader a picture; return when it was taken [ns], in whole microseconds as a driver has it.

        Add to `sequence` before for pictures that the driver lost.
        """
        self._wait_for_a_reader()
        taken_us = (time.monotonic_ns() - round(age_s * 1e9)) // 1000
        flags = (_MONOTONIC if is_stamped else 0) | (_ERROR if is_damaged else 0)
        self._send(_HEAD.pack(self.sequence, flags, len(data), 0, *divmod(taken_us, 1_000_000)) + data)
        self.sequence += 1
        return taken_us * 1000

    def fail(self, number: int) -> None:
        """Have the reader get an error in place of a picture; the next one is for who opens the camera anew."""
        self._send(_HEAD.pack(0, 0, 0, number, 0, 0))
        with self._changed:
            self._line = None

    def _wait_for_a_reader(self) -> None:
        with self._changed:
            assert self._changed.wait_for(lambda: self._line is not None, DEADLINE_S), "nobody reads the camera"

    def _send(self, data: bytes) -> None:
        self._wait_for_a_reader()
        with self._changed:
            assert self._line is not None
            self._line.sendall(data)

    def _welcome(self, door: socket.socket) -> None:
        while True:
            try:
                line, _ = door.accept()
            except OSError:  # torn out
                return
            line.sendall(self._profile)
            threading.Thread(target=self._hear, args=(line,), daemon=True).start()

    def _hear(self, line: socket.socket) -> None:
        """Wait until a program that has opened the camera wants pictures; most only look."""
        with contextlib.suppress(OSError):
            if line.recv(1) != b"S":
                line.close()
                return
            with self._changed:
                self._line = line
                self._changed.notify_all()
            line.recv(1)  # it has closed the camera
            with self._changed:
                if self._line is line:
                    self._line = None
            line.close()


@contextlib.contextmanager
def camera(library: Path, folder: Path, modes: Sequence[Mode] = (Mode(),), **more: object) -> Iterator[FakeCamera]:
    """Give a camera that is unplugged at the end."""
    made = FakeCamera(library, folder, modes, **more)  # type: ignore[arg-type]
    try:
        yield made
    finally:
        made.unplug()
        with contextlib.suppress(OSError):
            os.unlink(f"{made.path}.sock")
