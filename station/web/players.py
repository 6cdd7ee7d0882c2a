"""Players of episodes for pages: a process each, a few at a time, that end with their pages.

Everything here runs in the event loop and waits for no file: a player reads them (`station.web.player`), stands back
behind everything else, and may be killed at any time.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import socket
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec

from station import python_child
from station.errors import StationError
from station.printable import printable
from station.web.feeds import Frame, Viewer
from station.web.player import HEAD, PLAY, Order

MOST_PLAYERS = 4
"""That run at a time."""

_BEAT_S, _OPENS_S, _SILENT_S = 1.0, 60.0, 30.0  # a player on a busy machine is slow to begin
_LARGEST = 64 << 20  # bytes of a frame
_MOST_WAITING = 64 << 10  # bytes of orders that a player does not take
_TEXT = 300


class Players:
    """Who plays.

    Args:
        folder_of: Returns the folder of an episode by its id; raises `StationError` with the reason where it cannot be
            played.
    """

    def __init__(self, folder_of: Callable[[str], Path]) -> None:
        self.folder_of = folder_of
        self.count = 0

    def join(self, viewer: Viewer) -> Playback:
        """Return what plays to a viewer, nothing yet."""
        return Playback(self, viewer)


class Asked(msgspec.Struct, frozen=True):
    """What a page asks: which episode it shows, the number of its asking, and what is left to the player."""

    episode: str
    opened: int
    order: Order = Order()


class Playback:
    """An episode that is played to one viewer; none most of the time."""

    def __init__(self, players: Players, viewer: Viewer) -> None:
        self._players, self._viewer = players, viewer
        self._shown: tuple[str, int] | None = None  # episode, and the number under which the page asked for it
        self._task: asyncio.Task[None] | None = None
        self._orders: list[Order] = []  # until there is somebody to obey
        self._writer: asyncio.StreamWriter | None = None

    def ask(self, said: object) -> None:
        """Do what a page asks: show an episode, go elsewhere in it; None shows none."""
        if said is None:
            self.close()
            return
        try:
            asked = msgspec.convert(said, Asked)
        except msgspec.ValidationError:  # no page of ours
            return
        if self._shown != (asked.episode, asked.opened):
            self.close()
            self._shown = asked.episode, asked.opened
            self._begin(asked.episode)
        self._send(asked.order)

    def got(self, feed: str) -> None:
        """Take note that the page has used a frame, unless a newer one of this player waits for it."""
        if feed.startswith(PLAY) and not self._viewer.is_waiting(feed):
            self._send(Order(got=feed))

    def close(self) -> None:
        """Show nothing."""
        if self._task is not None:
            self._task.cancel()
        self._shown = self._task = self._writer = None
        self._orders.clear()
        self._viewer.drop()

    def _begin(self, episode: str) -> None:
        try:
            if self._players.count >= MOST_PLAYERS:
                raise StationError(f"{MOST_PLAYERS} episodes are being played already; close one of them first")
            folder = self._players.folder_of(episode)
        except StationError as error:
            self._fail(str(error))
            return
        self._players.count += 1
        self._task = asyncio.create_task(self._run(folder))

    def _send(self, order: Order) -> None:
        if self._writer is None:
            if self._task is not None and len(self._orders) < _MOST_WAITING:
                self._orders.append(order)
        elif self._writer.transport.get_write_buffer_size() < _MOST_WAITING:
            self._writer.write(msgspec.json.encode(order) + b"\n")

    def _put(self, facts: dict[str, Any], payload: bytes = b"") -> None:
        _, opened = self._shown or ("", 0)
        now_s = asyncio.get_running_loop().time()
        self._viewer.put(Frame({**facts, "opened": opened}, payload, now_s))

    def _fail(self, why: str) -> None:
        self._put({"f": PLAY, "error": printable(why, _TEXT)})

    async def _run(self, folder: Path) -> None:
        """Have a process play, and pass its frames on until it ends or is not wanted any more."""
        loop, (ours, its) = asyncio.get_running_loop(), socket.socketpair()
        process: subprocess.Popen[bytes] | None = None
        try:
            starting = loop.run_in_executor(None, _start, folder, its)
            try:
                process = await asyncio.shield(starting)
            except asyncio.CancelledError:
                starting.add_done_callback(_end_started)
                raise
            reader, writer = await asyncio.open_unix_connection(sock=ours)
            self._writer = writer
            for order in self._orders:
                self._send(order)
            self._orders.clear()
            why = await self._pass_on(reader)
            if why:
                self._fail(why)
            elif why is None:
                code = await loop.run_in_executor(None, process.wait)
                self._fail(f"its player ended by itself (code {code})")
        except OSError as error:
            self._fail(f"no player could be started: {error.strerror or error}")
        finally:
            self._players.count -= 1
            ours.close()
            if process is not None:
                _end(process)

    async def _pass_on(self, reader: asyncio.StreamReader) -> str | None:
        """Pass frames on; return why there are no more, "" where the player has said so, None where it just ended."""
        loop = asyncio.get_running_loop()
        heard_s, limit_s = loop.time(), _OPENS_S
        while True:
            reading = asyncio.ensure_future(_frame(reader))
            try:
                while not (await asyncio.wait((reading,), timeout=_BEAT_S))[0]:
                    if loop.time() - heard_s > limit_s:
                        return f"its player has said nothing for {limit_s:.0f} s"
                    self._put({"f": PLAY, "is_waiting": True})
                facts, payload = reading.result()
            except (asyncio.IncompleteReadError, ConnectionError, ValueError, msgspec.DecodeError):
                return None
            finally:
                reading.cancel()
            self._put(facts, payload)
            if "error" in facts:
                return ""
            heard_s, limit_s = loop.time(), _SILENT_S


async def _frame(reader: asyncio.StreamReader) -> tuple[dict[str, Any], bytes]:
    sizes = HEAD.unpack(await reader.readexactly(HEAD.size))
    if sum(sizes) > _LARGEST:
        raise ValueError("a frame that no player of ours sends")
    facts = msgspec.json.decode(await reader.readexactly(sizes[0]), type=dict[str, Any])
    return facts, await reader.readexactly(sizes[1])


def _start(folder: Path, its: socket.socket) -> subprocess.Popen[bytes]:
    nothing = subprocess.DEVNULL
    with its:
        return subprocess.Popen(
            python_child.command("-m", "station.web.player", str(folder), str(its.fileno())),
            stdin=nothing, stdout=nothing, stderr=nothing, pass_fds=(its.fileno(),), start_new_session=True,
            env={python_child.BLAS_THREADS: "1", **os.environ},
        )  # fmt: skip


def _end_started(starting: asyncio.Future[subprocess.Popen[bytes]]) -> None:
    with contextlib.suppress(OSError):
        _end(starting.result())


def _end(process: subprocess.Popen[bytes]) -> None:
    """Kill a player, and bury it where nobody waits."""
    process.kill()
    asyncio.get_running_loop().run_in_executor(None, process.wait)
