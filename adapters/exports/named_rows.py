"""What the quick looks (csv, npz, parquet, jointstate-mcap) share: every value of every key whose elements have names.

Nothing is resampled and nothing is repaired: a row is a write, with the time of its arrival at the recorder, the time
at which its writer wrote it, and its writer's own number.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, NamedTuple

import msgspec
import numpy as np

from station.bus import contracts
from station.episode.reading.reader import EpisodeReader, open_episode
from station.episode.reading.vectors import decoder
from station.errors import EpisodeError, UsageError
from station.export.columns import KeyColumns, key_columns
from station.export.kind import ExportOptions, MinQuality, ShardResult, Source

_NANOSECONDS = 1_000_000_000
_MOST_FILES = 512  # of 1024 that a process may have open


class QuickLookOptions(ExportOptions, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What a quick look can be asked.

    Attributes:
        min_quality: A bad episode is what one wants to look at, so any will do unless told otherwise.
        keys: Keys to export; none takes every key whose elements have names.
    """

    min_quality: Annotated[MinQuality, msgspec.Meta(description="Least verdict of `station check`.")] = "any"
    keys: Annotated[tuple[str, ...], msgspec.Meta(description="Keys, with commas.  [default: all with names]")] = ()


class Plan(msgspec.Struct, frozen=True, kw_only=True):
    """The keys that were asked for; none for all that have names."""

    keys: tuple[str, ...] = ()


class Row(NamedTuple):
    """One value: key, arrival and writing [ns since the epoch], the writer's number of it, its numbers, the writer."""

    key: str
    log_ns: int
    publish_ns: int
    sequence: int
    values: Sequence[float]
    writer: str = ""


def prepare(_sources: Sequence[Source], options: QuickLookOptions) -> Plan:
    """Return the plan.

    Raises:
        UsageError: the numbers of a key have no names, whatever the episode; says so and what to do.
    """
    for key in options.keys:
        contract = contracts.contract(key)
        if contract is not None and not (contract.elements and contract.vector_codec):
            what = "has no names for its numbers" if contract.vector_codec else f"holds {contract.codec}"
            raise UsageError(f"--keys {key}: {what}; leave it out, `station keys` says which keys hold named numbers")
    return Plan(keys=options.keys)


def inspect(source: Source, plan: Plan) -> list[str]:
    """Check whether an episode can be converted; see `ExportKind.inspect`."""
    Rows(source, plan.keys)
    return []


class Rows:
    """The rows of an episode.

    Args:
        source: The episode.
        keys: Keys; none for all whose numbers have names.

    Attributes:
        reader: Of the episode.
        start_ns: When it begins; times are told from there [ns since the epoch].
        recorded: The contract of every key of the episode as it was recorded, None for none.
        columns: What the numbers of each key are called.
        left_out: Keys that are in the episode and not in the rows.
        counts, unfit: Rows so far, and values that did not fit their contract, by key.
        first_ns, last_ns: First and last arrival of a row so far [ns].

    Raises:
        EpisodeError: a key is not in the episode, or its numbers have no names; or no key has any.
    """

    def __init__(self, source: Source, keys: Sequence[str]) -> None:
        self.reader: EpisodeReader = open_episode(Path(source.folder))
        self.recorded = found = self.reader.recorded
        named = [key for key, one in found.items() if one is not None and one.elements and one.vector_codec]
        self.columns: Mapping[str, KeyColumns] = {key: key_columns(self.reader, key) for key in keys or named}
        if not self.columns:
            raise EpisodeError(f"{source.episode_id}: no key in it whose numbers have names, so nothing to export")
        self.left_out = sorted(set(found) - set(self.columns))
        self.start_ns = self.reader.start_ns
        self.counts: Counter[str] = Counter()
        self.unfit: Counter[str] = Counter()
        self.first_ns = self.last_ns = 0

    def __iter__(self) -> Iterator[Row]:
        """Read the episode once, in order of arrival, one chunk in memory."""
        decoders = {key: decoder(columns.codec) for key, columns in self.columns.items()}
        lengths = {key: len(columns.names) for key, columns in self.columns.items()}
        for message in self.reader.messages(self.columns.keys()):
            if message.channel.is_deletion:
                continue
            key = message.topic
            values = decoders[key](message.data)
            if values is None or len(values) != lengths[key]:
                self.unfit[key] += 1
                continue
            self.counts[key] += 1
            self.first_ns = min(self.first_ns or message.log_ns, message.log_ns)
            self.last_ns = max(self.last_ns, message.log_ns)
            row = values.tolist() if isinstance(values, np.ndarray) else values
            yield Row(key, message.log_ns, message.publish_ns, message.sequence, row, message.channel.writer)

    def expect_files(self) -> None:
        """Refuse an episode with more keys than files can be open, for a format that has a file per key.

        Raises:
            EpisodeError: it has; says how many.
        """
        if (count := len(self.columns)) > _MOST_FILES:
            raise EpisodeError(f"{self.reader.episode_id}: {count} keys, at most {_MOST_FILES}; choose with --keys")

    def narrow(self, keys: Collection[str]) -> None:
        """Leave out all but some keys."""
        self.columns = {key: columns for key, columns in self.columns.items() if key in keys}
        self.left_out = sorted({*self.recorded} - {*keys})

    def made(self) -> ShardResult:
        """Return what was made, once all rows were read."""
        return ShardResult(
            seconds=(self.last_ns - self.first_ns) / _NANOSECONDS,
            rows=self.counts.total(),
            facts={"keys": dict(self.counts), "unfit": dict(self.unfit), "left_out": self.left_out},
        )


def in_seconds(time_ns: int) -> str:
    """Return a span as seconds, exact to the nanosecond: -0.000000001."""
    whole, part = divmod(abs(time_ns), _NANOSECONDS)
    return f"{'-' if time_ns < 0 else ''}{whole}.{part:09d}"
