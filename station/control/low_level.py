"""The loop of a low-level server: a control step between the bus's commands and the bus's recordings.

Knows no robot, and no policy. Two paces: the wall clock at a fixed rate, or lock-step, where a tick waits for a command
that is newer than the last and the gate's clock is that of the ticks.
"""

from __future__ import annotations

import contextlib
import logging
import math
from collections import Counter
from collections.abc import Callable, Mapping
from typing import Any, Generic, Self, TypeVar

import msgspec
import numpy as np

from station.bus import codec, keys
from station.control.command_arbiter import CommandArbiter, News, spoken
from station.control.command_path import CommandPath, Control, Record, StepEvent
from station.control.command_receiver import CommandReceiver, CommandWatch
from station.control.command_validator import CommandSample, Samples
from station.control.control import StepRecord
from station.control.phase_lock import PhaseLock
from station.errors import BusError, Refused
from station.life import estop
from station.life.arm_request import ArmAnswer, ArmRequest
from station.life.controller_request import ControllerAnswer
from station.life.loop import Rate
from station.life.policy_request import PolicyAnswer
from station.life.request import OVERTAKEN, Asked, DoneRequests, NewRequests, parse
from station.life.server import Life
from station.life.stop_file import StopKeeper
from station.life.writer_conflict import FOREIGN

log = logging.getLogger(__name__)

_REPORT_S = 0.5
_TOO_EARLY = "the release came before this robot had acted on the stop: it stays stopped; `station estop --reset`"


StateT = TypeVar("StateT")
RecordT = TypeVar("RecordT", bound=Record)


