"""The emergency stop as a file, which outlives bus, processes and a reboot until somebody releases the stop.

One small file per bus in the user's state folder, ``$XDG_STATE_HOME/station/stops``, else the one in
``~/.local/state``: the runtime folder is emptied at a reboot, and the data folder is another one from command to
command. It holds the newest word, a stop or a release, and when that was asked for: a word that is older than the one
in the file changes nothing, however late it is written. A file that cannot be read counts as a stop.
"""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import logging
import os
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from pathlib import Path

import msgspec

from station.atomic_file import write_atomic
from station.bus import address as addresses
from station.bus import codec, stamp
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.bus.sample import Sample
from station.errors import ConfigError, StationError
from station.life import estop
from station.printable import printable

log = logging.getLogger(__name__)

_LOCKED_WITHIN_S = 1.0  # a write takes milliseconds, on a slow disk a tenth of a second
_LOCK_AGAIN_S = 0.01
_FLUSH_S = 5.0
_LONGEST = 200  # characters of a reason


class NotKept(StationError):
    """The file of the stop cannot be written."""


class _Overtaken(Exception):
    """Another process has written the file."""


class LatchedStop(msgspec.Struct, frozen=True, kw_only=True):
    """A stop that nobody has released.

    Attributes:
        reason: Who asked for it and why.
        since_wall_ns: When, on the wall clock [ns]; None when unknown.
        remedy: The command that releases it.
    """

    reason: str
    since_wall_ns: int | None
    remedy: str

    def __str__(self) -> str:
        """Return it as a sentence: when, by what, and how to release it."""
        return f"{self.found}; release it with `{self.remedy}`"

    @property
    def found(self) -> str:
        """When it was latched, and by what."""
        return f"the emergency stop is latched{_since(self.since_wall_ns)} ({self.reason})"


class _Word(msgspec.Struct, frozen=True, kw_only=True):
    """What the file holds; `asked_ns` is of the monotonic clock of `boot`."""

    bus: str
    stop: bool
    reason: str
    since_wall_ns: int
    asked_ns: int
    boot: str


