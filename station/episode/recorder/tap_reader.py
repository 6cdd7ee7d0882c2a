"""What a recorder takes in: its tap, through all that befalls it, and the recording that it feeds."""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from station.bus import codec, keys
from station.bus import stamp as stamps
from station.bus.tap import Tap, Write, why_not_resumed
from station.episode.recorder.both_taps import BothTaps, cuts_of, open_taps
from station.episode.recorder.catching_up import CatchingUp
from station.episode.recorder.crash_recovery import CrashRecovery
from station.episode.recorder.latched import latched, not_among
from station.episode.recorder.recording import Recording
from station.episode.recorder.resume import as_written, newest_written_ns
from station.errors import BusError

if TYPE_CHECKING:
    from station.bus.client import Bus
    from station.episode.recorder.options import RecordingOptions
    from station.life.server import Life

log = logging.getLogger(__name__)

_READ_S = 0.02  # how long a due answer may wait for a write that does not come
_RETRY_S = 0.05  # what a bus that is restarted at once costs an episode
_DRAIN_S = 2.0  # a healthy tap is less than 10 ms behind
_NOT_READ = "the recorder was asked to stop before it had caught up with what was written"


class TapReader:
    """Opens the tap where the recorder before us was lost, and again whenever it is lost; what it misses is told.

    Args:
        options: Of the recording.
        life: The server's: its bus, its events, the wish to stop.
        backend: Tap to use; None probes for the best.
        resume_s: How long an episode stays open while the bus is gone [s].
        take_up_s: How long after its recorder was killed an episode is taken up again with a hole [s].

    Attributes:
        recording: What is fed.
        tap: The tap in use.
    """

    def __init__(
        self, options: RecordingOptions, life: Life, *, backend: str | None, resume_s: float, take_up_s: float
    ) -> None:
        self._life, self._backend, self._resume_s = life, backend, resume_s
        self._clock = clock = life.clock
        recovery = CrashRecovery(options, life, take_up_s)
        self._offset_of = options.writer.offset_of
        self.tap: Tap = open_taps(
            life.bus.address, life.bus.bulk_address, resume=recovery.position, backend=backend,
            since_ns=recovery.saved_ns, offset_of=self._offset_of,
        )  # fmt: skip
        bus, bulk, tap = str(life.bus.address), str(life.bus.bulk_address or ""), self.tap
        self.recording = Recording(
            options, backend=tap.backend, is_lossless=tap.is_lossless, bus=bus, bulk=bulk, clock=clock
        )
        self._seed()
        recovery.finish_ended(self.recording, backend)
        self.recording.placed(tap.position())
        self._catching_up = CatchingUp(tap, clock.monotonic_s(), life.event)
        self._heard_ns = self._known_ns = clock.monotonic_ns()  # the tap; up to when we know of every write
        self._written_ns = recovery.enter(self.recording, tap)  # the newest write, on our monotonic clock
        if tap.resumed:
            self._known_ns = self._written_ns or recovery.start_ns
        self._tell_cuts()
        self._preroll_s = options.preroll_s
        if not tap.resumed:
            self._read_earlier_states()
        recovery.see_to_request(self.recording, is_in_stream=bool(tap.resumed))

    def step(self) -> None:
        """Read what arrived, unless it had better wait at the bus; reconnect a tap that is lost."""
        try:
            now_s, written_s = self._clock.monotonic_s(), self._written_ns * 1e-9
            must_wait = self._catching_up.must_wait(self.recording.load, now_s, written_s)
            if must_wait and not self._clock.wait(self._life.stop_event, _READ_S):
                self._heard_ns = self._clock.monotonic_ns()
                return
            writes = self._read()
        except BusError as error:
            self._tap_again(error)
            return
        if writes:
            self._feed(writes)
        self.recording.unseen_keys(self.tap.unseen_keys)

    def drain(self) -> None:
        """Read all that was written before we were asked to stop: until a write of our own has come back."""
        try:
            is_whole = self._read_up_to_now(self._feed)
        except BusError as error:
            log.warning("the tap was lost at the end: %s", error)
            reason = f"the tap was lost while the recorder stopped: {_bare(error, self._life.bus)}"
            self.recording.hole(self._known_ns, self._clock.monotonic_ns(), reason)
            return
        if isinstance(self.tap, BothTaps) and (writes := self.tap.settle()):
            self._feed(writes)
        if not is_whole:
            self.recording.hole(self._known_ns, self._clock.monotonic_ns(), _NOT_READ)

    def close(self) -> None:
        """Hang up; a second call does nothing."""
        self.tap.close()

    def _feed(self, writes: Sequence[Write]) -> None:
        is_late = self._catching_up.is_late
        if is_late:
            writes = as_written(writes, self._written_ns, self.recording.options.writer.offset_of)
        self._written_ns = writes[-1].mono_ns
        if not is_late:  # what waited comes all at once, and says nothing of the rate
            self.recording.room.count(writes)
        self.recording.feed(writes, self.tap.position(), is_live=not is_late)

    def _read(self) -> list[Write]:
        """Return what the tap brings, and note up to when we know of every write: what it brings may be old."""
        writes = self.tap.read(_READ_S)
        self._tell_cuts()
        self._heard_ns = now_ns = self._clock.monotonic_ns()
        told = [write for write in writes if not keys.is_bulk(write.key)]  # a bulk bus proves nothing of the bus
        self._known_ns = max(self._known_ns, min(newest_written_ns(told), now_ns))
        return writes

    def _tell_cuts(self) -> None:
        """Tell of the bulk bus what befell it; the recording goes on without it."""
        for cut in cuts_of(self.tap):
            self.recording.bulk_cut(cut)
            numbers = {} if cut.kind == "lost" else {"seconds": round((cut.to_ns - cut.from_ns) * 1e-9, 3)}
            self._life.event(f"tap-{cut.kind}", severity="warning", bus="bulk", reason=cut.reason, **numbers)

    def _read_up_to_now(self, take: Callable[[list[Write]], None]) -> bool:
        """Hand over what the tap brings until a write of our own has come back; False when that takes too long.

        Raises:
            BusError: the tap is lost.
        """
        began_ns = self._clock.monotonic_ns()
        deadline_ns = began_ns + int(_DRAIN_S * 1e9)
        self._life.bus.publish({keys.RECORDER: codec.json_object(self.recording.state())})
        while self._clock.monotonic_ns() < deadline_ns:
            writes = self._read()
            if writes:
                take(writes)
            if any(self._is_own(write, began_ns) for write in writes):
                return True
        return False

    def _read_earlier_states(self) -> None:
        """Have states that were written before the tap was open in the pre-roll, unless the tap brings them as well."""
        states = latched(self._life.bus, self._preroll_s) if self._preroll_s else []
        if not states:
            return
        early: list[Write] = []
        try:
            if self._read_up_to_now(early.extend):
                self.recording.latched(not_among(states, early))
            else:
                log.warning("the bus is slow: states from before the recorder's tap are not in its pre-roll")
        finally:
            if early:
                self._feed(early)

    def _is_own(self, write: Write, since_ns: int) -> bool:
        mark = stamps.decode(write.stamp) if write.stamp is not None and write.key == keys.RECORDER else None
        return mark is not None and mark.source == self._life.bus.source and mark.mono_ns >= since_ns

    def _seed(self) -> None:
        """Learn from the bus what was said before the tap was open."""
        bus = self._life.bus
        names = [
            name
            for prefix in (keys.SERVER_PREFIX, keys.CONFIG_PREFIX, keys.CLOCK_PREFIX)
            for name in bus.names(prefix + "*")
        ]
        for key, sample in bus.read(names).items():
            self.recording.seed(key, sample.value, sample.stamp.encode() if sample.stamp else None)

    def _learn(self) -> None:
        """Learn after a hole what was said in it: servers that came up, and a request that waits for its answer."""
        with contextlib.suppress(BusError):  # gone again; the next hole brings us back here
            self._seed()
            self._read_earlier_states()
            if (value := self._life.bus.get(keys.RECORD)) is not None:
                self.recording.missed(Write(keys.RECORD, value, None, self._clock.monotonic_ns()))

    def _tap_again(self, error: BusError) -> None:
        """Open another tap where the lost one was; an episode waits for it, though not for ever."""
        position, known_ns = self.tap.position(), self._known_ns
        self.tap.close()
        reason = _bare(error, self._life.bus)
        self._life.event("tap-lost", severity="warning", reason=reason)
        if not self._open_again():
            return
        now_ns = self._clock.monotonic_ns()
        seconds = round((now_ns - self._heard_ns) * 1e-9, 3)
        self._catching_up = CatchingUp(self.tap, now_ns * 1e-9, self._life.event)
        self.recording.retapped(self.tap.backend, self.tap.is_lossless)
        if self.tap.resumed:
            self._life.event("tap-resumed", severity="warning", seconds=seconds, reason=reason)
            return
        why = why_not_resumed(position, self.tap.position())
        self.recording.placed(self.tap.position())
        self._known_ns = now_ns
        self.recording.hole(known_ns, now_ns, f"the tap could not go on where it was: {why}")
        seconds = round((now_ns - known_ns) * 1e-9, 3)
        self._life.event("tap-hole", severity="warning", seconds=seconds, reason=why)
        self._learn()

    def _open_again(self) -> bool:
        """Try until there is a tap; False when we are asked to stop first."""
        deadline_s = self._clock.monotonic_s() + self._resume_s
        position = self.tap.position()
        while not self._life.stopping:
            try:
                # One that is coming up refuses for a moment; only one that goes on to do so costs the lossless tap.
                is_early = self.tap.is_lossless and self._clock.monotonic_s() <= deadline_s
                backend = self._backend or (self.tap.backend if is_early else None)
                self.tap = open_taps(
                    self._life.bus.address, self._life.bus.bulk_address, resume=position, backend=backend,
                    since_ns=self._known_ns, is_bulk_apart=True, offset_of=self._offset_of,
                )  # fmt: skip
                self._tell_cuts()
                return True
            except BusError:  # still gone; the loss was said by our caller, who says its end
                if self._clock.monotonic_s() > deadline_s:
                    self.recording.finish("bus-lost")
                self.recording.poll()
                self._clock.wait(self._life.stop_event, _RETRY_S)
        return False


def _bare(error: BusError, bus: Bus) -> str:
    """Return what happened to the tap, without the address of the bus."""
    return str(error).removeprefix(f"bus {bus.address}: ")
