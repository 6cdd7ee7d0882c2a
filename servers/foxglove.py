"""The Foxglove server: the Foxglove app opens a running station as it opens a recording of one.

It is one more reader of the bus, in a process of its own. What a key is to a viewer says `station.enrich.live`; the
protocol, a queue per client and the socket are the library's (``foxglove-sdk``). A key gets its channels when it first
appears, and is read and converted only while a client has subscribed to one of them. What no message could be sent of
is counted: overwritten before it was looked at, or not what the key is described to hold. Nothing comes back: no
capability is offered, so a client can neither publish, nor set parameters, nor call services.
"""

from __future__ import annotations

import logging
import os
import queue
from collections import Counter, defaultdict
from collections.abc import Mapping, Set
from itertools import islice
from typing import TYPE_CHECKING, Any, NamedTuple, cast

import msgspec

from station import libraries
from station.bus import codec, keys
from station.bus.address import is_loopback
from station.bus.contracts import Contracts
from station.bus.sample import Sample
from station.bus.watch import Watch
from station.config import to_plain
from station.errors import BusError, StationError
from station.life.event_feed import EventFeed
from station.life.events import Event
from station.life.loop import Rate
from station.life.server import Life, ServerKind

if TYPE_CHECKING:
    from foxglove import Channel, Context
    from foxglove.websocket import ChannelView, Client, WebSocketServer

    from station.contract import Contract
    from station.enrich.live import LiveKey

log = logging.getLogger(__name__)

MOST_KEYS = 2000
"""Keys that get channels: a client of the bus that invents keys must not fill the memory. A station has 100."""

_LOOK_S = 0.5  # how long a new key stays unseen
_NEW_AT_ONCE = (
    8  # keys that get channels in a step: the library cuts off a client for which more than its backlog waits
)
_BACKLOG = 512  # messages that wait for a slow client, more than one look at a whole station; then the oldest go
_MOST_SKIPPED = 1_000_000  # at once; a stamp that says more is no writer's count
_BUS = "bus"  # name of what clients are told of it