class LowLevelLoop(Generic[StateT, RecordT]):
    """Ticks of a low-level server; a context manager, since it watches the bus.

    Args:
        life: The server's.
        control: The step.
        state_values: Makes the values that tell of the state; there may be none.
        result_values: Makes those that are published after a step, with the answer to the last request to arm.
        period_s: Control period [s].
        requests: Keys of further requests to this robot, and what does them; called in the loop, between ticks.
        acts_first: Whether a state is published once the robot was sent what it led to, half a millisecond earlier. A
            simulation publishes it at the start of a tick, before its physics.
    """

    def __init__(
        self,
        life: Life,
        control: Control[StateT, RecordT],
        *,
        state_values: Callable[[StateT], Mapping[str, bytes]],
        result_values: Callable[[RecordT, ArmAnswer | None], Mapping[str, bytes]],
        period_s: float,
        requests: Mapping[str, Callable[[Asked], None]] | None = None,
        acts_first: bool = False,
    ) -> None:
        self._life, self._control, self._clock = life, control, life.clock
        self._state_values, self._result_values = state_values, result_values
        self._period_s, self._requests, self._acts_first = period_s, dict(requests or {}), acts_first
        self._paths = control.commanded.paths
        self._watches, self._receivers = list[CommandWatch](), list[CommandReceiver]()
        for path in self._paths:
            key, config, is_first = path.command_format.key, path.gate.config, not self._watches
            asked = (*estop.KEYS, keys.ARM, *self._requests) if is_first else ()
            bus, wanted = life.bus, [key, *asked]
            self._watches.append(CommandWatch(bus.address, wanted, key=key, outages=bus.outages, clocks=bus.clocks))
            arbiter = CommandArbiter(config.rivals, config.return_after_s)
            self._receivers.append(CommandReceiver(self._watches[-1], key, arbiter))
        self._watch, self._receiver, self._key = self._watches[0], self._receivers[0], self._paths[0].command_format.key
        self._stopped_past_bus = ""  # why it is asked to past the bus, and has not obeyed yet
        self._keeper = StopKeeper(life.bus.address)
        self._arm_asked = NewRequests(self._watch, keys.ARM)
        self._arm_answer: ArmAnswer | None = None
        self._arm_done = DoneRequests[ArmAnswer]()
        self._asked = {key: NewRequests(self._watch, key) for key in self._requests}
        self._said_s = -math.inf
        self._bus_is_lost = False
        life.on_estop(self._on_supervisor_stop)
        life.on_bus_back(self._restate_stop)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        for watch in self._watches:
            watch.close()
        self._keeper.close()

    def run_at(self, rate: Rate) -> None:
        """Tick at a fixed rate until the server is asked to stop; an emergency stop does not wait for its tick.

        Ticks move to just behind the commands, those of the first part where there are several.
        """
        phase, followed = PhaseLock(rate.period_ns * 1e-9), None
        self._begin()
        while not self._life.stopping:
            rate.wait(self._watch.urgent)
            self._watch.urgent.clear()
            state = self._sense()
            now_s = self._clock.monotonic_s()
            self._obey(now_s)
            commands = tuple(receiver.newest() for receiver in self._receivers)
            self._act(state, commands, now_s)
            if (first := commands[0]) is not None and first is not followed and first.arrived_s is not None:
                followed = first
                rate.shift(phase.on_tick(first.source, now_s - first.arrived_s))
            if self._is_time_to_report():
                self._report(**msgspec.structs.asdict(rate.stats()), follows_commander=phase.is_locked)

    def run_in_lock_step(self, timeout_s: float) -> None:
        """Tick with the commander until the server is asked to stop.

        Nothing moves before the first command. When none comes in time, ticks go on at the control period (so that
        the gate holds and returns) until the next one.
        """
        tick, patience_s, started = 0, timeout_s, False
        began_s = self._clock.monotonic_s()
        self._begin()
        while not self._life.stopping:
            now_s = tick * self._period_s
            state = self._sense()
            has_come = self._await_command(patience_s, now_s)
            started = started or has_come
            patience_s = timeout_s if has_come or not started else self._period_s
            was_told = self._obey(now_s)
            if started or was_told:
                newest = tuple(receiver.newest(now_s) for receiver in self._receivers) if started else None
                self._act(state, newest, now_s)
                tick += 1
            if self._is_time_to_report():
                elapsed_s = self._clock.monotonic_s() - began_s
                self._report(rate_hz=tick / elapsed_s)

    def _begin(self) -> None:
        """Obey a stop that holds now; of one that was released before this robot was driven nothing remains."""
        self._watch.begin_stops()
        if (found := estop.latched(self._watch.latest)) is not None:
            self._stop(found[0].reason)
        elif (latched := self._keeper.file.read()) is not None:  # by a bus that is gone
            self._control.stop(latched.reason)
            self._life.event("estop-remembered", severity="warning", reason=str(latched))
            with contextlib.suppress(BusError):  # it is gone again; once it is back, `_restate_stop` is called
                estop.restate(self._life.bus, latched.reason, self._life.name)

    def _stop(self, reason: str) -> None:
        """Stop the robot, and keep that until it is released."""
        self._control.stop(reason)
        self._keeper.latch(reason)

    def _await_command(self, patience_s: float, now_s: float) -> bool:
        """Wait for a command newer than the last; return early, False, when asked for something else."""
        end_s = self._clock.monotonic_s() + patience_s
        while not self._life.stopping and not self._is_asked():
            left_s = end_s - self._clock.monotonic_s()
            wait_s = max(0.0, min(left_s, self._period_s))
            if self._watch.wait(self._key, after=self._receiver.seen, timeout_s=wait_s) and self._receiver.has_come(
                now_s
            ):
                return True
            if left_s <= 0:
                return False
        return False

    def _sense(self) -> StateT:
        state = self._control.sense()
        if not self._acts_first:
            self._publish(self._state_values(state))
        return state

    def _is_asked(self) -> bool:
        return bool(self._stopped_past_bus) or self._watch.has_stop_news or self._arm_asked.has_come

    def _obey(self, now_s: float) -> bool:
        """Do what an operator asks for; return whether something was newly asked."""
        is_told = self._obey_stop(now_s)
        for key, act in self._requests.items():
            if (asked := self._asked[key].pop()) is not None:
                act(asked)
        return self._obey_arm(now_s) or is_told

    def _obey_arm(self, now_s: float) -> bool:
        if (asked := self._arm_asked.pop()) is None:
            return False
        try:
            request = parse(asked.data, ArmRequest, "an arm request")
        except Refused as error:
            self._life.event("request-refused", severity="warning", reason=str(error))
            return False
        if request.server not in ("", self._life.name):
            return False
        if (known := self._arm_done.get(request.id)) is not None:  # its asker has not seen the answer yet
            self._arm_answer = known
            return False
        who = ", ".join(word for word in (request.who, request.reason) if word)
        refused, was = "", self._control.commanded.arming.state
        is_overtaken = self._arm_done.begin(asked.first_ns(request.late_s))
        if request.action == "arm" and is_overtaken and was == "disarmed":
            refused = OVERTAKEN
            self._life.event("arm-refused", severity="warning", who=who, reason=refused)
        elif request.action == "arm":
            refused = self._control.arm(now_s, who)
        else:
            self._control.disarm(who)
        began = request.action == "arm" and was == "disarmed" and not refused
        self._arm_answer = ArmAnswer(id=request.id, action=request.action, refused=refused, began=began)
        self._arm_done.put(request.id, self._arm_answer)
        return True

    def _on_supervisor_stop(self, reason: str) -> None:
        self._stopped_past_bus = reason
        self._watch.urgent.set()

    def _restate_stop(self) -> None:
        """Restate on a bus that has forgotten it that we are stopped, for servers that start only now."""
        gate = self._paths[0].gate
        if gate.state == "stopped" and estop.restate(self._life.bus, gate.reason, self._life.name):
            self._keeper.latch(gate.reason)
            self._life.event("estop-restated", severity="warning", reason=gate.reason)

    def _obey_stop(self, now_s: float) -> bool:
        if reason := self._stopped_past_bus:
            self._stopped_past_bus = ""
            before = self._watch.pop_stop()  # what was written until now releases nothing
            self._stop(reason)
            if before is not None and (before.is_release_refused or not before.request.stop):
                self._life.event("release-refused", severity="warning", reason=_TOO_EARLY)
            return True
        news = self._watch.pop_stop()
        if news is None:
            return False
        if news.request.stop:
            self._stop(news.request.reason)
        else:
            self._control.reset(news.request.reason)
            self._keeper.release(news.request.reason)
            if news.request.arm:
                self._control.arm(now_s, news.request.reason)
        if news.is_release_refused:
            self._life.event("release-refused", severity="warning", reason=_TOO_EARLY)
        return True

    def _act(self, state: StateT, command: Samples, now_s: float) -> None:
        for path, receiver in zip(self._paths, self._receivers, strict=True):
            if refused := receiver.pop_refused():
                path.refuse_rivals(refused, receiver.writers.refusal)
            path.heard_all(*receiver.heard_s)
        record = self._control.step(state, command, now_s)
        of_state = self._state_values(state) if self._acts_first else {}
        self._publish({**of_state, **self._result_values(record, self._arm_answer)})
        for step_event in record.step_events:
            self._publish_step(step_event)
        for path, receiver in zip(self._paths, self._receivers, strict=True):
            for news in receiver.writers.pop_news(now_s):
                self._publish_writers(path.command_format.key, news)

    def _publish_writers(self, key: str, news: News) -> None:
        detail: dict[str, Any] = {"key": key, "writers": list(news.writers), "obeyed": spoken(news.obeyed)}
        if news.kind == "handover":
            self._life.event("command-handover", **detail, reason=news.reason)
        elif news.kind == "alone":
            self._life.event("second-writer", **detail, ended=True, writes_refused=news.refused)
        else:
            others = [spoken(writer) for writer in news.writers if writer != news.obeyed]
            self._life.event("second-writer", severity="warning", **detail, refused=others)

    def _publish(self, values: Mapping[str, bytes]) -> None:
        if not values:
            return
        is_lost = not self._life.bus.publish(values)
        if is_lost and not self._bus_is_lost:
            # Only the log can hear this one; `bus-back` follows on the bus with the count.
            log.warning("bus lost: the loop goes on, commands are held and then left")
        self._bus_is_lost = is_lost

    def _publish_step(self, step_event: StepEvent) -> None:
        self._life.event(step_event.name, severity=step_event.severity, **step_event.detail)

    def _is_time_to_report(self) -> bool:
        now_s = self._clock.monotonic_s()
        if now_s - self._said_s < _REPORT_S:
            return False
        self._said_s = now_s
        return True

    def _report(self, **loop: float | bool) -> None:
        commanded = self._control.commanded
        validator = self._paths[0].validator
        refused = sum((path.validator.refused for path in self._paths), Counter[str]())
        self._life.report(
            gate=commanded.state, gate_reason=commanded.reason, arming=commanded.arming.state,
            command_age_by=_age_by(validator.good),
            command_writer=self._receiver.writers.obeyed and spoken(self._receiver.writers.obeyed),
            refused=dict(refused), clamped=sum(path.validator.clamped_samples for path in self._paths),
            **self._control.health(), **loop,
        )  # fmt: skip