class StopFile:
    """The file of a bus; safe to share between threads and processes.

    Args:
        address: The bus. Two addresses of one server have two files.
    """

    def __init__(self, address: BusAddress) -> None:
        self._bus, self._clock = str(address), address.clock
        self.path = folder() / f"{hashlib.sha256(self._bus.encode()).hexdigest()[:16]}.json"
        self._remedy = remedy(address)

    def read(self) -> LatchedStop | None:
        """Return the stop that is latched, or None."""
        try:
            word = self._load()
        except NotKept as error:
            return LatchedStop(reason=f"{error}; what cannot be read counts as a stop", since_wall_ns=None,
                               remedy=self._remedy)  # fmt: skip
        if word is None or not word.stop:
            return None
        return LatchedStop(reason=word.reason, since_wall_ns=word.since_wall_ns, remedy=self._remedy)

    def latch(self, reason: str, asked_ns: int | None = None) -> None:
        """Keep a stop that was asked for at an instant of the monotonic clock [ns], by default now.

        One that is latched already keeps its time and reason.

        Raises:
            NotKept: the file cannot be written.
        """
        self._write(self._word(reason, asked_ns, stop=True))

    def release(self, reason: str, asked_ns: int | None = None) -> None:
        """Release what was latched until an instant of the monotonic clock [ns], by default now.

        Raises:
            NotKept: the file cannot be written.
        """
        self._write(self._word(reason, asked_ns, stop=False))

    def _word(self, reason: str, asked_ns: int | None, *, stop: bool) -> _Word:
        return _Word(
            bus=self._bus, stop=stop, reason=printable(reason, _LONGEST), since_wall_ns=self._clock.wall_ns(),
            asked_ns=self._clock.monotonic_ns() if asked_ns is None else asked_ns, boot=stamp.boot_id(),
        )  # fmt: skip

    def _load(self) -> _Word | None:
        """Return what the file holds; None where there is none.

        Raises:
            NotKept: it cannot be read.
        """
        try:
            return codec.parse_struct(self.path.read_bytes(), _Word)
        except FileNotFoundError:
            return None
        except (OSError, codec.BadValue) as error:
            raise NotKept(f"{self.path}: {_reason(error)}") from None

    def _write(self, word: _Word) -> None:
        try:
            self.path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
            while not self._replace(self._known(), word):
                pass  # another process has written meanwhile
        except OSError as error:
            raise NotKept(f"{self.path}: {_reason(error)}; make it writable, or remove it") from None

    def _replace(self, known: _Word | None, word: _Word) -> bool:
        """Write a word over what is known, unless that is newer; return whether it still stood there.

        The lock is not held while the disk takes its time: who has waited in vain for it writes all the same, and
        might be overwritten by an older word.
        """
        if (newest := _newer(known, word)) == known:
            return True

        def put(temporary: str, path: Path) -> None:
            with self._locked():
                if self._known() != known:
                    raise _Overtaken
                os.replace(temporary, path)

        try:
            write_atomic(self.path, codec.json_object(newest), mode=0o600, put=put)
        except _Overtaken:
            return False
        return True

    def _known(self) -> _Word | None:
        """Return what the file holds; None where that is nothing, or nothing that can be read: it is replaced."""
        try:
            return self._load()
        except NotKept:
            return None

    @contextlib.contextmanager
    def _locked(self) -> Iterator[None]:
        """Keep other processes from writing meanwhile; one that is frozen holds up no other for long."""
        descriptor = os.open(self.path.with_suffix(".lock"), os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
        try:
            end_s = self._clock.monotonic_s() + _LOCKED_WITHIN_S
            while not _lock(descriptor) and self._clock.monotonic_s() < end_s:
                self._clock.sleep(_LOCK_AGAIN_S)
            yield
        finally:
            os.close(descriptor)


class StopKeeper:
    """Writes a stop's file in a thread of its own, in order: stopping a robot waits for no disk.

    Args:
        address: The bus.

    Attributes:
        file: What is written.
        failure: Why the newest word could not be kept, or "".
    """

    def __init__(self, address: BusAddress) -> None:
        self.file = StopFile(address)
        self.failure = ""
        self._clock = address.clock
        self._words: deque[tuple[bool, str, int] | None] = deque()
        self._has_words = threading.Event()
        self._thread = self._clock.start(self._run, "stop-file")

    def latch(self, reason: str, asked_ns: int | None = None) -> None:
        """Keep a stop, as `StopFile.latch`."""
        self._put((True, reason, self._clock.monotonic_ns() if asked_ns is None else asked_ns))

    def release(self, reason: str, asked_ns: int | None = None) -> None:
        """Release it, as `StopFile.release`."""
        self._put((False, reason, self._clock.monotonic_ns() if asked_ns is None else asked_ns))

    def close(self) -> None:
        """Wait until all is on the disk; not for ever."""
        self._put(None)
        self._clock.join(self._thread, _FLUSH_S)
        if self._thread.is_alive():
            self._fail(f"{self.file.path}: the disk did not take it within {_FLUSH_S:g} s")

    def _put(self, word: tuple[bool, str, int] | None) -> None:
        self._words.append(word)
        self._has_words.set()

    def _next(self) -> tuple[bool, str, int] | None:
        while not self._words:
            self._clock.wait(self._has_words)
            self._has_words.clear()
        return self._words.popleft()

    def _run(self) -> None:
        while (word := self._next()) is not None:
            is_stop, reason, asked_ns = word
            try:
                (self.file.latch if is_stop else self.file.release)(reason, asked_ns)
            except NotKept as error:
                self._fail(str(error))
            else:
                self.failure = ""

    def _fail(self, reason: str) -> None:
        self.failure = reason
        log.error("an emergency stop, or its release, will not outlive the bus: %s", reason)


def latched(bus: Bus) -> LatchedStop | None:
    """Return the stop that nobody has released, by its file or by the bus; or None.

    Raises:
        BusError: the bus is lost.
    """
    return StopFile(bus.address).read() or on_bus(bus.address, bus.read(estop.KEYS).get)


def on_bus(address: BusAddress, find: Callable[[str], Sample | None]) -> LatchedStop | None:
    """Return the stop that the keys of the stop hold, or None.

    Args:
        address: The bus.
        find: Returns what a key holds.
    """
    if (found := estop.latched(find)) is None:
        return None
    request, sample = found
    since_wall_ns = None if sample.stamp is None else sample.stamp.wall_ns
    return LatchedStop(reason=printable(request.reason, _LONGEST), since_wall_ns=since_wall_ns, remedy=remedy(address))


def folder() -> Path:
    """Return the folder of the files; not necessarily there."""
    base = os.environ.get("XDG_STATE_HOME")
    return (Path(base).absolute() if base else Path.home() / ".local" / "state") / "station" / "stops"


def remedy(address: BusAddress) -> str:
    """Return the command that releases the stop of a bus."""
    try:
        is_default = str(address) == str(addresses.default())
    except ConfigError:  # of the environment, which the address then is not from
        is_default = False
    return "station estop --reset" + ("" if is_default else f" --bus {address}")


def _newer(known: _Word | None, word: _Word) -> _Word:
    """Return the word that counts; a stop that is asked for again is the one that was latched first."""
    if known is None or (known.boot == word.boot and known.asked_ns > word.asked_ns):
        return known or word
    if known.stop and word.stop:
        return msgspec.structs.replace(known, asked_ns=word.asked_ns, boot=word.boot)
    return word


def _lock(descriptor: int) -> bool:
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


def _since(wall_ns: int | None) -> str:
    try:
        return "" if wall_ns is None else time.strftime(" since %Y-%m-%d %H:%M:%S", time.localtime(wall_ns * 1e-9))
    except (OverflowError, ValueError, OSError):  # any number may stand in a stamp
        return ""


def _reason(error: Exception) -> str:
    return (error.strerror if isinstance(error, OSError) else None) or str(error)
