"""A line to the bus that can be cut or frozen: a socket that passes everything on, until it is told not to."""

from __future__ import annotations

import contextlib
import selectors
import signal
import socket
import subprocess
import sys
from pathlib import Path

from station.bus.address import BusAddress

_SIZE = 1 << 16


class CuttableLine:
    """A process of its own, so that nothing that a test does makes the line slow; a context manager.

    Args:
        path: Of the socket; short.
        target: The bus, on a unix socket.
    """

    def __init__(self, path: Path, target: BusAddress) -> None:
        self.address = BusAddress(socket=str(path))
        arguments = [sys.executable, __file__, str(path), str(target.socket)]
        self._process = subprocess.Popen(arguments, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        self._expect("ready")

    def cut(self) -> None:
        """Break every connection, and let nobody connect."""
        self._ask("cut")

    def mend(self) -> None:
        """Let everybody connect again."""
        self._ask("mend")

    def freeze(self) -> None:
        """Pass nothing on, and keep what comes."""
        self._process.send_signal(signal.SIGSTOP)

    def thaw(self) -> None:
        """Go on, with all that came meanwhile at once."""
        self._process.send_signal(signal.SIGCONT)

    def close(self) -> None:
        """End it; a second call does nothing."""
        self.thaw()
        self._process.communicate()

    def __enter__(self) -> CuttableLine:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _ask(self, word: str) -> None:
        assert self._process.stdin is not None
        self._process.stdin.write(word + "\n")
        self._process.stdin.flush()
        self._expect(word)

    def _expect(self, word: str) -> None:
        assert self._process.stdout is not None
        assert self._process.stdout.readline() == word + "\n"


class _Line:
    """The other process: listens on a unix socket and passes on to a bus, until its stdin ends."""

    def __init__(self, path: Path, target: str) -> None:
        self._path, self._target = path, target
        self._selector = selectors.DefaultSelector()
        self._far: dict[socket.socket, socket.socket] = {}
        self._listener: socket.socket | None = None
        self._selector.register(sys.stdin, selectors.EVENT_READ)

    def run(self) -> None:
        """Pass on until told to end."""
        self._listen()
        self._answer("ready")
        while True:
            for key, _ in self._selector.select():
                if key.fd == sys.stdin.fileno():
                    if not (word := sys.stdin.readline().strip()):
                        return
                    (self._break if word == "cut" else self._listen)()
                    self._answer(word)
                    break  # what else is ready may be gone now
                if key.fileobj is self._listener:
                    self._accept()
                elif isinstance(key.fileobj, socket.socket) and key.fileobj in self._far:
                    self._pass_on(key.fileobj)

    @staticmethod
    def _answer(word: str) -> None:
        sys.stdout.write(word + "\n")
        sys.stdout.flush()

    def _listen(self) -> None:
        self._listener = socket.socket(socket.AF_UNIX)
        self._listener.bind(str(self._path))
        self._listener.listen()
        self._selector.register(self._listener, selectors.EVENT_READ)

    def _accept(self) -> None:
        assert self._listener is not None
        near, _ = self._listener.accept()
        far = socket.socket(socket.AF_UNIX)
        try:
            far.connect(self._target)
        except OSError:
            near.close()
            far.close()
            return
        for one, other in ((near, far), (far, near)):
            self._far[one] = other
            self._selector.register(one, selectors.EVENT_READ)

    def _pass_on(self, one: socket.socket) -> None:
        try:
            data = one.recv(_SIZE)
            if data:
                self._far[one].sendall(data)
        except OSError:
            data = b""
        if not data:
            self._hang_up(one)

    def _hang_up(self, one: socket.socket) -> None:
        for end in (one, self._far.pop(one)):
            self._far.pop(end, None)
            self._selector.unregister(end)
            end.close()

    def _break(self) -> None:
        if self._listener is not None:
            self._selector.unregister(self._listener)
            self._listener.close()
            self._listener = None
            with contextlib.suppress(FileNotFoundError):
                self._path.unlink()
        while self._far:
            self._hang_up(next(iter(self._far)))


if __name__ == "__main__":
    _Line(Path(sys.argv[1]), sys.argv[2]).run()
