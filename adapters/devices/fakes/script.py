"""Scripts of fake devices: what the operator does when, read from a JSON file and played by a clock.

    {"device": "spacemouse", "period_s": 10.0, "steps": [{"at_s": 0.5, "twist": [1, 0, 0, 0, 0, 0]}, …]}

``device`` guards against the wrong file; ``period_s``, where there is one, plays the steps again and again. What a step
may say beside ``at_s`` is told by each fake. The clock of a script starts with the first look at it, so a server that
takes its time to load misses nothing; and what is played depends on nothing but that clock.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, TypeVar

import msgspec

from station.assets import is_reference, resolve
from station.errors import BadFile

Clock = Callable[[], float]
S = TypeVar("S", bound="Step")

_LARGEST = 32_000_000  # bytes; an hour of a step every 20 ms
_ROUNDING_S = 1e-9


class Step(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Something that happens; each fake adds what it can be.

    Attributes:
        at_s: When, from the beginning of the script [s].
    """

    at_s: float


class _File(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    device: str
    steps: list[msgspec.Raw]
    period_s: float | None = None


@dataclass(frozen=True)
class Script(Generic[S]):
    """What happens when, in order.

    Attributes:
        steps: Not empty; their times do not fall.
        period_s: After how long the first step comes again [s]; None for a script that ends.
    """

    steps: tuple[S, ...]
    period_s: float | None = None

    def after_start(self) -> Iterator[tuple[float, S]]:
        """Yield every step with its time from the start [s], repeats included."""
        offset_s = 0.0
        while True:
            yield from ((offset_s + step.at_s, step) for step in self.steps)
            if self.period_s is None:
                return
            offset_s += self.period_s


def file_of(path: Path) -> Path:
    """Return the file of a script: the path itself, or what it names as ``collection:path``.

    Raises:
        AssetMissing: the collection has no such file.
    """
    return resolve(path) if is_reference(path) else path


def load(path: Path, device: str, kind: type[S]) -> Script[S]:
    """Read a script.

    Args:
        path: The file, or ``collection:path`` (``builtin:spacemouse/example.json``).
        device: What it has to be for.
        kind: What a step may say.

    Raises:
        BadFile: missing, not JSON, for another device, an unknown or wrong key, or times that fall.
    """
    path = file_of(path)
    try:
        if path.stat().st_size > _LARGEST:
            raise BadFile(f"{path}: more than {_LARGEST // 1_000_000} MB; expected a script of a fake {device}")
        file = msgspec.json.decode(path.read_bytes(), type=_File)
    except OSError as error:
        raise BadFile(f"{path}: cannot be read: {error.strerror}; expected a script of a fake {device}") from None
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise BadFile(f"{path}: {error}; expected a script of a fake {device}") from None
    if file.device != device:
        raise BadFile(f"{path}: is a script of a fake {file.device!r}; expected one of {device!r}")
    steps = tuple(_step(path, index, raw, kind) for index, raw in enumerate(file.steps))
    _check_times(path, steps, file.period_s)
    return Script(steps, file.period_s)


def _step(path: Path, index: int, raw: msgspec.Raw, kind: type[S]) -> S:
    try:
        return msgspec.json.decode(raw, type=kind)
    except msgspec.DecodeError as error:
        known = ", ".join(kind.__struct_fields__)
        raise BadFile(f"{path}: step {index}: {error}; a step may say {known}") from None


def _check_times(path: Path, steps: tuple[S, ...], period_s: float | None) -> None:
    if not steps:
        raise BadFile(f"{path}: has no steps; expected at least one")
    last_s = 0.0
    for index, step in enumerate(steps):
        if not step.at_s >= last_s:
            raise BadFile(f"{path}: step {index}: at_s is {step.at_s:g}, after {last_s:g}; expected times in order")
        last_s = step.at_s
    if period_s is not None and not period_s > last_s:
        raise BadFile(f"{path}: period_s is {period_s:g}; expected more than {last_s:g} s, the time of the last step")


class Play(Generic[S]):
    """Plays a script.

    Args:
        script: What is played.
        clock: Tells the time [s]; replaced in tests.
    """

    def __init__(self, script: Script[S], clock: Clock = time.monotonic) -> None:
        self._clock = clock
        self._steps = script.after_start()
        self._next = next(self._steps, None)
        self._began_s: float | None = None

    @property
    def has_begun(self) -> bool:
        """Whether anybody has looked."""
        return self._began_s is not None

    def time_s(self) -> float:
        """Return the time since the first look [s]; the first look returns 0."""
        now_s = self._clock()
        if self._began_s is None:
            self._began_s = now_s
        return now_s - self._began_s

    def begin(self, start_s: float = 0.0) -> None:
        """Take the first look, at a time of the script [s] that need not be its beginning; later ones do nothing."""
        if self._began_s is None:
            self._began_s = self._clock() - start_s

    def due(self, until_s: float) -> Iterator[tuple[float, S]]:
        """Yield, once, each step up to a time since the first look, with its own time [s]."""
        while self._next is not None and self._next[0] <= until_s + _ROUNDING_S:
            step = self._next
            self._next = next(self._steps, None)
            yield step
