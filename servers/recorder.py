"""The recorder: taps the bus, keeps every write, and turns requests into episodes on disk."""

from __future__ import annotations

import contextlib
import ctypes
import sys
from collections import deque
from pathlib import Path
from typing import Any, Literal

import msgspec

from station.bus import codec, contracts, keys
from station.config import to_plain
from station.episode.recorder.options import RecordingOptions
from station.episode.recorder.tap_reader import TapReader
from station.episode.storage.claim import Claim
from station.episode.storage.folder import data_folder
from station.episode.storage.left_out import why_not
from station.episode.storage.progress import WriterOptions
from station.episode.storage.request import RecordAnswer, RecorderState
from station.errors import BusError
from station.life.server import Life, ServerKind
from station.software import software

_STATE_PERIOD_S = 0.5
_ANSWER_SPACING_S = 0.02  # two answers at once would overwrite each other before the first asker has read
_STILL_TOLD = 8  # answers that go with the newest one: on a busy machine an asker reads later than the spacing
_CLOSE_S = 8.0  # a supervisor kills after 15 s, its own death after 10
_MANY_MINUTES = 20
_SWITCH_S = 0.001  # Python's 5 ms between threads would stand in the arrival times

_MMAP_THRESHOLD = -3  # M_MMAP_THRESHOLD of malloc.h
_LARGE_BYTES = 256 * 1024


class RecorderConfig(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Configuration of the recorder.

    Attributes:
        data: Folder of episodes; None: ``$STATION_DATA``, else ``./data``.
        task: Name of the task where a request gives none.
        leave_out: Keys that every episode does without, or beginnings of keys up to a ``_``: ``[policy_obs]``, since
            `station audit` derives observations from states and commands.
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
    leave_out: tuple[str, ...] = ()
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
        if why := why_not(self.leave_out):
            raise ValueError(why)

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
            leave_out=self.leave_out,
            writer=WriterOptions(
                flush_s=self.flush_s, flush_bytes=int(self.flush_kb * 1e3), queue_bytes=int(self.queue_mb * 1e6)
            ),
            config=to_plain(self),
        )


def main(config: RecorderConfig, life: Life) -> int:
    """Run until asked to stop; an open episode is then closed."""
    options = config.options
    writer = msgspec.structs.replace(options.writer, offset_of=life.bus.clocks.offset_of)
    options = msgspec.structs.replace(options, writer=writer)
    sys.setswitchinterval(_SWITCH_S)
    give_back_large_blocks()
    contracts.load()  # otherwise the first writes of an episode wait for it
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
    """A recording, what feeds it, and the bus that it answers on."""

    def __init__(self, config: RecorderConfig, options: RecordingOptions, life: Life) -> None:
        self._config = config
        self._life = life
        self._state_due = self._answer_due = 0.0
        self._given: deque[RecordAnswer] = deque(maxlen=_STILL_TOLD)
        self._tap_reader = TapReader(
            options, life, backend=config.backend, resume_s=config.resume_s, take_up_s=config.take_up_s
        )
        self.recording = self._tap_reader.recording

    def facts(self) -> dict[str, Any]:
        """What this server states that it runs."""
        return {
            "server": self._life.name,
            "role": KIND.role,
            "backend": self._tap_reader.tap.backend,
            "is_lossless": self._tap_reader.tap.is_lossless,
            "bulk": str(self._life.bus.bulk_address or ""),
            "data": str(self.recording.options.data),
            "software": msgspec.to_builtins(software()),
            "config": to_plain(self._config),
        }

    def step(self) -> None:
        """Read what arrived, and publish what is due."""
        self._tap_reader.step()
        self.recording.poll()
        self._speak()

    def close(self) -> int:
        """Close the open episode and give the last answers; returns the exit code."""
        self._tap_reader.drain()
        is_closed = self.recording.close(_CLOSE_S)
        if not is_closed:
            self._life.event("recorder-not-closed", severity="error", waited_s=_CLOSE_S)
        self._publish_notices()
        for answer in self.recording.answers.pop():
            self._answer(answer)
        return 0 if is_closed else 1

    def hang_up(self) -> None:
        """Leave the bus as if no recorder had been there, so that the next one need not wonder."""
        self._tap_reader.close()
        with contextlib.suppress(BusError):  # a bus that is gone has forgotten us already
            self._life.bus.call("DEL", keys.RECORDER, keys.stamp(keys.RECORDER))

    def _answer(self, answer: RecordAnswer) -> None:
        told = msgspec.structs.replace(answer, earlier=tuple(self._given))
        self._life.bus.publish({keys.RECORD_ACK: codec.json_object(told)})
        self._given.appendleft(answer)

    def _speak(self) -> None:
        now = self._life.clock.monotonic_s()
        self._publish_notices()
        if now >= self._answer_due and (answer := self.recording.answers.next()) is not None:
            self._answer_due = now + _ANSWER_SPACING_S
            self._answer(answer)
            self._state_due = now
        if now >= self._state_due:
            self._state_due = now + _STATE_PERIOD_S
            state = self.recording.state()
            self._life.bus.publish({keys.RECORDER: codec.json_object(state)})
            self._life.report(
                recording=state.episode_id, backend=state.backend, lag_ms=state.lag_ms, lag_p99_ms=state.lag_p99_ms,
                dropped=state.dropped, restarts=state.restarts, minutes_left=_shown(state),
            )  # fmt: skip

    def _publish_notices(self) -> None:
        while self.recording.notices:
            notice = self.recording.notices.popleft()
            self._life.event(notice.name, severity=notice.severity, **notice.numbers)


def _shown(state: RecorderState) -> float | None:
    """Return the minutes left of an episode as a person reads them: whole ones, where there are many."""
    left = state.minutes_left if state.episode_id else None
    return left if left is None or left < _MANY_MINUTES else round(left)


KIND = ServerKind(
    name="recorder",
    role="recorder",
    summary="Records every write of the bus, byte for byte, into episodes.",
    config=RecorderConfig,
    main=main,
    bus_timeout_s=1.0,
)


def give_back_large_blocks() -> None:
    """Have every large block of this process be a mapping of its own, which ends when it is freed.

    Left alone, glibc raises that limit to the size of the largest block that was freed, and from then on cuts buffers
    of megabytes out of the heap, between values that stay: measured under eight times the recorder's load, 40 MB more
    in the first ten minutes.
    """
    with contextlib.suppress(AttributeError, OSError):  # another C library knows no such limit, and needs none
        ctypes.CDLL(None).mallopt(_MMAP_THRESHOLD, _LARGE_BYTES)
