"""The loop that cameras and lidars share: read the newest of a source, publish, tell.

Nothing is queued: as long as the bus owes the answer to a picture no other is written, and the newest one goes when it
has answered; depth over a bulk bus likewise, apart from its picture. What is dropped, and where, is counted and stands
in the server's health; that it begins and ends are the
events ``camera-dropping`` and ``camera-steady``. A camera that gives nothing, or is torn out, is ``camera-lost``; it is
looked for once a second, and ``camera-back`` when it gives pictures again. Events of a lidar begin with ``lidar``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Generic, NamedTuple, Protocol, TypeVar

from station.camera.source import Drops, SensorError
from station.life.server import Life

_AGAIN_S = 1.0
_LOOK_S = 0.1  # longest wait for a picture, so that a wish to stop is heard
_SILENT_S = 1.0
_PERIODS = 5  # without a picture are silence too, for a slow camera
_STEADY_S = 3.0


class Reading(Protocol):
    """A picture or a cloud: what it is, and when it was taken on this machine's monotonic clock [ns]."""

    @property
    def capture_ns(self) -> int:
        """When it was taken."""
        ...


Given_co = TypeVar("Given_co", bound=Reading, covariant=True)


class Source(Protocol[Given_co]):
    """What a camera and a lidar have in common; `station.camera.source.Camera` says what each does."""

    drops: Drops

    def read(self, timeout_s: float) -> Given_co | None:
        """Return the newest reading that was not given before."""
        ...

    def why_silent(self) -> str:
        """Return why there may be none."""
        ...

    def facts(self) -> dict[str, Any]:
        """Return what a manifest says of it; of a rate ``fps`` [Hz]."""
        ...

    def close(self) -> None:
        """Release it."""
        ...


AnySource = TypeVar("AnySource", bound=Source[Any])


class Kind(NamedTuple):
    """What a source is called.

    Attributes:
        name: Itself, in events.
        readings: What it gives, in its health.
        told_late: The fact that may be None before the first reading.
    """

    name: str
    readings: str
    told_late: str


def _nothing(_source: Any) -> None:
    pass


class Feed(Generic[AnySource]):
    """Between a source and the bus.

    Args:
        life: The server's.
        open_source: Opens the source; called again after it was lost.
        kind: What it is called.
        key: Of its readings.
        head: What a manifest says of the server, beside what the source itself says.
        described: Returns what a manifest says of the source, of what that says.
        values: Returns what is written of a reading, by key.
        beside: Called after each look at the source, for what else that has.

    Raises:
        SensorError: the source cannot be opened at the start, or not used as it is described.
    """

    def __init__(
        self, life: Life, open_source: Callable[[], AnySource], kind: Kind, *, key: str, head: Mapping[str, Any],
        described: Callable[[dict[str, Any]], dict[str, Any]], values: Callable[[Any], Mapping[str, bytes]],
        beside: Callable[[AnySource], None] = _nothing,
    ) -> None:  # fmt: skip
        self._life, self._open, self._kind, self._key = life, open_source, kind, key
        bulk = life.bus.bulk_address
        self._head = {**head, **({"bulk": str(bulk)} if bulk is not None else {})}
        self._described, self._values, self._beside = described, values, beside
        self._clock = life.clock
        self._source: AnySource | None = None
        self._silence_s, self._look_s = _SILENT_S, 0.0
        self._is_live, self._reason = True, ""  # until the contrary shows
        self._past = Drops()  # of sources before this one
        self._unsent = 0
        self._published, self._bytes = 0, 0
        self._capture_ns: int | None = None
        self._reading_s = self._clock.monotonic_s()  # when the newest one came
        self._meter = _Meter(life, kind)
        self._facts: dict[str, Any] = {}
        self._adopt(open_source())

    def run(self) -> int:
        """Publish until the server is asked to stop; return the exit code."""
        try:
            if not self._life.ready():
                return 0
            self.begin()
            while not self._life.stopping:
                self.step()
        finally:
            self.close()
        return 0

    def begin(self) -> None:
        """Count time from now on: what was taken before the server was active is old."""
        self._reading_s = self._clock.monotonic_s()
        self._meter.begin(self._reading_s, self._published, self._drops)

    def step(self) -> None:
        """Wait for a reading for a moment and take it to the bus."""
        reading = self._read()
        now_s = self._clock.monotonic_s()
        if self._source is not None:
            self._beside(self._source)
        if reading is not None:
            self._welcome(now_s)
            self._publish(reading)
        elif self._source is not None and now_s - self._reading_s > self._silence_s and now_s >= self._look_s:
            self._look_s = now_s + _AGAIN_S
            self._lose(self._source.why_silent() or f"it gives no {self._kind.readings}", now_s)
        age_ms = None if self._capture_ns is None else (self._clock.monotonic_ns() - self._capture_ns) * 1e-6
        self._meter.update(now_s, self._published, self._bytes, self._drops, self._unsent, age_ms)

    def close(self) -> None:
        """Let go of the source."""
        self._release()

    @property
    def _drops(self) -> Drops:
        return self._past + self._source.drops if self._source is not None else self._past

    def _read(self) -> Reading | None:
        if self._source is None:
            self._reopen()
        if self._source is None:
            self._clock.wait(self._life.stop_event, _LOOK_S)
            return None
        try:
            return self._source.read(_LOOK_S)
        except SensorError as error:
            self._release()
            now_s = self._clock.monotonic_s()
            self._look_s = now_s + _AGAIN_S
            self._lose(str(error), now_s)
            return None

    def _reopen(self) -> None:
        now_s = self._clock.monotonic_s()
        if now_s < self._look_s:
            return
        self._look_s = now_s + _AGAIN_S
        try:
            self._adopt(self._open())
        except SensorError as error:
            self._lose(str(error), now_s)

    def _adopt(self, source: AnySource) -> None:
        self._source, facts = source, self._described(source.facts())
        if facts != self._facts:
            self._facts = facts
            self._life.configured({**self._head, **facts})
        if facts.get("fps"):
            self._silence_s = max(_SILENT_S, _PERIODS / facts["fps"])

    def _publish(self, reading: Reading) -> None:
        sent = 0
        lines = self._life.bus.lines(self._values(reading))
        for bus, values in lines:
            is_behind = bus.is_late and not bus.catch_up()
            if not is_behind and bus.publish(values, capture_ns=reading.capture_ns):
                sent += 1
                self._bytes += sum(map(len, values.values()))
        self._unsent += sent < len(lines)
        if not sent:
            return
        self._published += 1
        if self._source is not None and self._facts.get(self._kind.told_late) is None:
            self._adopt(self._source)  # a stream shows its size with its first picture
        self._capture_ns = reading.capture_ns

    def _welcome(self, now_s: float) -> None:
        if not self._is_live:
            self._is_live, self._reason = True, ""
            silent_s = round(now_s - self._reading_s, 3)
            self._life.event(
                f"{self._kind.name}-back", key=self._key, silent_s=silent_s, device=self._facts.get("device")
            )
        self._reading_s = now_s
        self._life.report(**{self._kind.name: "live", "reason": ""})

    def _lose(self, reason: str, now_s: float) -> None:
        if not self._is_live and reason == self._reason:
            return
        self._is_live, self._reason = False, reason
        silent_s = round(now_s - self._reading_s, 3)
        self._life.event(f"{self._kind.name}-lost", severity="warning", key=self._key, reason=reason, silent_s=silent_s)
        self._life.report(**{self._kind.name: "lost", "reason": reason})

    def _release(self) -> None:
        source, self._source = self._source, None
        if source is not None:
            self._past += source.drops
            source.close()


