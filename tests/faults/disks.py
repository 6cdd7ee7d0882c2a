"""Disks that fail: a real one that is too small, and one whose system calls are late or refused."""

from __future__ import annotations

import contextlib
import os
import subprocess
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from station.bus import keys
from station.bus.address import BusAddress
from station.bus.client import Bus

CAMERA = keys.camera_image("front")
_FRAME_BYTES = 50_000
_BLOCK = bytes(64 * 1024)


class SmallDisk:
    """A file system in memory, in a mount namespace of its own: that takes no privilege, and nobody else sees it.

    Attributes:
        path: Where it is mounted, as other processes reach it.
    """

    def __init__(self, shell: subprocess.Popen[str], folder: Path, size_mb: int) -> None:
        self._shell, self._folder, self._size_mb = shell, folder, size_mb
        self.path = Path(f"/proc/{shell.pid}/root{folder}")
        self.mount()

    def mount(self) -> None:
        self._do(f"mount -t tmpfs -o size={self._size_mb}m tmpfs '{self._folder}'")

    def unmount(self) -> None:
        """Take it away, as a cable that is pulled does: whoever has files open may keep them."""
        self._do(f"umount -l '{self._folder}'")

    def fill(self) -> Path:
        """Leave no free byte; return the file that takes them all."""
        filler = self.path / "filler"
        with filler.open("wb", buffering=0) as file:
            for block in (_BLOCK, _BLOCK[:1]):
                with contextlib.suppress(OSError):
                    while file.write(block):
                        pass
        return filler

    def _do(self, command: str) -> None:
        assert self._shell.stdin is not None
        assert self._shell.stdout is not None
        self._shell.stdin.write(f"{command}; echo done $?\n")
        self._shell.stdin.flush()
        assert self._shell.stdout.readline() == "done 0\n", command


@contextmanager
def small_disk(folder: Path, size_mb: int) -> Iterator[SmallDisk]:
    """Mount a small disk as ``folder/data``."""
    _expect_namespaces()
    (folder / "data").mkdir()
    with subprocess.Popen(
        ["unshare", "-Urm", "sh"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as shell:  # fmt: skip
        try:
            yield SmallDisk(shell, folder / "data", size_mb)
        finally:
            shell.kill()


def _expect_namespaces() -> None:
    """Skip where an ordinary user may not have a mount namespace; CI fails."""
    try:
        done = subprocess.run(["unshare", "-Urm", "true"], capture_output=True, text=True, check=False)
    except FileNotFoundError:
        said = "there is no `unshare`"
    else:
        if done.returncode == 0:
            return
        said = done.stderr.strip()
    if os.environ.get("CI"):
        pytest.fail(f"no mount namespace: {said}")
    pytest.skip(f"no mount namespace: {said}")


class BadDisk:
    """Orders to the processes that are started from now on; see `bad_disk/sitecustomize.py`."""

    def __init__(self, folder: Path, data: Path, patch: pytest.MonkeyPatch) -> None:
        self._orders = folder / "orders"
        self._orders.mkdir()
        patch.setenv("BAD_DISK", str(self._orders))
        patch.setenv("BAD_DISK_DATA", str(data))
        patch.setenv("PYTHONPATH", str(Path(__file__).parent / "bad_disk"), prepend=os.pathsep)

    def order(self, what: str, *calls: str) -> None:
        for call in calls:
            (self._orders / call).write_text(what)

    def heal(self) -> None:
        for order in self._orders.iterdir():
            order.unlink()


class Film:
    """How many bytes of pictures come a second.

    Attributes:
        mb_per_s: May be set anew [MB/s].
    """

    def __init__(self, mb_per_s: float) -> None:
        self.mb_per_s = mb_per_s


@contextmanager
def camera(address: BusAddress, mb_per_s: float) -> Iterator[Film]:
    """Write pictures that nothing can compress, as many bytes a second."""
    film, done = Film(mb_per_s), threading.Event()

    def write() -> None:
        with Bus(address, name="camera", timeout_s=5.0) as bus:
            while not done.wait(_FRAME_BYTES / (film.mb_per_s * 1e6)):
                bus.publish({CAMERA: os.urandom(_FRAME_BYTES)})

    thread = threading.Thread(target=write)
    thread.start()
    try:
        yield film
    finally:
        done.set()
        thread.join()
