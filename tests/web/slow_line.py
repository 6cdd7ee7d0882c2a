"""A line that takes so many bytes a second."""

from __future__ import annotations

import contextlib
import socket
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any


@contextlib.contextmanager
def slow_line(port: int, bytes_s: float, *, both_ways: bool = False) -> Iterator[int]:
    """Give a port that leads to another, so many bytes a second for all answers, or for both ways, together."""
    listener, over, lock = socket.create_server(("127.0.0.1", 0)), threading.Event(), threading.Lock()
    free_s, ends, threads = [time.monotonic()], list[socket.socket](), list[threading.Thread]()

    def begin(act: Callable[..., None], *arguments: Any, **more: Any) -> None:
        threads.append(threading.Thread(target=act, args=arguments, kwargs=more))
        threads[-1].start()

    def pump(source: socket.socket, sink: socket.socket, *, is_slow: bool) -> None:
        with contextlib.suppress(OSError):
            while data := source.recv(1460):
                if is_slow:
                    with lock:  # one after the other, as on the air
                        free_s[0] = max(free_s[0], time.monotonic()) + len(data) / bytes_s
                        time.sleep(max(0.0, free_s[0] - time.monotonic()))
                sink.sendall(data)
        for end in (source, sink):
            with contextlib.suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)

    def accept() -> None:
        while not over.is_set():
            try:
                near, _ = listener.accept()
            except OSError:
                return
            far = socket.create_connection(("127.0.0.1", port))
            ends.extend((near, far))
            begin(pump, near, far, is_slow=both_ways)
            begin(pump, far, near, is_slow=True)

    begin(accept)
    try:
        yield int(listener.getsockname()[1])
    finally:
        over.set()
        for end in (listener, *ends):
            with contextlib.suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)
        for thread in threads:
            thread.join()
        for end in (listener, *ends):
            end.close()
