"""One station from the first check to the last farewell: runs a runbook, watches over it, takes it down in reverse."""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import msgspec

from station.bus.client import Bus
from station.episode.recorder import remote
from station.episode.storage import left_open
from station.episode.storage.request import RecordAnswer
from station.errors import BusError, ConfigError, NotReady, Refused, StationError
from station.life import arm_request
from station.life.event_feed import EventFeed
from station.life.events import Event
from station.life.restarts import Restarts
from station.life.server import HEARTBEAT_S, Health, read_health
from station.software import software
from station.supervision.checks import DiskCheck
from station.supervision.disk_need import disk_need
from station.supervision.exit_policy import ExitPolicy
from station.supervision.figures import Figure, table
from station.supervision.runbook import (
    CheckStep,
    ConfirmStep,
    MeasureStep,
    QuestionStep,
    Runbook,
    StartStep,
    Step,
)
from station.supervision.runbook_publisher import TERMINAL, GivenAnswer, RunbookPublisher
from station.supervision.session_ui import SessionUI
from station.supervision.stop_memory import StopMemory
from station.supervision.supervisor import NAME, Supervisor, how_it_ended

_LOOK_S = 0.1
_BUS_GONE_S = 10.0  # a restarted server is back within a second; without one no server can be supervised
_TOLD_S = HEARTBEAT_S + 0.1  # what robots say of a stop may be overwritten by servers that it ends, till the next beat
_RECORDER = "recorder"
_UNATTENDED = "--yes"
_YES_NO = ("yes", "no")
_TOLD_OTHERWISE = (  # with more, by the session itself
    "record-start", "measured", "answered", "server-failed", "server-crashed", "server-died", "server-silent",
)  # fmt: skip
_INTERRUPTED = 130  # what a shell calls a command that Ctrl-C ended


class Answer(msgspec.Struct, frozen=True, kw_only=True):
    """What was found or said at a step, for the manifest; `where` is "" for what the station found itself."""

    step: str
    answer: str
    who: str
    wall_ns: int
    where: str = ""
    is_unattended: bool = False


class Recording(msgspec.Struct, frozen=True, kw_only=True):
    """What is to be recorded, as the operator named it; `planned_s` must fit on the disk [s]."""

    task: str
    instruction: str = ""
    operator: dict[str, str] = {}
    planned_s: float | None = None


