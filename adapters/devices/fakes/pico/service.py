"""A PC service on the loopback interface, under the real ``xrobotoolkit-sdk``."""

from __future__ import annotations

import importlib
import os
import threading
from collections import deque
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from adapters.devices.fakes.pico import wire
from station.operator.device import DeviceError

SERIAL = "PA0000FAKE"
DEFAULT_PORT = 60061
_QUEUED = 2  # frames per listener, as in the headset's app: older ones are dropped
_LISTENERS = 8


class PicoService:
    """Listens from its construction on; every client that watches gets each frame that is sent.

    Args:
        port: TCP port on 127.0.0.1; 0 takes a free one.

    Attributes:
        port: The port it listens on.

    Raises:
        DeviceError: the port is in use, or grpcio is not installed.
    """

    def __init__(self, port: int = DEFAULT_PORT) -> None:
        self._grpc = _import_grpc()
        self._changed = threading.Condition()
        self._queues: list[deque[bytes]] = []
        self._server: Any = None
        self.port = port
        self.start()

    @property
    def listeners(self) -> int:
        """Number of clients that watch."""
        return len(self._queues)

    def start(self) -> None:
        """Listen (again, after `stop`, on the same port)."""
        grpc = self._grpc
        server = grpc.server(ThreadPoolExecutor(_LISTENERS), options=[("grpc.so_reuseport", 0)])
        answer = grpc.unary_unary_rpc_method_handler(lambda _request, _context: wire.EMPTY)
        calls = dict.fromkeys(("SendBeat", "CancelServerFeedback", "DeviceControlJson", "SendBytesToDevice"), answer)
        calls["WatchServerFeedback"] = grpc.unary_stream_rpc_method_handler(self._watch)
        server.add_generic_rpc_handlers((grpc.method_handlers_generic_handler(wire.SERVICE, calls),))
        try:
            self.port = server.add_insecure_port(f"127.0.0.1:{self.port}")
        except RuntimeError:
            self.port = self.port or 0
            raise DeviceError(
                f"port {self.port} on 127.0.0.1 is in use, maybe by the real PC service; stop that, or take --port N"
            ) from None
        server.start()
        self._server = server

    def send(self, frame: wire.Frame) -> None:
        """Send one frame, in the headset's own frame of reference, to every client that watches."""
        message = wire.device_state(SERIAL, frame)
        with self._changed:
            for queue in self._queues:
                queue.append(message)
            self._changed.notify_all()

    def wait_for_listener(self, timeout_s: float) -> bool:
        """Wait until a client watches; False on time-out [s]."""
        with self._changed:
            return self._changed.wait_for(lambda: bool(self._queues), timeout_s)

    def stop(self) -> None:
        """Cut every client off and stop listening, as a service that dies; a second call does nothing."""
        server, self._server = self._server, None
        if server is not None:
            ended = server.stop(grace=0)
            with self._changed:
                self._changed.notify_all()
            ended.wait()

    def _watch(self, _request: bytes, context: Any) -> Iterator[bytes]:
        queue: deque[bytes] = deque([wire.device_found(SERIAL)], maxlen=_QUEUED)
        is_over = threading.Event()

        def end() -> None:
            with self._changed:
                is_over.set()
                if queue in self._queues:
                    self._queues.remove(queue)
                self._changed.notify_all()

        if not context.add_callback(end):
            return
        with self._changed:
            self._queues.append(queue)
            self._changed.notify_all()
        while True:
            with self._changed:
                self._changed.wait_for(lambda: queue or is_over.is_set())
                if is_over.is_set():
                    return
                message = queue.popleft()
            yield message

    def __enter__(self) -> PicoService:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()


def _import_grpc() -> Any:
    os.environ.setdefault("GRPC_VERBOSITY", "NONE")  # what matters is said by ourselves, in a line
    try:
        return importlib.import_module("grpc")  # an optional dependency with a runtime of its own
    except ImportError as error:
        raise DeviceError(
            "the fake PC service needs grpcio, which is not installed; pip install 'teleop-station[pico]'"
        ) from error
