"""A console as a process of its own, and pages of it without a browser."""

from __future__ import annotations

import contextlib
import json
import os
import re
import signal
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request
from pathlib import Path
from typing import Any

from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection, connect

from station.bus.address import BusAddress
from tests.waiting import DEADLINE_S, wait_until

_LINK = re.compile(r"^(operator|viewer): +(\S+)", re.MULTILINE)


class ConsoleProcess:
    """``station console`` on a bus.

    Args:
        address: The bus.
        folder: For its words, episodes and state.
        more: Further arguments.
    """

    def __init__(self, address: BusAddress, folder: Path, *more: str, port: int = 0) -> None:
        self._words = folder / f"console-{time.monotonic_ns()}.txt"
        command = [sys.executable, "-m", "station", "console", "--bus", address.url, "--port", str(port),
                   "--data", str(folder / "data"), *more]  # fmt: skip
        with self._words.open("wb") as words:
            self.process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=words, stderr=words)
        wait_until(lambda: self.process.poll() is not None or "Ctrl-C ends" in self.words())
        if self.process.poll() is not None:
            self.process.wait()
            raise AssertionError(self.words())

    def words(self) -> str:
        """What it printed."""
        return self._words.read_text()

    def links(self) -> dict[str, str]:
        """The links that it printed, by role."""
        return dict(_LINK.findall(self.words()))

    @property
    def origin(self) -> str:
        """Where its pages are."""
        return self.links()["operator"].partition("/?")[0]

    @property
    def port(self) -> int:
        """Its port."""
        return int(self.origin.rpartition(":")[2])

    def cookie(self, role: str = "operator") -> str:
        """The cookie that a browser gets for a link."""
        return f"station-{self.port}={self.links()[role].partition('token=')[2]}"

    def ask(self, path: str, *, role: str = "operator", body: bytes | None = None, **headers: str) -> tuple[int, bytes]:
        """Send a request as a page of ours does, some headers replaced; return status and answer."""
        given = {"Cookie": self.cookie(role), "Origin": self.origin, "X-Station": "1",
                 "Content-Type": "application/json"}  # fmt: skip
        given |= {name.replace("_", "-").title(): value for name, value in headers.items()}
        request = urllib.request.Request(self.origin + path, data=body, headers=given)
        try:
            with urllib.request.urlopen(request, timeout=DEADLINE_S) as answer:
                return int(answer.status), answer.read()
        except urllib.error.HTTPError as error:
            return error.code, error.read()
        except urllib.error.URLError:  # refused before all of it was sent
            return 0, b""

    def stop_key(self) -> str:
        """The key of the stop, as a page gets it."""
        return str(json.loads(self.ask("/api/me")[1])["stop_key"])

    def page(self, role: str = "operator", *, cookie: str | None = None) -> PageSocket:
        """Open the socket of a page."""
        return PageSocket(self, "/ws/news", cookie or self.cookie(role))

    def view(self, role: str = "viewer") -> PageSocket:
        """Open the socket of a page's frames."""
        return PageSocket(self, "/ws/view", self.cookie(role))

    def freeze(self) -> None:
        """Stop the process where it stands."""
        os.kill(self.process.pid, signal.SIGSTOP)

    def thaw(self) -> None:
        """Let it go on."""
        os.kill(self.process.pid, signal.SIGCONT)

    def kill(self) -> None:
        """Kill it without a word."""
        self.process.kill()
        self.process.wait()


def players(folder: Path) -> list[int]:
    """Return the processes that play an episode."""
    found = []
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            words = path.read_bytes().split(b"\0")
        except OSError:
            continue
        if b"station.web.player" in words and bytes(folder.absolute()) in words:
            found.append(int(path.parent.name))
    return found


class PageSocket:
    """A socket of a page: what it is told, by kind."""

    def __init__(
        self, console: ConsoleProcess, path: str, cookie: str, origin: str | None = None, port: int = 0
    ) -> None:
        self._origin = origin or console.origin
        where = f"ws://127.0.0.1:{console.port}{path}"
        line = socket.create_connection(("127.0.0.1", port)) if port else None
        self._open = contextlib.ExitStack()
        self.socket: ClientConnection = self._open.enter_context(connect(
            where, origin=self._origin, additional_headers={"Cookie": cookie}, max_size=None, compression=None,
            sock=line,
        ))  # fmt: skip
        self.told: list[dict[str, Any]] = []

    def say(self, **said: Any) -> None:
        """Say something as the page does."""
        self.socket.send(json.dumps(said))

    def hear(self, timeout_s: float = DEADLINE_S) -> dict[str, Any]:
        """Return the next thing that it is told."""
        said = json.loads(self.socket.recv(timeout_s))
        self.told.append(said)
        return dict(said)

    def until(self, holds: Any, timeout_s: float = DEADLINE_S) -> dict[str, Any]:
        """Return the first thing from now on for which something holds."""
        deadline_s = time.monotonic() + timeout_s
        while True:
            said = self.hear(max(0.0, deadline_s - time.monotonic()))
            if holds(said):
                return said

    def state(self, holds: Any = lambda state: True, timeout_s: float = DEADLINE_S) -> dict[str, Any]:
        """Return the first state from now on for which something holds."""
        return self.until(lambda said: said["t"] == "state" and holds(said), timeout_s)

    def ask(self, what: str, **fields: Any) -> dict[str, Any]:
        """Ask for something; return the answer."""
        number = f"{what}-{time.monotonic_ns()}"
        self.say(t="ask", id=number, what=what, **fields)
        return self.until(lambda said: said["t"] == "answer" and said["id"] == number)

    def frame(self, timeout_s: float = DEADLINE_S) -> tuple[dict[str, Any], bytes]:
        """Return header and payload of the next frame."""
        data = self.socket.recv(timeout_s)
        assert isinstance(data, bytes)
        length = int.from_bytes(data[:4], "little")
        return json.loads(data[4 : 4 + length]), data[4 + length :]

    def close(self) -> None:
        """Go away."""
        with contextlib.suppress(ConnectionClosed):
            self._open.close()
