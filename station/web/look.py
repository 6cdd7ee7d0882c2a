"""What a page is told of a station: read from the bus some thirty times a second, in plain values, each with its age.

Nothing here waits for a page, and nothing of the station waits for this. A bus that is gone leaves what was known, with
ages that grow.
"""

from __future__ import annotations

import contextlib
from collections import deque
from collections.abc import Callable, Collection, Iterable, Mapping
from typing import Any

import msgspec

from station import registry
from station.bus import clocks, codec, keys
from station.bus import stamp as stamps
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.bus.contracts import Contracts
from station.bus.sample import Sample
from station.bus.stamp import Stamp
from station.bus.watch import Watch
from station.episode.storage.request import RecorderState
from station.errors import BusError, StationError, UnknownName
from station.life import estop, runbook_request, stop_file
from station.life.event_feed import EventFeed
from station.life.events import Event
from station.life.server import Health, decode_health
from station.printable import printable
from station.web.drawn_robot import DrawnRobot
from station.web.feeds import Frame

MOST_KEYS, MOST_EVENTS, MOST_SERVERS, MOST_ROBOTS = 500, 50, 100, 8
"""That a page is told of: a client of the bus may invent more."""

FROZEN_S = 0.5
"""Age from which on a picture is said to be frozen [s]."""

_LOOK_S, _COUNT_S, _ASK_S = 0.5, 1.0, 0.2
_LINKED_S = 0.5  # since the bus last answered
_LONGEST = 300  # characters of a text from the bus
_STOP = "stop"  # level of an alarm that says that robots were stopped; to a page it is an error
_LEVELS = {_STOP: "error"}
_GATES_TOLD = ("holding", "returning", "stopped")
_MOST_STEPS = 200  # of a runbook
_LARGEST_JSON = 2000  # of a server's own words


