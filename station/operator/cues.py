"""What waits to be heard, and the thread that says it: the newest matters, urgent cues interrupt, no caller waits."""

from __future__ import annotations

import logging
import threading
from collections import deque
from collections.abc import Callable

from station.clock import SYSTEM, Clock
from station.errors import StationError
from station.operator.voice import Cue, Voice

log = logging.getLogger(__name__)

MOST_WAITING = 4
OLD_S = 4.0
"""What has waited for longer is news no more [s]."""

REPEAT_S = 2.0
"""The same words about the same subject are one piece of news within this time [s]: several servers tell of it."""


class CueQueue:
    """Cues that wait, in the order in which they are to be said: urgent ones first. Pure: times are given.

    Args:
        most: How many may wait.
        old_s: After how long one is dropped unheard [s].

    Attributes:
        dropped: Number of cues that were never said: too old, too many, or overtaken by a newer one.
    """

    def __init__(self, most: int = MOST_WAITING, old_s: float = OLD_S) -> None:
        self.dropped = 0
        self._most, self._old_s = most, old_s
        self._waiting: deque[tuple[float, Cue]] = deque()
        self._newest: dict[str, tuple[float, str]] = {}  # what was put last, by subject

    def __len__(self) -> int:
        return len(self._waiting)

    def put(self, cue: Cue, now_s: float) -> bool:
        """Add a cue; return whether it is news, and not what was told a moment ago."""
        if cue.about:
            told_s, words = self._newest.get(cue.about, (-REPEAT_S, ""))
            if words == cue.words and now_s - told_s < REPEAT_S:
                return False
            self._newest[cue.about] = (now_s, cue.words)
            self._forget(now_s)
            self._leave_out(lambda other: other.about == cue.about)
        if len(self._waiting) >= self._most:
            self._give_one_up()
        before = sum(other.is_urgent for _, other in self._waiting) if cue.is_urgent else len(self._waiting)
        self._waiting.insert(before, (now_s, cue))
        return True

    def pop(self, now_s: float) -> Cue | None:
        """Return the cue that is to be said now."""
        while self._waiting:
            put_s, cue = self._waiting.popleft()
            if now_s - put_s <= self._old_s:
                return cue
            self.dropped += 1
        return None

    def _give_one_up(self) -> None:
        """Drop the oldest that is not urgent, or else the oldest."""
        routine = next((index for index, (_, cue) in enumerate(self._waiting) if not cue.is_urgent), 0)
        del self._waiting[routine]
        self.dropped += 1

    def _leave_out(self, is_overtaken: Callable[[Cue], bool]) -> None:
        kept = [(put_s, cue) for put_s, cue in self._waiting if not is_overtaken(cue)]
        self.dropped += len(self._waiting) - len(kept)
        self._waiting = deque(kept)

    def _forget(self, now_s: float) -> None:
        self._newest = {about: told for about, told in self._newest.items() if now_s - told[0] < REPEAT_S}


class Speaker:
    """Says cues with a voice, in a thread of its own; handing one over never waits.

    Args:
        voice: Says them; closed with the speaker.
        queue: Where they wait.
        clock: Of the server.

    Attributes:
        said: Number of cues that were begun.
        broken_off: Number of these that an urgent one broke off.
    """

    def __init__(self, voice: Voice, queue: CueQueue | None = None, clock: Clock = SYSTEM) -> None:
        self.said = self.broken_off = 0
        self._why_not = self._untold = ""
        self._voice, self._queue, self._clock = voice, queue or CueQueue(), clock
        self._changed = threading.Condition()
        self._present: Cue | None = None
        self._is_hushed = self._is_closed = False
        self._thread = clock.start(self._run, "cues")

    @property
    def dropped(self) -> int:
        """Number of cues that were never said."""
        return self._queue.dropped

    @property
    def is_idle(self) -> bool:
        """Whether nothing is being said, and nothing waits."""
        with self._changed:
            return self._present is None and not len(self._queue)

    def play(self, cue: Cue) -> None:
        """Have a cue said; an urgent one breaks off one that is not."""
        with self._changed:
            if not self._queue.put(cue, self._clock.monotonic_s()):
                return
            present = self._present
            if present is not None and cue.is_urgent and not present.is_urgent and not self._is_hushed:
                self._is_hushed = True
                self.broken_off += 1
            self._changed.notify_all()

    def pop_error(self) -> str:
        """Return why a cue could not be said since the last call, "" where all were; what lasts is told once."""
        with self._changed:
            why_not, self._untold = self._untold, ""
            return why_not

    def close(self, within_s: float = 2.0) -> None:
        """Break off, and release the voice."""
        with self._changed:
            self._is_closed = self._is_hushed = True
            self._changed.notify_all()
        self._clock.join(self._thread, within_s)
        if not self._thread.is_alive():
            self._voice.close()

    def _run(self) -> None:
        while (cue := self._next()) is not None:
            why_not = self._why_not_of(cue)
            with self._changed:
                if why_not and why_not != self._why_not:
                    self._untold = why_not
                self._why_not, self._present = why_not, None

    def _why_not_of(self, cue: Cue) -> str:
        """Play a cue; return why it could not be played, or ""."""
        try:
            self._voice.play(cue, self._hush)
        except StationError as error:
            return str(error)
        except Exception as error:  # a fault in one voice, a third party's perhaps, must not silence an operator's ears
            log.debug("%r", cue, exc_info=True)
            return f"internal error in the voice: {' '.join(f'{type(error).__name__}: {error}'.split())}"
        return ""

    def _next(self) -> Cue | None:
        with self._changed:
            while not self._is_closed:
                if (cue := self._queue.pop(self._clock.monotonic_s())) is not None:
                    self._present, self._is_hushed = cue, False
                    self.said += 1
                    return cue
                self._clock.wait_for(self._changed, lambda: bool(len(self._queue)) or self._is_closed)
            return None

    def _hush(self, wait_s: float) -> bool:
        with self._changed:
            return self._clock.wait_for(self._changed, lambda: self._is_hushed, wait_s)
