"""What an operator asks of a motion that plays: JSON on ``station:motion``, and the signals of stock TWIST2."""

from __future__ import annotations

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
        watch: Watches the three keys.
        playback: What they are for.
    """

    def __init__(self, life: Life, watch: Watch, playback: Playback) -> None:
        self._life, self._watch, self._playback = life, watch, playback
        self._seen = {key: watch.latest(key) for key in (keys.MOTION_START_SIGNAL, keys.MOTION_EXIT_SIGNAL)}
        self._seen[keys.MOTION_CONTROL] = watch.latest(keys.MOTION_CONTROL)

    def obey(self) -> None:
        """Do what was newly asked for; call once per tick."""
        if self._new(keys.MOTION_START_SIGNAL) == b"1":
            self._playback.start()
        if self._new(keys.MOTION_EXIT_SIGNAL) == b"1":
            self._playback.leave()
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