class Look:
    """Reads a bus; `step` is called at any rate, by one thread.

    Args:
        address: The bus.
        name: Under which it reads.

    Raises:
        BusError: the bus cannot be reached.
    """

    def __init__(self, address: BusAddress, name: str) -> None:
        self.bus = Bus(address, name=name, timeout_s=0.25)
        self.clock = self.bus.clock
        self._contracts = Contracts()
        self._stated: dict[str, bytes] = {}
        self._facts: list[dict[str, Any]] = []
        self._health: list[Health] = []
        self._names: list[str] = []
        self._robots: dict[str, tuple[str, bytes, DrawnRobot]] = {}  # by name: server, what it stated, how it is drawn
        self._watch: Watch | None = None
        self._watched: frozenset[str] = frozenset()
        self._pictures: dict[str, Sample] = {}
        self._counts: dict[str, tuple[float, Stamp, float]] = {}  # of a key: when, its stamp then, rate [Hz]
        self._ahead_ns: dict[str, int] = {}
        self._feed = EventFeed(self.bus)
        self._events: deque[Event] = deque(maxlen=MOST_EVENTS)
        self._next_look_s = self._next_count_s = self._next_ask_s = 0.0
        self._answered_s = self.clock.monotonic_s()
        self._is_there = True
        self._alarms: dict[str, float] = {}  # text of an alarm, and since when it stands

    def step(self, wanted: Collection[str]) -> dict[str, Frame]:
        """Read what is new; return the frames of those feeds that are wanted and have one."""
        is_there, now_s = self._ask_bus(), self.clock.monotonic_s()
        if is_there and now_s >= self._next_look_s:
            self._next_look_s = now_s + _LOOK_S
            self._read(self._look_around)
        if is_there and now_s >= self._next_count_s:
            self._next_count_s = now_s + _COUNT_S
            self._read(lambda: self._count(now_s))
        self._follow(wanted)
        frames = {}
        for _, _, robot in self._robots.values():
            if robot.feed in wanted and (frame := robot.frame(self._latest, now_s)) is not None:
                frames[robot.feed] = frame
        for key in self._watched:
            if key.startswith(keys.camera_image("")) and (found := self._picture(key, now_s)) is not None:
                frames[found.facts["f"]] = found
        return frames

    def new_events(self) -> list[Event]:
        """Return the events that came since the last call."""
        found = list(self._feed.pop())
        self._events.extend(found)
        return found

    @property
    def events(self) -> list[Event]:
        """The last events, oldest first."""
        return list(self._events)

    def robot(self, name: str) -> DrawnRobot | None:
        """Return how a robot is drawn; None for one that is not there."""
        found = self._robots.get(name)
        return None if found is None else found[2]

    def close(self) -> None:
        """Read the bus no more."""
        self._feed.close()
        if self._watch is not None:
            self._watch.close()
        self.bus.close()

    def urgent(self) -> tuple[object, ...]:
        """Return what a page must be told of at once: it differs where that does."""
        gates = [_gate(self._latest(keys.command_gate(name))) for name in self._robots]
        recorder = self._latest(keys.RECORDER)
        recording = recorder is not None and b'"recording"' in recorder.value[:40]
        stops = [self._latest(key) for key in estop.KEYS]
        return (*gates, recording, *stops, self._latest(keys.RUNBOOK), self._is_linked(self.clock.monotonic_s()))

    # -- Whole states ---------------------------------------------------------------------------------------------
    def state(self) -> dict[str, Any]:
        """Return how the station is doing, in plain values."""
        now_s, now_wall_ns = self.clock.monotonic_s(), self.clock.wall_ns()
        bus, stop = self._bus_state(now_s), self._stop(now_wall_ns)
        robots, recorder = [self._robot_state(name, now_s) for name in self._robots], self._recorder()
        servers, cameras = [_server(health, now_wall_ns) for health in self._health], self._cameras(now_wall_ns)
        alarms = self._with_since(_alarms(bus, stop, robots, recorder, servers, cameras), now_s)
        return {
            "bus": bus, "stop": stop, "robots": robots, "recorder": recorder, "cameras": cameras, "servers": servers,
            "alarms": alarms, "runbook": self._runbook(),
        }  # fmt: skip

    def keys_table(self) -> list[dict[str, Any]]:
        """Return the keys of the bus: what each is to a station, its writer, rate and age."""
        now_wall_ns, found = self.clock.wall_ns(), []
        for key in self._names[:MOST_KEYS]:
            known, counted = self._contracts.get(key), self._counts.get(key)
            mark = None if counted is None else counted[1]
            found.append({
                "key": printable(key, _LONGEST), "role": known.role if known else "unknown",
                "writer": printable(mark.writer, 60) if mark else "foreign",
                "rate_hz": None if counted is None else round(counted[2], 1),
                "age_s": None if mark is None else self._age_s(mark, now_wall_ns),
            })  # fmt: skip
        return found

    def _bus_state(self, now_s: float) -> dict[str, Any]:
        age_s = self._silent_s(now_s)
        is_linked = age_s < _LINKED_S
        reason = "" if is_linked else (self.bus.last_error or "the bus does not answer")
        return {"linked": is_linked, "age_s": round(min(age_s, 1e6), 3), "address": str(self.bus.address),
                "reason": printable(reason, _LONGEST)}  # fmt: skip

    def _silent_s(self, now_s: float) -> float:
        """Return the time since the bus last answered [s]."""
        return max(0.0, now_s - self._answered_s)

    def _is_linked(self, now_s: float) -> bool:
        return self._silent_s(now_s) < _LINKED_S

    def _stop(self, now_wall_ns: int) -> dict[str, Any] | None:
        found = stop_file.on_bus(self.bus.address, self._latest) or stop_file.StopFile(self.bus.address).read()
        if found is None:
            return None
        since_s = None if found.since_wall_ns is None else max(0.0, (now_wall_ns - found.since_wall_ns) * 1e-9)
        return {"reason": printable(found.reason, _LONGEST), "since_s": since_s, "remedy": found.remedy}

    def _robot_state(self, name: str, now_s: float) -> dict[str, Any]:
        server, stated, _ = self._robots[name]
        key = keys.command_gate(name)
        sample, counted = self._latest(key), self._counts.get(key)
        gate = {} if sample is None else codec.parse_facts(sample.value)
        health = next((each for each in self._health if each.name == server), None)
        age_s = None if sample is None or sample.arrived_ns is None else max(0.0, now_s - sample.arrived_ns * 1e-9)
        return {
            "name": name, "server": server, "state": health.state if health else "", "age_s": age_s,
            **{field: _text(gate.get(given)) for field, given in _OF_GATE},
            "is_real": not _is_simulated(codec.parse_facts(stated)),
            "rate_hz": None if counted is None else round(counted[2], 1),
            "detail": _modest(health.detail if health else {}),
        }  # fmt: skip

    def _recorder(self) -> dict[str, Any] | None:
        sample = self._latest(keys.RECORDER)
        if sample is None or not any(health.role == "recorder" and health.is_alive for health in self._health):
            return None
        try:
            told = codec.parse_struct(sample.value, RecorderState)
        except codec.BadValue:
            return None
        minutes = told.minutes_left
        return {
            "state": told.state, "episode": _text(told.episode_id), "path": _text(told.path),
            "messages": told.messages, "bytes": told.bytes, "dropped": told.dropped, "error": _text(told.error),
            "free_gb": None if told.free_mb is None else round(told.free_mb / 1e3, 1),
            "minutes_left": None if minutes is None else round(minutes, 1),
        }  # fmt: skip

    def _cameras(self, now_wall_ns: int) -> list[dict[str, Any]]:
        found = []
        for key in self._names:
            counted = self._counts.get(key)
            if not key.startswith(keys.camera_image("")) or counted is None or keys.is_stamp(key):
                continue
            sample = self._latest(key)
            mark = sample.stamp if sample is not None and sample.stamp is not None else counted[1]
            name = key.removeprefix(keys.camera_image(""))
            found.append(
                {"name": _text(name), "age_s": self._age_s(mark, now_wall_ns), "rate_hz": round(counted[2], 1)}
            )
        return found[:MOST_ROBOTS]

    def _runbook(self) -> dict[str, Any] | None:
        sample = self._latest(keys.RUNBOOK)
        try:
            found = None if sample is None else runbook_request.current(self.bus, sample)
        except BusError:
            return None
        return None if found is None else _readable(msgspec.to_builtins(found))

    def _with_since(self, told: Iterable[tuple[str, str]], now_s: float) -> list[dict[str, Any]]:
        levels = {text: level for level, text in told}
        self._alarms = {text: self._alarms.get(text, now_s) for text in levels}
        return [
            {
                "level": _LEVELS.get(levels[text], levels[text]),
                "is_stop": levels[text] == _STOP,
                "text": text,
                "since_s": round(now_s - since_s, 1),
            }
            for text, since_s in self._alarms.items()
        ]

    # -- Reading --------------------------------------------------------------------------------------------------
    def _latest(self, key: str) -> Sample | None:
        return None if self._watch is None else self._watch.latest(key)

    def _ask_bus(self) -> bool:
        """Ask whether the bus is there, a few times a second: its silence says nothing where nobody writes.

        Returns whether it answered the last time: one that does not is asked for nothing else, which would take longer.
        """
        if (now_s := self.clock.monotonic_s()) >= self._next_ask_s:
            self._next_ask_s = now_s + _ASK_S
            try:
                self.bus.call("PING")
            except BusError:
                self._is_there = False
            else:
                self._is_there, self._answered_s = True, self.clock.monotonic_s()
        return self._is_there

    def _read(self, read: Callable[[], None]) -> None:
        """Read something of the bus, which may take a while where there are thousands of keys, and is an answer."""
        with contextlib.suppress(BusError):  # the state says so; what was known stays
            read()
            self._answered_s = self.clock.monotonic_s()

    def _look_around(self) -> None:
        """Find the keys, the servers and what they state, and the robots."""
        self._names = [name for name in self.bus.names() if not keys.is_stamp(name)]
        own = [name for name in self._names if name.startswith((keys.CONFIG_PREFIX, keys.SERVER_PREFIX))]
        read = self.bus.read(own[: 2 * MOST_SERVERS])
        stated = {key: sample.value for key, sample in read.items() if key.startswith(keys.CONFIG_PREFIX)}
        told = (decode_health(sample.value) for key, sample in read.items() if key not in stated)
        health = [each for each in told if each is not None]
        elsewhere = {each.boot for each in health} - {stamps.boot_id()}
        ahead_ns = clocks.walls_ahead_ns(self.bus.call, elsewhere, self.clock)
        for each in health:
            each.wall_ns -= ahead_ns.get(each.boot, 0)
        self._health = sorted(health, key=lambda each: each.name)
        if stated != self._stated:
            self._stated, self._facts = stated, [codec.parse_facts(value) for value in stated.values()]
            self._contracts = Contracts(self._facts)
        self._find_robots()

    def _find_robots(self) -> None:
        driven = {health.name for health in self._health if health.role == "low-level" and health.state != "finalized"}
        found: dict[str, tuple[str, bytes, DrawnRobot]] = {}
        for key, value in self._stated.items():
            server, facts = key.removeprefix(keys.CONFIG_PREFIX), codec.parse_facts(value)
            name = facts.get("robot")
            if server not in driven or not isinstance(name, str) or len(found) >= MOST_ROBOTS:
                continue
            before = self._robots.get(name)
            is_same = before is not None and before[:2] == (server, value)
            found[name] = before if before is not None and is_same else (
                server, value, DrawnRobot(name, self._contracts, self._facts)
            )  # fmt: skip
        self._robots = found

    def _count(self, now_s: float) -> None:
        """Count writes by the stamps of the keys."""
        found = {}
        for name, mark in self.bus.stamps(self._names[:MOST_KEYS]).items():
            if mark is None:
                continue
            at_s, before, _ = self._counts.get(name, (now_s, mark, 0.0))
            written = mark.seq - before.seq if mark.source == before.source else 0
            rate_hz = max(0, written) / (now_s - at_s) if now_s > at_s else 0.0
            found[name] = now_s, mark, rate_hz
        self._counts = found
        elsewhere = {stamps.boot_of(mark.source) for _, mark, _ in found.values()} - {stamps.boot_id()}
        self._ahead_ns = dict(clocks.walls_ahead_ns(self.bus.call, elsewhere, self.clock))

    def _age_s(self, mark: Stamp, now_wall_ns: int) -> float:
        written_ns = mark.wall_ns - self._ahead_ns.get(stamps.boot_of(mark.source), 0)
        return round(max(0.0, (now_wall_ns - written_ns) * 1e-9), 3)

    def _follow(self, wanted: Collection[str]) -> None:
        """Watch what a state needs, and of robots and cameras those that somebody looks at."""
        watched = {keys.RECORDER, keys.RUNBOOK, *estop.KEYS}
        for name, (_, _, robot) in self._robots.items():
            watched.add(keys.command_gate(name))
            if robot.feed in wanted:
                watched |= robot.keys
        cameras = (name.removeprefix("camera:") for name in wanted if name.startswith("camera:"))
        watched |= {keys.camera_image(name) for name in cameras} & set(self._names)
        if watched == self._watched:
            return
        before, self._watch = self._watch, self.bus.watch(sorted(watched))
        self._watched = frozenset(watched)
        if before is not None:
            before.close()

    def _picture(self, key: str, now_s: float) -> Frame | None:
        sample = self._latest(key)
        if sample is None or self._pictures.get(key) is sample:
            return None
        self._pictures[key] = sample
        taken_ns = sample.written_ns or sample.arrived_ns
        rate_hz = self._counts[key][2] if key in self._counts else 0.0
        facts = {"f": f"camera:{key.removeprefix(keys.camera_image(''))}", "rate_hz": round(rate_hz, 1),
                 "media": "image/jpeg"}  # fmt: skip
        return Frame(facts, sample.value, now_s if taken_ns is None else taken_ns * 1e-9)


