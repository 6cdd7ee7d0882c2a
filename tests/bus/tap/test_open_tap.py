"""Which tap one gets, and what one is told when it is not the best."""

from __future__ import annotations

import contextlib
import logging
import shutil
import socket
import ssl
import subprocess
import threading
from collections.abc import Iterator
from pathlib import Path

import msgspec
import pytest

from station.bus.address import BusAddress
from station.bus.connection import Connection
from station.bus.tap import BACKENDS, Position, TapRefused, open_tap
from station.bus.tap.base import PROBE, new_token
from station.errors import BusError, UnknownName
from tests.bus.tap.traffic import read

RECORDER_RIGHTS = ("on", ">secret", "~*", "&*", "+@all")


def test_replication_is_taken_where_it_is_allowed(bus_server: BusAddress, caplog: pytest.LogCaptureFixture) -> None:
    tap = open_tap(bus_server)
    assert (tap.backend, tap.is_lossless, tap.resumed) == ("replication", True, None)
    assert caplog.records == []
    tap.close()


@pytest.mark.parametrize("backend", BACKENDS)
def test_tap_is_armed_when_it_is_handed_out(bus_server: BusAddress, writer: Connection, backend: str) -> None:
    for number in range(10):
        tap = open_tap(bus_server, backend=backend)
        assert tap.backend == backend
        writer.call("MSET", "a", number, "a@", number)
        assert [write[:3] for write in read(tap, 1)] == [("a", b"%d" % number, b"%d" % number)]
        tap.close()


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.timeout(40)
def test_taps_that_open_at_the_same_instant_are_all_armed(bus_server: BusAddress, backend: str) -> None:
    """Each writes the probe that the others wait for."""
    done = threading.Event()

    def open_others() -> None:
        with contextlib.closing(Connection(bus_server, timeout_s=10.0)) as line:
            while not done.is_set():
                line.call("SET", PROBE, new_token())

    others = [threading.Thread(target=open_others) for _ in range(2)]
    for other in others:
        other.start()
    try:
        for _ in range(5):
            tap = open_tap(bus_server, backend=backend)
            assert tap.backend == backend
            tap.close()
    finally:
        done.set()
        for other in others:
            other.join()


def test_user_without_the_right_to_replicate_gets_notifications_and_one_warning(
    bus_server: BusAddress, writer: Connection, caplog: pytest.LogCaptureFixture
) -> None:
    tap = open_tap(_user(bus_server, writer, "-psync"), resume=Position("0" * 40, 5))
    assert (tap.backend, tap.is_lossless, tap.resumed) == ("notifications", False, False)
    assert [record.levelno for record in caplog.records] == [logging.WARNING]
    assert "notifications" in caplog.text
    assert "NOPERM" in caplog.text or "permission" in caplog.text
    writer.call("SET", "a", "1")
    assert [write[:3] for write in read(tap, 1)] == [("a", b"1", None)]
    tap.close()


@pytest.mark.parametrize("rights", [("-replconf", "-psubscribe"), ("-psync", "resetchannels")])
def test_user_without_notifications_either_gets_polling(
    bus_server: BusAddress, writer: Connection, rights: tuple[str, ...]
) -> None:
    tap = open_tap(_user(bus_server, writer, *rights))
    assert tap.backend == "poll"
    writer.call("SET", "a", "1")
    assert [write[:3] for write in read(tap, 1)] == [("a", b"1", None)]
    tap.close()


def test_backend_that_was_asked_for_is_not_replaced(bus_server: BusAddress, writer: Connection) -> None:
    with pytest.raises(BusError, match=r"cannot be tapped.*refuses its replication stream") as caught:
        open_tap(_user(bus_server, writer, "-psync"), backend="replication")
    assert "\n" not in str(caught.value)


def test_user_who_may_not_write_the_probe_is_told(bus_server: BusAddress, writer: Connection) -> None:
    with pytest.raises(BusError, match="may not write station:tap:probe") as caught:
        open_tap(_user(bus_server, writer, "-set"))
    assert not isinstance(caught.value, TapRefused)


def test_unknown_backend_names_the_known_ones(bus_server: BusAddress) -> None:
    with pytest.raises(UnknownName, match="did you mean 'replication'"):
        open_tap(bus_server, backend="replicaton")


@pytest.mark.parametrize("backend", [None, *BACKENDS])
def test_missing_server_is_told(tmp_path: Path, backend: str | None) -> None:
    with pytest.raises(BusError, match="No such file"):
        open_tap(BusAddress(socket=str(tmp_path / "none.sock")), backend=backend)


