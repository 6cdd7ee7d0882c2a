"""The ROS 2 bridge: keys of the bus as topics of a running graph, and topics as commands, by a table.

A node in the user's own ROS Python (``bridges/ros2/station_node.py``) publishes and hears, and this server, which has
no ROS, does all the rest: what a message says, whether a command is good, what was dropped and how old what passed was.
They share two pipes and ROS's own bytes. A node that dies or stands still is told of, killed and started again; what is
silent on one side is silent on the other, and a topic that drives somebody ends with zeros, which the node sends.
"""

from __future__ import annotations

import json
import math
import os
import queue
import select
import shlex
import shutil
import struct
import subprocess
import threading
from collections import Counter, deque
from collections.abc import Callable, Collection, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, cast

import msgspec

from adapters.ros2 import table as tables
from adapters.ros2.table import PublishRow, SubscribeRow, Table
from station import libraries, registry
from station.bus import codec, keys
from station.bus.contracts import Contracts
from station.bus.sample import Sample
from station.bus.watch import Watch
from station.config import to_plain
from station.errors import BusError, ConfigError, StationError
from station.life import arm_request, estop
from station.life.ages import Ages
from station.life.event_feed import EventFeed
from station.life.events import Event, Severity
from station.life.server import Life, ServerKind
from station.life.stop_file import StopFile

if TYPE_CHECKING:
    from adapters.ros2.heard import Read
    from adapters.ros2.told import Tell
    from station.protocols import CommandFormat

NODE = Path(__file__).parents[1] / "bridges/ros2/station_node.py"
"""The node's file."""

HEAD = struct.Struct("<IcHqqI")
"""Before each frame: bytes that follow, kind, topic, two times [ns], publisher; the node's file says more."""

SILENT_S = 0.5
"""Whoever has sent nothing for so long on a topic is silent [s]."""

STILL_S = 2.0
"""A node that says nothing for so long stands still, and is killed [s]; it speaks five times a second."""

START_S = 60.0
"""Longest time until a node that was started speaks [s]: a container, or a computer with too much to do."""

_LOOK_S = 0.05  # at the node, and who is silent; what comes waits for no look
_FACTS_S = 0.5
_AGAIN_S = 2.0  # between two starts of a node
_LEAVE_S = 3.0  # for the last words of its topics
_MOST_SKIPPED = 1_000_000  # at once; a stamp that says more is no writer's count
_LONGEST = 64 << 20


