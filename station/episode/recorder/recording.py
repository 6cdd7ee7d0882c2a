"""The recorder without its bus: writes in, episodes on disk, answers and events out.

Requests are taken from the stream of writes itself, so an episode begins and ends at an exact place of it.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from typing import TYPE_CHECKING

from station.bus import keys
from station.clock import SYSTEM, Clock
from station.episode.recorder.controller import RecorderController
from station.episode.recorder.options import RecordingOptions
from station.episode.storage.manifest import Recorder
from station.episode.storage.request import parse_request, request_id
from station.episode.writing.servers_seen import is_motion
from station.errors import Refused

if TYPE_CHECKING:
    from station.bus.tap import Position, Write
    from station.episode.recorder.both_taps import Cut

_THEN = ", then "
_MOST_CHANGES = 10  # of the tap, that are told one by one
_MOST_KEYS = 100_000  # of which we remember whether they matter; a client that invents keys must not fill the memory


class Recording(RecorderController):
    """A recorder's state. One thread feeds it and polls it; no call waits for the disk but for making a folder."""

    def __init__(
        self, options: RecordingOptions, *, backend: str, is_lossless: bool, bus: str = "", bulk: str = "",
        clock: Clock = SYSTEM,
    ) -> None:  # fmt: skip
        super().__init__(options, Recorder(backend=backend, is_lossless=is_lossless, bus=bus, bulk=bulk), clock)
        self._known: dict[str, Callable[[Write], None] | None] = {}

    def seed(self, key: str, value: bytes, stamp: bytes | None) -> None:
        """Add what a key held before the tap was opened: servers that are up, a request that is answered."""
        if key == keys.RECORD:
            self.answers.is_new(request_id(value))
        elif key.startswith(keys.CLOCK_PREFIX):
            self._on_clock(key.removeprefix(keys.CLOCK_PREFIX))
        elif self._heard.is_of_interest(key):
            self._heard.record(key, value, stamp, self.clock.monotonic_ns())

    def latched(self, states: Sequence[Write]) -> None:
        """Add states to the pre-roll that were written before the tap was open; see `recorder.latched`."""
        self._ring.add(states, self._position)
        self._latched = {state.key: state.stamp for state in states}

    def placed(self, position: Position | None) -> None:
        """Set where a tap stands before its first write."""
        self._position = position

    def missed(self, request: Write) -> None:
        """Do a request that was written while no tap was open, unless it was seen; the file does not hold it."""
        if request.value is not None and not self.answers.knows(request_id(request.value)):
            self._request(request)

    def feed(
        self, writes: Sequence[Write], position: Position | None = None, *, is_live: bool = True, is_whole: bool = True
    ) -> None:
        """Add what the tap returned.

        Args:
            writes: In the order of the bus.
            position: The tap's place after the last of them.
            is_live: False for what had waited for us at the server.
            is_whole: False where the place is not known; no place is saved then.
        """
        if self._awaited:
            writes = self._behind_the_start(writes)
        done = 0
        for index, write in enumerate(writes):
            handle = self._handler(write.key)
            if handle is None:
                continue
            if write.key == keys.RECORD:
                self._advance(writes[done : index + 1], None, is_whole=False, is_live=is_live)
                done = index + 1
            handle(write)
        self._advance(writes[done:], position, is_whole=is_whole, is_live=is_live)
        self._position = position

    def feed_to_the_end(self, writes: Sequence[Write], position: Position | None, later: Collection[str]) -> None:
        """Add what the tap returned for an episode that was ended before, up to what ended it; see `is_recording`.

        What comes behind belongs to a later episode. None of it is done here, and none is pre-roll.

        Args:
            writes: In the order of the bus.
            position: The tap's place after the last of them.
            later: Ids of the requests that began later episodes.
        """
        start_id = self._awaited or self._ignored_until
        begun = not start_id  # what comes before its own start was asked of the episode before it
        for number, write in enumerate(writes):
            action, asker = self._new_request(write) if begun else ("", "")
            begun = begun or (write.key == keys.RECORD and request_id(write.value or b"") == start_id)
            if action in ("stop", "discard"):
                self.feed(writes[: number + 1], is_live=False, is_whole=False)
            elif action == "start" and asker in later:
                self.feed(writes[:number], is_live=False, is_whole=False)
                self.finish("killed")
            else:
                continue
            self._ring.clear()
            return
        self.feed(writes, position, is_live=False)

    def _new_request(self, write: Write) -> tuple[str, str]:
        """Return action and id of a request that was not seen before; empty ones for any other write."""
        if write.key != keys.RECORD or write.value is None or self.answers.knows(request_id(write.value)):
            return "", ""
        try:
            request = parse_request(write.value)
        except Refused:
            return "", ""
        return request.action, request.id

    def _behind_the_start(self, writes: Sequence[Write]) -> Sequence[Write]:
        """Put what leads up to the awaited start into its episode, as its pre-roll; return what comes behind."""
        take = self._active
        found = next((n for n, w in enumerate(writes) if w.key == keys.RECORD and self._is_awaited(w)), None)
        before = writes if found is None else writes[: found + 1]
        if take is not None:
            oldest_ns = take.anchor.mono_ns - int(self.options.preroll_s * 1e9)
            take.begin([write for write in before if write.mono_ns >= oldest_ns] if self.options.preroll_s else [])
        if found is None:
            return []
        self._awaited = ""
        return writes[found + 1 :]

    def _is_awaited(self, write: Write) -> bool:
        return write.value is not None and request_id(write.value) == self._awaited

    def hole(self, from_ns: int, to_ns: int, reason: str) -> None:
        """Record that writes between two instants [ns, monotonic] may be missing."""
        self._ring.clear()
        self._awaited = self._ignored_until = ""  # a start that was to come once more is among them
        if self._active is not None:
            self._active.hole(from_ns, to_ns, reason)

    def bulk_cut(self, cut: Cut) -> None:
        """Record what befell the bulk bus; what it had not given when an episode ends is missing there."""
        self._bulk_lost = cut if cut.kind == "lost" else None
        if cut.kind == "hole":
            self._bulk_hole = cut
            if self._active is not None:
                self._tell_bulk_hole(self._active, cut, cut.to_ns)

    @property
    def is_recording(self) -> bool:
        """Whether there is an episode now."""
        return self._active is not None

    @property
    def is_ignoring(self) -> bool:
        """Whether a start is yet to come by, see `ignore_until`."""
        return bool(self._ignored_until)

    @property
    def load(self) -> float:
        """How full the queue before the disk is, 0..1; from a half on images are dropped."""
        return self._active.writer.load if self._active is not None else 0.0

    def retapped(self, backend: str, is_lossless: bool) -> None:
        """Record that another tap is in use from now on."""
        for recorder in [self.tap, *([self._active.manifest.recorder] if self._active else [])]:
            recorder.backend = _then(recorder.backend, backend)
            recorder.is_lossless &= is_lossless
        self.tap.backend, self.tap.is_lossless = backend, is_lossless

    def unseen_keys(self, count: int) -> None:
        """Set how many keys there are that the tap cannot read."""
        if self._active is not None and self._active.manifest.recorder.unseen_keys != count:
            self._active.manifest.recorder.unseen_keys = count
            self._active.touch()

    def _handler(self, key: str) -> Callable[[Write], None] | None:
        try:
            return self._known[key]
        except KeyError:
            if len(self._known) >= _MOST_KEYS:
                self._known.clear()
            handle = self._known[key] = self._choose(key)
            return handle

    def _choose(self, key: str) -> Callable[[Write], None] | None:
        if key == keys.RECORD:
            return self._request
        if key in (keys.EVENT, keys.NOT_MIRRORED) or is_motion(key):
            return self._add_to_manifest
        if key.startswith(keys.CLOCK_PREFIX):
            boot = key.removeprefix(keys.CLOCK_PREFIX)
            return lambda _write: self._on_clock(boot)
        return self._on_facts if self._heard.is_of_interest(key) else None

    def _advance(
        self, writes: Sequence[Write], position: Position | None, *, is_whole: bool = True, is_live: bool = True
    ) -> None:
        self._ring.add(writes, self._position)
        if self._active is not None:
            self._active.put(writes, position, is_whole=is_whole, is_live=is_live)

    def _add_to_manifest(self, write: Write) -> None:
        if self._active is not None:
            self._active.add_to_manifest(write)

    def _on_clock(self, boot: str) -> None:
        """Ask for a machine's clock as soon as it tells of it: its values may be recorded in a moment."""
        self.options.writer.offset_of(boot)

    def _on_facts(self, write: Write) -> None:
        if write.value is None:
            return
        self._heard.record(write.key, write.value, write.stamp, write.mono_ns)
        if self._active is not None and write.key.startswith(keys.CONFIG_PREFIX):
            self._heard.fill(self._active.manifest)
            self._active.touch()


def _then(told: str, backend: str) -> str:
    """Return the taps that were used, with one more behind them; of very many, the first ones and the last."""
    if told.endswith(backend):
        return told
    names = told.split(_THEN)
    more = _THEN + "…" if len(names) > _MOST_CHANGES else ""
    return _THEN.join(names[:_MOST_CHANGES]) + more + _THEN + backend
