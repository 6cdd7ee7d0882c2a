"""Opens the byte stream to a server: a unix socket, TCP, or TLS over it."""

from __future__ import annotations

import socket
import ssl

_CONNECT_TIMEOUT_S = 0.5  # a TCP handshake may cross a lab network; a unix socket answers at once

_KEEP_ALIVE = (("TCP_KEEPIDLE", 2), ("TCP_KEEPINTVL", 1), ("TCP_KEEPCNT", 3))  # a peer that is gone is known after 5 s


def open_unix(path: str, timeout_s: float) -> socket.socket:
    """Connect to a unix socket within a time [s].

    Raises:
        OSError: it cannot be reached.
    """
    stream = socket.socket(socket.AF_UNIX)
    try:
        stream.settimeout(timeout_s)
        stream.connect(path)
    except OSError:
        stream.close()
        raise
    return stream


def open_tcp(host: str, port: int, timeout_s: float) -> socket.socket:
    """Connect to a TCP port within a time [s], which is at least that of a handshake.

    Raises:
        OSError: it cannot be reached.
    """
    stream = socket.create_connection((host, port), timeout=max(timeout_s, _CONNECT_TIMEOUT_S))
    try:
        stream.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        _keep_alive(stream)
    except OSError:
        stream.close()
        raise
    return stream


def tls_context(ca_file: str | None, certificate_file: str | None, key_file: str | None) -> ssl.SSLContext:
    """Return what TLS needs of files; None trusts the system's certificates, and shows none of ours.

    Raises:
        OSError: a file cannot be used; of which `ssl.SSLError` is one.
    """
    context = ssl.create_default_context(cafile=ca_file)
    if certificate_file is not None:
        context.load_cert_chain(certificate_file, key_file)
    return context


def _keep_alive(stream: socket.socket) -> None:
    """Have the kernel find out that a peer is gone that said nothing: unplugged, or its machine lost its power."""
    stream.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    for name, value in _KEEP_ALIVE:
        if hasattr(socket, name):  # each system has some of them
            stream.setsockopt(socket.IPPROTO_TCP, getattr(socket, name), value)