class Session:
    """A running station.

    Args:
        runbook: What to do.
        bus: The bus it runs on.
        supervisor: Starts the processes.
        face: Shows and asks.
        data: Folder of episodes.
        recording: What to record; None records nothing until the recorder is asked.
        is_unattended: Answer confirmations with yes, recorded as such; refused for a real robot.
    """

    def __init__(
        self,
        runbook: Runbook,
        bus: Bus,
        supervisor: Supervisor,
        face: SessionUI,
        *,
        data: Path,
        recording: Recording | None = None,
        is_unattended: bool = False,
    ) -> None:
        if is_unattended and runbook.robot_is_real:
            raise ConfigError(
                f"runbook {runbook.name}: --yes is refused, because people stand beside a real robot; "
                "run it without, and answer each confirmation"
            )
        if recording is not None and not any(step.start == _RECORDER for step in runbook.servers):
            raise ConfigError(
                f"runbook {runbook.name} starts no recorder; add the step `- start: recorder`, or leave out --record"
            )
        self._runbook, self._bus, self._supervisor, self._ui = runbook, bus, supervisor, face
        self._clock = bus.clock
        self._data, self._recording, self._is_unattended = data, recording, is_unattended
        self._is_recording = False
        self._bus_lost_s: float | None = None
        self._publisher = RunbookPublisher(bus, runbook)
        self._exit_policy = ExitPolicy(
            runbook, supervisor, face, self._publisher, self._on_restart, is_unattended=is_unattended
        )
        self.answers: list[Answer] = []
        self.episode: RecordAnswer | None = None

    def run(self, stop: threading.Event, *, for_s: float | None = None) -> int:
        """Run until a command server finishes, `for_s` has passed or `stop` is set; return an exit code.

        Raises:
            Refused: a server of this runbook already runs on the bus, or an emergency stop is latched.
        """
        self._refuse_a_second_station()
        self._look_at_hosts()
        if not self.recorder_host and (line := left_open.offer(self._data)) is not None:
            self._ui.report(line, "warning")
        with EventFeed(self._bus) as feed, StopMemory(self._bus, NAME) as memory:
            if (latched := memory.latched()) is not None:
                raise Refused(f"{latched}, then start again")
            with self._publisher:
                try:
                    self._start_all(feed, memory, stop)
                    reason, code = self._watch_over(feed, memory, stop, for_s)
                except StationError as error:
                    is_asked = stop.is_set()
                    reason, code = (f"stopped: {error}", _INTERRUPTED) if is_asked else (f"failed: {error}", 1)
                if code == 1 and memory.latched() is not None:
                    self._clock.sleep(_TOLD_S)
                    feed.look()
                self._print_events(feed)
                self._ui.report(reason, "error" if code == 1 else "info")
                code = self._stop_servers(code)
            if (latched := memory.latched()) is not None:
                self._ui.report(f"{latched}; until then nothing starts", "warning")
            return code

    def _refuse_a_second_station(self) -> None:
        wanted = {step.start for step in self._runbook.servers}
        for health in read_health(self._bus):
            if health.name in wanted and health.is_alive:
                raise Refused(
                    f"server {health.name!r} already runs on {self._bus.address} (pid {health.pid} on {health.host}); "
                    "stop that station first, or use another bus with --bus"
                )

    @property
    def recorder_host(self) -> str:
        """The machine that its recorder runs on; "" for this one, and for none."""
        return next((step.host for step in self._runbook.servers if step.start == _RECORDER), "")

    def _look_at_hosts(self) -> None:
        """Find the other machines that it needs.

        Raises:
            NotReady, Refused: one has not joined, or runs servers of another station.
        """
        for host in dict.fromkeys(step.host for step in self._runbook.servers if step.host):
            version = self._supervisor.hosts.expect(host).version
            if version != software().version:
                self._ui.report(
                    f"host {host} has version {version or 'unknown'} of the station, this machine "
                    f"{software().version or 'unknown'}: install the same on both",
                    "warning",
                )

    def _start_all(self, feed: EventFeed, memory: StopMemory, stop: threading.Event) -> None:
        self._spawn_next()
        for number, step in enumerate(self._runbook.steps):
            if stop.is_set():
                raise NotReady("asked to stop before everything had started")
            self._publisher.step(number, "now")
            try:
                result = self._run_step(step, feed, memory, stop)
            except StationError as error:
                self._publisher.step(number, "failed", str(error))
                raise
            self._publisher.step(number, "done", result)
            self._print_events(feed)

    def _spawn_next(self) -> None:
        """In a simulation, have servers that are not there yet load side by side, up to one that loads first."""
        if self._runbook.robot_is_real:
            return
        for server in self._runbook.servers:
            if server.start not in self._supervisor.children:
                self._spawn(server)
                if server.kind.loads_first:
                    break

    def _run_step(self, step: Step, feed: EventFeed, memory: StopMemory, stop: threading.Event) -> str:
        self._ui.begin(str(step))
        try:
            self._hold(memory, stop)
            result = self._result(step, feed, memory, stop)
        except StationError:
            self._ui.failed(self._to_blame(step), "stopped" if stop.is_set() else "failed")
            raise
        self._ui.done(str(step), result)
        if isinstance(step, StartStep) and step.start == _RECORDER and self._recording is not None:
            self._record(self._recording, stop)
        return result

    def _to_blame(self, step: Step) -> str:
        """Return the step that failed: servers load side by side, and while one is waited for another may die."""
        dead = self._supervisor.ended()
        if isinstance(step, StartStep) and step.start not in dead:
            return next((str(other) for other in self._runbook.servers if other.start in dead), str(step))
        return str(step)

    def _hold(self, memory: StopMemory, stop: threading.Event) -> bool:
        """Go no further while the emergency stop is latched; return whether it was, and a person has released it."""
        latched = memory.latched()
        if latched is None:
            return False
        if self._is_unattended or not self._ui.is_attended:
            raise NotReady(str(latched))
        self._ui.report(f"{latched}; until then nothing goes on", "error")
        while memory.latched() is not None:
            if self._clock.wait(stop, _LOOK_S):
                raise NotReady("asked to stop while the emergency stop was latched")
        self._ui.report("the emergency stop is released", "warning")
        return True

    def _result(self, step: Step, feed: EventFeed, memory: StopMemory, stop: threading.Event) -> str:
        if isinstance(step, StartStep):
            return self._start(step, stop)
        if isinstance(step, CheckStep):
            found = (
                self._look_at_disk(step.what)
                if isinstance(step.what, DiskCheck)
                else step.what.run(self._bus, self._data, stop)
            )
            return self._record_answer(step, found, who="station")
        if isinstance(step, ConfirmStep):
            return self._confirm(step, memory, stop)
        if isinstance(step, QuestionStep):
            return self._ask(step, memory, stop)
        if isinstance(step, MeasureStep):
            return self._measure(step, feed, memory, stop)
        return self._record_answer(step, "shown", who="station")

    def _look_at_disk(self, check: DiskCheck) -> str:
        """Look whether there is room where the recorder runs."""
        configs: dict[str, object] = {server.start: server.config for server in self._runbook.servers}
        need = disk_need(configs, self._data, self._recording.task if self._recording else None)
        if not self.recorder_host:
            return check.look(self._data, need)
        there = self._supervisor.hosts.expect(self.recorder_host)
        return check.judge(there.free_gb, f"host {self.recorder_host}, {there.data}", need)

    def _start(self, step: StartStep, stop: threading.Event) -> str:
        if step.start not in self._supervisor.children:
            self._spawn(step)
        self._supervisor.wait_for(step.start, "inactive", step.ready_within_s, stop=stop)
        self._expect_robot(step)
        self._supervisor.activate(step.start)
        health = self._supervisor.wait_for(step.start, "active", step.ready_within_s, stop=stop)
        if step.kind.loads_first:
            self._spawn_next()
        took_s = self._clock.monotonic_s() - self._supervisor.children[step.start].started_s
        return f"active after {took_s:.1f} s, pid {health.pid}"

    def _expect_robot(self, step: StartStep) -> None:
        """Compare the robot that the runbook names with those that its servers drive, when the last of them is loaded.

        Raises:
            ConfigError: none of them drives it.
        """
        low_level = [each.start for each in self._runbook.low_level]
        if not self._runbook.robot or step.start not in low_level[-1:]:
            return
        try:
            driven = [arm_request.robot_of(self._bus, name) for name in low_level]
        except NotReady:
            return  # one that states nothing of its robot may drive any
        if self._runbook.robot not in driven:
            raise ConfigError(
                f"runbook {self._runbook.name}: robot: expected what its servers drive, {' or '.join(driven)}, "
                f"got {self._runbook.robot!r}"
            )

    def _spawn(self, step: StartStep) -> None:
        restarts = Restarts() if step.if_it_dies == "restart" else None
        self._supervisor.spawn(step.start, step.config, server=step.kind.name, host=step.host, restarts=restarts)

    def _confirm(self, step: ConfirmStep, memory: StopMemory, stop: threading.Event) -> str:
        if self._is_unattended:
            return self._record_answer(step, "yes (unattended)", who=_UNATTENDED)
        while True:
            given = self._given(
                step.confirm, _YES_NO, lambda is_answered: _YES_NO[not self._ui.confirm(step.confirm, is_answered)]
            )
            if given is None or given.answer != "yes":
                raise NotReady(f"not confirmed{_by(given)}: {step.confirm}")
            if not self._hold(memory, stop):  # what was confirmed before a stop has to be seen again after it
                return self._record_answer(step, "yes", who=given.who, where=given.where)

    def _ask(self, step: QuestionStep, memory: StopMemory, stop: threading.Event) -> str:
        given, is_held = GivenAnswer("not asked", _UNATTENDED, ""), not self._is_unattended
        while is_held:
            found = self._given(
                step.ask, step.answers, lambda is_answered: self._ui.ask(step.ask, step.answers, is_answered)
            )
            if found is None:
                raise NotReady(f"not answered: {step.ask}")
            given, is_held = found, self._hold(memory, stop)
        self._supervisor.publish("answered", "info", question=step.ask, answer=given.answer, who=given.who)
        return self._record_answer(step, given.answer, who=given.who, where=given.where)

    def _given(
        self, sentence: str, answers: Sequence[str], prompt: Callable[[Callable[[], bool]], str]
    ) -> GivenAnswer | None:
        """Ask at the terminal and on the bus; return the first answer, and tell the terminal if it is of another."""
        given = self._publisher.ask(sentence, answers, prompt)
        if given is not None and given.where != TERMINAL:
            self._ui.report(f"{sentence}  {given}", "warning")
        return given

    def _on_restart(self, names: str, given: GivenAnswer) -> None:
        if given.where != TERMINAL:
            self._ui.report(f"{names}: {given}", "warning")
        self._keep_answer(f"restart {names}", given.answer, who=given.who, where=given.where)

    def _measure(self, step: MeasureStep, feed: EventFeed, memory: StopMemory, stop: threading.Event) -> str:
        """Measure, show what came of it, and keep that.

        Raises:
            NotReady: something is not as expected, or it could not be measured.
        """
        from station.supervision.measuring import measured  # it loads NumPy

        measure, faults = step.what, list[Event]()

        def meanwhile(elapsed_s: float) -> list[Event]:
            if stop.is_set():
                raise NotReady("asked to stop while it was measured")
            if memory.is_stopped:
                raise NotReady(f"{memory.latched()}; it was pressed while it was measured")
            for dead, code in self._supervisor.ended().items():
                words = self._supervisor.last_words(dead)
                raise NotReady(f"server {dead!r} {how_it_ended(code)} while it was measured: {words}")
            happened = self._print_events(feed)
            faults.extend(event for event in happened if event.severity == "error")
            self._ui.begin(f"{step}  {elapsed_s:.0f} of {measure.for_s:g} s")
            return happened

        found = measured(measure, self._bus, self._robots(), meanwhile)
        if measure.after_commands is None:  # there a fault is what is waited for
            told = "; ".join(map(str, faults)) or "none"
            found.append(Figure(name="faults", text=told, expected="none" if faults else "", is_good=not faults))
        bad = [figure for figure in found if not figure.is_good]
        for line, figure in zip(table(found), found, strict=True):
            self._ui.report(line, "info" if figure.is_good else "error")
        figures = [msgspec.to_builtins(figure) for figure in found]
        self._supervisor.publish("measured", "warning" if bad else "info", what=measure.measure, figures=figures)
        self._record_answer(step, "; ".join(f"{figure.name}: {figure.text}" for figure in found), who="station")
        if bad and measure.if_not == "stop":
            first, *others = bad
            beside = f"; nor are {', '.join(figure.name for figure in others)}" if others else ""
            raise NotReady(
                f"{measure.measure}: {first.name} is not as expected ({first.expected}): {first.text}{beside}; look at "
                "it before you go on (`if_not: continue` in the runbook goes on all the same)"
            )
        if bad:
            return f"not as expected: {', '.join(figure.name for figure in bad)}; goes on"
        return "as expected" if any(figure.expected for figure in found) else "kept"

    def _robots(self) -> list[str]:
        """Return the names of the robots that it drives."""
        named = [self._runbook.robot] if self._runbook.robot else []
        with contextlib.suppress(NotReady):
            named += arm_request.robots_of(self._bus).values()
        return list(dict.fromkeys(named))

    def _record_answer(self, step: Step, answer: str, *, who: str, where: str = "") -> str:
        self._keep_answer(str(step), answer, who=who, where=where)
        return answer

    def _keep_answer(self, step: str, answer: str, *, who: str, where: str) -> None:
        is_unattended, wall_ns = who == _UNATTENDED and not where, self._clock.wall_ns()
        self.answers.append(
            Answer(step=step, answer=answer, who=who, wall_ns=wall_ns, where=where, is_unattended=is_unattended)
        )

    def _record(self, recording: Recording, stop: threading.Event) -> None:
        """Begin the episode, once everything is loaded that loads already: what cannot start leaves no episode."""
        for step in self._runbook.servers:
            if step.start in self._supervisor.children:
                self._supervisor.wait_for(step.start, "inactive", step.ready_within_s, stop=stop)
        self.episode = remote.ask(self._bus, "start", runbook=self._told(), **msgspec.to_builtins(recording))
        self._is_recording = True
        where = f" on host {self.recorder_host}" if self.recorder_host else ""
        self._ui.report(f"recording {self.episode.path}{where}")

    def _told(self) -> dict[str, Any]:
        """Return what a manifest says of the runbook."""
        return {
            "name": self._runbook.name,
            "answers": msgspec.to_builtins(self.answers),
            "text": self._runbook.text,
        }

    def _watch_over(
        self, feed: EventFeed, memory: StopMemory, stop: threading.Event, for_s: float | None
    ) -> tuple[str, int]:
        """Show how the station is doing until it should end; return why, and an exit code."""
        deadline = None if for_s is None else self._clock.monotonic_s() + for_s
        while not self._clock.wait(stop, _LOOK_S):
            self._print_events(feed)
            health = self._poll_health()
            self._restate_stop(memory)
            if (end := self._exit_policy.check(health, memory.latched)) is not None:
                return end
            if deadline is not None and self._clock.monotonic_s() > deadline:
                return f"{for_s:g} s are over", int(self._exit_policy.are_open)
            if self._bus_lost_s is not None and self._clock.monotonic_s() - self._bus_lost_s > _BUS_GONE_S:
                return f"the bus {self._bus.address} has been gone for {_BUS_GONE_S:.0f} s", 1
        return "stopped", int(self._exit_policy.are_open)

    def _print_events(self, feed: EventFeed) -> list[Event]:
        """Show what happened since the last call, and return it."""
        for event in self._supervisor.publisher.recent:
            feed.add(event)
        found = list(feed.pop())
        for event in found:
            if event.name not in _TOLD_OTHERWISE:
                self._ui.report(f"{event.source}: {event}", event.severity)
        return found

    def _restate_stop(self, memory: StopMemory) -> None:
        with contextlib.suppress(BusError):  # it is gone again; the next look tries again
            if reason := memory.poll():
                self._supervisor.publish("estop-restated", "warning", reason=reason)

    def _poll_health(self) -> list[Health] | None:
        """Show the servers' health and return it; None while the bus is gone."""
        try:
            health = read_health(self._bus)
        except BusError as error:
            if self._bus_lost_s is None:
                self._bus_lost_s = self._clock.monotonic_s()
                self._ui.report(f"{error}; the servers hold their robots; waiting for it to come back", "error")
            return None
        self._ui.show(health)
        if self._bus_lost_s is not None:
            self._ui.report(f"the bus is back after {self._clock.monotonic_s() - self._bus_lost_s:.1f} s", "warning")
            self._bus_lost_s = None
        return health

    def _stop_servers(self, code: int) -> int:
        """Stop the servers, newest first or as the runbook has it; the episode is closed before its recorder."""
        newest_first = tuple(step.start for step in reversed(self._runbook.servers))
        order: Sequence[str] = self._runbook.stop_order if code == 1 else newest_first
        for name in [n for n in order if n in self._supervisor.children]:
            if name == _RECORDER and self._is_recording:
                self._finish_episode()
            if not self._stop(name):
                code = code or 1
        return code

    def _stop(self, name: str) -> bool:
        """Stop a server; return whether it ended cleanly."""
        step, began_s = f"stop {name}", self._clock.monotonic_s()
        has_ended = name in self._supervisor.ended()
        self._ui.begin(step)
        code = self._supervisor.stop(name)
        is_clean = code in (0, -signal.SIGTERM)  # one that is stopped while it loads dies of our signal, and may
        if not is_clean:
            self._ui.failed(step, f"{'already ' * has_ended}{how_it_ended(code)}")
        else:
            self._ui.done(step, "already ended" if has_ended else f"after {self._clock.monotonic_s() - began_s:.1f} s")
        return is_clean

    def _finish_episode(self) -> None:
        self._is_recording = False
        if _RECORDER in self._supervisor.ended() or not self._bus.is_connected:
            gone = "bus" if not self._bus.is_connected else "recorder"
            self._ui.report(f"the {gone} is gone: the episode ends where it was last written to disk", "error")
            return
        self._ui.begin("close the episode")
        try:
            self.episode = remote.ask(self._bus, "stop", runbook=self._told())
        except StationError as error:
            self._ui.report(f"the episode was not closed here: {error}", "warning")


def _by(given: GivenAnswer | None) -> str:
    return f" by {given.who} ({given.where})" if given is not None and given.where != TERMINAL else ""
