"""Which keys become the columns of a table, what each number of them is called, and its unit: from contracts only."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import msgspec

from station.bus import keys
from station.contract import Element, Role, VectorCodec
from station.episode.reading import steps
from station.episode.reading.reader import EpisodeReader
from station.errors import EpisodeError, did_you_mean


class KeyColumns(msgspec.Struct, frozen=True, kw_only=True):
    """One key of a table.

    Attributes:
        key: The key.
        role: Its role, which decides how it is resampled; see `station.export.resample`.
        codec: How its bytes are read.
        names: What its n numbers are called, in order.
        units: Their units, "" for none.
        rate_hz: Nominal rate of its writes [Hz]; None when it is written as things happen.
    """

    key: str
    role: Role
    codec: VectorCodec
    names: tuple[str, ...]
    units: tuple[str, ...]
    rate_hz: float | None = None

    @property
    def titles(self) -> list[str]:
        """Names with units, as a person reads them: ``left_knee_pos [rad]``."""
        return [Element(name, unit).title for name, unit in zip(self.names, self.units, strict=True)]

    def __str__(self) -> str:
        return f"{len(self.names)} numbers: {', '.join(self.titles)}"


def key_columns(reader: EpisodeReader, key: str) -> KeyColumns:
    """Return the columns of a key as an episode recorded them.

    Raises:
        EpisodeError: the episode has no such key, or nothing says what its numbers are; names key and cure.
    """
    found = reader.recorded
    if key not in found:
        raise EpisodeError(
            f"{reader.episode_id}: no key {key!r} in it{did_you_mean(key, found)}; "
            f"`station episodes show {reader.episode_id}` lists its keys"
        )
    contract = reader.contract(key)
    if contract is None:
        raise EpisodeError(
            f"{reader.episode_id}: key {key!r} has no contract, so nothing says what its numbers are; "
            "the server that writes it can describe it; or leave it out"
        )
    if contract.vector_codec is None:
        raise EpisodeError(f"{reader.episode_id}: key {key!r} holds {contract.codec}, no numbers; leave it out")
    if not contract.elements:
        raise EpisodeError(
            f"{reader.episode_id}: the contract of key {key!r} names no elements, so its columns would have no names; "
            "the server that writes it can name them; or leave it out"
        )
    units = tuple(element.unit for element in contract.elements)
    return KeyColumns(
        key=key,
        role=contract.role,
        codec=contract.vector_codec,
        names=contract.names,
        units=units,
        rate_hz=contract.rate_hz,
    )


def expect_same(reader: EpisodeReader, wanted: Sequence[KeyColumns]) -> None:
    """Refuse an episode whose keys do not hold what the table has.

    Raises:
        EpisodeError: a key is missing, or has other elements, units, role, codec or rate; names it and both values.
    """
    for columns in wanted:
        found = key_columns(reader, columns.key)
        if found != columns:
            raise EpisodeError(f"{reader.episode_id}: key {columns.key!r} {_difference(found, columns)}")


def _difference(found: KeyColumns, wanted: KeyColumns) -> str:
    """Return in which way an episode's columns of a key differ from those of the table."""
    if found.names != wanted.names:
        odd = ", ".join(sorted(set(found.names) ^ set(wanted.names))[:3]) or "in another order"
        return (
            f"has {len(found.names)} elements, the data set {len(wanted.names)} ({odd}); "
            "export episodes of one robot at a time"
        )
    units = zip(found.names, found.units, wanted.units, strict=True)
    if unlike := next(
        (f"{name} in {unit!r}, the data set in {ours!r}" for name, unit, ours in units if unit != ours), ""
    ):
        return f"has {unlike}; export episodes of one unit at a time"
    fields = ("role", "codec", "rate_hz")
    field = next(name for name in fields if getattr(found, name) != getattr(wanted, name))
    return (
        f"has {field} {getattr(found, field)} in its contract, the data set {getattr(wanted, field)}; "
        "export these episodes apart"
    )


def unique_names(columns: Sequence[KeyColumns]) -> list[str]:
    """Return the name of every number of several keys: as in the contract, with the key before it where two agree."""
    counts = Counter(name for one in columns for name in one.names)
    return [name if counts[name] == 1 else f"{one.key}.{name}" for one in columns for name in one.names]


def robot_of(reader: EpisodeReader, wanted: str = "") -> str:
    """Return the suffix of the robot of an episode: the one that is wanted, else the only one that was driven.

    Raises:
        EpisodeError: it has not that one, or none, or several; names them.
    """
    topics = reader.topics()
    found = steps.robots(topics)
    if wanted:
        if wanted not in (known := steps.robots_of(reader)):
            raise EpisodeError(
                f"{reader.episode_id}: another robot than {wanted} (--robot): it has {', '.join(known) or 'none'}"
            )
        return wanted
    suffix = reader.manifest.robot.suffix
    if len(found) > 1:
        raise EpisodeError(
            f"{reader.episode_id}: several robots in it; export one at a time: --robot {' or --robot '.join(found)}"
        )
    if suffix or found:
        return found[0] if found else suffix
    state = keys.robot_state("")
    robots = sorted(topic.removeprefix(state) for topic in topics if topic.startswith(state))
    if len(robots) == 1:
        return robots[0]
    raise EpisodeError(
        f"{reader.episode_id}: no robot in it that the defaults could mean; name one with --robot, or the keys "
        "with --state and --action"
    )
