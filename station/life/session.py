"""One station from the first check to the last farewell: runs a runbook, watches over it, takes it down in reverse."""

from __future__ import annotations

import getpass
import threading
import time
from pathlib import Path
from typing import Any, Protocol

import msgspec

from station.bus import keys
from station.bus.client import Bus
from station.episode import remote
from station.episode.request import RecordAnswer
from station.errors import ConfigError, NotReady, Refused, StationError
from station.life import checks, events
from station.life.runbook import CheckStep, ConfirmStep, NoteStep, Runbook, StartStep, Step
from station.life.server import Health, read_health
from station.life.supervisor import Supervisor

_LOOK_S = 0.1
_RECORDER = "recorder"


class Answer(msgspec.Struct, frozen=True, kw_only=True):
    """What was found or said at a step, for the manifest."""

    step: str
    answer: str
    who: str
    wall_ns: int
    is_unattended: bool = False


class Recording(msgspec.Struct, frozen=True, kw_only=True):
    """What is to be recorded, as the operator named it."""

    task: str
    instruction: str = ""
    operator: dict[str, str] = {}


class Face(Protocol):
    """How a session shows itself and asks; the command line implements it."""

    def begin(self, step: str) -> None:
        """A step begins."""
        ...

    def done(self, step: str, result: str) -> None:
        """A step is done."""
        ...

    def say(self, text: str) -> None:
        """Something happened."""
        ...

    def confirm(self, sentence: str) -> bool:
        """Ask a person; whether the answer was yes."""
        ...

    def show(self, health: list[Health]) -> None:
        """How the servers are doing, a few times a second."""
        ...


