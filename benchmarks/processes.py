"""Processes that a benchmark needs beside it, none of which outlives it."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import socket
import subprocess
import tempfile
import time
import traceback
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from station import python_child
from station.bus import codec, keys
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.bus.redis_server import RedisServer, ServerOptions
from station.errors import BusError

_SPAWN = multiprocessing.get_context("spawn")  # a forked copy of a process with threads may hang
_STOP_S = 10.0
_LIMIT_S = 120.0

Stop = Callable[[], bool]


class Worker:
    """A process of its own that measures when asked to and sleeps in between.

    Args:
        make: Gives a context manager that sets up and yields a function; both live in the other process.
        arguments: For `make`.
    """

    def __init__(self, make: Callable[..., AbstractContextManager[Callable[..., Any]]], *arguments: Any) -> None:
        self._line, far = _SPAWN.Pipe()
        self._process = _SPAWN.Process(target=_work, args=(far, make, arguments), daemon=True)
        self._process.start()
        far.close()
        self._receive()

    def ask(self, *arguments: Any) -> Any:
        """Call the function over there and return what it returns."""
        self._line.send(arguments)
        return self._receive()

    def close(self) -> None:
        """End the process."""
        self._line.close()
        self._process.join(_STOP_S)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()

    def __enter__(self) -> Worker:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _receive(self) -> Any:
        kind, value = self._line.recv()
        if kind == "failed":
            raise RuntimeError(f"a process of the benchmark failed:\n{value}")
        return value


class Beside:
    """A process that does something until it is told to stop: a writer, a burner.

    Args:
        act: Called over there with a function that says whether to stop, and with `arguments`; what it returns is
            the result of `stop`.
        arguments: For `act`.
    """

    def __init__(self, act: Callable[..., Any], *arguments: Any) -> None:
        self._line, far = _SPAWN.Pipe()
        self._process = _SPAWN.Process(target=_stay, args=(far, act, arguments), daemon=True)
        self._process.start()
        far.close()
        self._line.recv()
        self.pid = self._process.pid

    def stop(self) -> Any:
        """Ask it to stop and return its result."""
        try:
            self._line.send(None)
            kind, value = self._line.recv()
        finally:
            self._line.close()
            self._process.join(_STOP_S)
        if kind == "failed":
            raise RuntimeError(f"a process of the benchmark failed:\n{value}")
        return value

    def __enter__(self) -> Beside:
        return self

    def __exit__(self, *_: object) -> None:
        if not self._line.closed:
            self.stop()


def burners() -> AbstractContextManager[None]:
    """Keep every core busy with a process of normal priority."""
    return _all([lambda: Beside(burn)] * (os.cpu_count() or 1))


def nothing() -> AbstractContextManager[None]:
    """Keep nothing busy."""
    return contextlib.nullcontext()


def burn(stop: Stop) -> None:
    """Take a core until told to stop."""
    while not stop():
        end_s = time.monotonic() + 0.01
        while time.monotonic() < end_s:
            pass


def work(seconds: float) -> None:
    """Use that much processor time of this thread, as inference and physics would."""
    end_s = time.thread_time() + seconds
    while time.thread_time() < end_s:
        pass


def fifo_is_permitted() -> bool:
    """Whether this process may ask for real-time scheduling."""
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
    except PermissionError:
        return False
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    return True


@contextlib.contextmanager
def bus(*, is_fifo: bool = True) -> Iterator[tuple[BusAddress, int]]:
    """Start a server of our own; yield its socket's address and the loopback port that stock scripts use.

    Args:
        is_fifo: Whether it keeps the real-time scheduling that it asks for; False: it runs as a server that somebody
            else started.
    """
    with tempfile.TemporaryDirectory(prefix="bench-") as name:
        folder, port = Path(name), free_port()
        options = ServerOptions(folder=folder, socket=folder / "bus.sock", tcp_port=port)
        with RedisServer.start(options) as server:
            if not is_fifo:
                os.sched_setscheduler(server.pid, os.SCHED_OTHER, os.sched_param(0))
            yield server.address, port


def free_port() -> int:
    """Return a loopback port that nothing listens on."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@contextlib.contextmanager
