"""What an operator asks of others with a button: recorder, emergency stop, arming, another policy.

None of it holds up the caller.
"""

from __future__ import annotations

import getpass
import threading
from collections import deque
from functools import partial
from pathlib import PurePath
from typing import Any

from station.bus import codec, keys
from station.bus.client import Bus
from station.bus.watch import Watch
from station.episode.recorder import remote
from station.episode.storage.request import RecorderState
from station.errors import BusError, NotReady, Refused, StationError
from station.life import arm_request, policy_request
from station.life.arm_request import Action
from station.life.server import Life
from station.life.stop_button import StopButton
from station.operator.buttons import Pressed

RECORDING = ("record", "mark", "discard", "rerecord", "success")
"""Actions of `station.operator.buttons` that are the recorder's."""

_MOST_WAITING = 8
_ANSWERS_WITHIN_S = 20.0  # a stop waits for the disk
_GONE_S = 10.0  # it speaks twice a second; one that is started again takes a few


class RecordButtons:
    """Passes actions on to the recorder, in order, in a thread of its own; what is refused is an event.

    Args:
        life: Says the events; its bus is the recorder's.
        watch: Watches ``station:recorder``.
        task: Task of episodes that are started here; "" for that of the episode before.
        instruction: What to do, in words.
        operator: Who asks, for the manifest.
    """

    def __init__(self, life: Life, watch: Watch, *, task: str, instruction: str, operator: dict[str, Any]) -> None:
        self._life, self._watch, self._clock = life, watch, life.clock
        self._task, self._instruction, self._operator = task, instruction, operator
        self._own: tuple[int, bool] | None = None  # what the recorder last answered, and when: newer than its status
        self._changed = threading.Condition()
        self._wanted: deque[str] = deque()
        self._is_closed = False
        self._thread = self._clock.start(self._run, "record-buttons")

    def press(self, action: str) -> None:
        """Ask for one of `RECORDING`; never blocks."""
        with self._changed:
            has_room = len(self._wanted) < _MOST_WAITING
            if has_room:
                self._wanted.append(action)
                self._changed.notify()
        if not has_room:
            self._refused(action, "the recorder is still busy with what was asked before")

    def close(self, within_s: float = 2.0) -> None:
        """Let what was asked for be done, for so long [s]."""
        with self._changed:
            self._is_closed = True
            self._changed.notify()
        self._clock.join(self._thread, within_s)

    def _run(self) -> None:
        while (action := self._next()) is not None:
            try:
                self._do(action)
            except StationError as error:
                self._refused(action, str(error))

    def _next(self) -> str | None:
        """Wait for what is to be asked next; None when that was all."""
        with self._changed:
            self._clock.wait_for(self._changed, lambda: bool(self._wanted) or self._is_closed)
            return self._wanted.popleft() if self._wanted else None

    def _do(self, action: str) -> None:
        if action == "record":
            if self._is_recording():
                self._ask("stop")
            else:
                self._start()
        elif action == "rerecord":
            self._ask("discard", label="begun anew by the operator")
            self._start()
        elif action == "discard":
            self._ask("discard", label="discarded by the operator")
        else:
            self._ask("mark", label=action, success=True if action == "success" else None)

    def _start(self) -> None:
        task = self._task or self._last_task() or "teleop"
        self._ask("start", task=task, instruction=self._instruction, operator=self._operator)

    def _ask(self, action: Any, **fields: Any) -> None:
        sample = self._watch.latest(keys.RECORDER)
        now_ns = self._clock.monotonic_ns()
        if sample is None or (sample.arrived_ns is not None and sample.age_s(now_ns) > _GONE_S):
            raise NotReady("no recorder runs; start one with `station serve recorder`")
        remote.ask(self._life.bus, action, timeout_s=_ANSWERS_WITHIN_S, **fields)
        if action != "mark":
            self._own = (self._clock.monotonic_ns(), action == "start")

    def _is_recording(self) -> bool:
        sample = self._watch.latest(keys.RECORDER)
        if self._own is not None and (sample is None or (sample.arrived_ns or 0) < self._own[0]):
            return self._own[1]
        state = self._state()
        return state is not None and state.state == "recording"

    def _last_task(self) -> str:
        state = self._state()
        return PurePath(state.path).parent.name if state is not None and state.path else ""

    def _state(self) -> RecorderState | None:
        sample = self._watch.latest(keys.RECORDER)
        try:
            return None if sample is None else codec.parse_struct(sample.value, RecorderState)
        except codec.BadValue:
            return None

    def _refused(self, action: str, reason: str) -> None:
        self._life.event("operator-record-refused", severity="warning", action=action, reason=reason)


