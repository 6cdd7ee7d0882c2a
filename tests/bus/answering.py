"""A server that knows nothing but what it is told: for answers that no real one gives when a test wants them."""

from __future__ import annotations

import contextlib
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from station.bus.address import BusAddress


@contextmanager
def answering(path: Path, answers: dict[bytes, bytes]) -> Iterator[BusAddress]:
    """A server on a socket that knows nothing but what it is told: each command's answer by its name, else ``+OK``."""
    listener = socket.socket(socket.AF_UNIX)
    listener.bind(str(path))
    listener.listen()
    listener.settimeout(0.05)
    closed = threading.Event()
    threads: list[threading.Thread] = []

    def serve(stream: socket.socket) -> None:
        stream.settimeout(0.05)
        with stream, contextlib.suppress(OSError):  # who asked has gone
            while not closed.is_set():
                try:
                    data = stream.recv(1 << 16)
                except TimeoutError:
                    continue
                if not data:
                    return
                for command in data.split(b"*")[1:]:
                    name = command.split(b"\r\n")[2]
                    stream.sendall(answers.get(name, b"+OK\r\n"))

    def accept() -> None:
        while not closed.is_set():
            try:
                stream, _ = listener.accept()
            except TimeoutError:
                continue
            threads.append(threading.Thread(target=serve, args=(stream,)))
            threads[-1].start()

    accepting = threading.Thread(target=accept)
    accepting.start()
    try:
        yield BusAddress(socket=str(path))
    finally:
        closed.set()
        accepting.join()
        for thread in threads:
            thread.join()
        listener.close()
