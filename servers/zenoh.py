"""The Zenoh bridge: keys of the bus for peers on Zenoh, and keys of theirs for the bus.

=========  ============================================================================================================
`publish`  patterns of keys of the bus: each write goes out under the key's own name, byte for byte, with the stamp of
           the bus as its attachment; of several writes before a look the newest
`accept`   keys, by name, that are written to the bus as they come; one that a contract describes has to hold what that
           says. The sender's stamp is read for its age and its count; the write's own is this server's.
=========  ============================================================================================================

Zenoh has no authentication here: it listens on this computer alone, finds nobody by itself, and keys that command the
station itself (``station:…``) are never accepted. What a value holds is never run, and never unpacked.
"""

from __future__ import annotations

import contextlib
import fnmatch
import functools
import math
import re
import threading
from collections import Counter, deque
from collections.abc import Callable, Collection, Iterator
from typing import TYPE_CHECKING, Any

import msgspec

from adapters.pauses import Pauses
from station import libraries
from station.bus import codec, keys, stamp
from station.bus.address import is_loopback
from station.bus.contracts import Contracts
from station.bus.sample import Sample
from station.bus.watch import Watch
from station.config import to_plain
from station.control.foreign_commander import ForeignCommander
from station.control.foreign_stream import Arrived, Dropped, ForeignStream, why_not_as_described
from station.errors import BusError, StationError
from station.life.server import Life, ServerKind

if TYPE_CHECKING:
    import zenoh

ENDPOINT = "tcp/127.0.0.1:7447"
"""Zenoh's own port."""

MOST_BYTES = 4 << 20
"""Of a value that is accepted."""

MOST_KEYS = 500
"""Keys that are published: a client of the bus that invents keys must not fill the memory."""

_LOOK_S = 0.5  # how long a new key stays unseen
_WAITING = 1000  # values that wait to be written; then the newest are dropped
_MOST_READ = 200
_LONGEST_STAMP = 512
_CLOSED_S = 2.0
_MOST_SKIPPED = 1_000_000  # at once; a stamp that says more is no writer's count
_ENDPOINT = re.compile(r"tcp/([A-Za-z0-9_.-]+|\[[0-9a-fA-F:]+\]):([0-9]{1,5})")
_KEY = re.compile(r"[A-Za-z0-9_.:-]+(/[A-Za-z0-9_.:-]+)*")


