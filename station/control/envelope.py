"""The envelope of a policy: which commands it was seen to survive, in a file beside its checkpoint.

A format's ranges are what a motion may say. A policy survives less: not every pose within them, not every combination
of poses and velocities, and not for as long as one likes what its motions show for a moment. So an envelope bounds

- each element that it names by itself, and how fast it changes;
- weighted sums of them, as they are now, averaged over some times, and as they differ from such an average: how fast a
  pose as a whole changes;
- what reaches out beyond the motions (arms), by how much of all that is in use: all the way while the robot stands, not
  at all at the edge of what it survives; and the other way round.

All are differences from the command's default: standing, which is inside. What is beyond comes back towards standing,
all bounded elements together along a straight line, just as far as is needed; and from one command to the next they go
in a straight line as well, as between two that are survived each element at a pace of its own may pass by one that is
not. Pure: no bus, no robot, no clock.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np

from station import assets
from station.config import build, read_yaml
from station.contract import names_of
from station.errors import AssetMissing, BadFile, ConfigError
from station.protocols import CommandFormat, Floats

SUFFIX = ".envelope.yaml"
"""Of the file; before it stands the name of the checkpoint, without its own."""

MOST_BYTES = 100_000
"""Of one as `stated`: every episode keeps it, and a list of episodes reads it."""

_MOST = 1000  # elements, sums: more are no command
_SHORTEST_S = 0.05  # longer than a tick counts for at most
_LEAST = 1e-9  # a range of a format that is no wider than the motions' has no room to reach out
_Names = Annotated[tuple[str, ...], msgspec.Meta(max_length=_MOST)]
_Numbers = Annotated[tuple[float, ...], msgspec.Meta(max_length=_MOST)]


class Ranges(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Some elements of a command, each by itself.

    Attributes:
        elements: Their names, e of them.
        lower, upper: Range of each, shape (e,).
        rate: Greatest change of each per second, shape (e,).

    Raises:
        ValueError: shapes that do not fit, an empty range, or a rate that is not above 0.
    """

    elements: _Names
    lower: _Numbers
    upper: _Numbers
    rate: _Numbers

    def __post_init__(self) -> None:
        if len(set(self.elements)) < len(self.elements):
            raise ValueError("elements: one is named twice")
        for name in ("lower", "upper", "rate"):
            if len(getattr(self, name)) != len(self.elements):
                raise ValueError(
                    f"{name}: {len(getattr(self, name))} numbers, expected {len(self.elements)}, one per element"
                )
        if not np.isfinite([*self.lower, *self.upper, *self.rate]).all():
            raise ValueError("lower, upper, rate: expected finite numbers")
        if not all(low < high for low, high in zip(self.lower, self.upper, strict=True)):
            raise ValueError("lower: expected less than upper")
        if not all(each > 0.0 for each in self.rate):
            raise ValueError("rate: expected more than 0")


