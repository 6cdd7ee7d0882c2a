"""What is asked of a recorder on ``station:record``, and what it answers."""

from __future__ import annotations

from typing import Any, Literal

import msgspec

from station.bus import codec
from station.episode.storage.left_out import why_not
from station.episode.storage.manifest_parts import Operator
from station.errors import Refused
from station.life.request import parse

_LONGEST_S = 30 * 24 * 3600.0

Action = Literal["start", "stop", "mark", "discard"]


class RecordRequest(msgspec.Struct, frozen=True, kw_only=True):
    """One request.

    Attributes:
        id: Any text that is new; the answer carries it.
        action: ``start`` an episode, ``stop`` it, ``mark`` this instant, ``discard`` the present episode (it ends) or,
            between episodes, the last one. Discarding sets a flag; it never deletes.
        task, instruction: For ``start``: short name of the task, and what to do in words.
        operator: For ``start``: ``interface``, ``id``, and anything else worth keeping.
        runbook: For ``start``: steps and answers of the runbook; for ``stop``: the same with all answers that there
            are by then.
        planned_s: For ``start``: how long it is to be [s]; refused where the disk cannot hold that. None for what the
            recorder's configuration says, which is a minute.
        leave_out: For ``start``: keys that the episode does without, or beginnings of keys up to a ``_``, beside those
            of the recorder's configuration.
        label: For ``mark``: what happened; for ``discard``: why.
        success: For ``stop`` and ``mark``: the operator's verdict, None for none.
    """

    id: str
    action: Action
    task: str = ""
    instruction: str = ""
    operator: dict[str, Any] = {}
    runbook: dict[str, Any] = {}
    planned_s: float | None = None
    leave_out: tuple[str, ...] = ()
    label: str = ""
    success: bool | None = None

    def who(self) -> Operator:
        """Return the operator as the manifest has it."""
        details = {name: value for name, value in self.operator.items() if name not in ("interface", "id")}
        given = self.operator
        return Operator(interface=str(given.get("interface", "")), id=str(given.get("id", "")), details=details)


class RecordAnswer(msgspec.Struct, frozen=True, kw_only=True):
    """The answer to one request, on ``station:record:ack``.

    Attributes:
        id: Id of the request.
        ok: Whether it was done.
        episode_id, path: The episode it is about, and its folder.
        reason: Why not, in one line; "" when `ok`.
        summary: After ``stop`` and ``discard``: seconds, messages, bytes, lost, dropped, … as counted in the file.
        earlier: The answers before it, newest first: an asker that looked a moment too late finds its own among them.
    """

    id: str
    ok: bool
    episode_id: str | None = None
    path: str | None = None
    reason: str = ""
    summary: dict[str, Any] = {}
    earlier: tuple[RecordAnswer, ...] = ()


def parse_answer(data: bytes, asker: str | None) -> RecordAnswer | None:
    """Return the answer to a request that ``station:record:ack`` holds, the newest or one before it; None for none."""
    try:
        newest = codec.parse_struct(data, RecordAnswer)
    except codec.BadValue:
        return None
    return next((answer for answer in (newest, *newest.earlier) if answer.id == asker), None)


class RecorderState(msgspec.Struct, frozen=True, kw_only=True):
    """What a recorder is doing, on ``station:recorder`` twice a second.

    Attributes:
        state: ``idle`` or ``recording``.
        episode_id, path: The episode that is being recorded, and its folder.
        messages, bytes: In its file so far.
        dropped: Writes that arrived and could not be kept.
        queued: Writes that wait for the disk.
        backend: The tap in use.
        lag_ms, lag_p99_ms: From arrival of a write to its place in the file: median and 99th percentile [ms].
        restarts: How often a recorder took this episode up again.
        free_mb: Free space of the disk [MB]; None where unknown.
        minutes_left: How long this episode (when idle: one that began now) may go on until the disk ends it [min]; None
            where unknown, or where nothing is written.
        error: Why the last episode ended by itself, "" otherwise.
    """

    state: Literal["idle", "recording"]
    episode_id: str | None = None
    path: str | None = None
    messages: int = 0
    bytes: int = 0
    dropped: int = 0
    queued: int = 0
    backend: str = ""
    lag_ms: float | None = None
    lag_p99_ms: float | None = None
    restarts: int = 0
    free_mb: float | None = None
    minutes_left: float | None = None
    error: str = ""


def parse_request(data: bytes) -> RecordRequest:
    """Read a request.

    Raises:
        Refused: it is none; says why.
    """
    request = parse(data, RecordRequest, "a record request")
    if not (codec.is_modest(request.operator) and codec.is_modest(request.runbook)):
        raise Refused("not a record request: operator and runbook hold more than a manifest takes")
    if request.planned_s is not None and not 0 <= request.planned_s <= _LONGEST_S:
        raise Refused(f"not a record request: planned_s is {request.planned_s}, expected 0 to {_LONGEST_S:.0f} seconds")
    if why := why_not(request.leave_out):
        raise Refused(f"not a record request: {why}")
    return request


def request_id(data: bytes) -> str | None:
    """Return the id of what may be no valid request otherwise, so that even a refusal finds its asker."""
    if len(data) > codec.MAX_BYTES:
        return None
    try:  # past the codec, whose bounds hold for all of a value: of this one nothing but the id is built
        return msgspec.json.decode(data, type=_OnlyId).id
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        return None


class _OnlyId(msgspec.Struct):
    id: str