class ZenohConfig(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Configuration of the Zenoh bridge.

    Attributes:
        publish: Keys of the bus that go out, with ``*`` for any letters: ``robot_state_*``.
        accept: Keys, by name, that come in.
        listen: Where it listens, ``tcp/HOST:PORT``; "" for nowhere.
        connect: Peers or routers that it connects to, and reconnects to.
    """

    publish: tuple[str, ...] = ()
    accept: tuple[str, ...] = ()
    listen: str = ENDPOINT
    connect: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not self.publish and not self.accept:
            raise ValueError("publish and accept are empty: nothing would pass; name keys, such as robot_state_*")
        if not self.listen and not self.connect:
            raise ValueError(f"listen and connect are empty: nobody would be met; expected one, such as {ENDPOINT}")
        for name, endpoint in (*(("connect", each) for each in self.connect), ("listen", self.listen or ENDPOINT)):
            found = _ENDPOINT.fullmatch(endpoint)
            if found is None or not 1 <= int(found.group(2)) <= 65535:
                raise ValueError(f"{name} is {endpoint!r}; expected an endpoint such as {ENDPOINT}")
            if name == "listen" and found.group(1) in ("0.0.0.0", "[::]"):
                raise ValueError(f"listen is {endpoint}: that is every network; name the one address of this computer")
        for key in self.accept:
            if not _KEY.fullmatch(key) or keys.is_stamp(key):
                raise ValueError(f"accept: {key!r} is no key; expected names without patterns")
            if key.startswith("station:"):
                raise ValueError(f"accept: {key!r} commands the station itself, which no stranger may")


def main(config: ZenohConfig, life: Life) -> int:
    """Pass values on until asked to stop; return the exit code."""
    with contextlib.ExitStack() as stack:
        session = _open(config)
        stack.callback(_close, session, life)
        facts = {"publish": list(config.publish), "accept": list(config.accept), "config": to_plain(config)}
        life.configured({"server": life.name, "role": KIND.role, **facts})
        if not life.ready():
            return 0
        if config.listen and not is_loopback(config.listen.split("/")[1].rpartition(":")[0].strip("[]")):
            note = "everybody who reaches it hears what is published, and writes what is accepted"
            life.event("zenoh-open-to-network", severity="warning", listen=config.listen, note=note)
        incoming = Incoming(life, session, config)
        if config.publish:
            outgoing = Outgoing(life, session, config.publish)
            stack.callback(outgoing.close)
        incoming.run()
    return 0


KIND = ServerKind(
    name="zenoh",
    role="command",
    summary="keys of the bus for peers on Zenoh, and theirs for the bus",
    config=ZenohConfig,
    main=main,
    expect=lambda config: libraries.expect("the Zenoh bridge", "eclipse-zenoh", "zenoh"),
)


def _open(config: ZenohConfig) -> zenoh.Session:
    import zenoh

    made = zenoh.Config()
    listen = [config.listen] if config.listen else []
    for name, value in {
        "mode": "peer",
        "listen/endpoints": listen,
        "connect/endpoints": list(config.connect),
        "connect/timeout_ms": -1,  # who is not there yet is tried again, for ever, and nothing waits for that
        "connect/exit_on_failure": False,
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "transport/shared_memory/enabled": False,  # its files stay where a process is killed
    }.items():
        made.insert_json5(name, msgspec.json.encode(value).decode())
    try:
        return zenoh.open(made)
    except zenoh.ZError as error:
        why = str(error).partition(" at /")[0]
        raise StationError(
            f"Zenoh: {why}; expected an address of this computer and a port that is free: --set listen={ENDPOINT}"
        ) from None


def _close(session: Any, life: Life) -> None:
    """Close a session; where the library does not come back from that the server ends all the same."""
    closing = life.clock.start(session.close, "zenoh-close")
    life.clock.join(closing, _CLOSED_S)
    if closing.is_alive():
        life.event("zenoh-not-closed", severity="warning", reason=f"not within {_CLOSED_S:g} s")


class Incoming:
    """Writes to the bus what comes on accepted keys.

    Args:
        life: The server's.
        session: Of Zenoh.
        config: The server's.
    """

    def __init__(self, life: Life, session: zenoh.Session, config: ZenohConfig) -> None:
        self._life, self._clock = life, life.clock
        self._contracts, self._described_s = Contracts(), -math.inf
        self._contract_of = {key: self._contracts.get(key) for key in config.accept}
        # No queue: one that is woken by each value has woken late for the last. Nor a SimpleQueue: its `get` with a
        # time waits for ever where a signal comes as that time ends (CPython 3.11).
        self._waiting, self._none_waits = deque[tuple[str, bytes, bytes]](), threading.Lock()
        self._pauses, self._not_for_us = Pauses(life.clock), Counter[str]()
        self._counts: dict[str, tuple[str, int]] = {}
        self._missing = 0
        self._streams = [
            ForeignStream(("zenoh", "key"), key, self._checked(key), then=f"nothing is written on {key}")
            for key in config.accept
        ]
        on_sample = _at_once(self._on_sample)
        self._subscribers = [session.declare_subscriber(key, on_sample) for key in config.accept]

    def run(self) -> None:
        """Write until asked to stop."""
        streams: list[tuple[ForeignStream, tuple[str, ...]]] = [(stream, ()) for stream in self._streams]
        ForeignCommander(self._life, "zenoh", "key", streams, self._receive, self._not_for_us).run()

    def _on_sample(self, sample: zenoh.Sample) -> None:
        """Keep a value; called by the library's threads."""
        if len(self._waiting) >= _WAITING:
            self._not_for_us["too many at once"] += 1
            return
        attachment = sample.attachment
        mark = b"" if attachment is None else attachment.to_bytes()
        self._waiting.append((str(sample.key_expr), sample.payload.to_bytes(), mark[: _LONGEST_STAMP + 1]))
        with contextlib.suppress(RuntimeError):  # another value has said so
            self._none_waits.release()

    def _receive(self, timeout_s: float) -> Iterator[tuple[str, Arrived]]:
        self._describe()
        self._pauses.begin()
        self._none_waits.acquire(timeout=0.0 if self._waiting else timeout_s)
        self._pauses.end(timeout_s)
        for _ in range(min(len(self._waiting), _MOST_READ)):
            yield self._arrived(*self._waiting.popleft())
        self._pauses.done(is_empty=not self._waiting)

    def _arrived(self, key: str, value: bytes, attachment: bytes) -> tuple[str, Arrived]:
        """Return a value and when it came; by a stamp of this machine's clock, when it was written."""
        came_s, sender = self._pauses.came_s(), "a peer without stamps"
        mark = stamp.decode(attachment) if 0 < len(attachment) <= _LONGEST_STAMP else None
        if mark is not None:
            sender = mark.writer
            if mark.is_from_this_boot:
                came_s = min(came_s, mark.mono_ns * 1e-9)
            source, number = self._counts.get(key, ("", 0))
            if source == mark.source and 0 < mark.seq - number - 1 < _MOST_SKIPPED:
                self._missing += mark.seq - number - 1
            self._counts[key] = mark.source, mark.seq
        return key, Arrived(value, sender, came_s)

    def _describe(self) -> None:
        """Take up what servers state of their robots' keys, and tell what never came, now and then."""
        if (now_s := self._clock.monotonic_s()) - self._described_s < _LOOK_S or not self._streams:
            return
        self._described_s = now_s
        self._life.report(missing=self._missing)
        with contextlib.suppress(BusError):  # the bus itself says so in the log
            names = self._life.bus.names(keys.CONFIG_PREFIX + "*")
            for sample in self._life.bus.read(names).values():
                self._contracts.add_facts(codec.parse_facts(sample.value))
        self._contract_of = {key: self._contracts.get(key) for key in self._contract_of}

    def _checked(self, key: str) -> Any:
        """Return what makes a write of a value of a key."""

        def write(value: bytes, _: float) -> dict[str, bytes] | Dropped:
            if len(value) > MOST_BYTES:
                return Dropped("too-long", f"{len(value)} bytes, expected at most {MOST_BYTES}")
            contract = self._contract_of[key]
            return (None if contract is None else why_not_as_described(value, contract)) or {key: value}

        return write


class Outgoing:
    """Publishes what is written on the bus, in the thread of its watch; looks for new keys in one of its own.

    Args:
        life: The server's.
        session: Of Zenoh.
        patterns: Of the keys.
    """

    def __init__(self, life: Life, session: zenoh.Session, patterns: tuple[str, ...]) -> None:
        import zenoh

        self._error: type[Exception] = zenoh.ZError
        self._blocks = zenoh.CongestionControl.BLOCK
        self._life, self._session, self._clock = life, session, life.clock
        self._wanted = re.compile("|".join(fnmatch.translate(pattern) for pattern in patterns))
        self._publishers: dict[str, zenoh.Publisher] = {}
        self._matched: set[str] = set()  # keys that somebody subscribes to
        self._matching: list[object] = []  # what tells of that, as long as it is kept
        self._last: dict[str, Sample] = {}
        self._sent, self._dropped = 0, Counter[str]()
        self._age_s: float | None = None
        self._is_heard = False
        self._closed, self._turn, self._matches = threading.Event(), threading.Lock(), threading.Lock()
        self._watch: Watch | None = None
        self._thread = self._clock.start(life.guarded(self._run), "zenoh-out")

    def close(self) -> None:
        """Publish no more."""
        self._closed.set()
        self._clock.join(self._thread, _CLOSED_S)

    def _run(self) -> None:
        while True:
            self._look()
            self._tell()
            if self._clock.wait(self._closed, _LOOK_S):
                break
        if self._watch is not None:
            self._watch.close()

    def _look(self) -> None:
        """Take up keys that are new, and watch them too."""
        try:
            names = self._life.bus.names()
        except BusError:
            return
        before = self._watch
        with self._turn:  # of what is written meanwhile the new watch tells alone, so that it goes out once
            count = len(self._publishers)
            self._declare(names)
            if len(self._publishers) == count:
                return
            wanted, pass_on = sorted(self._publishers), self._life.guarded(self._pass_on)
            self._watch = self._life.bus.watch(wanted, on_change=pass_on)
        if before is not None:
            before.close()

    def _declare(self, names: list[str]) -> None:
        for key in names:
            if key in self._publishers or not self._wanted.match(key):
                continue
            if len(self._publishers) >= MOST_KEYS:
                self._dropped["more keys than are published"] += 1
                break
            with contextlib.suppress(self._error):  # a name that Zenoh does not allow
                publisher = self._session.declare_publisher(key, congestion_control=self._blocks)
                match = functools.partial(self._match, key, publisher)
                self._matching.append(publisher.declare_matching_listener(_at_once(match)))
                match()
                self._publishers[key] = publisher

    def _match(self, key: str, publisher: Any, _: object = None) -> None:
        """Record whether anybody subscribes to a key; the library says it as an object, its type as a flag."""
        with self._matches:  # so that who comes last has read it last
            status = publisher.matching_status
            (self._matched.add if getattr(status, "matching", status) else self._matched.discard)(key)

    def _pass_on(self, changed: Collection[str]) -> None:
        """Publish what is new of some keys."""
        with self._turn:
            if (watch := self._watch) is None:
                return
            for key in changed:
                if (sample := watch.latest(key)) is not None:
                    self._publish(key, sample)

    def _publish(self, key: str, sample: Sample) -> None:
        last, mark = self._last.get(key), sample.stamp
        if sample is last:
            return
        self._last[key] = sample
        if sample.arrived_ns is None:  # of before we looked: nobody knows how old it is
            return
        if last is not None and mark is not None and last.stamp is not None and mark.source == last.stamp.source:
            missing = mark.seq - last.stamp.seq - 1
            self._dropped["overwritten"] += missing if 0 < missing < _MOST_SKIPPED else 0
        if mark is not None and mark.source == self._life.bus.source:
            return  # what came in does not go out again
        if key not in self._matched:
            self._dropped["nobody hears it"] += 1
            return
        try:
            self._publishers[key].put(sample.value, attachment=None if mark is None else mark.encode())
        except self._error:
            self._dropped["Zenoh refused it"] += 1
            return
        self._sent += 1
        written_ns = sample.written_ns or sample.arrived_ns
        self._age_s = None if written_ns is None else (self._clock.monotonic_ns() - written_ns) * 1e-9

    def _tell(self) -> None:
        is_heard = bool(self._matched)
        if is_heard != self._is_heard:
            self._is_heard = is_heard
            self._life.event("zenoh-heard" if is_heard else "zenoh-not-heard", keys=len(self._publishers))
        self._life.report(
            published={
                "keys": len(self._publishers), "sent": self._sent, "dropped": dict(self._dropped), "heard": is_heard,
                "age_ms": None if self._age_s is None else round(self._age_s * 1e3, 2),
            }
        )  # fmt: skip


def _at_once(act: Callable[[Any], None]) -> Any:
    """Have something called in the library's thread that reads; else each key has one of its own, which is woken."""
    from zenoh.handlers import Callback

    return Callback(act, indirect=False)
