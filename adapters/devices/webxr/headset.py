"""Judges what a page sends, and gives it as a `station.operator.device.Device`.

- One page at a time. A second one is refused, never mixed in; it takes the place of one that has been silent for long.
- A frame is as old as its own stamp says: after a cut a line delivers what it held back, all at once. Its page's clock
  is compared with ours four times a second; before that is known nothing counts.
- The operator lets go by more than a button: the session ends, the headset's menu opens, it is taken off, its world is
  placed anew, a controller is put down for a hand, the page goes. Frames go on meanwhile, or come back at once, so for
  a moment there is a sample of nothing held, long enough for every loop to see. What was held then counts as released
  until it has been seen at rest.
"""

from __future__ import annotations

import math
import threading
from collections import deque
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from adapters.devices.webxr.controls import CONTROLS
from adapters.devices.webxr.frame import BadFrame, Palms, mirrored, parse, sample_of
from station.bus.clocks import BusTime
from station.clock import SYSTEM, Clock
from station.operator.sample import OperatorSample, Pose, Side

OLD_S = 0.1
"""A frame that left its page longer ago is not obeyed [s]."""

LET_GO_S = 0.15
"""How long nothing is held after the operator let go [s]: seven periods of a loop at 50 Hz."""

GIVEN_LATELY_S = 0.2
"""A page that has given no sample for longer has nothing to let go of [s]."""

GIVEN_UP_S = 2.0
"""A page that has been silent for longer gives its place to another [s]."""

_AT_REST = 0.1  # of a control
_MOST_PINGS = 8  # under way
_WORDS = 200


