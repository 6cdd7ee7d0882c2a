"""The stop line: a unix socket of each station, on which any process of this user stops its robots past the bus.

A line ``stop <reason>`` asks its supervisor to tell every server of this machine that drives a robot, over the pipe of
that server (`station.life.supervisor_pipe`); the answer, a line of JSON, says which were told. The sockets are in the
runtime folder, one for each station, named after the bus and the process: several stations may share a bus, and one
that was killed leaves a file on which nobody answers.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import selectors
import socket
from collections.abc import Callable, Iterator
from pathlib import Path
from types import TracebackType
from typing import Any

import msgspec

from station.bus import address as addresses
from station.bus import codec
from station.bus.address import BusAddress
from station.errors import ConfigError
from station.life.stop_file import StopKeeper
from station.printable import printable

WITHIN_S = 0.1
"""How long an answer may take, from when a stop was said [s]; most often it takes a millisecond."""

_WORD = "stop"
_LONGEST_NAME = "stop-12345678-4194304.sock"
_LONGEST = 1024  # bytes of a line
_LONGEST_REASON = 200  # characters; a pipe takes such a line whole
_MOST = 32  # callers at a time: of more the oldest, which has said nothing yet, is hung up on
_PATIENCE_S = 1.0  # a caller says its line at once
_LOOK_S = 0.2
_AGAIN_S = 0.005


class StopReply(msgspec.Struct, frozen=True, kw_only=True):
    """What came of a stop.

    Attributes:
        told: Names of the servers that drive a robot and were told.
        not_told: Of those that were not: on other machines, or dead.
        why_not: Why the line was not understood, or "".
    """

    told: tuple[str, ...] = ()
    not_told: tuple[str, ...] = ()
    why_not: str = ""


def parse(line: bytes) -> str | None:
    """Return the reason of ``stop <reason>``, safe to print; None where a line asks for nothing of the kind."""
    word, _, reason = line.decode(errors="replace").strip().partition(" ")
    return (printable(reason.strip(), _LONGEST_REASON) or "stop line") if word == _WORD else None


def decode_reply(data: bytes) -> StopReply | None:
    """Return what a supervisor has answered; None where that is no answer."""
    try:
        return codec.parse_struct(data, StopReply)
    except codec.BadValue:
        return None


class StopCall:
    """A stop that is said on every stop line of a bus. It is said when this is made, and waits for nothing.

    Args:
        address: The bus, which need not be there.
        reason: Who asks for it, and why.
    """

    def __init__(self, address: BusAddress, reason: str) -> None:
        self._clock = address.clock
        self._until_s = self._clock.monotonic_s() + WITHIN_S
        self._said = f"{_WORD} {printable(reason, _LONGEST_REASON)}\n".encode()
        self._open: dict[socket.socket, bytearray] = {}
        self._replies: list[StopReply] = []
        self._busy = [path for path in _lines(address) if self._is_busy(path)]

    def reply(self) -> StopReply:
        """Return what the supervisors have answered, within `WITHIN_S` of when the stop was said; then hang up."""
        while self._open or self._busy:
            left_s = self._until_s - self._clock.monotonic_s()
            with selectors.DefaultSelector() as ready:
                for caller in self._open:
                    ready.register(caller, selectors.EVENT_READ)
                found = ready.select(max(0.0, min(left_s, _AGAIN_S if self._busy else left_s)))
            for key, _ in found:
                self._hear(key.fileobj)  # type: ignore[arg-type]  # what was registered
            self._busy = [path for path in self._busy if self._is_busy(path)]
            if left_s <= 0.0 and not found:
                break
        self.close()
        return StopReply(
            told=tuple(dict.fromkeys(name for reply in self._replies for name in reply.told)),
            not_told=tuple(dict.fromkeys(name for reply in self._replies for name in reply.not_told)),
        )

    def close(self) -> None:
        """Hang up; what was said is heard all the same."""
        for caller in self._open:
            caller.close()
        self._open.clear()
        self._busy = []

    def _is_busy(self, path: Path) -> bool:
        """Say it to one station; return whether so many call it that it is to be tried again."""
        caller = socket.socket(socket.AF_UNIX)
        caller.setblocking(False)
        try:
            caller.connect(str(path))
            caller.send(self._said)
        except OSError as error:  # most often a file whose station was killed
            caller.close()
            return isinstance(error, BlockingIOError)
        self._open[caller] = bytearray()
        return False

    def _hear(self, caller: socket.socket) -> None:
        data = _received(caller)
        if data is None:
            return
        heard = self._open[caller]
        heard += data
        if data and b"\n" not in heard and len(heard) < _LONGEST * _MOST:
            return
        if (reply := decode_reply(bytes(heard))) is not None:
            self._replies.append(reply)
        del self._open[caller]
        caller.close()


class StopLine:
    """Listens for a stop until its end; a context manager.

    Args:
        address: The bus of the station.
        stop: Tells the servers, given the reason; returns what came of it. Called in a thread; waits for no bus.

    Attributes:
        failure: Why nobody can stop this station's robots past the bus, or "".
    """

    def __init__(self, address: BusAddress, stop: Callable[[str], StopReply]) -> None:
        self._address, self._clock, self._stop = address, address.clock, stop
        self._callers: dict[
            socket.socket, tuple[bytearray, float]
        ] = {}  # what each has said, and since when it is there
        self.failure = ""

    def __enter__(self) -> StopLine:
        self._held = contextlib.ExitStack()
        try:
            self._listen()
        except (OSError, ConfigError) as error:
            self._held.close()
            self.failure = f"no process can stop these robots past the bus: {error}"
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._held.close()

    def _listen(self) -> None:
        for path in _lines(self._address):
            if not _lives(path):
                path.unlink(missing_ok=True)
        path = _folder() / f"{_prefix(self._address)}{os.getpid()}.sock"
        path.unlink(missing_ok=True)  # of an earlier process of our number
        listener = self._held.enter_context(socket.socket(socket.AF_UNIX))
        listener.bind(str(path))
        self._held.callback(path.unlink, missing_ok=True)
        path.chmod(0o600)
        listener.setblocking(False)
        listener.listen(socket.SOMAXCONN)
        ended, end = socket.socketpair()
        self._held.callback(ended.close)
        self._keeper = StopKeeper(self._address)
        self._held.callback(self._keeper.close)
        thread = self._clock.start(lambda: self._run(listener, ended), "stop-line")
        self._held.callback(self._clock.join, thread)
        self._held.callback(end.close)  # the first of all: it ends the thread

    def _run(self, listener: socket.socket, ended: socket.socket) -> None:
        with selectors.DefaultSelector() as ready:
            ready.register(listener, selectors.EVENT_READ)
            ready.register(ended, selectors.EVENT_READ)
            while True:
                found = {key.fileobj for key, _ in ready.select(_LOOK_S if self._callers else None)}
                for caller in [each for each in self._callers if each in found]:
                    self._hear(ready, caller)
                if listener in found:
                    self._accept(ready, listener)
                if ended in found:
                    break
                late_s = self._clock.monotonic_s() - _PATIENCE_S
                for caller in [each for each, (_, since_s) in self._callers.items() if since_s < late_s]:
                    self._hang_up(ready, caller)
            for caller in list(self._callers):
                self._hang_up(ready, caller)

    def _accept(self, ready: selectors.BaseSelector, listener: socket.socket) -> None:
        """Take who calls, as many as may be there at a time; each has most often said its line already."""
        for _ in range(_MOST):
            try:
                caller, _ = listener.accept()
            except BlockingIOError:  # nobody any more
                return
            except OSError:  # no file is left to take one with
                self._clock.sleep(_AGAIN_S)
                return
            if len(self._callers) >= _MOST:
                self._hang_up(ready, next(iter(self._callers)))
            caller.setblocking(False)
            self._callers[caller] = bytearray(), self._clock.monotonic_s()
            ready.register(caller, selectors.EVENT_READ)
            self._hear(ready, caller)

    def _hear(self, ready: selectors.BaseSelector, caller: socket.socket) -> None:
        data = _received(caller)
        if data is None:
            return
        heard, _ = self._callers[caller]
        heard += data
        if b"\n" in heard or (heard and not data):
            line, _, _ = heard.partition(b"\n")
            self._answer(caller, bytes(line))
        elif data and len(heard) < _LONGEST:
            return
        self._hang_up(ready, caller)

    def _answer(self, caller: socket.socket, line: bytes) -> None:
        reason = parse(line)
        if reason is None:
            said = printable(line.decode(errors="replace"), 40)
            reply = StopReply(why_not=f"expected `{_WORD} <reason>`, got {said!r}; nothing was stopped")
        else:
            reply = self._stop(reason)
            self._keeper.latch(reason)
        with contextlib.suppress(OSError):  # who has asked is gone, and needs no answer
            caller.send(codec.json_object(reply) + b"\n")

    def _hang_up(self, ready: selectors.BaseSelector, caller: socket.socket) -> None:
        del self._callers[caller]
        ready.unregister(caller)
        caller.close()


def _received(caller: socket.socket) -> bytes | None:
    """Return what came, b"" at the end of a line that was cut; None where nothing has come yet."""
    try:
        return caller.recv(_LONGEST)
    except BlockingIOError:
        return None
    except OSError:
        return b""


def _lines(address: BusAddress) -> Iterator[Path]:
    """Yield the sockets of the stations on a bus, those of killed ones too."""
    try:
        yield from _folder().glob(f"{_prefix(address)}*.sock")
    except (OSError, ConfigError):  # a folder that is not ours alone: `station up` tells of it
        return


def _lives(path: Path) -> bool:
    """Whether the process may live whose number a socket bears."""
    number = path.stem.rpartition("-")[2]
    try:
        os.kill(int(number), 0)
    except (ProcessLookupError, OverflowError, ValueError):
        return False
    except PermissionError:
        return True
    return True


def _folder() -> Path:
    return addresses.runtime_folder(_LONGEST_NAME)


def _prefix(address: BusAddress) -> str:
    """Return how the names of the sockets of a bus begin; one server has one name, whoever asks it for what."""
    if address.socket is not None:
        server: Any = os.path.realpath(address.socket)
    else:
        server = "localhost" if addresses.is_loopback(address.host) else address.host, address.port
    return f"stop-{hashlib.sha256(f'{server} {address.db}'.encode()).hexdigest()[:8]}-"