_OF_GATE = (("gate", "state"), ("reason", "reason"), ("arming", "arming"))


def _server(health: Health, now_wall_ns: int) -> dict[str, Any]:
    return {
        "name": _text(health.name), "role": health.role, "state": health.state, "reason": _text(health.reason),
        "rate_hz": health.rate_hz, "jitter_p99_ms": health.jitter_p99_ms, "is_alive": health.is_alive_at(now_wall_ns),
        "why_late": health.why_late,
        "age_s": round(max(0.0, (now_wall_ns - health.wall_ns) * 1e-9), 2), "host": _text(health.host),
    }  # fmt: skip


def _alarms(
    bus: Mapping[str, Any], stop: Mapping[str, Any] | None, robots: Iterable[Mapping[str, Any]],
    recorder: Mapping[str, Any] | None, servers: Iterable[Mapping[str, Any]], cameras: Iterable[Mapping[str, Any]],
) -> Iterable[tuple[str, str]]:  # fmt: skip
    """Yield level and words of all that a person has to know now, the worst first."""
    if not bus["linked"]:
        yield "error", f"the bus does not answer: {bus['reason']}"
    if stop is not None:
        yield _STOP, f"the emergency stop is latched ({stop['reason']})"
    for server in servers if bus["linked"] else ():  # else nothing is known of them
        if not server["is_alive"] and server["state"] != "finalized":
            yield "error", f"server {server['name']} is silent: it died, or it is frozen"
        elif server["state"] == "finalized" and server["reason"] not in ("", "stopped"):
            yield "error", f"server {server['name']} ended: {server['reason']}"
        elif server["is_alive"] and server["why_late"]:
            yield "warning", f"server {server['name']}: {server['why_late']}"
    for robot in robots:
        if robot["gate"] in _GATES_TOLD:
            why = f" ({robot['reason']})" if robot["reason"] else ""
            yield _STOP if robot["gate"] == "stopped" else "warning", f"robot {robot['name']} is {robot['gate']}{why}"
    yield from _recorder_alarms(recorder or {})
    for camera in cameras:
        if camera["age_s"] > FROZEN_S:
            yield "warning", f"camera {camera['name']}: the picture is frozen"


