"""A running station for scripts and notebooks: what is there, what its keys hold, and what may be asked of it.

It needs neither NumPy nor a file until numbers are asked for, so a command line answers at once with it too.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, TypeVar
from weakref import WeakSet

import msgspec

from station import user_config
from station.bus import address as addresses
from station.bus import codec, keys
from station.bus.client import Bus
from station.bus.contracts import Contracts
from station.bus.sample import Sample
from station.bus.watch import Watch
from station.contract import Contract
from station.description import RobotDescription
from station.errors import BusError, NotReady, UsageError
from station.life import arm_request, controller_request, policy_request, runbook_request
from station.life.event_feed import EventFeed
from station.life.events import Event
from station.life.policy_request import Policies
from station.life.runbook_request import RunbookStatus
from station.life.server import Health, read_configurations, read_health
from station.life.stop_button import StopButton, keep_for_the_next_start, say_past_bus
from station.printable import printable

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from station.episode.storage.request import Action, RecordAnswer, RecorderState
    from station.motion.playback_requests import MotionAction

WITHIN_S = 60.0
"""Longest wait for a station that is coming up [s]."""

_LOOK_S = 0.05
_FRESH_S = 1.0
"""What servers state is read again after this [s]: it is 20 kB of JSON, and a script may publish at 100 Hz."""

_FEW = 4  # names in an error
_OF_GATE = {"gate": "state", "reason": "reason", "arming": "arming"}
_Given = TypeVar("_Given")
_ANSWER_S = 20.0  # of a recorder: a stop waits for the disk
_DOUBT_S = 2.0  # where no recorder is heard: one on a machine with a wrong clock may be there all the same

Values = Mapping[str, bytes | str | Sequence[float] | Mapping[str, Any]]


class RobotStatus(msgspec.Struct, frozen=True, kw_only=True):
    """A robot as its low-level server tells of it.

    Attributes:
        name: Suffix of its keys.
        server: Name of the server that drives it.
        state: Of that server: ``active`` when it drives.
        gate: What is done with commands: ``waiting``, ``tracking``, ``holding``, ``stopped``, …; "" before it is known.
        reason: Why, in a line.
        arming: ``armed``, ``arming`` or ``disarmed``; "" before it is known.
        detail: What else its heartbeat tells.
    """

    name: str
    server: str
    state: str
    gate: str = ""
    reason: str = ""
    arming: str = ""
    detail: dict[str, Any] = {}


class Value:
    """What a key holds.

    Attributes:
        key: The key.
        data: Its bytes.
        writer: Name of the server that wrote it; "" for a writer that stamps nothing.
        written_ns: When, by the writer's wall clock [ns since the epoch]; None for such a writer.
        contract: What the key holds; None where nothing describes it.
    """

    def __init__(self, sample: Sample, contract: Contract | None) -> None:
        self.key, self.data, self.contract = sample.key, sample.value, contract
        self.writer = sample.stamp.writer if sample.stamp is not None else ""
        self.written_ns = sample.stamp.wall_ns if sample.stamp is not None else None

    def vector(self) -> NDArray[Any]:
        """Return its numbers, shape (m,), in the units of the contract; of many rows the newest.

        Raises:
            UsageError: the key holds no vector, or these bytes are none.
        """
        kind = self.contract.vector_codec if self.contract is not None else None
        if self.contract is not None and self.contract.codec == "f64-rows":
            newest: NDArray[Any] = self._rows(len(self.contract.names))[-1]
            return newest
        if kind is None:
            held = "nothing describes it" if self.contract is None else f"it holds {self.contract.codec}"
            raise UsageError(f"{self.key}: no vector, {held}; read its `data`, or `json()`")
        try:
            return codec.parse_vector(kind, self.data)
        except codec.BadValue as error:
            raise UsageError(f"{self.key}: {error}") from None

    def _rows(self, width: int) -> NDArray[Any]:
        """Return rows of so many numbers, at least one."""
        if not width or not self.data or len(self.data) % (8 * width):
            raise UsageError(f"{self.key}: {len(self.data)} bytes; expected rows of {width} numbers")
        return codec.parse_vector("f64", self.data).reshape(-1, width)

    def named(self) -> dict[str, float]:
        """Return its numbers by the names of the contract.

        Raises:
            UsageError: as `vector`, or their count is not that of the names.
        """
        numbers = self.vector().tolist()
        names = self.contract.names if self.contract is not None else ()
        if len(names) != len(numbers):
            raise UsageError(f"{self.key}: {len(numbers)} numbers for {len(names)} names; read its `vector()`")
        return dict(zip(names, numbers, strict=True))

    def json(self) -> Any:
        """Return the JSON that it is.

        Raises:
            UsageError: it is none.
        """
        try:
            return codec.parse_json(self.data)
        except codec.BadValue as error:
            raise UsageError(f"{self.key}: {error}") from None


class Station:
    """A line to a running station; a context manager, safe to share between threads.

    Args:
        bus: Its address, ``redis://…``, ``rediss://…`` or ``unix://…``; None takes ``$STATION_BUS``, else this user's
            own.
        name: Who speaks, in what it writes.

    Attributes:
        record: Asks the recorder.
        motion: Asks the server that plays a motion.

    Raises:
        UsageError: no address.
        BusError: no server answers there.
    """

    def __init__(self, bus: str | None = None, *, name: str = "script") -> None:
        self._bus = Bus(addresses.parse(bus) if bus else None, name=name, timeout_s=1.0)
        self._name = name
        self._clock = self._bus.clock
        self.record = Record(self._bus)
        self.motion = MotionPlayer(self._bus)
        self._listening: WeakSet[Watch | EventFeed] = WeakSet()
        self._is_closed = False
        self._contracts: tuple[float, Contracts] | None = None

    @property
    def address(self) -> str:
        """Where its bus is; without a password."""
        return str(self._bus.address)

    def close(self) -> None:
        """Hang up; what follows a key or the events comes to its end."""
        self._is_closed = True
        for each in list(self._listening):
            each.close()
        self._bus.close()

    def __enter__(self) -> Station:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    # -- What is there -----------------------------------------------------------------------------------------------
    def servers(self) -> list[Health]:
        """Return the servers that are alive, by name, with what each tells of itself."""
        now_ns = self._clock.wall_ns()
        return [health for health in read_health(self._bus) if health.is_alive_at(now_ns)]

    def robots(self) -> list[RobotStatus]:
        """Return the robots that are driven, by name."""
        found = []
        for health in self.servers():
            if health.role != "low-level":
                continue
            try:
                name = arm_request.robot_of(self._bus, health.name)
            except NotReady:  # it loads
                continue
            gate = codec.parse_facts(self._bus.get(keys.command_gate(name)))
            told = {field: str(gate.get(key, "")) for field, key in _OF_GATE.items()}
            found.append(
                RobotStatus(name=name, server=health.name, state=health.state, detail=dict(health.detail), **told)
            )
        return sorted(found, key=lambda robot: robot.name)

    def wait_for_robot(self, name: str = "", *, within_s: float = WITHIN_S) -> RobotStatus:
        """Wait until a robot is driven; return it.

        Args:
            name: Of the robot or of its server; "" for any.
            within_s: Longest wait [s].

        Raises:
            NotReady: there is none in time.
        """
        deadline_s = self._clock.monotonic_s() + within_s
        while True:
            there = self.robots()
            for robot in there:
                if robot.state == "active" and robot.gate and name in ("", robot.name, robot.server):
                    return robot
            if self._is_closed or self._clock.monotonic_s() >= deadline_s:
                seen = ", ".join(f"{robot.name} ({robot.state})" for robot in there) or "none"
                wanted = printable(name) or "any robot"
                raise NotReady(f"{wanted}: not driven within {within_s:g} s on {self.address}; there: {seen}")
            self._clock.sleep(_LOOK_S)

    def keys(self, pattern: str = "*") -> list[str]:
        """Return the keys of the bus that match a pattern, sorted, stamps left out."""
        return self._bus.names(pattern)

    def contracts(self) -> Contracts:
        """Return what is known of robots and keys, by what each server stated at most `_FRESH_S` ago."""
        now_s = self._clock.monotonic_s()
        if self._contracts is None or now_s - self._contracts[0] > _FRESH_S:
            self._contracts = now_s, Contracts(read_configurations(self._bus))
        return self._contracts[1]

    def describe(self, key: str) -> Contract | None:
        """Return what a key holds, names and units of its numbers; None where nothing describes it."""
        return self.contracts().get(key)

    def description(self, robot: str) -> RobotDescription | None:
        """Return what a robot says of itself: joints with limits, limbs, keys; None where nothing describes it."""
        return self.contracts().robot(robot)

    # -- What its keys hold ------------------------------------------------------------------------------------------
    def read(self, key: str) -> Value | None:
        """Return what a key holds; None where it does not exist."""
        sample = self._bus.read([key]).get(key)
        return None if sample is None else Value(sample, self.describe(key))

    def cloud(
        self, lidar: str, *, max_age_s: float = 1.0, most: int = 50_000, seed: int = 0
    ) -> NDArray[np.float32] | None:
        """Return the newest points of a lidar [m], shape (n, 3), all finite, in the frame that it is mounted in.

        None before its first cloud, and where the newest was written longer ago, by its writer's clock.

        Args:
            lidar: Its name.
            max_age_s: Of the cloud [s].
            most: Of more points a random choice stays.
            seed: Of that choice.

        Raises:
            UsageError: its key holds no cloud.
        """
        from station import point_cloud

        sample = self._bus.read([keys.lidar_cloud(lidar)]).get(keys.lidar_cloud(lidar))
        mark = None if sample is None else sample.stamp
        if sample is None or mark is None:
            return None
        is_ours = mark.is_from_this_boot
        age_ns = self._clock.monotonic_ns() - mark.mono_ns if is_ours else self._clock.wall_ns() - mark.wall_ns
        if age_ns * 1e-9 > max_age_s:
            return None
        try:
            return point_cloud.xyz(point_cloud.decoded(sample.value), most=most, seed=seed)
        except point_cloud.BadCloud as error:
            raise UsageError(f"{sample.key}: {error}") from None

    def follow(self, key: str, *, silent_s: float | None = None) -> Iterator[Value]:
        """Yield each newest value of a key that is written from now on; one that is overwritten at once may be missed.

        Args:
            key: The key.
            silent_s: Ends when nothing was written for so long [s]; None: never.
        """
        return _found(self.follow_or_none(key, silent_s=silent_s))

    def follow_or_none(self, key: str, *, silent_s: float | None = None) -> Generator[Value | None]:
        """As `follow`, and None where nothing came for 50 ms: a caller that waits may look after something else."""
        contract, watch = self.describe(key), self._bus.watch([key])
        newest = watch.latest(key)

        def newer() -> list[Value]:
            nonlocal newest
            if (sample := watch.wait(key, after=newest, timeout_s=_LOOK_S)) is None:
                return []
            newest = sample
            return [Value(sample, contract)]

        return self._given_by(watch, newer, silent_s)

    def events(self, *, silent_s: float | None = None) -> Iterator[Event]:
        """Yield what happens from now on, each event once.

        Args:
            silent_s: Ends when nothing happened for so long [s]; None: never.
        """
        return _found(self.events_or_none(silent_s=silent_s))

    def events_or_none(self, *, silent_s: float | None = None) -> Generator[Event | None]:
        """As `events`, and None where nothing happened for 50 ms."""
        feed = EventFeed(self._bus)

        def newer() -> list[Event]:
            self._clock.sleep(_LOOK_S)
            return list(feed.pop())

        return self._given_by(feed, newer, silent_s)

    def publish(self, values: Values) -> None:
        """Write keys and their stamps in one atomic command.

        Args:
            values: By key: numbers, encoded as the key's contract says; a mapping, as JSON; bytes and text as they are.

        Raises:
            UsageError: numbers for a key that holds none, or not as many as its contract names.
            BusError: the bus did not take them.
        """
        encoded = {key: self._encoded(key, value) for key, value in values.items()}
        if not self._bus.publish(encoded):
            raise BusError(self._bus.last_error or f"bus {self.address}: no answer")
        self._bus.call("PING")  # answered after the write: it was taken

    # -- What may be asked -------------------------------------------------------------------------------------------
    def estop(self, reason: str = "asked for by a script") -> list[str]:
        """Stop every robot on the bus, latched; return the names of the servers that have.

        Where the bus is gone or frozen, those of this machine are stopped that a `station up` of this user drives; the
        stop is kept, and nothing starts under it.

        Raises:
            station.errors.StoppedPastBus: the bus did not take it, but such a station; its `told` names the servers.
            BusError: the stop was not taken; use the robot's own.
            NotReady: a robot does not obey; use its own stop.
        """
        call = say_past_bus(self._bus.address, reason)  # first: a bus that is frozen may hold up all the rest
        try:
            opened = self._button()
        except BusError as error:
            raise keep_for_the_next_start(self._bus.address, reason, error, call) from None
        finally:
            call.close()
        with opened as button:
            button.press(reason)
            robots = button.robots()
            if left := button.unstopped():
                said = ", ".join(f"{name} ({state})" for name, state in left.items())
                raise NotReady(f"the bus has the stop, but not every robot obeys: {said}; use the robot's own stop")
        _expect_kept(button)
        return robots

    def release(self, reason: str = "asked for by a script", *, arm: bool = False) -> None:
        """Release the emergency stop: a simulated robot stands up again, a real one stays disarmed unless `arm`.

        Raises:
            BusError: the release was not taken.
            NotReady: a robot is still stopped.
        """
        with self._button() as button:
            button.release(reason, arm=arm)
            if left := button.unreleased():
                raise NotReady(f"the bus has the release, but {', '.join(left)} is still stopped; release it again")
        _expect_kept(button)

    def arm(self, robot: str = "", *, reason: str = "") -> dict[str, list[str]]:
        """Let targets go to a robot and wait until it is armed; return the states it went through, by server.

        Args:
            robot: Its name, or that of its server; "" for every one on the bus.
            reason: For the recording.

        Raises:
            NotReady: no such robot, or no answer in time.
            Refused: it said no, with its reason.
        """
        return arm_request.ask(self._bus, "arm", name=robot, reason=reason)

    def disarm(self, robot: str = "", *, reason: str = "") -> dict[str, list[str]]:
        """Send nothing to a robot any more; as `arm`."""
        return arm_request.ask(self._bus, "disarm", name=robot, reason=reason)

    def release_motors(self, robot: str = "") -> list[str]:
        """Have a controller of a robot's own let go of its motors: the robot goes limp; return the robots' names.

        Args:
            robot: Its name, or that of its server; "" for every one on the bus.

        Raises:
            NotReady: no such robot, or no answer in time.
            Refused: it is armed, it has no such controller, or that does not let go; with the reason.
        """
        found = list(arm_request.robots_of(self._bus, robot).values())
        for name in found:
            controller_request.ask(self._bus, name, "release", within_s=controller_request.RELEASED_WITHIN_S)
        return found

    def policies(self, robot: str = "") -> list[Policies]:
        """Return for each robot here, or for the one that is named, which policy drives it and which ones may.

        Raises:
            NotReady: no such robot, or it has not said so yet.
        """
        return policy_request.policies(self._bus, robot)

    def switch_policy(self, policy: str, robot: str = "") -> str:
        """Have another policy drive a robot while it moves, and wait until it does; return the robot's name.

        Args:
            policy: Its name, as the settings of the robot's server have it.
            robot: Name of the robot, or of its server; "" for the one that has several policies.

        Raises:
            NotReady: no such robot, or no answer in time.
            Refused: the policy does not take over, with the reason; or the robot has to be named.
        """
        return policy_request.ask(self._bus, policy, name=robot)

    def runbook(self) -> RunbookStatus | None:
        """Return what the runbook of `station up` is doing, with the question that it asks now; None where none runs.

        One whose station was killed is none after 2 s.
        """
        return runbook_request.status(self._bus)

    def answer(self, question_id: str, answer: str, *, who: str = "", where: str = "script") -> None:
        """Answer the question that a runbook asks, before anybody does at its terminal, and wait until that counts.

        Args:
            question_id: As `runbook` told; a question that is asked again has another.
            answer: One of its answers.
            who: Who answers, for the recording; "" for this user's login name.
            where: From where, likewise.

        Raises:
            NotReady: no runbook is run here, or nothing came of the answer.
            Refused: it does not count, with the reason: another was first, the question is over, it has no such answer,
                or this user of the bus may not answer.
        """
        runbook_request.answer(self._bus, question_id, answer, who=who, where=where)

    def _given_by(
        self, source: Watch | EventFeed, newer: Callable[[], Sequence[_Given]], silent_s: float | None
    ) -> Generator[_Given | None]:
        """Yield what a source gives, until it was silent for too long or this is closed; the source listens already."""
        self._listening.add(source)

        def given() -> Generator[_Given | None]:
            heard_s = self._clock.monotonic_s()
            with source:
                yield None  # begun: whatever becomes of this, its source is closed
                while not self._is_closed and (silent_s is None or self._clock.monotonic_s() - heard_s < silent_s):
                    found = newer()
                    for item in found:
                        heard_s = self._clock.monotonic_s()
                        yield item
                    if not found:
                        yield None

        items = given()
        next(items)
        return items

    def _button(self) -> StopButton:
        return StopButton(self._bus.address, name=self._name)

    def _encoded(self, key: str, value: bytes | str | Sequence[float] | Mapping[str, Any]) -> bytes:
        if isinstance(value, bytes):
            return value
        if isinstance(value, str):
            return value.encode()
        if isinstance(value, Mapping):
            return codec.json_object(value)
        contract = self.describe(key)
        kind = contract.vector_codec if contract is not None else None
        if contract is None or kind is None:
            raise UsageError(f"{key}: numbers, but the key holds no vector that is known; give it bytes")
        if contract.elements and len(value) != len(contract.elements):
            raise UsageError(f"{key}: {len(value)} numbers, expected {len(contract.elements)}: {_listed(contract)}")
        return codec.vector(kind, value)


class Record:
    """Asks the recorder of a station.

    Every method raises `NotReady` where no recorder answers, and `Refused`, with its reason, where it says no.
    """

    def __init__(self, bus: Bus) -> None:
        self._bus = bus

    def start(
        self,
        task: str = "",
        *,
        instruction: str = "",
        operator: str = "",
        planned_s: float | None = None,
        leave_out: Sequence[str] = (),
    ) -> RecordAnswer:
        """Begin an episode; return its id and folder.

        Args:
            task: Name of the task; episodes of a task share a folder.
            instruction: What is to be done, in words.
            operator: Who operates; "" for the default of this user's file (`station.user_config`), else the login name.
            planned_s: Refused where the disk cannot hold so long [s].
            leave_out: Keys that the episode does without, or beginnings of keys up to a ``_``, such as ``policy_obs``.
        """
        person, without = {"id": user_config.operator(operator)}, tuple(leave_out)
        return self._ask("start", task=task, instruction=instruction, operator=person, planned_s=planned_s,
                         leave_out=without)  # fmt: skip

    def stop(self, *, success: bool | None = None) -> RecordAnswer:
        """End the episode; return its id, its folder and what is in it.

        Args:
            success: Whether the task was done; None where that is not said.
        """
        return self._ask("stop", success=success)

    def mark(self, label: str = "mark") -> RecordAnswer:
        """Put a mark into the episode, here and now."""
        return self._ask("mark", label=label)

    def discard(self, reason: str = "") -> RecordAnswer:
        """End the episode, if it still runs, and flag it as not to be used; nothing is deleted."""
        return self._ask("discard", label=reason)

    def status(self) -> RecorderState | None:
        """Return what the recorder does; None where none has said."""
        from station.episode.storage.request import RecorderState

        data = self._bus.get(keys.RECORDER)
        try:
            return None if data is None else codec.parse_struct(data, RecorderState)
        except codec.BadValue:
            return None

    def _ask(self, action: Action, **fields: Any) -> RecordAnswer:
        from station.episode.recorder import remote

        is_there = any(health.role == "recorder" and health.is_alive for health in read_health(self._bus))
        return remote.ask(self._bus, action, timeout_s=_ANSWER_S if is_there else _DOUBT_S, **fields)


class MotionPlayer:
    """Asks the server that plays a motion.

    Every method raises `NotReady` where none answers, and `Refused` where it does not apply now: a motion that is not
    paused cannot be resumed.
    """

    def __init__(self, bus: Bus) -> None:
        self._bus = bus

    def start(self) -> None:
        """Begin to play, where it waits for that."""
        self._ask("start")

    def pause(self) -> None:
        """Hold the pose; a walk comes to a stand."""
        self._ask("pause")

    def resume(self) -> None:
        """Go on after a pause."""
        self._ask("resume")

    def seek(self, time_s: float) -> None:
        """Blend to another time of the motion [s] and go on from there."""
        self._ask("seek", time_s=time_s)

    def loop(self, *, on: bool = True) -> None:
        """Begin anew at the end, or do not."""
        self._ask("loop", on=on)

    def leave(self) -> None:
        """Blend to the default pose and end."""
        self._ask("leave")

    def _ask(self, action: MotionAction, **fields: Any) -> None:
        from station.motion import playback_requests

        playback_requests.ask(self._bus, action, **fields)


def _found(items: Generator[_Given | None]) -> Iterator[_Given]:
    return (item for item in items if item is not None)


def _listed(contract: Contract) -> str:
    names = list(contract.names)
    return ", ".join(names if len(names) <= _FEW else [*names[:_FEW], "…"])


def _expect_kept(button: StopButton) -> None:
    if button.not_kept:
        raise NotReady(f"the bus has it, but a restarted one will not: {button.not_kept}")
