"""A network between a client and a server: one that can be cut, and one that swallows everything without a word."""

from __future__ import annotations

import contextlib
import selectors
import socket
import threading

from station.bus.address import BusAddress

_LOOK_S = 0.01


class Proxy:
    """Carries bytes between a TCP port of its own and the unix socket of a server, in a thread; a context manager."""

    def __init__(self, server: BusAddress) -> None:
        self._server = server.socket or ""
        self._listener = socket.create_server(("127.0.0.1", 0))
        self._others: dict[socket.socket, socket.socket] = {}
        self._swallowed: set[socket.socket] = set()
        self._is_cut = False
        self._lock = threading.Lock()
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    @property
    def address(self) -> BusAddress:
        return BusAddress(host="127.0.0.1", port=self._listener.getsockname()[1])

    def swallow(self, *, only_newest: bool = False) -> None:
        """Carry nothing more on the connections of now, or on the newest, and do not close them: half-open ones."""
        with self._lock:
            self._swallowed |= set(list(self._others)[-2 if only_newest else 0 :])

    def cut(self) -> None:
        """Close every connection, and close new ones at once, until `mend`."""
        with self._lock:
            self._is_cut = True
            while self._others:
                self._drop(next(iter(self._others)))

    def mend(self) -> None:
        self._is_cut = False

    def __enter__(self) -> Proxy:
        return self

    def __exit__(self, *_: object) -> None:
        self._closed.set()
        self._thread.join()
        self.cut()
        self._listener.close()

    def _run(self) -> None:
        while not self._closed.is_set():
            with selectors.DefaultSelector() as selector, self._lock:
                selector.register(self._listener, selectors.EVENT_READ)
                for one in set(self._others) - self._swallowed:
                    selector.register(one, selectors.EVENT_READ)
                for key, _ in selector.select(_LOOK_S):
                    stream = key.fileobj
                    assert isinstance(stream, socket.socket)
                    if stream is self._listener:
                        self._accept()
                    elif stream in self._others:
                        self._carry(stream)
            self._closed.wait(0.0005)  # so that others get the lock

    def _accept(self) -> None:
        client, _ = self._listener.accept()
        if self._is_cut:
            client.close()
            return
        server = socket.socket(socket.AF_UNIX)
        server.connect(self._server)
        self._others |= {client: server, server: client}

    def _carry(self, stream: socket.socket) -> None:
        try:
            data = stream.recv(1 << 16)
            if not data:
                raise ConnectionResetError
            self._others[stream].sendall(data)
        except OSError:
            self._drop(stream)

    def _drop(self, stream: socket.socket) -> None:
        other = self._others.pop(stream)
        self._others.pop(other)
        for end in (stream, other):
            self._swallowed.discard(end)
            with contextlib.suppress(OSError):
                end.close()