class Span(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Between what the sums of an envelope may be.

    Attributes:
        over_s: Averaged over about so long, exponentially [s]; 0 for each as it is now.
        lower, upper: Ends of each sum, shape (k,).
        is_change: Whether it is not the average that is bounded, but each sum less its average.

    Raises:
        ValueError: standing is outside.
    """

    over_s: Annotated[float, msgspec.Meta(ge=0.0, le=3600.0)]
    lower: _Numbers
    upper: _Numbers
    is_change: bool = False

    def __post_init__(self) -> None:
        if self.is_change and self.over_s < _SHORTEST_S:
            raise ValueError(f"over_s {self.over_s:g}: a change is from an average over {_SHORTEST_S:g} s or more")
        if not np.isfinite([*self.lower, *self.upper]).all():
            raise ValueError("lower, upper: expected finite numbers")
        if not (all(low < 0.0 for low in self.lower) and all(high > 0.0 for high in self.upper)):
            raise ValueError("expected lower < 0 < upper: standing is inside")


class Envelope(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Which commands a policy was seen to survive.

    Attributes:
        bounded: What is bounded together.
        reaching: What may go beyond its range, as far as the format's, as long as what is bounded leaves room.
        sums: Weights of k sums of the bounded elements' differences from standing, shape (k, e).
        spans: Between what the sums may be.

    Raises:
        ValueError: shapes that do not fit, or an element in both.
    """

    bounded: Ranges
    reaching: Ranges = Ranges(elements=(), lower=(), upper=(), rate=())
    sums: Annotated[tuple[_Numbers, ...], msgspec.Meta(max_length=_MOST)] = ()
    spans: Annotated[tuple[Span, ...], msgspec.Meta(max_length=16)] = ()

    def __post_init__(self) -> None:
        count = len(self.bounded.elements)
        if not count:
            raise ValueError("bounded: expected elements")
        if twice := set(self.bounded.elements) & set(self.reaching.elements):
            raise ValueError(f"{min(twice)} is in bounded and in reaching")
        if odd := next((row for row in self.sums if len(row) != count), None):
            raise ValueError(f"sums: a row of {len(odd)} weights, expected {count}, one per bounded element")
        if not np.isfinite([weight for row in self.sums for weight in row]).all():
            raise ValueError("sums: expected finite numbers")
        for span in self.spans:
            if not len(span.lower) == len(span.upper) == len(self.sums) > 0:
                raise ValueError(f"spans: over_s {span.over_s:g}: expected {len(self.sums)} ends, one per sum")

    @property
    def elements(self) -> tuple[str, ...]:
        """All that it names."""
        return self.bounded.elements + self.reaching.elements


def read(file: Path) -> Envelope:
    """Read an envelope.

    Raises:
        BadFile: the file is not there, or cannot be read.
        ConfigError: it is no envelope, or a larger one than an episode keeps; the message names the file.
    """
    envelope = build(Envelope, read_yaml(file), where=str(file))
    if (size := len(stated(envelope))) > MOST_BYTES:
        raise ConfigError(
            f"{file}: {size} characters as JSON, expected at most {MOST_BYTES}: every episode keeps it; fewer sums"
        )
    return envelope


def stated(envelope: Envelope) -> str:
    """Return an envelope as one text, JSON: the tracker's, number by number, takes 25 ms to read in a manifest."""
    return msgspec.json.encode(envelope).decode()


def from_stated(value: Any) -> Envelope:
    """Return the envelope that `stated` was of; or that a mapping is of, as it was stated once.

    Raises:
        msgspec.MsgspecError: it is none.
    """
    return msgspec.json.decode(value, type=Envelope) if isinstance(value, str) else msgspec.convert(value, Envelope)


def found(setting: str, checkpoint: Path) -> Envelope | None:
    """Return the envelope that a setting names.

    Args:
        setting: ``auto`` for the one beside the checkpoint, if any; ``none`` for none; else a file.
        checkpoint: Of the policy.

    Raises:
        AssetMissing, BadFile, ConfigError: the file is not there, or is no envelope.
    """
    if setting == "none":
        return None
    if setting == "auto":
        beside = checkpoint.with_name(checkpoint.stem + SUFFIX)
        return read(beside) if beside.is_file() else None
    try:
        return read(assets.resolve(setting))
    except (AssetMissing, BadFile) as error:
        raise type(error)(f"envelope: {error}; expected a file, auto or none") from None


def of_parts(envelopes: Sequence[Envelope], parts: Sequence[CommandFormat]) -> list[list[Envelope]]:
    """Return the envelopes that bound each part of a command: those whose elements it all has.

    Raises:
        ConfigError: an envelope bounds elements that no part has.
    """
    shared: list[list[Envelope]] = [[] for _ in parts]
    names: list[set[str]] = [set(names_of(part.elements)) for part in parts]
    for envelope in envelopes:
        within = [index for index, has in enumerate(names) if has.issuperset(envelope.elements)]
        if not within:
            known = {name for has in names for name in has}
            lacking = [name for name in envelope.elements if name not in known] or envelope.elements
            raise ConfigError(
                f"envelope: it bounds {', '.join(lacking[:4])}, which {' and '.join(part.name for part in parts)} "
                "does not have; it is another policy's"
            )
        shared[within[0]].append(envelope)
    return shared


class EnvelopeLimit:
    """Keeps a stream of commands within an envelope.

    Args:
        envelope: Whose elements the format has.
        command_format: Format of the commands; its default is standing.

    Attributes:
        bounded: Indices of the bounded elements.
        lower, upper, rate: Of each element of the command, shape (m,), and its greatest change per second; infinite for
            what is not bounded, not named.

    Raises:
        ConfigError: standing is outside.
    """

    def __init__(self, envelope: Envelope, command_format: CommandFormat) -> None:
        names, standing = names_of(command_format.elements), command_format.default
        self.bounded, self._reaching = (
            [names.index(name) for name in ranges.elements] for ranges in (envelope.bounded, envelope.reaching)
        )
        self.lower, self.upper = np.full(len(names), -np.inf), np.full(len(names), np.inf)
        self.lower[self.bounded], self.upper[self.bounded] = envelope.bounded.lower, envelope.bounded.upper
        self.rate = np.full(len(names), np.inf)
        for at, ranges in ((self.bounded, envelope.bounded), (self._reaching, envelope.reaching)):
            self.rate[at] = ranges.rate
            inside = (standing[at] >= ranges.lower) & (standing[at] <= ranges.upper)
            if not inside.all():
                name = ranges.elements[int(np.argmin(inside))]
                raise ConfigError(f"envelope: {name} is outside of it when the robot stands")
        self._standing = standing[self.bounded]
        self._least, self._most = np.array(envelope.reaching.lower), np.array(envelope.reaching.upper)
        self._room_below = np.maximum(self._least - command_format.lower[self._reaching], 0.0)
        self._room_above = np.maximum(command_format.upper[self._reaching] - self._most, 0.0)
        self._weights = np.array(envelope.sums).reshape(-1, len(self.bounded)).T
        self._now, self._averaged, self._changing = (
            _Spans([span for span in envelope.spans if (span.over_s > 0.0, span.is_change) == kind])
            for kind in ((False, False), (True, False), (True, True))
        )
        self._remembering = [spans for spans in (self._averaged, self._changing) if spans.count]
        self.is_known = True

    def begin(self) -> None:
        """Remember that the robot has been standing."""
        self.is_known = True
        for spans in self._remembering:
            spans.average[:] = 0.0

    def forget(self) -> None:
        """Let averages bound nothing until the robot stands again: an audit begins in the middle."""
        self.is_known = False

    def limit(self, wanted: Floats, before: Floats, passed_s: float) -> Floats:
        """Return the command that the policy survives and that is nearest to a command, towards standing.

        Args:
            wanted: The command, shape (m,); returned as it is where it is inside, to the last bit.
            before: What the policy got last, shape (m,).
            passed_s: For how long it is to count [s].
        """
        limited: Floats = np.clip(wanted, self.lower, self.upper)
        change = limited[self.bounded] - self._standing
        sums = self._sums(change)
        now, of_average, less = self._now.share(sums), 0.0, 1.0
        if self.is_known and passed_s > 0.0:
            of_average = self._averaged.share(self._averaged.average)
            less = max(less, self._averaged.share_after(sums, passed_s))
        less = max(less, now)
        now /= less
        if self._reaching:
            used = min(max(now, of_average), 1.0)
            limited[self._reaching] = self._reached(wanted[self._reaching], 1.0 - used)
            room = 1.0 - self._reach(before[self._reaching])
            if now > room:  # what reached out is on its way back, at its rate
                less = less * now / room if room > 0.0 else np.inf
        if less > 1.0:
            limited[self.bounded] = self._standing + change / less
        return wanted if np.array_equal(limited, wanted) else limited

    def on_the_way(self, before: Floats, goal: Floats, moved: Floats, passed_s: float) -> Floats:
        """Return where the way to a command leads in a tick: straight, for the bounded elements.

        Args:
            before: What the policy got last, shape (m,).
            goal: Where to, shape (m,); inside.
            moved: How far each element by itself gets, shape (m,).
            passed_s: In this time [s].
        """
        start = before[self.bounded]
        gap = goal[self.bounded] - start
        if not gap.any():
            return moved
        own = np.divide(moved[self.bounded] - start, gap, out=np.ones_like(gap), where=gap != 0.0)
        share = min(float(own.min()), 1.0)
        if self.is_known and passed_s > 0.0:
            share = min(
                share, self._changing.share_of_way(self._sums(start - self._standing), self._sums(gap), passed_s)
            )
        if share < 1.0:
            moved = moved.copy()
            moved[self.bounded] = start + share * gap
        return moved

    def on_tick(self, given: Floats, passed_s: float) -> None:
        """Remember what the policy got, shape (m,), and for how long [s]."""
        if self._remembering and passed_s > 0.0:
            sums = self._sums(given[self.bounded] - self._standing)
            for spans in self._remembering:
                spans.average += spans.parts(passed_s) * (sums - spans.average)

    def _sums(self, change: Floats) -> Floats:
        """Return the sums of a change, added in one order: an audit on another machine gets the same bits."""
        sums: Floats = np.add.reduce(self._weights * change[:, None], axis=0)
        return sums

    def _reached(self, wanted: Floats, room: float) -> Floats:
        """Return what reaches out, shape (r,), with some of its room: 0 for what motions asked, 1 for the format's."""
        reached: Floats = np.clip(wanted, self._least - room * self._room_below, self._most + room * self._room_above)
        return reached

    def _reach(self, values: Floats) -> float:
        """Return how much of its room is in use by what reaches out, shape (r,)."""
        below = (self._least - values) / np.maximum(self._room_below, _LEAST)
        above = (values - self._most) / np.maximum(self._room_above, _LEAST)
        return float(np.maximum(below, above).max(initial=0.0).clip(0.0, 1.0))


class _Spans:
    """Ends of sums over s times, shape (s, k), and how much of what they may be is in use: 1 is all."""

    def __init__(self, spans: Sequence[Span]) -> None:
        self.count = len(spans)
        self._over_s = np.array([span.over_s for span in spans])[:, None]
        self._lower, self._upper = (np.array([getattr(span, end) for span in spans]) for end in ("lower", "upper"))
        self.average = np.zeros_like(self._lower)

    def parts(self, passed_s: float) -> Floats:
        """Return how much a time [s] counts in each average, shape (s, 1)."""
        return np.minimum(passed_s / self._over_s, 1.0)

    def share(self, sums: Floats) -> float:
        """Return that of sums."""
        return _most(sums, self._lower, self._upper) if self.count else 0.0

    def share_after(self, sums: Floats, passed_s: float) -> float:
        """Return that of sums, where averages must be inside after some time [s]."""
        if not self.count:
            return 0.0
        parts = self.parts(passed_s)
        held = (1.0 - parts) * self.average
        # Where a command was too slow to come back, an average is beyond its end, and asks for no less than that.
        lower = np.minimum((self._lower - held) / parts, self._lower)
        return _most(sums, lower, np.maximum((self._upper - held) / parts, self._upper))

    def share_of_way(self, sums: Floats, way: Floats, passed_s: float) -> float:
        """Return how much of a way from some sums their difference from the averages allows; 1 for all of it."""
        if not self.count:
            return 1.0
        ends, at = np.maximum(1.0 - self.parts(passed_s), _LEAST), sums - self.average
        room = np.where(way > 0.0, self._upper / ends - at, self._lower / ends - at)
        shares = np.divide(room, way, out=np.ones_like(room), where=way != 0.0)
        return float(shares.min().clip(0.0, 1.0))


def _most(sums: Floats, lower: Floats, upper: Floats) -> float:
    return float(np.maximum(sums / lower, sums / upper).max())