class Ros2Config(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Configuration of the ROS 2 bridge.

    Attributes:
        table: Which key is which topic: a YAML file, a path or ``collection:path``; docs/ros2.md tells what is in it.
        python: Python of the ROS installation, 3.10 or newer, with words before it for one elsewhere, such as
            ``docker exec -i ros python3``.
        setup: File to source before it, such as ``/opt/ros/jazzy/setup.bash``; "" where that was done.
        node: Name of the node in ROS; where `python` runs in a container, behind an @ where the node's file is there:
            ``station@/bridge/station_node.py``.
        domain_id: ROS domain; None for that of the environment, or 0.
        localhost: Whether it meets only nodes on this computer; false leaves that to ROS and its environment variables.
        engaged: Whether commands of ROS pass from the start; None for yes, but where the table has a service for it.
    """

    table: str
    python: str = "python3"
    setup: str = ""
    node: str = "station"
    domain_id: int | None = None
    localhost: bool = True
    engaged: bool | None = None

    def __post_init__(self) -> None:
        name = self.node.partition("@")[0]
        if not (name.isidentifier() and name.isascii()):
            raise ValueError(f"node is {name!r}; expected letters, digits and underscores, such as station")
        if self.domain_id is not None and not 0 <= self.domain_id <= 232:
            raise ValueError(f"domain_id is {self.domain_id}; expected 0 to 232")
        try:
            words = shlex.split(self.python)
        except ValueError as error:
            raise ValueError(f"python is {self.python!r}: {error}") from None
        if not words:
            raise ValueError("python is empty; expected that of a ROS installation, such as /usr/bin/python3")


def _expect(config: Ros2Config) -> None:
    libraries.expect("the ROS 2 bridge", "rosbags", "ros2")
    program = shlex.split(config.python)[0]
    if not config.setup and shutil.which(program) is None:
        raise StationError(
            f"python: {program} is no program of this computer; expected the Python of a ROS installation"
        )
    if config.setup and not Path(config.setup).is_file():
        raise StationError(f"setup: {config.setup} is no file; expected the setup.bash of a ROS 2 installation")
    tables.read(config.table)


def main(config: Ros2Config, life: Life) -> int:
    """Bridge until asked to stop; return the exit code."""
    table = tables.read(config.table)
    with Bridge(config, table, life) as bridge:
        bridge.connect()
        life.configured({
            "server": life.name, "role": KIND.role, "config": to_plain(config),
            "publish": {row.topic: row.key for row in table.publish},
            "subscribe": {intake.row.topic: intake.command.key for intake in bridge.intakes},
            "services": table.services.names,
        })  # fmt: skip
        if life.ready():
            bridge.run()
    return 0


KIND = ServerKind(
    name="ros2",
    role="command",
    summary="bridges the bus and a running ROS 2 graph, by a table of keys and topics",
    config=Ros2Config,
    main=main,
    expect=_expect,
    bus_timeout_s=0.25,
)


class Frame(NamedTuple):
    """What came from the node."""

    kind: bytes
    number: int
    at_ns: int
    got_ns: int
    sender: int
    data: bytes


class NodeProcess:
    """The process of the ROS side, of one life; sending is for one thread, and blocks no longer than `STILL_S`.

    Args:
        command: Its command line.
        life: Whose clock is read.
        on_frame: Called for each frame, in a thread of its own.
    """

    def __init__(self, command: list[str], life: Life, on_frame: Callable[[Frame], None]) -> None:
        self._clock, self._on_frame = life.clock, on_frame
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True)
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._in, self._out = self._process.stdin.fileno(), self._process.stdout
        os.set_blocking(self._in, False)
        self._sending = threading.Lock()
        self.started_s = self.heard_s = self._clock.monotonic_s()
        self.has_spoken = False
        self.is_over = threading.Event()
        self.reason = ""
        self._thread = self._clock.start(self._listen, "ros2-node")

    def send(self, kind: bytes, data: bytes, number: int = 0) -> bool:
        """Send a frame; return whether the node's pipe took all of it."""
        return self.send_packed(HEAD.pack(len(data), kind, number, 0, 0, 0) + data)

    def send_packed(self, frames: bytes) -> bool:
        """Send frames that are packed already; return whether the node's pipe took all of them."""
        frame = memoryview(frames)
        until_s = self._clock.monotonic_s() + STILL_S
        with self._sending:
            try:
                while frame and not self.is_over.is_set():
                    try:
                        frame = frame[os.write(self._in, frame) :]
                    except BlockingIOError:
                        poll = select.poll()
                        poll.register(self._in, select.POLLOUT)
                        if not poll.poll(100) and self._clock.monotonic_s() > until_s:
                            self.kill(f"it took nothing for {STILL_S:g} s")
            except (OSError, ValueError):  # it is dead, as the other thread will tell
                return False
        return not frame

    def look(self) -> None:
        """Kill a node that stands still."""
        limit_s = STILL_S if self.has_spoken else START_S
        if not self.is_over.is_set() and (still_s := self._clock.monotonic_s() - self.heard_s) > limit_s:
            self.kill(f"it said nothing for {still_s:.1f} s")

    def kill(self, reason: str) -> None:
        """End it at once."""
        self.reason = self.reason or reason
        self._signal_all()

    def leave(self) -> None:
        """Close its pipe, upon which it says its last words; kill it where it does not end."""
        with self._sending:
            assert self._process.stdin is not None
            self._process.stdin.close()
        if not self._clock.wait(self.is_over, _LEAVE_S):
            self.kill("it did not end")
            self._clock.wait(self.is_over, _LEAVE_S)

    def _signal_all(self) -> None:
        try:
            os.killpg(self._process.pid, 9)
        except ProcessLookupError:
            return

    def _listen(self) -> None:
        while (head := self._read(HEAD.size)) is not None:
            size, kind, number, at_ns, got_ns, sender = HEAD.unpack(head)
            data = self._read(size) if size <= _LONGEST else None
            if data is None:
                break
            self.heard_s, self.has_spoken = self._clock.monotonic_s(), True
            if kind == b"x":
                self.reason = str(_facts(data).get("reason", ""))
            else:
                self._on_frame(Frame(kind, number, at_ns, got_ns, sender, data))
        self._signal_all()  # what it started itself; and one whose bytes are no frames
        code = self._process.wait()
        self._out.close()
        self.reason = self.reason or (f"killed by signal {-code}" if code < 0 else f"it ended with code {code}")
        self.is_over.set()

    def _read(self, size: int) -> bytes | None:
        found: bytes = self._out.read(size)
        return found if len(found) == size else None


def _facts(data: bytes) -> dict[str, Any]:
    """Return what the node says of itself; nothing where that is no JSON object."""
    try:
        found = json.loads(data)
    except ValueError:
        return {}
    return found if isinstance(found, dict) else {}


class Dropped(NamedTuple):
    """Why a message is not passed on: a word, and a sentence."""

    kind: str
    text: str


class Intake:
    """Which message of a topic becomes a command, and why another does not. No socket, no bus, no clock.

    Args:
        row: Of the table.

    Attributes:
        source: What the bus is told of where its commands are from.
        passed: Messages that became commands.
        dropped: Others, by the reason.
    """

    def __init__(self, row: SubscribeRow) -> None:
        from adapters.ros2.heard import BadMessage, reader
        from station.control.command_arbiter import CommandArbiter
        from station.control.command_validator import why_refused

        self.row, self._bad, self._why_refused = row, BadMessage, why_refused
        self.command = _command(row)
        self.source = codec.json_object({"kind": "ros2", "topic": row.topic})
        self._read: Read = reader(row, self.command)
        self.passed, self.dropped = 0, Counter[str]()
        self._publishers = CommandArbiter("keep-first", SILENT_S)
        self._ages, self._delays = Ages(), Ages()
        self._passed_s = self._refused_s = -math.inf
        self._is_live = False
        self._events: deque[tuple[str, Severity, dict[str, Any]]] = deque()

    def take(self, frame: Frame, now_ns: int, now_s: float, why_not: str = "") -> bytes | None:
        """Return the command that a message is, as it stands on the bus, or None.

        Args:
            frame: The message, and when its publisher sent it [ns since the epoch].
            now_ns: The instant, by the same clock.
            now_s: The instant, by the monotonic clock.
            why_not: Why no command passes now, in a word; "" where they do.
        """

        if why_not:
            self.dropped[why_not] += 1
            return None
        found = self._judge(frame, now_ns)
        if isinstance(found, Dropped):
            self.dropped[found.kind] += 1
            if self._refused_s == -math.inf:
                self._tell("ros2-refused", "warning", reason=f"{found.kind}: {found.text}")
            self._refused_s = now_s
            return None
        if frame.sender and not self._publishers.on_write(f"publisher {frame.sender}", now_s):
            self.dropped["second-publisher"] += 1
            return None
        value, age_s = found
        if age_s is not None:
            self._ages.add(age_s * 1e3)
        return value

    def record(self, delay_s: float, now_s: float) -> None:
        """Record that a message has been written at an instant, and how long it was here before [s]."""
        self.passed += 1
        self._delays.add(delay_s * 1e3)
        if not self._is_live:
            self._is_live = True
            back = {} if self._passed_s == -math.inf else {"silent_s": round(now_s - self._passed_s, 3)}
            self._tell("ros2-back" if back else "ros2-live", "info", **back)
        self._passed_s = now_s

    def on_tick(self, now_s: float) -> Iterator[tuple[str, Severity, dict[str, Any]]]:
        """Yield the events since the last call: name, severity, detail."""
        self._publishers.know((-math.inf, now_s))
        for news in self._publishers.pop_news(now_s):
            severity: Severity = "warning" if news.kind == "rivals" else "info"
            name = "ros2-handover" if news.kind == "handover" else "ros2-second-publisher"
            ended = {"ended": True} if news.kind == "alone" else {}
            self._tell(name, severity, heard=news.obeyed, refused=news.refused, **ended)
        if self._is_live and now_s - self._passed_s > SILENT_S:
            self._is_live = False
            self._tell("ros2-silent", "warning", passed=self.passed, then=f"nothing is written on {self.command.key}")
        if self._refused_s > -math.inf and now_s - self._refused_s > SILENT_S:
            self._refused_s = -math.inf
            self._tell("ros2-refused", "info", ended=True, dropped=dict(self.dropped))
        while self._events:
            yield self._events.popleft()

    def status(self) -> dict[str, Any]:
        """Return what a heartbeat tells: `age_ms` since its stamp, `delay_ms` of that here; median, most."""
        told = {"key": self.command.key, "passed": self.passed, "dropped": dict(self.dropped), "live": self._is_live}
        return told | self._ages.facts("age_ms") | self._delays.facts("delay_ms")

    def _judge(self, frame: Frame, now_ns: int) -> tuple[bytes, float | None] | Dropped:
        """Return the command that a message is, and how old it is where that is known [s]; or why it is none."""
        try:
            heard = self._read(frame.data)
        except self._bad as error:
            return Dropped(error.kind, str(error))
        stamp_ns = {"header": heard.stamp_ns or frame.at_ns, "publisher": frame.at_ns, "none": 0}[self.row.stamp]
        age_s = (now_ns - stamp_ns) * 1e-9 if stamp_ns else None
        if age_s is not None and abs(age_s) > self.row.max_age_s:
            if age_s < 0.0:
                return Dropped("wrong-clock", f"its stamp is {-age_s:.3g} s ahead of this computer's clock")
            return Dropped("stale", f"it is {age_s:.3g} s old, allowed are {self.row.max_age_s:g} s")
        if not all(map(math.isfinite, heard.numbers)):
            return Dropped("not-finite", "a number is not finite")
        if (refusal := self._why_refused(heard.numbers, self.command)) is not None:
            return Dropped(refusal.kind, refusal.text)
        return codec.json_vector(heard.numbers), age_s

    def _tell(self, name: str, severity: Severity, **detail: Any) -> None:
        self._events.append((name, severity, {"topic": self.row.topic, **detail}))


def _command(row: SubscribeRow) -> CommandFormat:
    """Return the format of a topic's commands.

    Raises:
        StationError: there is none, or it is for any robot and none is named.
    """
    from station.protocols import ForAnyRobot

    registry.expect("command", row.command)
    found = registry.find("command", row.command)
    if isinstance(found, ForAnyRobot):
        if not row.robot:
            raise ConfigError(f"{row.topic}: command {row.command!r} is for any robot; say robot: NAME, such as go2")
        return found.for_robot(row.robot)
    return cast("CommandFormat", found)


class Outlet:
    """A topic that the station publishes: what its messages are made of, and an account of them.

    Args:
        row: Of the table.
    """

    def __init__(self, row: PublishRow) -> None:
        from adapters.ros2 import told

        self._teller = told.teller
        self.row, self.end = row, told.last_word(row)
        self._drives, self._longest_s = row.drives, row.longest_s
        self.dropped = Counter[str]()
        self.trouble = ""
        self._tell: Tell | None = None
        self._contract: object = self
        self._last: Sample | None = None
        self.sent, self._before, self._said = 0, 0, dict[str, Any]()
        self._blocked = False

    def describe(self, contracts: Contracts) -> None:
        """Take up what the key is described to hold now."""
        if self.row.kind == "diagnostics" or (contract := contracts.get(self.row.key)) == self._contract:
            return
        self._contract = contract
        try:
            self._tell, self.trouble = self._teller(self.row, contract), ""
        except ConfigError as error:
            self._tell, self.trouble = None, str(error)

    def message(self, sample: Sample, now_ns: int, written_ns: int, *, is_stopped: bool) -> bytes | None:
        """Return the message of a value that is new, or None.

        Args:
            sample: Of the row's key.
            now_ns: The instant, by the monotonic clock.
            written_ns: When it was written [ns since the epoch].
            is_stopped: Whether nobody may be driven.
        """
        last, self._last = self._last, sample
        if sample.arrived_ns is None:  # it was there before
            return None
        if last is not None and last.stamp is not None and sample.stamp is not None:
            missing = sample.stamp.seq - last.stamp.seq - 1 if sample.stamp.source == last.stamp.source else 0
            self.dropped["skipped"] += missing if 0 < missing < _MOST_SKIPPED else 0
        if self._drives:
            silence_s = (
                math.inf if last is None or last.arrived_ns is None else (sample.arrived_ns - last.arrived_ns) * 1e-9
            )
            self._blocked = is_stopped or (self._blocked and silence_s < self.row.ends_after_s)
            if self._blocked:  # who commanded through a stop has to cease first
                self.dropped["stopped"] += 1
                return None
        is_any_age = self._longest_s == math.inf
        if not is_any_age and (now_ns - (sample.written_ns or sample.arrived_ns)) * 1e-9 > self._longest_s:
            self.dropped["stale"] += 1
            return None
        if self._tell is None or "trouble" in self._said:
            self.dropped["no-type" if "trouble" in self._said else "not-described"] += 1
            return None
        made = self._tell(sample.value, written_ns)
        self.dropped["unfit"] += made is None
        return made

    def heard(self, facts: Mapping[str, Any]) -> None:
        """Take up what the node says of the topic."""
        self._said = dict(facts)
        self.trouble = str(facts.get("trouble", self.trouble))

    def node_is_gone(self) -> None:
        """Account for what the node had and did not publish."""
        published = int(self._said.get("published", 0))
        self.dropped["with-the-node"] += max(0, self.sent - published)
        self.sent, self._before, self._said = 0, self._before + published, {}

    def status(self) -> dict[str, Any]:
        """Return what a heartbeat tells: `age_ms` since a value was written until ROS got it, `delay_ms` since
        it came here; median, most."""
        passed = self._before + int(self._said.get("published", 0))
        dropped = {why: count for why, count in dict(self.dropped).items() if count}  # another thread counts on
        told = {"key": self.row.key, "passed": passed, "dropped": dropped, "peers": self._said.get("peers", 0)}
        trouble = {"trouble": self.trouble} if self.trouble else {}
        return told | trouble | {name: self._said[name] for name in ("age_ms", "delay_ms") if name in self._said}


class Bridge:
    """Both directions, the services, and the node's process; a context manager.

    Args:
        config: Of the server.
        table: Which key is which topic.
        life: Of the server.
    """

    def __init__(self, config: Ros2Config, table: Table, life: Life) -> None:
        from station.enrich.live import written_wall_ns  # Protobuf and NumPy, which a list of servers needs not

        self._written_ns = written_wall_ns
        self._config, self._table, self._life, self._clock = config, table, life, life.clock
        self.outlets = [Outlet(row) for row in table.publish]
        self.intakes = [Intake(row) for row in table.subscribe]
        _expect_one_topic_each(self.intakes)
        self._by_key: dict[str, list[int]] = {}
        self._told: list[int] = []
        for number, row in enumerate(table.publish):
            (self._told if row.kind == "diagnostics" else self._by_key.setdefault(row.key, [])).append(number)
        self._feed = EventFeed(life.bus) if self._told else None
        self._seen: dict[str, Sample] = {}
        self._contracts, self._stated = Contracts(), dict[str, bytes]()
        self._engaged = config.engaged if config.engaged is not None else not table.services.engage
        self._is_stopped, self._is_running = False, False
        self._troubles = set[str]()
        self._node: NodeProcess | None = None
        self._gone_s, self._next_s, self._why_gone = 0.0, 0.0, ""
        self._incoming: list[dict[str, Any]] = []
        self._ros: dict[str, Any] = {}
        self._turn = threading.Lock()  # of the watch's thread, which passes on, and of the loop, which keeps the node
        watched = [*estop.KEYS, *sorted(self._by_key)]
        self._watch: Watch = life.bus.watch(watched, on_change=life.guarded(self._pass_on))
        self._calls: queue.Queue[dict[str, Any] | None] = queue.Queue(maxsize=16)
        self._caller = self._clock.start(self._answer_calls, "ros2-services")

    def __enter__(self) -> Bridge:
        return self

    def __exit__(self, *_: object) -> None:
        self._is_running = False
        self._watch.close()
        if self._node is not None:
            self._node.leave()
        self._calls.put(None)
        self._clock.join(self._caller, 1.0)
        if self._feed is not None:
            self._feed.close()

    def connect(self) -> None:
        """Start the node and wait until it speaks, or the server is asked to stop.

        Raises:
            StationError: it does not.
        """
        self._node = self._start()
        while not self._life.stopping and not self._ros:
            self._node.look()
            if self._clock.wait(self._node.is_over, _LOOK_S):
                raise StationError(
                    f"the node in ROS did not start: {self._node.reason}; expected the Python of a ROS 2: "
                    "set python or setup, or source its setup.bash before"
                )

    def run(self) -> None:
        """Bridge until the server is asked to stop."""
        self._is_stopped = StopFile(self._life.bus.address).read() is not None
        self._is_running, facts_s = True, 0.0
        while not self._clock.wait(self._life.stop_event, _LOOK_S):
            now_s = self._clock.monotonic_s()
            with self._turn:
                self._keep_node(now_s)
            if now_s >= facts_s:
                facts_s = now_s + _FACTS_S
                self._look()
                self._life.report(**self._facts())
            self._pass_on(self._by_key)
            for intake in self.intakes:
                for name, severity, detail in intake.on_tick(now_s):
                    self._life.event(name, severity=severity, **detail)

    # -- The node -----------------------------------------------------------------------------------------------------
    def _start(self) -> NodeProcess:
        config, (name, _, file) = self._config, self._config.node.partition("@")
        words = [*shlex.split(config.python), file or str(NODE)]
        if config.setup:
            words = ["bash", "-c", 'source "$1" >&2 && shift && exec "$@"', "bash", config.setup, *words]
        node = NodeProcess(words, self._life, self._on_frame)
        first = {
            "node": name, "domain": config.domain_id, "localhost": config.localhost,
            "publish": [
                {
                    "topic": one.row.topic, "type": tables.TYPES[one.row.kind], "qos": to_plain(one.row.qos),
                    "end": one.end.hex(), "end_after_s": one.row.ends_after_s,
                }
                for one in self.outlets
            ],
            "subscribe": [
                {"topic": one.row.topic, "type": tables.TYPES[one.row.kind], "qos": to_plain(one.row.qos)}
                for one in self.intakes
            ],
            "services": [
                {"name": name, "type": f"std_srvs/srv/{'Trigger' if what == 'zero' else 'SetBool'}"}
                for what, name in self._table.services.names.items()
            ],
        }  # fmt: skip
        node.send(b"c", json.dumps(first).encode())
        return node

    def _keep_node(self, now_s: float) -> None:
        """See that the node lives; start another one where it does not."""
        if (node := self._node) is not None:
            node.look()
            if not node.is_over.is_set():
                return
            self._node, self._ros, self._incoming = None, {}, []
            for outlet in self.outlets:
                outlet.node_is_gone()
            if not self._gone_s:
                self._gone_s = node.heard_s
            if node.reason != self._why_gone:
                self._why_gone = node.reason
                self._life.event("ros2-lost", severity="error", reason=node.reason, then="it is started again")
            self._next_s = now_s if now_s - node.started_s > _AGAIN_S else now_s + _AGAIN_S
        elif now_s >= self._next_s:
            self._node = self._start()

    def _on_frame(self, frame: Frame) -> None:
        """Take up what the node says; in its thread."""
        if frame.kind == b"m" and frame.number < len(self.intakes):
            self._write(self.intakes[frame.number], frame)
        elif frame.kind == b"h":
            self._on_heartbeat(_facts(frame.data))
        elif frame.kind == b"q":
            try:
                self._calls.put_nowait(_facts(frame.data))
            except queue.Full:
                self._life.event("ros2-call-refused", severity="warning", reason="too many calls wait")

    def _on_heartbeat(self, facts: dict[str, Any]) -> None:
        for outlet, said in zip(self.outlets, facts.get("publish", []), strict=False):
            outlet.heard(said)
        self._incoming = facts.get("subscribe", [])
        is_new, self._ros = not self._ros, {name: facts.get(name, "") for name in ("distro", "rmw")}
        if is_new and self._gone_s:
            silent_s, self._gone_s, self._why_gone = self._clock.monotonic_s() - self._gone_s, 0.0, ""
            lost = sum(outlet.dropped["with-the-node"] for outlet in self.outlets)
            self._life.event("ros2-again", silent_s=round(silent_s, 3), lost_with_it=lost)

    # -- From the bus to ROS ------------------------------------------------------------------------------------------
    def _obey_stop(self) -> None:
        is_stopped = estop.latched(self._watch.latest) is not None
        if self._watch.latest(keys.ESTOP) is None and self._is_stopped and not is_stopped:
            return  # as the file says; a bus that was started anew has forgotten it
        if is_stopped and not self._is_stopped:
            for number, outlet in enumerate(self.outlets):
                if outlet.end and self._node is not None:
                    self._node.send(b"e", b"", number)
        self._is_stopped = is_stopped

    def _pass_on(self, changed: Collection[str]) -> None:
        """Obey a stop, and send what is new of some keys: the first message by itself, so that the node wakes while the
        others are made, and those at once. The watch calls it: to wake the loop for that took as long again."""
        if not self._is_running:
            return
        with self._turn:
            self._obey_stop()
            news = self._news(changed)
            if (first := next(news, None)) is not None:
                self._send([first])
                if rest := [*news]:
                    self._send(rest)

    def _news(self, changed: Collection[str]) -> Iterator[tuple[int, bytes]]:
        """Yield the frame of each message that is new, with the topic's number."""
        for key in changed:
            sample = self._watch.latest(key)
            if sample is None:
                self._seen.pop(key, None)
            elif sample is not self._seen.get(key):
                self._seen[key] = sample
                yield from self._messages(sample)
        for event in () if self._feed is None else self._feed.pop():
            data = _diagnostics(event)
            for number in self._told:
                yield number, HEAD.pack(len(data), b"m", number, event.wall_ns, self._clock.wall_ns(), 0) + data

    def _messages(self, sample: Sample) -> Iterator[tuple[int, bytes]]:
        """Yield the frame of each topic of a value, with the topic's number."""
        written_ns, now_ns = self._written_ns(sample, self._clock), self._clock.monotonic_ns()
        got_ns = self._clock.wall_ns() - (now_ns - (sample.arrived_ns or now_ns))
        for number in self._by_key.get(sample.key, ()):
            data = self.outlets[number].message(sample, now_ns, written_ns, is_stopped=self._is_stopped)
            if data is not None:
                yield number, HEAD.pack(len(data), b"m", number, written_ns, got_ns, 0) + data

    def _send(self, frames: list[tuple[int, bytes]]) -> None:
        node, why_not = self._node, ""
        if node is None or node.is_over.is_set() or not self._ros:
            why_not = "no-node"
        elif not node.send_packed(b"".join(data for _, data in frames)):
            why_not = "with-the-node"
        for number, _ in frames:
            if why_not:
                self.outlets[number].dropped[why_not] += 1
            else:
                self.outlets[number].sent += 1

    def _look(self) -> None:
        """Take up what servers state of their keys; tell of rows that make nothing of theirs."""
        try:
            stated = self._life.bus.read(self._life.bus.names(keys.CONFIG_PREFIX + "*"))
        except BusError:  # the bus itself says so in the log
            return
        for key, sample in stated.items():
            if self._stated.get(key) != sample.value:
                self._stated[key] = sample.value
                self._contracts.add_facts(codec.parse_facts(sample.value))
        for outlet in self.outlets:
            outlet.describe(self._contracts)
            is_written = self._watch.latest(outlet.row.key) is not None
            if outlet.trouble and is_written and outlet.trouble not in self._troubles:
                self._troubles.add(outlet.trouble)
                self._life.event("ros2-row-unfit", severity="warning", reason=outlet.trouble)

    # -- From ROS to the bus ------------------------------------------------------------------------------------------
    def _write(self, intake: Intake, frame: Frame) -> None:
        """Write the command that a message is."""
        now_s = self._clock.monotonic_s()
        why_not = "" if self._is_running and self._engaged else "not-engaged"
        value = intake.take(frame, self._clock.wall_ns(), now_s, "stopped" if self._is_stopped else why_not)
        if value is None:
            return
        command, delay_s = intake.command, (self._clock.wall_ns() - frame.got_ns) * 1e-9
        if self._life.bus.publish({command.key: value, keys.command_source(command.robot): intake.source}):
            intake.record(delay_s, now_s)
        else:
            intake.dropped["bus-lost"] += 1

    # -- Services -----------------------------------------------------------------------------------------------------
    def _answer_calls(self) -> None:
        names = {name: what for what, name in self._table.services.names.items()}
        while (call := self._calls.get()) is not None:
            try:
                is_done, text = True, self._do(names.get(str(call.get("service")), ""), call.get("data") is True)
            except StationError as error:
                is_done, text = False, str(error)
            answer = {"number": call.get("number"), "success": is_done, "message": text}
            self._life.event("ros2-called", severity="info" if is_done else "warning", **(call | answer))
            if (node := self._node) is not None:
                node.send(b"r", json.dumps(answer).encode())

    def _do(self, what: str, is_on: bool) -> str:
        """Do what a service was called for; return in words what was done.

        Raises:
            StationError: it was not.
        """
        if not self._is_running:
            raise StationError("the bridge is not active yet")
        if what == "arm":
            action: arm_request.Action = "arm" if is_on else "disarm"
            server = self._table.services.server
            states = arm_request.ask(self._life.bus, action, name=server, reason="a service of ROS 2 was called")
            return "; ".join(f"{name}: {arm_request.story(action, seen)}" for name, seen in states.items())
        if what == "engage" and is_on:
            if self._is_stopped:
                raise StationError("the emergency stop is pressed; release it first: station estop --reset")
            self._engaged = True
            return "commands of ROS are passed on"
        self._engaged = False
        return "commands of ROS are held back; a robot goes back to how it rests"

    def _facts(self) -> dict[str, Any]:
        heard = {}
        for number, intake in enumerate(self.intakes):
            said = self._incoming[number] if number < len(self._incoming) else {}
            heard[intake.row.topic] = intake.status() | {name: said.get(name, 0) for name in ("missed", "peers")}
        return {
            "ros": self._ros or None, "engaged": self._engaged, "stopped": self._is_stopped,
            "publish": {outlet.row.topic: outlet.status() for outlet in self.outlets}, "subscribe": heard,
        }  # fmt: skip


def _expect_one_topic_each(intakes: list[Intake]) -> None:
    counts = Counter(intake.command.key for intake in intakes)
    if twice := [key for key, count in counts.items() if count > 1]:
        raise ConfigError(f"two topics write {twice[0]}; expected one for each key")


def _diagnostics(event: Event) -> bytes:
    from adapters.exports.ros2 import messages

    said = {"source": event.source, "name": event.name, "severity": event.severity, "detail": event.detail}
    return messages.diagnostics(max(0, event.wall_ns), said)