def station(*arguments: str, environment: Mapping[str, str], log: Path) -> Iterator[subprocess.Popen[bytes]]:
    """Run a ``station`` command beside us; interrupt it at the end."""
    with log.open("ab") as output:
        process = subprocess.Popen(
            python_child.command("-m", "station", *arguments),
            stdin=subprocess.DEVNULL, stdout=output, stderr=subprocess.STDOUT, env={**os.environ, **environment},
        )  # fmt: skip
    try:
        yield process
    finally:
        process.terminate()
        try:
            process.wait(_STOP_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def own_station(folder: Path) -> dict[str, str]:
    """Return the environment of a station that shares nothing with one that the user may be running."""
    runtime = folder / "run"
    runtime.mkdir(mode=0o700, exist_ok=True)
    named = {"STATION_BUS", "STATION_BUS_PASSWORD", "STATION_DATA"}
    own = {"XDG_RUNTIME_DIR": str(runtime), "XDG_STATE_HOME": str(folder / "state")}
    return {k: v for k, v in os.environ.items() if k not in named} | own


def cpu_s(pid: int) -> float:
    """Return the processor time that a process has used so far [s]."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def resident_mb(pid: int) -> float:
    """Return the memory that a process holds [MB]."""
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def shared_out_mb(pid: int) -> float:
    """Return the memory of a process, each page divided by how many have it (PSS) [MB]."""
    lines = Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines()
    return sum(int(line.split()[1]) for line in lines if line.startswith("Pss:")) * 1024 / 1e6


def family(pid: int) -> list[int]:
    """Return a process and all that it has started, directly or not."""
    children = [int(child) for task in Path(f"/proc/{pid}/task").iterdir() for child in _words(task / "children")]
    return [pid, *(one for child in children for one in family(child))]


def _words(file: Path) -> list[str]:
    return file.read_text().split()


def until(holds: Callable[[], bool]) -> float:
    """Look every 5 ms; return the instant at which it held [s]."""
    deadline = time.monotonic() + _LIMIT_S
    while not holds():
        if time.monotonic() > deadline:
            raise RuntimeError(f"not started within {_LIMIT_S:.0f} s")
        time.sleep(0.005)
    return time.monotonic()


def has_key(address: BusAddress, key: str) -> bool:
    """Whether a key holds something."""
    with Bus(address, name="bench") as line:
        return line.get(key) is not None


def gate_state(address: BusAddress, robot: str) -> str:
    """Return the state of a robot's gate; "" while there is none, or no bus yet."""
    with contextlib.suppress(BusError), Bus(address, name="bench") as line:
        return str(codec.parse_facts(line.get(keys.command_gate(robot))).get("state", ""))
    return ""


def _work(line: Connection, make: Callable[..., AbstractContextManager[Callable[..., Any]]], arguments: Any) -> None:
    try:
        with make(*arguments) as act:
            line.send(("ready", None))
            with contextlib.suppress(EOFError, OSError):
                while True:
                    line.send(("done", act(*line.recv())))
    except Exception:  # noqa: BLE001 - whatever it was, the benchmark that asked must hear of it
        with contextlib.suppress(OSError):
            line.send(("failed", traceback.format_exc()))


def _stay(line: Connection, act: Callable[..., Any], arguments: Any) -> None:
    line.send("ready")
    try:
        answer = ("done", act(line.poll, *arguments))  # readable when told to stop, or when the other end died
    except Exception:  # noqa: BLE001 - whatever it was, the benchmark that asked must hear of it
        answer = ("failed", traceback.format_exc())
    with contextlib.suppress(OSError):
        line.send(answer)


@contextlib.contextmanager
def _all(makers: list[Callable[[], AbstractContextManager[Any]]]) -> Iterator[None]:
    with contextlib.ExitStack() as stack:
        for make in makers:
            stack.enter_context(make())
        yield
