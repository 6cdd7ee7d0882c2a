"""What the pages of a console show of a station, and what they ask of it.

What looks at the bus replaces plain values as a whole; the pages' event loop reads them, and waits for nothing.
"""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from station.api.live import Station
from station.bus.address import BusAddress
from station.episode.storage.folder import data_folder
from station.errors import BusError, NotReady, StationError
from station.life.events import Event
from station.printable import printable
from station.web import asks
from station.web.asks import Ask
from station.web.config import ConsoleConfig
from station.web.feeds import Feeds
from station.web.keyring import Keyring
from station.web.look import Look
from station.web.players import Players
from station.web.stops import Stops
from station.web.takes import Takes

_ASKS = 8  # side by side
_TEXT = 500

Told = dict[str, Any]


class Shown:
    """A station as pages see it.

    Args:
        config: How the console is set up.
        address: The bus, which need not be there.
        name: Name of the console's server.
        on_takes: Called, in a thread of its own, when something about the episodes has changed.

    Attributes:
        now: The state of the station as it was last seen.
        look: What looks at the bus; None while nothing does. Both are replaced by the thread that looks.
        keyring: Who may do what.
        feeds: What is drawn of robots and cameras.
        stops: The stop.
        takes: The episodes.
        players: What plays them.
    """

    def __init__(self, config: ConsoleConfig, address: BusAddress, name: str, on_takes: Callable[[], None]) -> None:
        self.address, self.name, self.keyring = address, name, Keyring()
        self.feeds, self.stops = Feeds(), Stops(address, name)
        self.look: Look | None = None
        self.now = nothing_yet(address)
        self._station: Station | None = None
        self._asking = ThreadPoolExecutor(_ASKS, "console-ask")
        self._lock = threading.Lock()
        self.takes = Takes(data_folder(config.data), address.clock, on_takes, is_judging=config.check)
        self.players = Players(self.takes.folder)

    @property
    def title(self) -> str:
        """What a page is called: the name of the console where it was given one, else "" for the product's."""
        return "" if self.name == "console" else self.name

    def state(self) -> Told:
        """Return the state of the station as it was last seen, whole."""
        recorder = self.now["recorder"]
        if recorder is not None and recorder["state"] == "recording":
            recorder = {**recorder, **self.takes.recording()}
        return {"t": "state", **self.now, "recorder": recorder, "takes": self.takes.figures()}

    def keys(self) -> Told:
        """Return the keys of the bus."""
        look = self.look  # kept, since the thread of the server may end it meanwhile
        return {"t": "keys", "keys": [] if look is None else look.keys_table()}

    def events(self) -> list[Told]:
        """Return the last events, oldest first."""
        look, now_ns = self.look, self.address.clock.wall_ns()
        return [told_of(event, now_ns) | {"is_old": True} for event in (look.events if look else ())]

    def episodes(self) -> Told:
        """Return the episodes."""
        return {"t": "episodes", "episodes": self.takes.listing()}

    def scene(self, robot: str) -> Told | None:
        """Return how a robot is drawn; None for one that is not there."""
        look = self.look
        found = None if look is None else look.robot(robot)
        return None if found is None else found.scene()

    async def do(self, ask: Ask, who: str) -> tuple[bool, str]:
        """Do what a page asks for; return whether that was done, and what there is to say."""

        def act() -> tuple[bool, str]:
            try:
                return True, asks.do(self._opened(), self.stops, ask, who)
            except StationError as error:
                return False, str(error)

        done, text = await asyncio.get_running_loop().run_in_executor(self._asking, act)
        return done, printable(text, _TEXT)

    def close(self) -> None:
        """Let go of bus and episodes; a stop that is being pressed is answered before."""
        self.stops.close()
        self.takes.close()
        self._asking.shutdown(cancel_futures=True)
        if self._station is not None:
            self._station.close()

    def _opened(self) -> Station:
        with self._lock:
            if self._station is None:
                try:
                    self._station = Station(self.address.url, name=self.name)
                except BusError as error:
                    raise NotReady(f"not done, since the station cannot be reached: {error}") from None
            return self._station


def nothing_yet(address: BusAddress, reason: str = "not looked at yet") -> Told:
    """Return the state of a station of which nothing has been seen, and why."""
    bus = {"linked": False, "age_s": 1e6, "address": str(address), "reason": printable(reason, _TEXT)}
    return {"bus": bus, "stop": None, "robots": [], "recorder": None, "cameras": [], "servers": [], "runbook": None,
            "alarms": [{"level": "error", "text": bus["reason"], "since_s": 0.0}]}  # fmt: skip


def told_of(event: Event, now_ns: int) -> Told:
    """Return an event as a page is told of it."""
    return {
        "t": "event", "name": printable(event.name, 100), "severity": event.severity,
        "source": printable(event.source, 60), "text": printable(str(event), _TEXT),
        "age_s": round(max(0.0, (now_ns - event.wall_ns) * 1e-9), 2),
    }  # fmt: skip
