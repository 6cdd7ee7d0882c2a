"""What an operator asks of a motion that plays: JSON on ``station:motion``, and the signals of a stock remote."""

from __future__ import annotations

import secrets
from collections.abc import Mapping
from typing import Any, Literal

import msgspec

from station.bus import codec, keys
from station.bus.client import Bus
from station.bus.watch import Watch
from station.errors import NotReady, Refused
from station.life.event_feed import EventFeed
from station.life.server import Life
from station.motion.playback import Playback

MotionAction = Literal["start", "pause", "resume", "seek", "loop", "leave"]

WITHIN_S = 3.0
"""Longest wait for an answer [s]: an event may come half a second late, with a heartbeat."""

_DONE, _REFUSED = "motion-control", "motion-control-refused"
_LOOK_S = 0.01


class MotionControl(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A request on ``station:motion``.

    Attributes:
        action: What to do.
        time_s: Where `seek` goes to [s].
        on: Whether `loop` is switched on.
        id: Found again in the event that answers; "" for whoever waits for none.
    """

    action: MotionAction
    time_s: float | None = None
    on: bool = True
    id: str = ""


def ask(bus: Bus, action: MotionAction, *, within_s: float = WITHIN_S, **fields: Any) -> None:
    """Ask and wait until it is done.

    Args:
        bus: The bus that the motion server listens on.
        action: What to do.
        within_s: Longest wait [s].
        fields: The other fields of `MotionControl`.

    Raises:
        NotReady: the bus did not take the request, or nobody answered.
        Refused: it does not apply now; with the reason.
    """
    wanted = MotionControl(action=action, id=secrets.token_hex(4), **fields)
    with EventFeed(bus) as feed:
        if not bus.publish({keys.MOTION_CONTROL: codec.json_object(wanted)}):
            raise NotReady(f"motion {action}: the bus {bus.address} did not take the request ({bus.last_error})")
        deadline_s = bus.clock.monotonic_s() + within_s
        while bus.clock.monotonic_s() < deadline_s:
            for event in feed.take():
                if event.detail.get("id") != wanted.id:
                    continue
                if event.name == _REFUSED:
                    raise Refused(f"motion {action}: {event.detail.get('reason', '')}")
                return
            bus.clock.sleep(_LOOK_S)
    raise NotReady(
        f"motion {action}: nobody answered in {within_s:g} s; start one with `station serve motion`, or look at "
        "`station status`"
    )


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
        self._life, self._watch, self._playback, self._signals = life, watch, playback, signals
        self._seen = {key: watch.latest(key) for key in (*signals, keys.MOTION_CONTROL)}

    def obey(self) -> None:
        """Do what was newly asked for; call once per tick."""
        verbs = {"start": self._playback.start, "leave": self._playback.leave}
        for key, asked in self._signals.items():
            if self._new(key) == b"1":
                verbs[asked]()
        data = self._new(keys.MOTION_CONTROL)
        if data is None:
            return
        whose: dict[str, Any] = {}
        try:
            request = codec.parse_struct(data, MotionControl)
            whose = {"id": request.id} if request.id else {}
            done = self._do(request)
        except codec.BadValue as error:
            self._life.event(_REFUSED, severity="warning", reason=str(error), **whose)
            return
        if done:
            self._life.event(_DONE, action=request.action, time_s=self._playback.time_s, **whose)
        else:
            reason = f"{request.action} does not apply while {self._playback.phase}"
            self._life.event(_REFUSED, severity="warning", reason=reason, **whose)

    def _do(self, request: MotionControl) -> bool:
        playback = self._playback
        if request.action == "loop":
            playback.loop = request.on
            return True
        if request.action == "seek":
            if request.time_s is None:
                raise codec.BadValue("seek needs time_s, the place to go to in seconds")
            return playback.seek(request.time_s)
        verbs = {"start": playback.start, "pause": playback.pause, "resume": playback.resume, "leave": playback.leave}
        return verbs[request.action]()

    def _new(self, key: str) -> bytes | None:
        sample = self._watch.latest(key)
        if sample is None or sample is self._seen[key]:
            return None
        self._seen[key] = sample
        return sample.value
