"""What an operator asks of others with a button: the recorder, and the emergency stop. Neither holds up the caller."""

from __future__ import annotations

import getpass
import queue
import threading
import time
from pathlib import PurePath
from typing import Any

from station.bus import codec, keys
from station.bus.watch import Watch
from station.episode import remote
from station.episode.request import RecorderState
from station.errors import BusError, NotReady, StationError
from station.life.server import Life
from station.life.stop_button import StopButton

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
        self._life, self._watch = life, watch
        self._task, self._instruction, self._operator = task, instruction, operator
        self._own: tuple[int, bool] | None = None  # what the recorder last answered, and when: newer than its status
        self._wanted: queue.Queue[str | None] = queue.Queue(_MOST_WAITING)
        self._thread = threading.Thread(target=self._run, name="record-buttons", daemon=True)
        self._thread.start()

    def press(self, action: str) -> None:
        """Ask for one of `RECORDING`; never blocks."""
        try:
            self._wanted.put_nowait(action)
        except queue.Full:
            self._refused(action, "the recorder is still busy with what was asked before")

    def close(self, within_s: float = 2.0) -> None:
        """Let what was asked for be done, for so long [s]."""
        try:
            self._wanted.put_nowait(None)
        except queue.Full:
            return
        self._thread.join(within_s)

    def _run(self) -> None:
        while (action := self._wanted.get()) is not None:
            try:
                self._do(action)
            except StationError as error:
                self._refused(action, str(error))

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
        if sample is None or (sample.arrived_ns is not None and sample.age_s() > _GONE_S):
            raise NotReady("no recorder runs; start one with `station serve recorder`")
        remote.ask(self._life.bus, action, timeout_s=_ANSWERS_WITHIN_S, **fields)
        if action != "mark":
            self._own = (time.monotonic_ns(), action == "start")

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
        threading.Thread(target=self._press, args=(reason,), name="stop-button", daemon=True).start()

    def close(self) -> None:
        """Hang up."""
        self._button.close()

    def _press(self, reason: str) -> None:
        try:
            self._button.press(reason)
        except BusError as error:
            self._life.event("operator-stop-failed", severity="error", reason=str(error))
