"""What an operator asks of a motion that plays: JSON on ``station:motion``, and the signals of a stock remote."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, Literal

import msgspec

from station.bus import codec, keys
from station.bus.client import Bus
from station.bus.watch import Watch
from station.errors import NotReady, Refused
from station.life import events, request
from station.life.events import Event
from station.life.request import DoneRequests, LateS, NewRequests
from station.life.server import Life
from station.motion.playback import Playback

MotionAction = Literal["start", "pause", "resume", "seek", "loop", "leave"]

WITHIN_S = 5.0
"""Longest wait for an answer [s]: of a motion server that is late."""

_ALWAYS = ("pause", "leave")  # is done however late it comes: it ends a movement
_DONE, _REFUSED = "motion-control", "motion-control-refused"


class MotionControl(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A request on ``station:motion``.

    Attributes:
        action: What to do.
        time_s: Where `seek` goes to [s].
        on: Whether `loop` is switched on.
        id: Found again in the event that answers; "" where none is waited for.
        late_s: How long after it was first written this was [s].
    """

    action: MotionAction
    time_s: float | None = None
    on: bool = True
    id: str = ""
    late_s: LateS = 0.0


def ask(bus: Bus, action: MotionAction, *, within_s: float = WITHIN_S, **fields: Any) -> None:
    """Ask and wait until it is done.

    Args:
        bus: The bus that the motion server listens on.
        action: What to do.
        within_s: Longest wait [s].
        fields: The other fields of `MotionControl`.

    Raises:
        NotReady: the bus did not take the request, or no answer came.
        Refused: it does not apply now; with the reason.
    """
    wanted, what = MotionControl(action=action, id=request.new_id(), **fields), f"motion {action}"
    with bus.watch([keys.EVENT]) as watch:
        answers = {keys.EVENT: lambda data: _answer(data, wanted.id)}
        found = request.ask(bus, watch, keys.MOTION_CONTROL, wanted, answers, what=what, within_s=within_s)
    if (answer := found.get(keys.EVENT)) is None:
        raise NotReady(
            f"{what}: nobody answered in {within_s:g} s; start one with `station serve motion`, or look at "
            "`station status`"
        )
    if answer.name == _REFUSED:
        raise Refused(f"{what}: {answer.detail.get('reason', '')}")


class Requests:
    """Passes on what was asked since the last look; what stood on the bus before is no request.

    Args:
        life: Says what was done and what was refused.
        watch: Watches ``station:motion`` and the keys of the signals.
        playback: What they are for.
        signals: What each key of a stock remote asks for.
    """

    def __init__(
        self, life: Life, watch: Watch, playback: Playback, signals: Mapping[str, Literal["start", "leave"]]
    ) -> None:
        self._life, self._playback, self._signals = life, playback, signals
        self._new = {key: NewRequests(watch, key, is_age_needed=False) for key in (*signals, keys.MOTION_CONTROL)}
        self._done = DoneRequests[Callable[[], None]]()

    def obey(self) -> None:
        """Do what was newly asked for; call once per tick."""
        verbs = {"start": self._playback.start, "leave": self._playback.leave}
        for key, verb in self._signals.items():
            if (signal := self._new[key].pop()) is not None and signal.data == b"1":
                verbs[verb]()
        if (asked := self._new[keys.MOTION_CONTROL].pop()) is None:
            return
        try:
            wanted = request.parse(asked.data, MotionControl, "a motion request")
        except Refused as error:
            self._life.event(_REFUSED, severity="warning", reason=str(error))
            return
        if (tell := self._done.get(wanted.id)) is None:
            is_overtaken = self._done.begin(asked.first_ns(wanted.late_s))
            tell = self._obey(wanted, request.OVERTAKEN if is_overtaken and wanted.action not in _ALWAYS else "")
            self._done.put(wanted.id, tell)
        tell()

    def _obey(self, asked: MotionControl, refusal: str) -> Callable[[], None]:
        """Do what was asked for, unless it is refused; return what tells of it."""
        whose: dict[str, Any] = {"id": asked.id} if asked.id else {}
        try:
            if not refusal and not self._do(asked):
                refusal = f"{asked.action} does not apply while {self._playback.phase}"
        except codec.BadValue as error:
            refusal = str(error)
        if not refusal:
            return partial(self._life.event, _DONE, action=asked.action, time_s=self._playback.time_s, **whose)
        return partial(self._life.event, _REFUSED, severity="warning", reason=refusal, **whose)

    def _do(self, asked: MotionControl) -> bool:
        playback = self._playback
        if asked.action == "loop":
            playback.loop = asked.on
            return True
        if asked.action == "seek":
            if asked.time_s is None:
                raise codec.BadValue("seek needs time_s, the place to go to in seconds")
            return playback.seek(asked.time_s)
        verbs = {"start": playback.start, "pause": playback.pause, "resume": playback.resume, "leave": playback.leave}
        return verbs[asked.action]()


def _answer(data: bytes, asked: str) -> Event | None:
    """Return the event that answers a request, if these bytes are it."""
    event = events.decode(data)
    return event if event is not None and event.name in (_DONE, _REFUSED) and event.detail.get("id") == asked else None
