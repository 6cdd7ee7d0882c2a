"""The recorder: taps the bus, keeps every write, and turns requests into episodes on disk."""

from __future__ import annotations

import contextlib
import logging
import sys
import time
from pathlib import Path
from typing import Any, Literal

import msgspec

from station.bus import codec, keys
from station.bus import stamp as stamps
from station.bus.client import Bus
from station.bus.tap import Tap, Write, open_tap, why_not_resumed
from station.config import to_plain
from station.episode.claim import Claim
from station.episode.folder import data_folder
from station.episode.heap import give_back_large_blocks
from station.episode.heritage import Heritage
from station.episode.options import RecordingOptions
from station.episode.progress import WriterOptions
from station.episode.recording import Recording
from station.episode.request import RecorderState
from station.episode.resume import as_written
from station.errors import BusError
from station.life.server import Life, ServerKind
from station.software import software

log = logging.getLogger(__name__)

_READ_S = 0.02  # how long a due answer may wait for a write that does not come
_STATE_PERIOD_S = 0.5
_ANSWER_SPACING_S = 0.02  # two answers at once would overwrite each other before the first asker has read
_RETRY_S = 0.05  # what a bus that is restarted at once costs an episode
_DRAIN_S = 2.0  # a healthy tap is less than 10 ms behind
_CLOSE_S = 8.0  # a supervisor kills after 15 s, its own death after 10
_MANY_MINUTES = 20
_SWITCH_S = 0.001  # Python's 5 ms between threads would stand in the arrival times