class Session:
    """A running station.

    Args:
        runbook: What to do.
        bus: The bus it runs on.
        supervisor: Starts the processes.
        face: Shows and asks.
        data: Folder of episodes.
        recording: What to record; None records nothing until somebody asks the recorder.
        is_unattended: Answer confirmations with yes, recorded as such; refused for a real robot.
    """

    def __init__(
        self,
        runbook: Runbook,
        bus: Bus,
        supervisor: Supervisor,
        face: Face,
        *,
        data: Path,
        recording: Recording | None = None,
        is_unattended: bool = False,
    ) -> None:
        if is_unattended and runbook.robot_is_real:
            raise ConfigError(f"runbook {runbook.name}: --yes is refused, because people stand beside a real robot")
        self._runbook, self._bus, self._supervisor, self._face = runbook, bus, supervisor, face
        self._data, self._recording, self._is_unattended = data, recording, is_unattended
        self._is_recording = False
        self.answers: list[Answer] = []
        self.episode: RecordAnswer | None = None

    def run(self, stop: threading.Event, *, for_s: float | None = None) -> int:
        """Run until a command server finishes, `for_s` has passed or `stop` is set; return an exit code."""
        self._refuse_a_second_station()
        try:
            if not self._runbook.robot_is_real:
                self._spawn_all()
            for step in self._runbook.steps:
                if stop.is_set():
                    return self._leave("stopped before everything had started", code=130)
                self._take(step)
            reason, code = self._watch_over(stop, for_s)
        except StationError as error:
            self._face.say(f"failed: {error}")
            return self._leave("failed", code=1, order=self._runbook.stop_order)
        return self._leave(reason, code, order=self._runbook.stop_order if code else None)

    def _refuse_a_second_station(self) -> None:
        wanted = {step.start for step in self._runbook.servers}
        for health in read_health(self._bus):
            if health.name in wanted and health.is_alive:
                raise Refused(
                    f"server {health.name!r} already runs on {self._bus.address} (pid {health.pid} on {health.host}); "
                    "stop that station first, or use another bus with --bus"
                )

    def _spawn_all(self) -> None:
        for step in self._runbook.servers:
            self._supervisor.spawn(step.start, step.config)

    def _take(self, step: Step) -> None:
        self._face.begin(str(step))
        result = self._result(step)
        self._face.done(str(step), result)
        if isinstance(step, StartStep) and step.start == _RECORDER and self._recording is not None:
            self._record(self._recording)

    def _result(self, step: Step) -> str:
        if isinstance(step, StartStep):
            return self._start(step)
        if isinstance(step, CheckStep):
            return self._note(step, checks.run(step, self._bus, self._data), who="station")
        if isinstance(step, ConfirmStep):
            return self._confirm(step)
        return self._note(step, "shown", who="station")

    def _start(self, step: StartStep) -> str:
        if step.start not in self._supervisor.children:
            self._supervisor.spawn(step.start, step.config)
        self._supervisor.wait_for(step.start, "inactive", step.ready_within_s)
        self._supervisor.activate(step.start)
        health = self._supervisor.wait_for(step.start, "active", step.ready_within_s)
        took_s = time.monotonic() - self._supervisor.children[step.start].started_s
        return f"active {took_s:.1f} s after its start (pid {health.pid})"

    def _confirm(self, step: ConfirmStep) -> str:
        if self._is_unattended:
            return self._note(step, "yes (unattended)", who="--yes")
        if not self._face.confirm(step.confirm):
            raise NotReady(f"not confirmed: {step.confirm}")
        return self._note(step, "yes", who=getpass.getuser())

    def _note(self, step: CheckStep | ConfirmStep | NoteStep, answer: str, *, who: str) -> str:
        self.answers.append(
            Answer(step=str(step), answer=answer, who=who, wall_ns=time.time_ns(), is_unattended=self._is_unattended)
        )
        return answer

    def _record(self, recording: Recording) -> None:
        runbook: dict[str, Any] = {
            "name": self._runbook.name,
            "answers": msgspec.to_builtins(self.answers),
            "text": self._runbook.text,
        }
        self.episode = remote.ask(self._bus, "start", runbook=runbook, **msgspec.to_builtins(recording))
        self._is_recording = True
        self._face.say(f"recording {self.episode.path}")

    def _watch_over(self, stop: threading.Event, for_s: float | None) -> tuple[str, int]:
        """Show how the station is doing until it should end; return why, and an exit code."""
        deadline = None if for_s is None else time.monotonic() + for_s
        roles = {step.start: step.kind.role for step in self._runbook.servers}
        newest = None
        with self._bus.watch([keys.EVENT]) as watch:
            while not stop.wait(_LOOK_S):
                sample = watch.latest(keys.EVENT)
                if sample is not newest and sample is not None and sample.arrived_ns is not None:
                    self._say_event(sample.value)
                newest = sample
                for name, code in self._supervisor.ended().items():
                    if code == 0 and roles[name] == "command":
                        return f"{name} has finished", 0
                    return f"server {name!r} ended with code {code}: {self._supervisor.last_words(name)}", 1
                if deadline is not None and time.monotonic() > deadline:
                    return f"{for_s:g} s are over", 0
                if self._bus.is_connected:
                    self._face.show(read_health(self._bus))
        return "stopped", 0

    def _say_event(self, data: bytes) -> None:
        event = events.decode(data)
        if event is not None:
            self._face.say(f"{event.source}: {event}")

    def _leave(self, reason: str, code: int, order: tuple[str, ...] | None = None) -> int:
        """Take the servers down, newest first or in the order given; the episode is closed before its recorder."""
        self._face.say(reason)
        names = order or tuple(step.start for step in reversed(self._runbook.servers))
        for name in [n for n in names if n in self._supervisor.children]:
            if name == _RECORDER and self._is_recording:
                self._finish_episode()
            ended = self._supervisor.stop(name)
            self._face.done(f"stop {name}", "stopped" if ended == 0 else f"ended with code {ended}")
            if ended != 0 and code == 0:
                code = 1
        return code

    def _finish_episode(self) -> None:
        self._is_recording = False
        try:
            self.episode = remote.ask(self._bus, "stop")
        except StationError as error:
            self._face.say(f"the episode was not closed: {error}")
