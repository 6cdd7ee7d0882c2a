"""What happened in an episode: states of the gate and the motion as coloured lanes, events as a log."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, TypeAlias

import numpy as np
import rerun as rr

from station.bus import keys
from station.view import layout
from station.view.episode_curves import Source
from station.view.phases import driven_by

StateOf: TypeAlias = Callable[[Mapping[str, Any]], str]

_LEVELS = {"info": rr.TextLogLevel.INFO, "warning": rr.TextLogLevel.WARN, "error": rr.TextLogLevel.ERROR}


def draw_states(recording: rr.RecordingStream, source: Source, robot: str) -> None:
    """Send each change of the gate's state, and of the motion's phase or what an operator moves."""
    layout.log_state_colours(recording)
    _send_changes(recording, source, f"{layout.STATES}/gate", keys.command_gate(robot), gate_state)
    _send_changes(recording, source, f"{layout.STATES}/motion", keys.command_source(robot), driven_by)


def draw_events(recording: rr.RecordingStream, source: Source) -> int:
    """Send every event as a line of the log; return their number."""
    found = [(log_ns, value) for log_ns, value in source.reader.json(keys.EVENT) if isinstance(value, dict)]
    if not found:
        return 0
    columns = rr.TextLog.columns(
        text=[line(event) for _, event in found],
        level=[_LEVELS.get(str(event.get("severity")), rr.TextLogLevel.INFO) for _, event in found],
    )
    times_ns = np.array([log_ns for log_ns, _ in found], dtype=np.int64)
    recording.send_columns(layout.EVENTS, source.index(times_ns), columns)
    return len(found)


def line(event: dict[str, Any]) -> str:
    """Return an event as a line: source, name, and what belongs to it."""
    detail = event.get("detail")
    pairs = detail.items() if isinstance(detail, dict) else ()
    shown = " ".join(f"{name}={value:.4g}" if isinstance(value, float) else f"{name}={value}" for name, value in pairs)
    return f"{event.get('source', '')}: {event.get('name', '')} {shown}".rstrip()


def level(event: dict[str, Any]) -> str:
    """Return the level of an event in Rerun's words."""
    return str(_LEVELS.get(str(event.get("severity")), rr.TextLogLevel.INFO))


def gate_state(gate: Mapping[str, Any]) -> str:
    """Return the state that a value of `keys.command_gate` tells, "" for none."""
    return str(gate.get("state", ""))


def _send_changes(recording: rr.RecordingStream, source: Source, entity: str, key: str, state_of: StateOf) -> None:
    times: list[int] = []
    states: list[str] = []
    for log_ns, value in source.reader.json(key):
        state = state_of(value) if isinstance(value, dict) else ""
        if state and (not states or states[-1] != state):
            times.append(log_ns)
            states.append(state)
    if states:
        index = source.index(np.array(times, dtype=np.int64))
        recording.send_columns(entity, index, rr.StateChange.columns(state=states))
