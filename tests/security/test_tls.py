"""TLS to a bus: the certificates that the environment names are used, and a wrong one is refused in a line.

The server that comes with Python has no TLS of its own: a proxy in front of it speaks Python's, and a Redis of the
system's is tried where there is one.
"""

from __future__ import annotations

import contextlib
import os
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
from tests.cli.running import COMMANDS_ONLY, SHORT, new_home, one_line
from tests.network_link.far_bus import opened_bus
from tests.tiers import ROOT
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


@pytest.fixture
def redis() -> dict[str, str]:
    """Variables with which `station bus start` finds a Redis with TLS: the system's, or one that `.ci/run` unpacked."""
    unpacked = ROOT / ".venv" / "redis" / "usr"
    folders = [str(unpacked / "bin"), *os.environ.get("PATH", "").split(os.pathsep)]
    libraries = os.pathsep.join(map(str, (unpacked / "lib").glob("*-linux-gnu")))
    found = {"PATH": os.pathsep.join(folders), "LD_LIBRARY_PATH": libraries}
    server = shutil.which("redis-server", path=found["PATH"])
    help_text = b"" if server is None else _help(server, found)
    if b"tls" not in help_text:
        message = "no redis-server with TLS: apt install redis-server"
        (pytest.fail if os.environ.get("CI") else pytest.skip)(message)
    return found


def _help(server: str, variables: dict[str, str]) -> bytes:
    """Return what a server says of a port with TLS but without a certificate; one that has no TLS says that instead."""
    words = [server, "--port", "0", "--tls-port", "1", "--tls-cert-file", "/nowhere.pem"]
    done = subprocess.run(words, env=os.environ | variables, capture_output=True, timeout=30, check=False)
    return b"tls" if b"Failed to configure TLS" in done.stdout else b""


def test_a_bus_of_ours_speaks_tls_and_a_station_elsewhere_is_recorded_over_it(
    redis: dict[str, str], certificates: Path, free_port: int, processes: None
) -> None:
    with new_home() as robot, new_home() as desk:
        robot.environment |= redis
        files = ("--certificate", certificates / "localhost.pem", "--key", certificates / "localhost.key")
        words = ["bus", "start", "--bind", "127.0.0.1", "--tcp", free_port, *files, "--ca", certificates / "ca.pem"]
        with robot.running(*map(str, words)) as bus:
            here = opened_bus(robot)
            desk.environment |= {
                "STATION_BUS": f"rediss://localhost:{free_port}/0", "STATION_BUS_PASSWORD": here.password or "",
                "STATION_BUS_CA": str(certificates / "ca.pem"),
            }  # fmt: skip
            assert "it may ask for a certificate of ours: name that in $STATION_BUS_CERT" in one_line(
                desk.run("status")
            )
            desk.environment |= {
                "STATION_BUS_CERT": str(certificates / "client.pem"),
                "STATION_BUS_KEY": str(certificates / "client.key"),
            }
            done = desk.run("up", COMMANDS_ONLY, "--record", "--task", "t", "--for", "2s", *SHORT)
            assert done.returncode == 0, done.stderr
            assert " 0 lost" in done.stderr
            assert "replication tap" in desk.run("check", "latest").stdout
            assert "bus certificate: valid until" in desk.run("doctor").stdout
            bus.interrupt()
            assert f"rediss://127.0.0.1:{free_port}/0, encrypted, with a password" in bus.finish()[1]


def test_a_server_without_tls_and_a_certificate_without_its_key_are_refused_in_a_line(
    certificates: Path, processes: None
) -> None:
    with new_home() as home:
        home.environment["PATH"] = ""  # the server that comes with Python is left
        pem, key = str(certificates / "localhost.pem"), str(certificates / "localhost.key")
        tls = ("--certificate", pem, "--key", key)
        assert "has no TLS; put one that has on PATH" in one_line(home.run("bus", "start", "--bind", "127.0.0.1", *tls))
        assert "name an address of this one, --bind" in one_line(home.run("bus", "start", *tls))
        assert "TLS needs --certificate and --key" in one_line(home.run("bus", "start", "--certificate", pem))