class RecorderConfig(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Configuration of the recorder.

    Attributes:
        data: Folder of episodes; None: ``$STATION_DATA``, else ``./data``.
        task: Name of the task where a request gives none.
        preroll_s: How much of what came before the start belongs to an episode [s]; 0 for nothing.
        preroll_mb: Bound of the memory for that [MB].
        backend: Tap to use; None probes for the best.
        flush_s: Time between two flushes to the disk [s]: what a power cut loses.
        flush_kb: Size that makes a flush come sooner [kB]: a bound of the memory.
        queue_mb: What may wait for a slow disk [MB]; beyond, images go before signals, and all is counted per key.
        min_free_mb: Free disk space that is left alone [MB]: no episode starts that would need it, and one that comes
            to it is ended, whole.
        planned_s: Time that must fit on the disk where a start request plans none [s].
        warn_minutes: Warn when the disk ends an episode within this time [min], and at each half of it.
        resume_s: How long an episode stays open while the bus is gone [s].
        take_up_s: How long after its recorder was killed an episode is taken up again with a hole [s], where the server
            no longer has what was written meanwhile; where it has, there is no limit.
    """

    data: Path | None = None
    task: str = "untitled"
    preroll_s: float = 2.0
    preroll_mb: float = 256.0
    backend: Literal["replication", "notifications", "poll"] | None = None
    flush_s: float = 0.5
    flush_kb: float = 8192.0
    queue_mb: float = 128.0
    min_free_mb: float = 500.0
    planned_s: float = 60.0
    warn_minutes: float = 10.0
    resume_s: float = 5.0
    take_up_s: float = 60.0

    def __post_init__(self) -> None:
        """Refuse what cannot work."""
        for name in (
            "preroll_s", "preroll_mb", "min_free_mb", "planned_s", "warn_minutes", "resume_s", "take_up_s",
        ):  # fmt: skip
            if not getattr(self, name) >= 0:
                raise ValueError(f"{name} is {getattr(self, name)}, expected 0 or more")
        for name in ("flush_s", "flush_kb", "queue_mb"):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name} is {getattr(self, name)}, expected more than 0")

    @property
    def options(self) -> RecordingOptions:
        """The same for the recording itself."""
        return RecordingOptions(
            data=data_folder(self.data).absolute(),
            preroll_s=self.preroll_s,
            preroll_bytes=int(self.preroll_mb * 1e6),
            min_free_mb=self.min_free_mb,
            planned_s=self.planned_s,
            warn_minutes=self.warn_minutes,
            task=self.task,
            writer=WriterOptions(
                flush_s=self.flush_s, flush_bytes=int(self.flush_kb * 1e3), queue_bytes=int(self.queue_mb * 1e6)
            ),
            config=to_plain(self),
        )


def main(config: RecorderConfig, life: Life) -> int:
    """Run until asked to stop; an open episode is then closed."""
    options = config.options
    sys.setswitchinterval(_SWITCH_S)
    give_back_large_blocks()
    with Claim(options.data, life.bus) as claim:
        recorder = _Recorder(config, options, life)
        recorder.recording.claim = claim.renew
        try:
            life.configured(recorder.facts())
            if not life.ready() and not recorder.recording.is_recording:
                return 0
            while not life.stopping:
                recorder.step()
            return recorder.close()
        finally:
            recorder.hang_up()


class _Recorder:
    """A recording, the tap that feeds it, and the bus that it answers on."""

    def __init__(self, config: RecorderConfig, options: RecordingOptions, life: Life) -> None:
        self._config = config
        self._life = life
        self._state_due = self._answer_due = 0.0
        heritage = Heritage(options, life, config.take_up_s)
        self._tap: Tap = open_tap(life.bus.address, resume=heritage.position, backend=config.backend)
        self._heard_ns = time.monotonic_ns()
        self.recording = Recording(
            options, backend=self._tap.backend, is_lossless=self._tap.is_lossless, bus=str(life.bus.address)
        )
        self.recording.placed(self._tap.position())
        self._seed()
        self._written_ns = heritage.enter(self.recording, self._tap)  # the newest write, on our monotonic clock

    def facts(self) -> dict[str, Any]:
        """What this server states that it runs."""
        return {
            "server": self._life.name,
            "role": KIND.role,
            "backend": self._tap.backend,
            "is_lossless": self._tap.is_lossless,
            "data": str(self.recording.options.data),
            "software": msgspec.to_builtins(software()),
            "config": to_plain(self._config),
        }

    def step(self) -> None:
        """Take in what arrived, and say what is due."""
        is_late = getattr(self._tap, "is_catching_up", False)
        try:
            # What waited for us so long can wait until the disk has caught up.
            must_wait = is_late and self.recording.is_congested and not self._life.stop_event.wait(_READ_S)
            writes = [] if must_wait else self._tap.read(_READ_S)
        except BusError as error:
            self._tap_again(error)
            return
        self._heard_ns = time.monotonic_ns()
        if writes:
            writes = as_written(writes, self._written_ns) if is_late else writes
            self._written_ns = writes[-1].mono_ns
            if not is_late:  # what waited came all at once, and says nothing of the rate
                self.recording.room.note(writes)
            self.recording.feed(writes, self._tap.position(), is_live=not is_late)
        self.recording.not_mirrored(getattr(self._tap, "not_mirrored", 0))
        self.recording.poll()
        self._speak()

    def close(self) -> int:
        """Close the open episode and give the last answers; returns the exit code."""
        self._drain()
        is_closed = self.recording.close(_CLOSE_S)
        if not is_closed:
            self._life.event("recorder-not-closed", severity="error", waited_s=_CLOSE_S)
        self._say_notices()
        for answer in self.recording.answers.take():
            self._life.bus.publish({keys.RECORD_ACK: codec.json_object(answer)})
        return 0 if is_closed else 1

    def _drain(self) -> None:
        """Take in all that was written before we were asked to stop: until a write of our own has come back."""
        began_ns = time.monotonic_ns()
        deadline_ns = began_ns + int(_DRAIN_S * 1e9)
        self._life.bus.publish({keys.RECORDER: codec.json_object(self.recording.state())})
        is_back = False
        while not is_back and time.monotonic_ns() < deadline_ns:
            try:
                writes = self._tap.read(_READ_S)
            except BusError as error:
                log.warning("the tap was lost at the end: %s", error)
                return
            self.recording.feed(writes, self._tap.position())
            is_back = any(self._is_own(write, began_ns) for write in writes)

    def _is_own(self, write: Write, since_ns: int) -> bool:
        mark = stamps.decode(write.stamp) if write.stamp is not None and write.key == keys.RECORDER else None
        return mark is not None and mark.source == self._life.bus.source and mark.mono_ns >= since_ns

    def hang_up(self) -> None:
        """Leave the bus as if no recorder had been there, so that the next one need not wonder."""
        self._tap.close()
        with contextlib.suppress(BusError):  # a bus that is gone has forgotten us already
            self._life.bus.call("DEL", keys.RECORDER, keys.stamp(keys.RECORDER))

    def _seed(self) -> None:
        """Learn from the bus what was said before the tap was open."""
        bus = self._life.bus
        names = [name for prefix in (keys.SERVER_PREFIX, keys.CONFIG_PREFIX) for name in bus.names(prefix + "*")]
        for key, sample in bus.read(names).items():
            self.recording.seed(key, sample.value, sample.stamp.encode() if sample.stamp else None)

    def _catch_up(self) -> None:
        """Learn after a hole what was said in it: servers that came up, and a request that waits for its answer."""
        with contextlib.suppress(BusError):  # gone again; the next hole brings us back here
            self._seed()
            value = self._life.bus.get(keys.RECORD)
            if value is not None:
                self.recording.missed(Write(keys.RECORD, value, None, time.monotonic_ns()))

    def _speak(self) -> None:
        now = time.monotonic()
        self._say_notices()
        if now >= self._answer_due and (answer := self.recording.answers.next()) is not None:
            self._answer_due = now + _ANSWER_SPACING_S
            self._life.bus.publish({keys.RECORD_ACK: codec.json_object(answer)})
            self._state_due = now
        if now >= self._state_due:
            self._state_due = now + _STATE_PERIOD_S
            state = self.recording.state()
            self._life.bus.publish({keys.RECORDER: codec.json_object(state)})
            self._life.report(
                recording=state.episode_id, backend=state.backend, lag_ms=state.lag_ms, lag_p99_ms=state.lag_p99_ms,
                dropped=state.dropped, restarts=state.restarts, minutes_left=_shown(state),
            )  # fmt: skip

    def _say_notices(self) -> None:
        while self.recording.notices:
            notice = self.recording.notices.popleft()
            self._life.event(notice.name, severity=notice.severity, **notice.numbers)

    def _tap_again(self, error: BusError) -> None:
        """Open another tap where the lost one was; an episode waits for it, though not for ever."""
        position = self._tap.position()
        self._tap.close()
        self._life.event("tap-lost", severity="warning", reason=_bare(error, self._life.bus))
        deadline = time.monotonic() + self._config.resume_s
        while not self._life.stopping:
            try:
                # One that is coming up refuses for a moment; only one that goes on to do so costs the lossless tap.
                is_early = self._tap.is_lossless and time.monotonic() <= deadline
                backend = self._config.backend or (self._tap.backend if is_early else None)
                self._tap = open_tap(self._life.bus.address, resume=position, backend=backend)
                break
            except BusError:  # still gone; the loss was said above, its end is said below
                if time.monotonic() > deadline:
                    self.recording.finish("bus-lost")
                self.recording.poll()
                self._life.stop_event.wait(_RETRY_S)
        else:
            return
        now_ns = time.monotonic_ns()
        seconds = round((now_ns - self._heard_ns) * 1e-9, 3)
        self.recording.retapped(self._tap.backend, self._tap.is_lossless)
        if self._tap.resumed:
            self._life.event("tap-resumed", severity="warning", seconds=seconds, reason=_bare(error, self._life.bus))
        else:
            why = why_not_resumed(position, self._tap.position())
            self.recording.placed(self._tap.position())
            self.recording.hole(self._heard_ns, now_ns, f"the tap could not go on where it was: {why}")
            self._life.event("tap-hole", severity="warning", seconds=seconds, reason=why)
            self._catch_up()


def _shown(state: RecorderState) -> float | None:
    """Return the minutes left of an episode as a person reads them: whole ones, where there are many."""
    left = state.minutes_left if state.episode_id else None
    return left if left is None or left < _MANY_MINUTES else round(left)


def _bare(error: BusError, bus: Bus) -> str:
    """Return what happened to the tap, without the address of the bus."""
    return str(error).removeprefix(f"bus {bus.address}: ")


KIND = ServerKind(
    name="recorder",
    role="recorder",
    summary="Records every write of the bus, byte for byte, into episodes.",
    config=RecorderConfig,
    main=main,
)