class _Meter:
    """Once a second: how many readings went to the bus, how many did not, and when that begins and ends."""

    def __init__(self, life: Life, kind: Kind) -> None:
        self._life, self._kind = life, kind
        self._since_s, self._published, self._bytes, self._dropped = 0.0, 0, 0, 0
        self._dropping_since: tuple[float, int] | None = None
        self._dropped_s = 0.0

    def begin(self, now_s: float, published: int, drops: Drops) -> None:
        """Start counting."""
        self._since_s, self._published, self._dropped = now_s, published, drops.total

    def update(
        self, now_s: float, published: int, size: int, drops: Drops, unsent: int, age_ms: float | None
    ) -> None:  # fmt: skip
        """Report when a second is over."""
        elapsed_s = now_s - self._since_s
        if elapsed_s < 1.0:
            return
        count, dropped = published - self._published, drops.total + unsent
        self._life.report(
            rate_hz=round(count / elapsed_s, 2), dropped=dropped, lost=drops.lost, skipped=drops.skipped,
            torn=drops.torn, unsent=unsent, age_ms=None if age_ms is None else round(age_ms, 1),
            kilobytes=round((size - self._bytes) / count / 1e3, 1) if count else None,
            **{self._kind.readings: published},
        )  # fmt: skip
        self._publish(now_s, dropped, drops, unsent)
        self._since_s, self._published, self._bytes, self._dropped = now_s, published, size, dropped

    def _publish(self, now_s: float, dropped: int, drops: Drops, unsent: int) -> None:
        new = dropped - self._dropped
        if new:
            self._dropped_s = now_s
            if self._dropping_since is None:
                self._dropping_since = (self._since_s, self._dropped)
                self._life.event(f"{self._kind.name}-dropping", severity="warning", dropped=new, lost=drops.lost,
                                 skipped=drops.skipped, torn=drops.torn, unsent=unsent)  # fmt: skip
        elif self._dropping_since is not None and now_s - self._dropped_s >= _STEADY_S:
            since_s, before = self._dropping_since
            self._dropping_since = None
            self._life.event(
                f"{self._kind.name}-steady", dropped=dropped - before, for_s=round(self._dropped_s - since_s, 1)
            )
