"""The console: a running station in a browser, one more client of the bus.

Three threads: the pages' event loop, what looks at the bus, and what looks at the episodes. They share plain values
that are replaced as a whole; nothing of a page is waited for.
"""

from __future__ import annotations

import asyncio
import os
import threading
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from station.api.live import Station
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.config import to_plain
from station.episode.storage.folder import data_folder
from station.errors import BusError, NotReady, StationError
from station.life.events import Event
from station.life.loop import Rate
from station.life.server import Life
from station.printable import printable
from station.software import software
from station.web import asks, links
from station.web.asks import Ask
from station.web.config import ConsoleConfig
from station.web.feeds import Feeds
from station.web.keyring import Keyring, Role
from station.web.look import Look
from station.web.players import Players
from station.web.stops import Stops
from station.web.takes import Takes
from station.web.web_server import listen

_STATE_S, _KEYS_S = 0.25, 1.0
_AGAIN_S = 0.5  # between two tries to reach a bus
_ASKS = 8  # side by side
_TEXT = 500

Told = dict[str, Any]


class Console:
    """Serves pages of a station from when it is made; `serve` looks at the bus meanwhile.

    Args:
        config: How it is set up.
        address: The bus, which need not be there.
        name: Name of the server.

    Attributes:
        url: Where the page is, without a token.
        authority: File of the authority that a browser has to trust; None without TLS, or with a certificate of others.

    Raises:
        StationError: the address or the port cannot be had, or the secrets cannot be read.
    """

    def __init__(self, config: ConsoleConfig, address: BusAddress, name: str) -> None:
        from station.web.pages import Pages

        self.address, self.name, self.keyring = address, name, Keyring()
        self._config = config
        self._server, hosts, self.url, self.authority = listen(config)
        self.feeds, self.stops = Feeds(), Stops(address, name)
        self._clock = address.clock
        self._look: Look | None = None
        self._station: Station | None = None
        self._asking = ThreadPoolExecutor(_ASKS, "console-ask")
        self._lock = threading.Lock()
        self._state: Told = _nothing_yet(address)
        self._pages = Pages(self, hosts, self._server.port, is_secure=config.is_secure)
        self.takes = Takes(data_folder(config.data), address.clock, self._tell_takes, is_judging=config.check)
        self.players = Players(self.takes.folder)
        self._server.start(self._pages.app)

    @property
    def title(self) -> str:
        """What a page is called: the name of the console where it was given one, else "" for the product's."""
        return "" if self.name == "console" else self.name

    def link(self, role: Role) -> str:
        """Return the link that lets a page in as a role."""
        return links.link(self.url, self.keyring, role)

    # -- For the pages, in their event loop ---------------------------------------------------------------------------
    def state(self) -> Told:
        """Return the state of the station as it was last seen, whole."""
        recorder = self._state["recorder"]
        if recorder is not None and recorder["state"] == "recording":
            recorder = {**recorder, **self.takes.recording()}
        return {"t": "state", **self._state, "recorder": recorder, "takes": self.takes.figures()}

    def keys(self) -> Told:
        """Return the keys of the bus."""
        look = self._look  # kept, since the thread of the server may end it meanwhile
        return {"t": "keys", "keys": [] if look is None else look.keys_table()}

    def events(self) -> list[Told]:
        """Return the last events, oldest first."""
        look, now_ns = self._look, self._clock.wall_ns()
        return [_event(event, now_ns) | {"is_old": True} for event in (look.events if look else ())]

    def episodes(self) -> Told:
        """Return the episodes."""
        return {"t": "episodes", "episodes": self.takes.listing()}

    def scene(self, robot: str) -> Told | None:
        """Return how a robot is drawn; None for one that is not there."""
        look = self._look
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

    # -- In the thread of the server ----------------------------------------------------------------------------------
    def wait_for_bus(self, stop: threading.Event) -> bool:
        """Wait until the bus answers, telling the pages meanwhile; return whether it does, and not `stop` was set."""
        while not stop.is_set():
            try:
                Bus(self.address, name=self.name).close()
            except BusError as error:
                self._state = _nothing_yet(self.address, str(error))
                self._post({"t": "state"})
                self._clock.wait(stop, _AGAIN_S)
            else:
                return True
        return False

    def serve(self, life: Life) -> int:
        """Look at the bus until the server is asked to stop; return the exit code."""
        os.nice(self._config.niceness)
        facts = {"server": life.name, "role": "console", "url": self.url, "config": to_plain(self._config)}
        life.configured(facts)
        if life.ready():
            self._run(life)
        return 0

    def _run(self, life: Life) -> None:
        self._look = look = Look(self.address, self.name)
        self.stops.warm()
        rate, next_state_s, next_keys_s = Rate(self._config.rate_hz, self._clock), 0.0, 0.0
        was: tuple[object, ...] = ()
        try:
            while not life.stopping:
                frames = look.step(self.feeds.wanted)
                if frames:
                    self._server.call(self.feeds.put, frames)
                now_s = self._clock.monotonic_s()
                for event in look.new_events():
                    if event.name.startswith("record-"):
                        self.takes.wake()
                    self._post(_event(event, self._clock.wall_ns()))
                if (now := look.urgent()) != was or now_s >= next_state_s:
                    was, next_state_s, self._state = now, now_s + _STATE_S, look.state()
                    self._post({"t": "state"})
                if now_s >= next_keys_s:
                    next_keys_s = now_s + _KEYS_S
                    self._post({"t": "keys"})
                    life.report(viewers=self._pages.viewers)
                rate.wait(life.stop_event)
        finally:
            self._look = None
            look.close()

    def close(self) -> None:
        """Let go of pages, bus and episodes; a stop that is being pressed is answered before."""
        self._server.close()
        self.stops.close()
        self.takes.close()
        self._asking.shutdown(cancel_futures=True)
        if self._station is not None:
            self._station.close()

    def __enter__(self) -> Console:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _opened(self) -> Station:
        with self._lock:
            if self._station is None:
                try:
                    self._station = Station(self.address.url, name=self.name)
                except BusError as error:
                    raise NotReady(f"not done, since the station cannot be reached: {error}") from None
            return self._station

    def _tell_takes(self) -> None:
        self._post({"t": "episodes"})

    def _post(self, told: Told) -> None:
        """Have all pages told something: an event, or that one of the whole states is new."""
        self._server.call(self._pages.tell, told)


def version() -> str:
    """Return the version of the station."""
    return software().version or "unknown"


def _nothing_yet(address: BusAddress, reason: str = "not looked at yet") -> Told:
    bus = {"linked": False, "age_s": 1e6, "address": str(address), "reason": printable(reason, _TEXT)}
    return {"bus": bus, "stop": None, "robots": [], "recorder": None, "cameras": [], "servers": [], "runbook": None,
            "alarms": [{"level": "error", "text": bus["reason"], "since_s": 0.0}]}  # fmt: skip


def _event(event: Event, now_ns: int) -> Told:
    return {
        "t": "event", "name": printable(event.name, 100), "severity": event.severity,
        "source": printable(event.source, 60), "text": printable(str(event), _TEXT),
        "age_s": round(max(0.0, (now_ns - event.wall_ns) * 1e-9), 2),
    }  # fmt: skip