class FoxgloveConfig(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Configuration of the Foxglove server.

    Attributes:
        host: Address to listen on; at any other than a loopback one, everybody who reaches it sees all of the station.
        port: Port to listen on; 0 takes a free one, which the log says.
        rate_hz: How often it looks for new values [Hz]; of a key that is written more often the newest is sent.
        niceness: How far the process stands back behind others, 0 to 19: a viewer may wait, a robot may not.
    """

    host: str = "127.0.0.1"
    port: int = 8765
    rate_hz: float = 60.0
    niceness: int = 5

    def __post_init__(self) -> None:
        if not self.host.strip():
            raise ValueError("host is empty; expected an address of this machine, for example 127.0.0.1")
        if not 0 <= self.port <= 65535:
            raise ValueError(f"port is {self.port}; expected 0 to 65535")
        if not 1.0 <= self.rate_hz <= 500.0:
            raise ValueError(f"rate_hz is {self.rate_hz:g}; expected 1 to 500")
        if not 0 <= self.niceness <= 19:
            raise ValueError(f"niceness is {self.niceness}; expected 0 to 19")


def main(config: FoxgloveConfig, life: Life) -> int:
    """Serve the station to viewers until asked to stop; return the exit code."""
    from foxglove import Context

    os.nice(config.niceness)
    context, subscribers = Context(), Subscribers()
    server = _listen(config, context, subscribers, life.name)
    try:
        url = f"ws://{f'[{config.host}]' if ':' in config.host else config.host}:{server.port}"
        life.configured({"server": life.name, "role": KIND.role, "url": url, "config": to_plain(config)})
        if not life.ready():
            return 0
        log.info("open %s in the Foxglove app", url)
        if not is_loopback(config.host):
            life.event(
                "foxglove-open-to-network", severity="warning", url=url,
                note="everybody who reaches it sees every key of the station, pictures too; nobody can write",
            )  # fmt: skip
        _run(config, life, server, LiveStation(life, context, subscribers))
    finally:
        server.stop()
    return 0


KIND = ServerKind(
    name="foxglove",
    role="observer",
    summary="shows a running station in the Foxglove app",
    config=FoxgloveConfig,
    main=main,
    expect=lambda config: libraries.expect("the Foxglove server", "foxglove-sdk", "foxglove"),
    bus_timeout_s=0.25,
)


class Subscribers:
    """Which clients look at which channels, as the library's threads say it.

    Attributes:
        newly: Channels, by number, that got a subscriber at the last `poll`.
    """

    def __init__(self) -> None:
        self._told: queue.SimpleQueue[tuple[int, int, bool]] = queue.SimpleQueue()
        self._of: defaultdict[int, Counter[int]] = defaultdict(Counter)
        self.newly: set[int] = set()

    def on_subscribe(self, client: Client, channel: ChannelView) -> None:
        """Record that a client looks at a channel; called by the library."""
        self._told.put((channel.id, client.id, True))

    def on_unsubscribe(self, client: Client, channel: ChannelView) -> None:
        """Record that a client looks at a channel no more, or is gone; called by the library."""
        self._told.put((channel.id, client.id, False))

    def poll(self) -> bool:
        """Take up what was said since the last call; return whether anything was."""
        self.newly, is_changed = set(), False
        while not self._told.empty():
            is_changed = True
            channel, client, is_there = self._told.get()
            count = self._of[channel]
            count[client] += 1 if is_there else -1
            if is_there:
                self.newly.add(channel)
            if count[client] <= 0:
                del count[client]
            if not count:
                del self._of[channel]
        return is_changed

    @property
    def channels(self) -> Set[int]:
        """Channels, by number, that anybody looks at."""
        return self._of.keys()

    @property
    def clients(self) -> int:
        """How many clients look at anything."""
        return len({client for count in self._of.values() for client in count})


class _Shown(NamedTuple):
    """A key as it is shown: what its values become, and a channel for each of its topics, by number, in their order."""

    live: LiveKey
    channels: dict[int, Channel]


class LiveStation:
    """Keys of a bus as channels; call `look` now and then, and `step` many times between.

    Args:
        life: Of the server.
        context: Of the library; who serves it shows the channels.
        subscribers: Who looks at them.

    Attributes:
        is_lost: Whether the bus did not answer at the last look.
    """

    def __init__(self, life: Life, context: Context, subscribers: Subscribers) -> None:
        from station.enrich.live import (
            LiveKey,
            written_wall_ns,
        )  # Protobuf and NumPy, which a list of servers needs not
        from station.enrich.vector import TypeNames

        self._new_key, self._written_ns = LiveKey, written_wall_ns
        self._life, self._bus, self._context, self._subscribers = life, life.bus, context, subscribers
        self._contracts, self._stated = Contracts(), dict[str, bytes]()
        self._names = TypeNames()
        self._shown: dict[str, _Shown] = {}
        self._to_show: dict[str, Contract | None] = {}  # keys with what describes them
        self._wanted: dict[str, _Shown] = {}
        self._watch: Watch | None = None
        self._watched: frozenset[str] = frozenset()
        self._feed: EventFeed | None = None
        self._last: dict[str, Sample] = {}
        self._beyond = False
        self._counts = Counter[str]()
        self.is_lost = False

    def look(self) -> None:
        """Find keys that are new, or that are described otherwise than before; `step` gives them channels."""
        try:
            names = self._bus.names()
            self._describe(self._bus.read([key for key in names if key.startswith(keys.CONFIG_PREFIX)]))
        except BusError:  # the bus itself says so in the log; what is shown stays
            self.is_lost = True
            return
        self.is_lost, room, self._to_show = False, MOST_KEYS - len(self._shown), {}
        for key in names:
            shown, contract = self._shown.get(key), self._contracts.get(key)
            if shown is not None and shown.live.contract == contract:
                continue
            if shown is None and not room:
                self._tell_beyond(len(names))
                break
            room -= shown is None
            self._to_show[key] = contract

    def step(self) -> None:
        """Give channels to some keys that have none yet, and send what is new of those that somebody looks at."""
        for key in list(islice(self._to_show, _NEW_AT_ONCE)):
            self._show(key, self._new_key(key, self._to_show.pop(key), self._names.new(key)))
        if self._subscribers.poll():
            self._follow()
        for key, shown in self._wanted.items():
            if (sample := self._fresh(key)) is not None:
                self._send(shown, sample, self._written_ns(sample, self._life.clock))
        for event in () if self._feed is None else self._feed.pop():
            self._send_event(event)

    def facts(self) -> dict[str, Any]:
        """Return what the heartbeat says."""
        return {
            "clients": self._subscribers.clients,
            "channels": sum(len(shown.channels) for shown in self._shown.values()),
            "followed": len(self._watched) + (self._feed is not None),
            **{name: self._counts[name] for name in ("sent", "skipped", "unfit")},
        }

    def close(self) -> None:
        """Read the bus no more."""
        self._read(frozenset())

    def _describe(self, stated: Mapping[str, Sample]) -> None:
        for key, sample in stated.items():
            if self._stated.get(key) != sample.value:
                self._stated[key] = sample.value
                self._contracts.add_facts(codec.parse_facts(sample.value))

    def _show(self, key: str, live: LiveKey) -> None:
        from foxglove import Channel, Schema

        if (before := self._shown.get(key)) is not None:
            for channel in before.channels.values():
                channel.close()
        channels = [
            Channel(
                topic.name, message_encoding=topic.encoding, context=self._context,
                schema=Schema(name=topic.schema_name, encoding=topic.schema_encoding, data=topic.schema),
            )
            for topic in live.topics
        ]  # fmt: skip
        self._shown[key] = _Shown(live, {channel.id(): channel for channel in channels})

    def _follow(self) -> None:
        """Read what somebody looks at and nothing else; who has just come gets what is there."""
        looked_at = self._subscribers.channels
        self._wanted = {key: shown for key, shown in self._shown.items() if shown.channels.keys() & looked_at}
        for key, shown in self._wanted.items():
            if shown.channels.keys() & self._subscribers.newly:
                self._last.pop(key, None)
        self._read(frozenset(self._wanted))

    def _read(self, wanted: frozenset[str]) -> None:
        """Read so many keys of the bus from now on; events by what gathers them, so that none is overwritten."""
        if (keys.EVENT in wanted) != (self._feed is not None):
            if self._feed is not None:
                self._feed.close()
            self._feed = EventFeed(self._bus) if keys.EVENT in wanted else None
        if (watched := wanted - {keys.EVENT}) == self._watched:
            return
        before, self._watch = self._watch, self._bus.watch(sorted(watched)) if watched else None
        if before is not None:
            before.close()
        for key in self._watched - watched:
            self._last.pop(key, None)
        self._watched = watched

    def _fresh(self, key: str) -> Sample | None:
        """Return the newest value of a key where it was not sent yet."""
        sample, last = None if self._watch is None else self._watch.latest(key), self._last.get(key)
        if sample is None or sample is last:
            return None
        self._last[key] = sample
        if last is None:
            return sample
        if sample.arrived_ns is None and (sample.value, sample.stamp) == (last.value, last.stamp):
            return None  # another watch found it again
        if sample.stamp is not None and last.stamp is not None and sample.stamp.source == last.stamp.source:
            missing = sample.stamp.seq - last.stamp.seq - 1
            self._counts["skipped"] += missing if 0 < missing < _MOST_SKIPPED else 0
        return sample

    def _send_event(self, event: Event) -> None:
        if (shown := self._shown.get(keys.EVENT)) is not None:
            at_ns = max(0, event.wall_ns)
            self._send(shown, Sample(keys.EVENT, event.encode(), None, None), at_ns)

    def _send(self, shown: _Shown, sample: Sample, written_ns: int) -> None:
        messages = shown.live.encode(sample, written_ns)
        if messages is None:
            self._counts["unfit"] += 1
            return
        for (number, channel), message in zip(shown.channels.items(), messages, strict=True):
            if number in self._subscribers.channels:
                channel.log(message, log_time=written_ns)
                self._counts["sent"] += 1

    def _tell_beyond(self, found: int) -> None:
        if not self._beyond:
            self._beyond = True
            self._life.event("foxglove-keys-left-out", severity="warning", keys=found, shown=MOST_KEYS)


def _listen(config: FoxgloveConfig, context: Context, subscribers: Subscribers, name: str) -> WebSocketServer:
    from foxglove import start_server

    try:
        return start_server(
            name=f"station ({name})", host=config.host, port=config.port, capabilities=[], context=context,
            server_listener=cast(Any, subscribers), message_backlog_size=_BACKLOG,
        )  # fmt: skip
    except RuntimeError as error:  # the library's only word for an address that it does not get
        why = str(error).rpartition(": ")[2]
        raise StationError(
            f"host {config.host}, port {config.port}: cannot listen there: {why}; expected an address of this machine "
            "and a port that is free; choose others: --set host=127.0.0.1, --set port=0 for any free one"
        ) from error


def _run(config: FoxgloveConfig, life: Life, server: WebSocketServer, station: LiveStation) -> None:
    rate, next_look_s, was_lost = Rate(config.rate_hz, life.clock), 0.0, False
    try:
        while not life.stopping:
            if (now_s := life.clock.monotonic_s()) >= next_look_s:
                next_look_s = now_s + _LOOK_S
                station.look()
                life.report(**station.facts())
                if station.is_lost != was_lost:
                    was_lost = station.is_lost
                    _tell_bus(server, is_lost=was_lost)
            station.step()
            rate.wait(life.stop_event)
    finally:
        station.close()


def _tell_bus(server: WebSocketServer, *, is_lost: bool) -> None:
    """Tell every client that what it sees stands still, and when it does no more."""
    from foxglove import StatusLevel

    if is_lost:
        server.publish_status("the bus of the station does not answer; what is shown is old", StatusLevel.Warning, _BUS)
    else:
        server.remove_status([_BUS])