def _recorder_alarms(recorder: Mapping[str, Any]) -> Iterable[tuple[str, str]]:
    if recorder.get("error"):
        yield "error", f"the last episode ended by itself: {recorder['error']}"
    if recorder.get("dropped"):
        yield "error", f"the recorder dropped {recorder['dropped']} writes of this episode"
    if recorder.get("state") == "recording" and (recorder["minutes_left"] or _MANY) < _FEW_MINUTES:
        yield "warning", f"the disk is full in {recorder['minutes_left']:g} minutes"


class _Gate(msgspec.Struct):
    state: str = ""
    arming: str = ""


def _gate(sample: Sample | None) -> tuple[str, str]:
    try:
        found = codec.parse_struct(b"{}" if sample is None else sample.value, _Gate)
    except codec.BadValue:
        return "", ""
    return found.state, found.arming


_MANY, _FEW_MINUTES = 1e9, 10.0


def _text(value: object) -> str:
    return "" if value is None else printable(str(value)[: _LONGEST + 1], _LONGEST)


def _readable(told: Any) -> Any:
    """Return plain values with their texts made safe to print."""
    if isinstance(told, str):
        return _text(told)
    if isinstance(told, Mapping):
        return {_text(name): _readable(value) for name, value in told.items()}
    return [_readable(value) for value in told[:_MOST_STEPS]] if isinstance(told, (list, tuple)) else told


def _modest(detail: Mapping[str, Any]) -> dict[str, Any]:
    """Return what a server tells of itself where that is little, else nothing."""
    return dict(detail) if codec.is_modest(detail) and len(msgspec.json.encode(detail)) < _LARGEST_JSON else {}


def _is_simulated(facts: Mapping[str, Any]) -> bool:
    """Whether a robot is a simulation, by what its server stated; False where that is unknown."""
    config = facts.get("config")
    named = config.get("robot") if isinstance(config, Mapping) else None
    try:
        return bool(registry.find("robot", str(named or facts.get("kind") or "")).is_simulated)
    except (StationError, UnknownName):
        described = facts.get("robot_facts")
        return isinstance(described, Mapping) and "physics_dt_s" in described