@pytest.mark.parametrize("backend", BACKENDS)
def test_password_opens_every_backend_and_its_lack_is_told(
    bus_server: BusAddress, writer: Connection, backend: str
) -> None:
    writer.call("CONFIG", "SET", "requirepass", "open sesame")
    for password in (None, "wrong"):
        with pytest.raises(BusError, match="password"):
            open_tap(msgspec.structs.replace(bus_server, password=password), backend=backend)
    tap = open_tap(msgspec.structs.replace(bus_server, password="open sesame"), backend=backend)
    writer.call("SET", "a", "1")
    assert [write[:3] for write in read(tap, 1)] == [("a", b"1", None)]
    tap.close()


@pytest.mark.parametrize("backend", BACKENDS)
def test_database_of_the_address_is_the_one_that_is_tapped(
    bus_server: BusAddress, writer: Connection, backend: str
) -> None:
    tap = open_tap(msgspec.structs.replace(bus_server, db=5), backend=backend)
    writer.pipeline([("SET", "a", "0"), ("SELECT", 5), ("SET", "a", "5")])
    assert [write[:3] for write in read(tap, 1)] == [("a", b"5", None)]
    assert tap.read(0.1) == []
    tap.close()


@pytest.mark.parametrize("backend", BACKENDS)
def test_tls_carries_every_backend(tls_address: BusAddress, writer: Connection, backend: str) -> None:
    tap = open_tap(tls_address, backend=backend)
    value = bytes(range(256)) * 1000
    for _ in range(20 if backend == "replication" else 1):
        writer.call("MSET", "a", value, "a@", "s")
        assert [write[:3] for write in read(tap, 1)] == [("a", value, b"s")]
    tap.close()


@pytest.fixture
def tls_address(bus_server: BusAddress, tmp_path: Path) -> Iterator[BusAddress]:
    """A TLS door in front of the server; the server in the Python package is built without TLS."""
    if shutil.which("openssl") is None:
        pytest.skip("needs openssl to make a certificate")
    key, certificate = tmp_path / "key.pem", tmp_path / "cert.pem"
    command = (
        "openssl req -x509 -newkey rsa:2048 -nodes -days 2 -subj /CN=localhost -addext subjectAltName=DNS:localhost"
    )
    subprocess.run([*command.split(), "-keyout", key, "-out", certificate], check=True, capture_output=True)
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(certificate, key)
    with socket.create_server(("127.0.0.1", 0)) as door:
        stop = threading.Event()
        porter = threading.Thread(target=_open_door, args=(door, context, bus_server, stop))
        porter.start()
        yield BusAddress(host="localhost", port=door.getsockname()[1], tls=True, ca_file=str(certificate))
        stop.set()
        porter.join()


def _open_door(door: socket.socket, context: ssl.SSLContext, inside: BusAddress, stop: threading.Event) -> None:
    """Let TLS connections in until told to stop, each carried by a thread."""
    door.settimeout(0.05)
    carriers = []
    while not stop.is_set():
        try:
            plain, _ = door.accept()
        except TimeoutError:
            continue
        carriers.append(threading.Thread(target=_carry, args=(plain, context, inside, stop)))
        carriers[-1].start()
    for carrier in carriers:
        carrier.join()


def _carry(plain: socket.socket, context: ssl.SSLContext, inside: BusAddress, stop: threading.Event) -> None:
    """Carry bytes both ways until one side hangs up."""
    assert inside.socket is not None
    with context.wrap_socket(plain, server_side=True) as outer, socket.socket(socket.AF_UNIX) as inner:
        inner.connect(inside.socket)
        for end in (outer, inner):
            end.settimeout(0.002)
        while not stop.is_set():
            for source, sink in ((outer, inner), (inner, outer)):
                try:
                    data = source.recv(1 << 16)
                except TimeoutError:
                    continue
                except OSError:
                    return
                if not data:
                    return
                sink.settimeout(5.0)
                sink.sendall(data)
                sink.settimeout(0.002)


def _user(address: BusAddress, writer: Connection, *rights: str) -> BusAddress:
    """Make a user with all rights but some, and return the bus as that user sees it."""
    writer.call("ACL", "SETUSER", "recorder", *RECORDER_RIGHTS, *rights)
    return msgspec.structs.replace(address, username="recorder", password="secret")
