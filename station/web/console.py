"""The console: a running station in a browser, one more client of the bus.

Three threads: the pages' event loop, what looks at the bus, and what looks at the episodes. They share plain values
that are replaced as a whole; nothing of a page is waited for.
"""

from __future__ import annotations

import os
import threading

from station.bus.address import BusAddress
from station.bus.client import Bus
from station.config import to_plain
from station.errors import BusError
from station.life.loop import Rate
from station.life.server import Life
from station.web import links
from station.web.config import ConsoleConfig
from station.web.keyring import Role
from station.web.look import Look
from station.web.pages import Pages
from station.web.shown import Shown, Told, nothing_yet, told_of
from station.web.web_server import listen

_STATE_S, _KEYS_S = 0.25, 1.0
_AGAIN_S = 0.5  # between two tries to reach a bus


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
        self._config, self._clock = config, address.clock
        self._server, hosts, self.url, self.authority = listen(config)
        self._shown = Shown(config, address, name, lambda: self._post({"t": "episodes"}))
        self._pages = Pages(self._shown, hosts, self._server.port, is_secure=config.is_secure)
        self._server.start(self._pages.app)

    def link(self, role: Role) -> str:
        """Return the link that lets a page in as a role."""
        return links.link(self.url, self._shown.keyring, role)

    def wait_for_bus(self, stop: threading.Event) -> bool:
        """Wait until the bus answers, telling the pages meanwhile; return whether it does, and not `stop` was set."""
        shown = self._shown
        while not stop.is_set():
            try:
                Bus(shown.address, name=shown.name).close()
            except BusError as error:
                shown.now = nothing_yet(shown.address, str(error))
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
        shown = self._shown
        shown.look = look = Look(shown.address, shown.name)
        shown.stops.warm()
        rate, next_state_s, next_keys_s = Rate(self._config.rate_hz, self._clock), 0.0, 0.0
        was: tuple[object, ...] = ()
        try:
            while not life.stopping:
                frames = look.step(shown.feeds.wanted)
                if frames:
                    self._server.call(shown.feeds.put, frames)
                now_s = self._clock.monotonic_s()
                for event in look.new_events():
                    if event.name.startswith("record-"):
                        shown.takes.wake()
                    self._post(told_of(event, self._clock.wall_ns()))
                if (now := look.urgent()) != was or now_s >= next_state_s:
                    was, next_state_s, shown.now = now, now_s + _STATE_S, look.state()
                    self._post({"t": "state"})
                if now_s >= next_keys_s:
                    next_keys_s = now_s + _KEYS_S
                    self._post({"t": "keys"})
                    life.report(viewers=self._pages.viewers)
                rate.wait(life.stop_event)
        finally:
            shown.look = None
            look.close()

    def close(self) -> None:
        """Let go of pages, bus and episodes; a stop that is being pressed is answered before."""
        self._server.close()
        self._shown.close()

    def __enter__(self) -> Console:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _post(self, told: Told) -> None:
        """Have all pages told something: an event, or that one of the whole states is new."""
        self._server.call(lambda: self._pages.tell(told))
