"""A recorder that is killed at a chosen operation on its files, while another operation hangs.

The recorder is the real one, in a forked process on a real bus; only the calls of the system that change files under
its data folder are replaced, by ones that count, hang or kill.
"""

from __future__ import annotations

import contextlib
import ctypes
import json
import os
import signal
import threading
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec

from servers.recorder import KIND, RecorderConfig
from station.bus import keys
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.episode.recorder import remote
from station.episode.storage.request import RecordAnswer, RecorderState, parse_answer
from station.life.serving import serve
from tests.waiting import wait_until

CALLS = ("write", "ftruncate", "fsync", "fdatasync", "rename", "replace", "unlink", "rmdir")
CLOSING, HELD = "closing", "held"
_PR_SET_PDEATHSIG = 1


class Orders(msgspec.Struct, frozen=True, kw_only=True):
    """What befalls a recorder's files.

    Attributes:
        hangs: The operation on episode ``a`` that never returns, counted from when its end is asked for; None for none.
        kills: The operation that kills the recorder, counted over the episodes of `of`; None for none.
        of: Tasks of those episodes.
    """

    hangs: int | None = None
    kills: int | None = None
    of: tuple[str, ...] = ("b",)


class Recorder:
    """A recorder in a process of its own."""

    def __init__(self, address: BusAddress, folder: Path, orders: Orders | None = None) -> None:
        self.pid = os.fork()
        if not self.pid:
            _run(address, folder, orders or Orders())

    def is_dead(self) -> bool:
        """Whether it has ended."""
        if self.pid and os.waitpid(self.pid, os.WNOHANG)[0]:
            self.pid = 0
        return not self.pid

    def end(self, number: int = signal.SIGKILL) -> None:
        """Send it a signal and wait until it has ended; it may have already."""
        if self.pid:
            with contextlib.suppress(ProcessLookupError):
                os.kill(self.pid, number)
        wait_until(self.is_dead)


class Client:
    """Writes a counter to a key, and asks the recorder."""

    def __init__(self, bus: Bus) -> None:
        self.bus = bus
        self.written = 0

    def write(self, times: int) -> None:
        for _ in range(times):
            self.written += 1
            assert self.bus.publish({"own": b"%d" % self.written})

    def request(self, action: str, asker: str, **fields: Any) -> None:
        """Ask without waiting for an answer."""
        assert self.bus.publish({keys.RECORD: json.dumps({"id": asker, "action": action, **fields}).encode()})

    def ask(self, action: Any, **fields: Any) -> RecordAnswer:
        return remote.ask(self.bus, action, timeout_s=60.0, **fields)

    def answered(self, asker: str) -> bool:
        value = self.bus.get(keys.RECORD_ACK)
        return value is not None and parse_answer(value, asker) is not None

    def state(self, recorder: Recorder) -> RecorderState | None:
        """Return what this recorder says that it does; None before its first word."""
        said = self.bus.read([keys.RECORDER]).get(keys.RECORDER)
        if said is None or said.stamp is None or said.stamp.source.split(".")[1] != str(recorder.pid):
            return None
        return msgspec.json.decode(said.value, type=RecorderState)


def _run(address: BusAddress, folder: Path, orders: Orders) -> None:
    """Be the recorder; never returns."""
    log = os.open(folder / "log", os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    os.dup2(log, 1)
    os.dup2(log, 2)
    code = 1
    try:
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)  # a test that is killed leaves no recorder behind
        _spoil(folder, orders)
        config = RecorderConfig(data=folder / "data", min_free_mb=0.0, flush_s=0.05, preroll_s=0.5)
        code = serve(KIND, config, address=address)
    finally:
        os._exit(code)


def _spoil(folder: Path, orders: Orders) -> None:
    """Replace the calls that change files under the data folder."""
    data, counts, lock = folder / "data", Counter[str](), threading.Lock()

    def obey(path: str) -> None:
        task = path.removeprefix(str(data)).strip("/").split("/")[0]
        if task == "a" and orders.hangs is not None and (folder / CLOSING).exists():
            with lock:
                counts["closing"] += 1
                is_last = counts["closing"] > orders.hangs
            if is_last:
                (folder / HELD).touch()
                threading.Event().wait()
        if task in orders.of and orders.kills is not None:
            with lock:
                counts["all"] += 1
                if counts["all"] > orders.kills:
                    os.kill(os.getpid(), signal.SIGKILL)

    def spoilt(call: Callable[..., Any]) -> Callable[..., Any]:
        def called(where: Any, *rest: Any, **named: Any) -> Any:
            path = os.readlink(f"/proc/self/fd/{where}") if isinstance(where, int) else os.fspath(where)
            if path.startswith(str(data)):
                obey(path)
            return call(where, *rest, **named)

        return called

    for name in CALLS:
        setattr(os, name, spoilt(getattr(os, name)))
