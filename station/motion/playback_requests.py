"""What an operator asks of a motion that plays: JSON on ``station:motion``, and the signals of a stock remote."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

import msgspec

from station.bus import codec, keys
from station.bus.watch import Watch
from station.life.server import Life
from station.motion.playback import Playback


class MotionControl(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A request on ``station:motion``.

    Attributes:
        action: What to do.
        time_s: Where `seek` goes to [s].
        on: Whether `loop` is switched on.
    """

    action: Literal["start", "pause", "resume", "seek", "loop", "leave"]
    time_s: float | None = None
    on: bool = True


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
        try:
            request = codec.parse_struct(data, MotionControl)
            done = self._do(request)
        except codec.BadValue as error:
            self._life.event("motion-control-refused", severity="warning", reason=str(error))
            return
        if done:
            self._life.event("motion-control", action=request.action, time_s=self._playback.time_s)
        else:
            reason = f"{request.action} does not apply while {self._playback.phase}"
            self._life.event("motion-control-refused", severity="warning", reason=reason)

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
