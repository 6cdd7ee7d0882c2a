"""TLS to a bus: the certificates that the environment names are used, and a wrong one is refused in a line.

The server that our tests run has no TLS of its own; a proxy in front of it speaks Python's.
"""

from __future__ import annotations

import contextlib
import shutil
import socket
import ssl
import subprocess
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from station.bus import address as addresses
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.bus.tap import open_tap
from station.errors import BusError, ConfigError
from tests.waiting import DEADLINE_S, wait_until

_CHUNK = 1 << 16

pytestmark = pytest.mark.skipif(shutil.which("openssl") is None, reason="certificates are made with openssl")


@pytest.fixture(scope="module")
def certificates(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with our own authority, and certificates of a server and of a client that it signed."""
    folder = tmp_path_factory.mktemp("tls")
    _openssl(folder, "req -x509 -newkey rsa:2048 -nodes -keyout ca.key -out ca.pem -days 2 -subj /CN=authority")
    for name in ("localhost", "client"):
        (folder / f"{name}.ext").write_text(f"subjectAltName=DNS:{name}\n")
        _openssl(folder, f"req -newkey rsa:2048 -nodes -keyout {name}.key -out {name}.csr -subj /CN={name}")
        _openssl(
            folder,
            f"x509 -req -in {name}.csr -CA ca.pem -CAkey ca.key -CAcreateserial -days 2 -out {name}.pem "
            f"-extfile {name}.ext",
        )
    return folder


def _openssl(folder: Path, arguments: str) -> None:
    subprocess.run(["openssl", *arguments.split()], cwd=folder, check=True, capture_output=True)


@pytest.fixture
def tls_port(certificates: Path, bus_server: BusAddress) -> Iterator[int]:
    """Port of a TLS proxy before the bus, which lets in only who shows a certificate of the authority."""
    context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH, cafile=certificates / "ca.pem")
    context.load_cert_chain(certificates / "localhost.pem", certificates / "localhost.key")
    context.verify_mode = ssl.CERT_REQUIRED
    with socket.create_server(("127.0.0.1", 0)) as listener:
        thread = threading.Thread(target=_serve, args=(listener, context, bus_server), daemon=True)
        thread.start()
        yield int(listener.getsockname()[1])
        listener.shutdown(socket.SHUT_RDWR)
        thread.join(10)


def _serve(listener: socket.socket, context: ssl.SSLContext, bus: BusAddress) -> None:
    while True:
        try:
            plain, _ = listener.accept()
        except OSError:
            return
        threading.Thread(target=_pump, args=(plain, context, bus), daemon=True).start()


def _pump(plain: socket.socket, context: ssl.SSLContext, bus: BusAddress) -> None:
    """Carry bytes both ways, in one thread: a TLS socket is not for two."""
    with (
        plain,
        contextlib.suppress(OSError),
        context.wrap_socket(plain, server_side=True) as outer,
        socket.socket(socket.AF_UNIX) as behind,
    ):
        behind.connect(str(bus.socket))
        outer.settimeout(0.002)
        behind.settimeout(0.002)
        while _carry(outer, behind) and _carry(behind, outer):
            pass


def _carry(source: socket.socket, target: socket.socket) -> bool:
    try:
        data = source.recv(_CHUNK)
    except TimeoutError:
        return True
    target.settimeout(5.0)
    target.sendall(data)
    target.settimeout(0.002)
    return bool(data)


def _environment(patch: pytest.MonkeyPatch, folder: Path, *, with_client: bool = True) -> None:
    patch.setenv("STATION_BUS_CA", str(folder / "ca.pem"))
    if with_client:
        patch.setenv("STATION_BUS_CERT", str(folder / "client.pem"))
        patch.setenv("STATION_BUS_KEY", str(folder / "client.key"))


def test_a_bus_behind_tls_is_written_watched_and_tapped(
    tls_port: int, certificates: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    _environment(monkeypatch, certificates)
    address = addresses.parse(f"rediss://localhost:{tls_port}/0")
    tap = open_tap(address)
    with Bus(address, name="tls", timeout_s=5.0) as bus, bus.watch(["a"]) as watch:
        wait_until(lambda: watch.is_connected)
        bus.publish({"a": b"x" * 100_000})
        wait_until(lambda: watch.latest("a"))
        sample = watch.latest("a")
    assert sample is not None
    assert len(sample.value) == 100_000
    writes = [write for write in tap.read(DEADLINE_S) if write.key == "a"]
    assert writes[0].value == sample.value
    tap.close()


def test_who_has_no_certificate_or_trusts_another_authority_is_refused_in_a_line(
    tls_port: int, certificates: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    url = f"rediss://localhost:{tls_port}/0"
    _environment(monkeypatch, certificates, with_client=False)
    _refused(url, BusError)
    monkeypatch.delenv("STATION_BUS_CA")
    assert "certificate" in _refused(url, BusError)
    _environment(monkeypatch, certificates)
    assert "certificate" in _refused(url.replace("localhost", "127.0.0.1"), BusError)  # it is not its name
    monkeypatch.setenv("STATION_BUS_KEY", str(certificates / "absent.key"))
    assert "absent.key" in _refused(url, ConfigError)
    monkeypatch.setenv("STATION_BUS_CA", str(certificates / "ca.key"))
    assert "ca.key" in _refused(url, ConfigError)


def _refused(url: str, kind: type[Exception]) -> str:
    with pytest.raises(kind) as refused:
        Bus(addresses.parse(url), name="tls", timeout_s=5.0)
    message = str(refused.value)
    assert "\n" not in message
    return message
