"""One recorder per data folder and per bus: the second is told so in a line, whatever became of the first."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path

from station import lock_file
from station.bus import keys
from station.bus.address import runtime_folder
from station.bus.client import Bus
from station.bus.stamp import boot_id
from station.errors import EpisodeError, Refused

_LOCK = ".recorder.lock"
_LISTEN_S = 1.2  # a living recorder says what it does twice a second


class Claim:
    """Holds the locks of a recorder until it is closed; the kernel drops them when the process dies.

    Args:
        data: Data folder; made when missing.
        bus: The bus; a recorder on another machine is heard there.

    Raises:
        Refused: another recorder has one of the two.
        EpisodeError: the data folder cannot be written.
    """

    def __init__(self, data: Path, bus: Bus) -> None:
        self._data = data
        self._descriptors: list[int] = []
        try:
            before = self._lock_data()
            name = f"recorder-{hashlib.sha256(str(bus.address).encode()).hexdigest()[:12]}.lock"
            self._lock(runtime_folder() / name, f"bus {bus.address}", "one is enough, it records every key")
            self._listen(bus, before)
        except BaseException:
            self.close()
            raise

    def renew(self) -> None:
        """See that the data folder is still ours: one that was removed, or whose disk was changed, is claimed anew.

        Raises:
            Refused: another recorder has claimed it meanwhile.
            EpisodeError: it cannot be made, or written.
        """
        ours = os.fstat(self._descriptors[0])
        try:
            if os.path.samestat(os.stat(self._data / _LOCK), ours):
                return
        except OSError:  # it is not there: made again below, or that says why it cannot be
            pass
        former, self._descriptors = self._descriptors, []
        try:
            self._lock_data()
            self._descriptors += former[1:]
            os.close(former[0])
        except (Refused, EpisodeError):
            for descriptor in self._descriptors:
                os.close(descriptor)
            self._descriptors = former
            raise

    def close(self) -> None:
        """Let go."""
        for descriptor in self._descriptors:
            os.close(descriptor)
        self._descriptors.clear()

    def __enter__(self) -> Claim:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _lock_data(self) -> str:
        return self._lock(_made(self._data) / _LOCK, f"data folder {self._data}", "give this one another --data")

    def _lock(self, path: Path, what: str, remedy: str) -> str:
        """Take a lock; returns the process that had it before."""
        try:
            descriptor, before = lock_file.take(path)
        except OSError as error:
            raise EpisodeError(f"{what}: cannot be written: {error.strerror}; {remedy}") from error
        except lock_file.Held as held:
            who = f"pid {held.holder or 'unknown'}"
            raise Refused(f"{what}: another recorder ({who}) is at work; stop it first: {remedy}") from None
        self._descriptors.append(descriptor)
        return before

    @staticmethod
    def _listen(bus: Bus, before: str) -> None:
        """Refuse when a recorder that shares neither folder nor machine with us speaks on the bus.

        What the process said that held our lock before need not be waited for: the kernel has told that it is dead.
        """
        said = bus.read([keys.RECORDER]).get(keys.RECORDER)
        if said is None:
            return
        is_of_the_dead = said.stamp is not None and said.stamp.source.split(".")[1:3] == [before, boot_id()]
        if is_of_the_dead and before != str(os.getpid()):
            return
        with bus.watch([keys.RECORDER]) as watch:
            heard = watch.wait(keys.RECORDER, after=None, timeout_s=_LISTEN_S)
        if heard is not None:
            who = heard.stamp.source if heard.stamp else "unknown"
            raise Refused(f"bus {bus.address}: another recorder ({who}) is at work; stop it first")


def _made(data: Path) -> Path:
    try:
        data.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise EpisodeError(f"data folder {data}: cannot be made: {error.strerror}; name another with --data") from error
    return data


def is_claimed(data: Path) -> bool:
    """Whether a recorder of this machine is at work in a data folder."""
    return lock_file.is_locked(data / _LOCK)