def _age_by(command: CommandSample | None) -> str:
    """Return what tells the age of a command, for people."""
    if command is None:
        return ""
    if command.delay_s is not None:
        return "stamp and arrival"
    is_native = command.source not in ("", FOREIGN) and not command.written_ns
    return "arrival alone, the clock of its machine is not known" if is_native else "arrival alone"


def result_values(
    suffix: str,
    record: StepRecord,
    commanded: CommandPath,
    answer: ArmAnswer | None = None,
    switch: PolicyAnswer | None = None,
    controller: ControllerAnswer | None = None,
) -> dict[str, bytes]:
    """Return what a step of a policy publishes after its targets were sent, by key.

    Args:
        suffix: Of the robot's keys.
        record: The step.
        commanded: Its command's way.
        answer: To the last request to arm.
        switch: To the last request for another policy.
        controller: To the last request to the robot's own controller.
    """
    decision, sent = record.decision, record.sent
    gate = commanded.status(decision)
    if answer is not None:
        gate["arm"] = msgspec.structs.asdict(answer)
    if record.policy:
        gate |= {"policy": record.policy, "next_policy": record.next_policy}
    if switch is not None:
        gate["switch"] = msgspec.structs.asdict(switch)
    if controller is not None:
        gate["controller"] = msgspec.structs.asdict(controller)
    return {
        **_values_of_parts(record, commanded),
        keys.policy_obs(suffix): codec.f32(record.observation),
        keys.policy_action(suffix): codec.f32(record.action),
        keys.target(suffix): codec.f64(np.concatenate([sent.q, sent.kp, sent.kd])),
        keys.command_gate(suffix): codec.json_object(gate),
        keys.command_used(suffix): codec.f64(decision.vector),
        keys.policy_timing(suffix): codec.json_vector((record.tick, record.command_seq, *record.timing_ns)),
    }


def _values_of_parts(record: StepRecord, commanded: CommandPath) -> dict[str, bytes]:
    """Return what a step tells of each part of a robot whose parts are commanded apart, by key; else nothing."""
    values: dict[str, bytes] = {}
    for path, part in zip(commanded.paths, record.decision.parts, strict=False):
        good = path.validator.good
        command = (good.seq, good.written_ns, good.arrived_ns) if good is not None else (0, 0, 0)
        row = (record.tick, *command, record.decision.at_s)
        values[keys.command_timing(path.command_format.robot)] = codec.json_vector(row)
        values[keys.command_gate(path.command_format.robot)] = codec.json_object(path.status(part))
        values[keys.command_used(path.command_format.robot)] = codec.f64(part.vector)
    return values
