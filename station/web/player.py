"""``python -m station.web.player FOLDER SOCKET``: plays an episode to one page, apart from what is live.

Orders come as lines of JSON and frames leave over one socket, with which it ends. Of each feed one frame is under way
until the page says that it has used it, so nothing queues up anywhere. What is shown at an instant is the newest that
had arrived at the recorder by then, as on the live page.
"""

from __future__ import annotations

import contextlib
import math
import os
import queue
import resource
import socket
import struct
import sys
import threading
from collections.abc import Callable, Collection, Iterator
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np

from station.bus.sample import Sample
from station.clock import SYSTEM
from station.episode.reading import frames, steps
from station.episode.reading.messages import Message
from station.episode.reading.reader import EpisodeReader, open_episode
from station.errors import EpisodeError, StationError
from station.printable import printable
from station.protocols import Floats
from station.view import phases
from station.web.drawn_robot import DrawnRobot, packed
from station.web.feeds import Frame

PLAY, EPISODE, SCENE, ROBOT, CAMERA = "play", "play:episode", "play:scene", "play:robot", "play:camera:"
"""Feeds of a player: how it stands, what the episode is, how its robot is drawn, where that is, what a camera saw."""

HEAD = struct.Struct("<II")
"""In front of a frame: how long is what is said of it, and how long are its bytes."""

MOST_CAMERAS, MOST_ROBOTS, MOST_LISTED = 8, 8, 300
_ROW_NS, _ROWS_NS = round(1e9 / 30), round(20e9)  # of the joints so often; after a jump from so long before
_PICTURES_NS = round(5e9)  # a picture that is older than this where one goes to is not looked for
_STEP_S, _BEAT_S, _LONGEST_STEP_S = 1 / 30, 1.0, 0.25
_GATHER_S = 0.005  # for orders that come together
_LONGEST_S, _BEYOND_S = 30 * 86400.0, 60.0
_LARGEST_PICTURE, _LARGEST_VALUE = 8_000_000, 1 << 20  # bytes; a page takes no larger picture
_MEMORY = 4 << 30  # bytes of address space
_NICENESS = 12
_TEXT = 300