class StopPresser:
    """Presses the emergency stop over a line of its own, in a thread: a bus that hangs does not hang the caller.

    Args:
        life: Says that the stop was not taken.

    Raises:
        BusError: the bus cannot be reached.
    """

    def __init__(self, life: Life) -> None:
        self._life = life
        self._button = StopButton(life.bus.address, name=life.name, who=getpass.getuser())

    def press(self, reason: str) -> None:
        """Stop every robot on the bus, latched."""
        self._life.clock.start(partial(self._press, reason), "stop-button")

    def close(self) -> None:
        """Hang up."""
        self._button.close()

    def _press(self, reason: str) -> None:
        try:
            self._button.press(reason)
        except BusError as error:
            self._life.event("operator-stop-failed", severity="error", reason=str(error))


class ArmButtons:
    """Arms and disarms a robot just as `station arm` does, over a line of its own and in a thread for each press: to
    disarm does not wait for a robot that is arming.

    Args:
        life: Says that no answer came; a refusal is said by the robot's server.
        robot: Suffix of the robot's keys.
        device: Whose buttons they are.

    Attributes:
        refusal: Why the newest press was refused, or "".
    """

    def __init__(self, life: Life, robot: str, device: str) -> None:
        self._life, self._robot, self._device = life, robot, device
        self._presses = 0
        self.refusal = ""

    def press(self, action: Action) -> None:
        """Ask for it."""
        self._presses, self.refusal = self._presses + 1, ""
        self._life.clock.start(partial(self._ask, action, self._presses), "arm-button")

    def _ask(self, action: Action, press: int) -> None:
        refusal = ""
        try:
            with Bus(self._life.bus.address, name=self._life.name, timeout_s=1.0) as line:
                server = arm_request.server_of(line, self._robot)
                arm_request.ask(line, action, name=server, reason=f"button of {self._device}")
        except Refused as error:
            refusal = str(error)
        except (BusError, NotReady) as error:
            refusal = str(error)
            self._life.event("operator-arm-failed", severity="error", action=action, reason=refusal)
        if press == self._presses:
            self.refusal = refusal


class PolicyButton:
    """Has a robot's next policy take over just as `station policy switch` does, over a line of its own, in a thread.

    Args:
        life: Says why none did.
        robot: Suffix of the robot's keys.
    """

    def __init__(self, life: Life, robot: str) -> None:
        self._life, self._robot = life, robot

    def press(self) -> None:
        """Ask for it."""
        self._life.clock.start(self._ask, "policy-button")

    def _ask(self) -> None:
        try:
            with Bus(self._life.bus.address, name=self._life.name, timeout_s=1.0) as line:
                policy_request.ask_next(line, name=arm_request.server_of(line, self._robot))
        except (BusError, NotReady, Refused) as error:
            self._life.event("operator-policy-failed", severity="warning", reason=str(error))


class Requests:
    """All of them, by the actions of `station.operator.buttons`.

    Args:
        record: Passes on to the recorder.
        stop: Stops every robot.
        arm: Arms and disarms the one that is driven.
        policy: Has another policy drive it.
        device: Whose buttons they are.
    """

    def __init__(
        self, record: RecordButtons, stop: StopPresser, arm: ArmButtons, policy: PolicyButton, *, device: str
    ) -> None:
        self._record, self._stop, self._arm, self._policy, self._device = record, stop, arm, policy, device

    def obey(self, pressed: Pressed) -> None:
        """Pass on what was pressed in a tick, the stop first."""
        if "estop" in pressed.started:
            self._stop.press(f"button of {self._device}")
        if "disarm" in pressed.started:
            self._arm.press("disarm")
        elif "arm" in pressed.started:
            self._arm.press("arm")
        if "policy" in pressed.started:
            self._policy.press()
        for name in RECORDING:
            if name in pressed.started:
                self._record.press(name)

    @property
    def refusal(self) -> str:
        """Why the robot was not armed when that was last asked for, or ""."""
        return self._arm.refusal

    def close(self) -> None:
        """Let what was asked of the recorder be done; hang up."""
        self._record.close()
        self._stop.close()
