"""An HTTP server for pages, in a thread of its own, on a port that is taken before anything else begins."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import socket
import ssl
import threading
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from station.errors import StationError
from station.web import certificates, links
from station.web.config import PageConfig

if TYPE_CHECKING:
    import uvicorn
    from starlette.types import ASGIApp

_QUEUE = 64  # connections that wait to be taken
_CLOSED_WITHIN_S = 3.0
_LARGEST = 64 << 10  # bytes of a message from a page


class WebServer:
    """Takes a port; then serves pages until it is closed.

    Args:
        host: Address of this machine.
        port: Port; 0 takes a free one.
        certificate: Files of a certificate and its key, as PEM; None serves in clear text.

    Attributes:
        port: The port that it has.
        loop: The event loop of the pages, once they are served.

    Raises:
        StationError: the address or the port cannot be had, or the certificate cannot be used.
    """

    def __init__(self, host: str, port: int, certificate: tuple[Path, Path] | None = None) -> None:
        self._certificate = certificate
        if certificate is not None:
            _expect_certificate(*certificate)
        self._socket = _listen(host, port)
        self.port = int(self._socket.getsockname()[1])
        self.loop: asyncio.AbstractEventLoop | None = None
        self._server: uvicorn.Server | None = None
        self._thread: threading.Thread | None = None

    def start(self, app: ASGIApp) -> None:
        """Serve some pages."""
        import uvicorn

        tls: dict[str, Any] = {}
        if self._certificate is not None:
            tls = {"ssl_certfile": str(self._certificate[0]), "ssl_keyfile": str(self._certificate[1])}
        config = uvicorn.Config(
            app, log_config=None, access_log=False, server_header=False, lifespan="off", ws="websockets-sansio",
            ws_max_size=_LARGEST, ws_per_message_deflate=False, ws_ping_interval=None, proxy_headers=False,
            timeout_graceful_shutdown=1, h11_max_incomplete_event_size=_LARGEST, **tls,
        )  # fmt: skip
        logging.getLogger("uvicorn.error").setLevel(logging.WARNING)
        self._server, begun = uvicorn.Server(config), threading.Event()

        async def serve(server: uvicorn.Server) -> None:
            self.loop = asyncio.get_running_loop()
            begun.set()
            await server.serve([self._socket])

        def run(server: uvicorn.Server) -> None:
            with contextlib.suppress(SystemExit):  # of a start that failed; its reason is in the log
                asyncio.run(serve(server))
            begun.set()

        self._thread = threading.Thread(target=run, args=(self._server,), name="web", daemon=True)
        self._thread.start()
        begun.wait(_CLOSED_WITHIN_S)

    def call(self, act: Callable[..., object], *arguments: object) -> None:
        """Have something done in the event loop of the pages, soon; safe to call from any thread."""
        if self.loop is not None:
            try:
                self.loop.call_soon_threadsafe(act, *arguments)
            except RuntimeError:  # it is being closed
                return

    def close(self) -> None:
        """Let go of all pages and of the port."""
        if self._server is not None and self._thread is not None:
            self._server.should_exit = True
            self._thread.join(_CLOSED_WITHIN_S)
        self._socket.close()


class Listening(NamedTuple):
    """A server that has its port.

    Attributes:
        server: To be started with the pages.
        hosts: Names that a browser may open them as.
        url: Where they are, without a token.
        authority: File of the authority that a browser has to trust; None without TLS, or with a certificate of others.
    """

    server: WebServer
    hosts: list[str]
    url: str
    authority: Path | None


def listen(config: PageConfig) -> Listening:
    """Take the port for some pages, with a certificate where they are served to other machines.

    Raises:
        StationError: the address or the port cannot be had, or the certificate cannot be used.
    """
    hosts = links.names_of(config.host, config.names)
    authority: Path | None = None
    certificate = None if config.certificate is None or config.key is None else (config.certificate, config.key)
    if certificate is None and config.is_secure:
        made = certificates.own(hosts)
        certificate, authority = (made.file, made.key_file), made.ca_file
    server = WebServer(config.host, config.port, certificate)
    return Listening(server, hosts, links.url(config, server.port), authority)


def _expect_certificate(file: Path, key_file: Path) -> None:
    for path in (file, key_file):
        if not path.is_file():
            raise StationError(f"{path}: no such file; expected a certificate, and its key, as PEM")
    try:
        ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER).load_cert_chain(file, key_file)
    except (ssl.SSLError, OSError) as error:
        raise StationError(f"{file} and {key_file}: no certificate with its key, as PEM: {error}") from None


def _listen(host: str, port: int) -> socket.socket:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    made = socket.socket(family, socket.SOCK_STREAM)
    try:
        made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        made.bind((host, port))
        made.listen(_QUEUE)
    except OSError as error:
        made.close()
        raise StationError(
            f"host {host}, port {port}: cannot listen there: {error.strerror or error}; expected an address of this "
            "machine and a port that is free; choose others, --host 127.0.0.1, --port 0 for any free one"
        ) from None
    return made