class Order(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What a page wants of its player; what is left out stays as it is.

    Attributes:
        number: Of the order; a page sees by it which one a frame came after.
        time_s: Go there, from the start of the episode [s].
        is_playing: Whether it plays.
        speed: How fast, 1 as it was.
        robot: Which of its robots is shown.
        got: The feed of which a frame was used.
    """

    number: int | None = None
    time_s: float | None = None
    is_playing: bool | None = None
    speed: Annotated[float, msgspec.Meta(ge=0.25, le=4.0)] | None = None
    robot: str | None = None
    got: str | None = None


class Cursor:
    """The newest value of some keys at an instant of an episode; the instant moves on, or elsewhere.

    Args:
        reader: The episode, whose files are finished.
        topics: The keys.
        largest: Larger values are passed over [bytes].

    Attributes:
        topics: As above.
        latest: The values, by key.
    """

    def __init__(self, reader: EpisodeReader, topics: Collection[str], largest: int) -> None:
        self._reader, self.topics, self._largest = reader, frozenset(topics), largest
        self.latest: dict[str, Sample] = {}
        self._messages: Iterator[Message] = iter(())
        self._next: Message | None = None

    def begin(self, at_ns: int) -> None:
        """Know nothing but what comes from about an instant on [ns].

        Raises:
            EpisodeError: a file is damaged there.
        """
        self.latest, self._next = {}, None
        self._messages = self._reader.messages_from(self.topics, at_ns)
        self._next = next(self._messages, None)

    def advance(self, to_ns: int) -> None:
        """Move on to an instant [ns].

        Raises:
            EpisodeError: a file is damaged there.
        """
        while (message := self._next) is not None and message.log_ns <= to_ns:
            self._next = None  # where the next one cannot be read
            if message.channel.is_deletion:
                self.latest.pop(message.topic, None)
            elif len(message.data) <= self._largest:
                self.latest[message.topic] = Sample(message.topic, message.data, None, message.log_ns)
            self._next = next(self._messages, None)


class Player:
    """Plays an episode: `step` is called some thirty times a second, and gives the frames that are due.

    Args:
        reader: The episode.
        now_s: Now, on the monotonic clock [s].

    Attributes:
        start_s, length_s: From the first message, which may lie before the start, to the last instant [s].

    Raises:
        EpisodeError: it cannot be played; says in a line why.
    """

    def __init__(self, reader: EpisodeReader, now_s: float) -> None:
        self._reader, self._stepped_s = reader, now_s
        if reader.is_active:
            raise EpisodeError(f"it was never finished; make it whole: station episodes repair {reader.folder}")
        self.start_s, self.length_s = _span_s(reader)
        self._robots = steps.robots_of(reader)[:MOST_ROBOTS]
        self._cameras = dict(list(frames.cameras(reader).items())[:MOST_CAMERAS])
        self._pictures = Cursor(reader, self._cameras.values(), _LARGEST_PICTURE)
        self._time_s, self._speed, self._is_playing = max(0.0, self.start_s), 1.0, False
        self._number, self._note = 0, ""
        self._jumps, self._is_elsewhere = 0, True
        self._rows_to_ns = 0  # up to which instant a page knows the joints
        self._under_way: set[str] = set()
        self._shown: dict[str, object] = {}  # by feed, what its newest frame was made of
        self._told_s = -math.inf
        self._choose(phases.robot_of(reader) or next(iter(self._robots), ""))

    @property
    def is_playing(self) -> bool:
        """Whether time goes on."""
        return self._is_playing

    def obey(self, order: Order) -> None:
        """Do what a page wants."""
        if order.got is not None:
            self._under_way.discard(order.got)
        if order.number is not None:
            self._number = order.number
        if order.speed is not None:
            self._speed = float(order.speed)
        if order.robot is not None and order.robot != self._robot.name and order.robot in self._robots:
            self._choose(order.robot)
        if order.is_playing is not None:
            is_over = self._time_s >= self.length_s and not self._is_playing
            self._is_playing = order.is_playing
            if order.is_playing and is_over and order.time_s is None:
                self._go_to(max(0.0, self.start_s))
        if order.time_s is not None and math.isfinite(order.time_s):
            self._go_to(order.time_s)

    def step(self, now_s: float) -> list[Frame]:
        """Let time go on; return the frames that are due and whose feeds are free."""
        elapsed_s = min(max(0.0, now_s - self._stepped_s), _LONGEST_STEP_S)  # a slow disk is waited for
        self._stepped_s = now_s
        if self._is_playing:
            self._time_s = min(self.length_s, self._time_s + elapsed_s * self._speed)
            self._is_playing = self._time_s < self.length_s
        found: list[Frame] = []
        try:
            self._move()
            if self._signals.topics:
                found += self._due(ROBOT, (self._robot.name, self._jumps, self._at_ns), self._robot_frame)
            for name, key in self._cameras.items():
                if (sample := self._pictures.latest.get(key)) is not None:
                    found += self._due(f"{CAMERA}{name}", sample, partial(self._picture, name, sample))
        except EpisodeError as error:
            self._note, self._is_playing = printable(str(error), _TEXT), False
        found += self._due(EPISODE, self._reader, self._episode)
        found += self._due(SCENE, self._robot, self._scene)
        if now_s - self._told_s >= _BEAT_S:  # so that a page knows that it is there
            self._shown.pop(PLAY, None)
        if state := self._due(PLAY, self._state(), self._state):
            self._told_s = now_s
        return [*state, *found]

    @property
    def _at_ns(self) -> int:
        return self._reader.start_ns + round(self._time_s * 1e9)

    def _choose(self, robot: str) -> None:
        recorded = [contract for contract in self._reader.recorded.values() if contract is not None]
        servers = self._reader.manifest.servers.values()
        self._robot = DrawnRobot(robot, self._reader.known, servers, recorded)
        topics = self._robot.keys & self._reader.recorded.keys() if robot else frozenset[str]()
        self._signals = Cursor(self._reader, topics, _LARGEST_VALUE)
        self._is_elsewhere = True

    def _go_to(self, time_s: float) -> None:
        self._time_s, self._note, self._is_elsewhere = min(max(time_s, self.start_s), self.length_s), "", True

    def _move(self) -> None:
        """Have both cursors where time is; after a jump the one of the joints begins before it."""
        at_ns = self._at_ns
        if self._is_elsewhere or at_ns - self._rows_to_ns > _ROWS_NS:
            self._is_elsewhere, self._jumps = False, self._jumps + 1
            self._rows_to_ns = at_ns - _ROWS_NS
            self._signals.begin(self._rows_to_ns)
            self._pictures.begin(at_ns - _PICTURES_NS)
        self._pictures.advance(at_ns)

    def _due(self, feed: str, made_of: object, make: Callable[[], tuple[dict[str, Any], bytes]]) -> list[Frame]:
        """Return a frame of a feed that is free, where what it is made of is not what the last one was made of."""
        if feed in self._under_way or self._shown.get(feed) == made_of:
            return []
        facts, payload = make()
        self._shown[feed] = made_of
        self._under_way.add(feed)
        return [Frame({"f": feed, **facts}, payload, 0.0)]

    def _state(self) -> tuple[dict[str, Any], bytes]:
        taken = {name: self._seconds(self._pictures.latest.get(key)) for name, key in self._cameras.items()}
        return {
            "number": self._number, "time_s": self._time_s, "is_playing": self._is_playing, "speed": self._speed,
            "robot": self._robot.name, "note": self._note, "pictures": taken,
        }, b""  # fmt: skip

    def _seconds(self, sample: Sample | None) -> float | None:
        """Return when a value arrived, from the start of the episode [s]."""
        return None if sample is None else ((sample.arrived_ns or 0) - self._reader.start_ns) * 1e-9

    def _episode(self) -> tuple[dict[str, Any], bytes]:
        manifest = self._reader.manifest
        told = [(event.at_s, event.name, event.severity) for event in manifest.events[:MOST_LISTED]]
        told += [(mark.at_s, f"mark {mark.label}".rstrip(), "mark") for mark in manifest.marks[:MOST_LISTED]]
        listed = sorted((at_s, text, kind) for at_s, text, kind in told if self.start_s <= at_s <= self.length_s)
        found = {
            "start_s": self.start_s, "length_s": self.length_s, "robots": self._robots, "cameras": list(self._cameras),
            "events": [{"at_s": at_s, "text": printable(text, 80), "kind": kind} for at_s, text, kind in listed],
        }  # fmt: skip
        return {}, msgspec.json.encode(found)

    def _scene(self) -> tuple[dict[str, Any], bytes]:
        if not self._robot.name:
            return {}, msgspec.json.encode({"robot": "", "note": "no robot in this episode"})
        return {"robot": self._robot.name}, msgspec.json.encode(self._robot.scene())

    def _robot_frame(self) -> tuple[dict[str, Any], bytes]:
        """Return where it is, and behind that a row for each instant since the last frame.

        A row, float32: time before the frame's [s], which of its gates, place of the root [m], joints measured, asked.
        """
        at_ns, robot, latest = self._at_ns, self._robot, self._signals.latest.get
        gates: dict[str, int] = {}
        rows: list[Floats] = []
        for instant_ns in (*range(self._rows_to_ns + _ROW_NS, at_ns, _ROW_NS), at_ns):
            self._signals.advance(instant_ns)
            seen = robot.seen(latest)
            if seen.where is not None:
                head = [(instant_ns - at_ns) * 1e-9, gates.setdefault(seen.gate, len(gates)), *seen.where.root[0, :2]]
                rows.append(np.concatenate([head, robot.joints(seen)]))
        self._rows_to_ns = at_ns
        facts, payload = robot.drawn(seen)
        told = {"robot": robot.name, "time_s": self._time_s, "jump": self._jumps, "rows": len(rows),
                "gates": list(gates)}  # fmt: skip
        return {**facts, **told}, payload + packed(np.array(rows, dtype=np.float64))

    def _picture(self, name: str, sample: Sample) -> tuple[dict[str, Any], bytes]:
        return {"camera": name, "taken_s": self._seconds(sample), "media": "image/jpeg"}, sample.value


def _span_s(reader: EpisodeReader) -> tuple[float, float]:
    """Return the first and the last instant of an episode, by its chunks and its manifest [s].

    Raises:
        EpisodeError: it holds nothing, or its times cannot be.
    """
    chunks = [place for part in reader.parts for place in part.contents.chunks]
    if not chunks:
        raise EpisodeError("it holds no messages")
    first_s = (min(place.start_ns for place in chunks) - reader.start_ns) * 1e-9
    last_s = (max(place.end_ns for place in chunks) - reader.start_ns) * 1e-9
    if not -_LONGEST_S < first_s <= last_s < _LONGEST_S:
        raise EpisodeError(f"its times cannot be: from {first_s:.3g} s to {last_s:.3g} s after its start")
    said_s = reader.manifest.timing.duration_s
    is_sound = reader.torn is None and said_s is not None and 0 < said_s < last_s + _BEYOND_S
    return min(0.0, first_s), max(0.0, said_s if is_sound and said_s is not None else last_s)


def main(folder: str, stream: socket.socket) -> int:
    """Play an episode over a socket until that closes; return the exit code."""
    orders: queue.Queue[Order | None] = queue.Queue()
    threading.Thread(target=_hear, args=(stream, orders), daemon=True).start()
    try:
        player = Player(open_episode(Path(folder)), SYSTEM.monotonic_s())
        while True:
            for frame in player.step(SYSTEM.monotonic_s()):
                send(stream, frame)
            if not _obeyed(player, orders):
                return 0
    except OSError as error:
        if isinstance(error, ConnectionError):  # nobody looks on any more
            return 0
        text = f"it cannot be read: {error.strerror or error}"
    except StationError as error:
        text = str(error)
    except MemoryError:
        text = f"it needs more than {_MEMORY >> 30} GB of memory"
    with contextlib.suppress(OSError):
        send(stream, Frame({"f": PLAY, "error": printable(text, _TEXT)}, b"", 0.0))
        while orders.get() is not None:  # whoever wrote to one that is gone would not read its last words
            pass
    return 1


def _obeyed(player: Player, orders: queue.Queue[Order | None]) -> bool:
    """Wait for the next step, and pass on what came until then; return whether there is still somebody there."""
    until_s = SYSTEM.monotonic_s() + (_STEP_S if player.is_playing else _BEAT_S)
    with contextlib.suppress(queue.Empty):
        while (wait_s := until_s - SYSTEM.monotonic_s()) > 0:
            if (order := orders.get(timeout=wait_s)) is None:
                return False
            player.obey(order)
            if not player.is_playing:
                until_s = min(until_s, SYSTEM.monotonic_s() + _GATHER_S)
    return True


def _hear(stream: socket.socket, orders: queue.Queue[Order | None]) -> None:
    with contextlib.suppress(OSError, msgspec.ValidationError), stream.makefile("rb") as lines:
        for line in lines:
            orders.put(msgspec.json.decode(line, type=Order))
    orders.put(None)


def send(stream: socket.socket, frame: Frame) -> None:
    """Send a frame: lengths of what is said of it and of its bytes, and both."""
    facts = msgspec.json.encode(frame.facts)
    stream.sendall(HEAD.pack(len(facts), len(frame.payload)) + facts + frame.payload)


if __name__ == "__main__":
    os.nice(_NICENESS)
    resource.setrlimit(resource.RLIMIT_AS, (_MEMORY, _MEMORY))
    sys.exit(main(sys.argv[1], socket.socket(fileno=int(sys.argv[2]))))