class Headset:
    """The page's side is called from the web server's thread, the device's side from the device server's.

    Args:
        clock: Of the process.
        palms: Where a right hand's palm is in a controller, by the name of its profile; WebXR's grip in any other.
        where: Address of the page, for a person.
        touch_scale: What the sticks of a touch screen are multiplied by.

    Attributes:
        frames, old, bad: How many frames came, were too old, and were none.
        round_trip_s: Of the newest ping [s]; None before the first.
    """

    def __init__(
        self, clock: Clock = SYSTEM, palms: Mapping[str, Pose] | None = None, where: str = "", touch_scale: float = 1.0
    ) -> None:
        self.frames = self.old = self.bad = 0
        self.round_trip_s: float | None = None
        self._clock, self._known, self._where = clock, palms or {}, where
        self._palms: Palms = {}  # of what is held now
        self._touch_scale = touch_scale
        self._lock = threading.Lock()
        self._page = 0  # number of the page that drives; 0 for none
        self._pages = 0
        self._heard_s = 0.0
        self._time = BusTime()
        self._pings: dict[int, int] = {}
        self._asked: deque[int] = deque(maxlen=_MOST_PINGS)
        self._newest: OperatorSample | None = None
        self._taken_ms = -math.inf
        self._given_s = self._let_go_until_s = -1.0
        self._why = ""
        self._unseen: set[str] = set(CONTROLS)  # controls that have not been seen at rest since the operator let go
        self._about: dict[str, str] = {}

    # -- The page's side ----------------------------------------------------------------------------------------------
    def join(self) -> int:
        """Let a page drive; return its number, or 0 where another one drives."""
        with self._lock:
            now_s = self._clock.monotonic_s()
            if self._page and now_s - self._heard_s < GIVEN_UP_S:
                return 0
            self._pages += 1
            self._page, self._heard_s, self._taken_ms = self._pages, now_s, -math.inf
            self._time, self._about, self._palms = BusTime(), {}, {}
            self._pings.clear()
            self._let_go("the page was opened", now_s)
            return self._page

    def leave(self, page: int) -> None:
        """Take note that a page is gone."""
        with self._lock:
            if page == self._page:
                self._page = 0
                self._let_go("the page is gone", self._clock.monotonic_s())

    def is_driving(self, page: int) -> bool:
        """Whether a page still has its place."""
        return page == self._page

    def let_go(self, page: int, why: str) -> None:
        """Take note that the operator has let go, whatever is still held."""
        with self._lock:
            if page == self._page:
                self._let_go(why[:_WORDS], self._clock.monotonic_s())

    def about(self, page: int, told: dict[str, str]) -> None:
        """Take note of what a page says of its headset, browser and controllers."""
        with self._lock:
            if page == self._page:
                self._about = {name[:40]: value[:_WORDS] for name, value in list(told.items())[:8]}
                palms: dict[Side, Pose] = {}
                if left := self._known.get(told.get("left_input", "")):
                    palms["left"] = mirrored(left)
                if right := self._known.get(told.get("right_input", "")):
                    palms["right"] = right
                self._palms = palms

    def ping(self, page: int) -> int:
        """Return the number of a question for the page's time, which leaves now."""
        with self._lock:
            if page != self._page:
                return 0
            number, now_ns = self._asked[-1] + 1 if self._asked else 1, self._clock.monotonic_ns()
            if len(self._asked) == _MOST_PINGS:
                self._pings.pop(self._asked[0], None)
            self._asked.append(number)
            self._pings[number] = now_ns
            return number

    def pong(self, page: int, number: int, page_ms: float) -> None:
        """Take the page's time [ms] as the answer to a question."""
        with self._lock:
            now_ns = self._clock.monotonic_ns()
            asked_ns = self._pings.pop(number, None)
            if page != self._page or asked_ns is None or not abs(page_ms) < 1e12:
                return
            self.round_trip_s = (now_ns - asked_ns) * 1e-9
            if self._time.add(asked_ns, round(page_ms * 1e6), now_ns):  # it was set
                self._taken_ms = -math.inf

    def on_frame(self, page: int, data: bytes) -> None:
        """Take a frame."""
        with self._lock:
            if page != self._page:
                return
            now_ns = self._clock.monotonic_ns()
            self._heard_s = now_ns * 1e-9
            offset = self._time.best(now_ns)
            try:
                frame = parse(data)
                if offset is None:  # nobody can tell how old it is
                    return
                self.frames += 1
                sent_ns = round(float(frame["sent_ms"]) * 1e6) - offset.ns
                if abs(now_ns - sent_ns) > OLD_S * 1e9 + offset.error_ns:
                    self.old += 1
                    return
                if (taken_ms := float(frame["taken_ms"])) <= self._taken_ms:
                    return  # the same animation frame once more: nothing was tracked meanwhile
                self._taken_ms = taken_ms
                sample = sample_of(frame, round(taken_ms * 1e6) - offset.ns, self._palms, self._touch_scale)
            except BadFrame:
                self.bad += 1
                return
            self._newest, self._given_s, self._why = self._without_unseen(sample), now_ns * 1e-9, ""

    # -- The device's side --------------------------------------------------------------------------------------------
    def read(self) -> OperatorSample | None:
        """Return the newest sample, or None where there is none since the last call."""
        with self._lock:
            if (now_ns := self._clock.monotonic_ns()) * 1e-9 < self._let_go_until_s:
                return OperatorSample(capture_ns=now_ns, controls=dict.fromkeys(CONTROLS, 0.0))
            newest, self._newest = self._newest, None
            return newest

    def why_silent(self) -> str:
        """Return what is missing: a page, or what it last said."""
        if not self._page:
            why = f"; {self._why}" if self._pages else ""
            return f"no page drives{why}: open {self._where} in the headset's browser; `station pair` prints its code"
        if self.old and self._time.best(self._clock.monotonic_ns()) is not None and not self._why:
            return "frames come too late: is the network busy?"
        return f"the page is open, and nobody drives by it: {self._why or 'nothing has come for a while'}"

    def facts(self) -> dict[str, Any]:
        """Return where the page is, and what it said of itself."""
        return {"page": self._where, **self._about}

    def numbers(self) -> dict[str, Any]:
        """Return what the device's server tells of it once a second."""
        trip = {} if self.round_trip_s is None else {"page_round_trip_ms": round(self.round_trip_s * 1e3, 1)}
        return {"pages": int(bool(self._page)), "frames_old": self.old, "frames_bad": self.bad, **trip, **self._about}

    def close(self) -> None:
        """Nothing is held."""

    def _let_go(self, why: str, now_s: float) -> None:
        self._why, self._newest = why, None
        if now_s - self._given_s < GIVEN_LATELY_S:
            self._let_go_until_s = now_s + LET_GO_S
        self._unseen = set(CONTROLS)

    def _without_unseen(self, sample: OperatorSample) -> OperatorSample:
        if not self._unseen:
            return sample
        self._unseen -= {name for name, value in sample.controls.items() if abs(value) < _AT_REST}
        controls = {name: 0.0 if name in self._unseen else value for name, value in sample.controls.items()}
        return replace(sample, controls=controls)
