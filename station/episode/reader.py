"""Reading an episode: its streams, its messages in order, its vectors as arrays; also of a torn or unfinished file."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Literal, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from station.bus.contracts import Contract
from station.episode.anchor import Anchor
from station.episode.manifest import Manifest

Order = Literal["file", "log"]
Ints = NDArray[np.int64]


class Channel(msgspec.Struct, frozen=True, kw_only=True):
    """One key as one source wrote it.

    Attributes:
        id: Channel number in the MCAP file.
        topic: The key.
        source: Full source of a native writer, "" for a foreign one.
        writer: Server name, or ``foreign``.
        encoding: ``json``, ``application/octet-stream``, or ``application/x-deleted``.
        contract: The contract that was recorded with it, or None.
    """

    id: int
    topic: str
    source: str
    writer: str
    encoding: str
    contract: Contract | None

    @property
    def is_native(self) -> bool:
        """Whether its writer stamps what it writes."""
        raise NotImplementedError

    @property
    def is_deletion(self) -> bool:
        """Whether its (empty) messages say that the key was deleted or expired."""
        raise NotImplementedError


class Message(NamedTuple):
    """One write, byte for byte.

    Times are nanoseconds since the Unix epoch on the episode's clock: `log_ns` arrival at the recorder, `publish_ns`
    the writer's own time (equal to `log_ns` for a foreign writer). `sequence` is 32 bit: the writer's own count,
    or ours from 1 for a foreign one. `stamp` is the exact stamp of a native write, None unless it was asked for.
    """

    topic: str
    data: bytes
    log_ns: int
    publish_ns: int
    sequence: int
    channel: Channel
    stamp: bytes | None = None


class Vectors(NamedTuple):
    """The numbers of one key: times (k,) int64 [ns], and values (k, m) float64, float32 or int64 by its codec."""

    log_ns: Ints
    publish_ns: Ints
    values: NDArray[np.float64] | NDArray[np.float32] | NDArray[np.int64]


class StreamInfo(msgspec.Struct, frozen=True, kw_only=True):
    """A channel and what of it is in the file: number of messages, first and last arrival [ns] (0 when empty)."""

    channel: Channel
    count: int
    first_ns: int
    last_ns: int


class EpisodeReader:
    """An episode on disk. Opens, reads and closes the file within each call; holds nothing open in between.

    Attributes:
        folder: Folder of the episode.
        path: The MCAP file: ``signals.mcap``, or ``signals.mcap.active`` when it was never finished.
        manifest: From ``manifest.yaml``, else from the attachment in the MCAP file.
        anchor: Clock of the log times, or None when the file does not say.
        is_active: Whether the file was never finished.
        torn: One line that says what was cut off, or None for a whole file.
        skipped: After `vectors`: number of values per topic that did not fit their contract.
    """

    folder: Path
    path: Path
    manifest: Manifest
    anchor: Anchor | None
    is_active: bool
    torn: str | None
    skipped: dict[str, int]

    @property
    def episode_id(self) -> str:
        """The episode's id."""
        raise NotImplementedError

    def streams(self) -> list[StreamInfo]:
        """Return every channel with its message count, by topic; the recorder's own bookkeeping is left out."""
        raise NotImplementedError

    def topics(self) -> list[str]:
        """Return every key that has messages, sorted."""
        raise NotImplementedError

    def messages(
        self, topics: Collection[str] | None = None, *, order: Order = "file", stamps: bool = False
    ) -> Iterator[Message]:
        """Iterate over messages, all or those of some topics.

        Args:
            topics: Keys; None for all.
            order: ``file`` is the order of arrival at the recorder; ``log`` sorts by log time, stable.
            stamps: Whether to join the exact stamp to each native message.
        """
        raise NotImplementedError

    def collect(self, topics: Collection[str]) -> dict[str, list[Message]]:
        """Return the messages of some topics in file order, in one pass; a topic without messages has an empty list."""
        raise NotImplementedError

    def vectors(self, topic: str, *, source: str | None = None) -> Vectors:
        """Return the numbers of a topic as arrays, decoded by its recorded contract.

        Values that do not fit (not a vector, other length, not finite for JSON) are left out and counted in
        `skipped`. A topic without messages gives arrays of length 0.

        Raises:
            EpisodeError: the topic has no contract, or one that holds no numbers.
        """
        raise NotImplementedError

    def json(self, topic: str) -> list[tuple[int, object]]:
        """Return (log_ns, decoded value) of every message of a JSON topic; undecodable ones are counted in `skipped`."""
        raise NotImplementedError

    def attachments(self) -> dict[str, bytes]:
        """Return the attachments of the file by name, the last of each name."""
        raise NotImplementedError

    def metadata(self) -> dict[str, dict[str, str]]:
        """Return the metadata records of the file by name, the last of each name."""
        raise NotImplementedError


def open_episode(episode: str | Path, data: Path | None = None) -> EpisodeReader:
    """Open an episode named by path, id, unique beginning of an id, or ``latest``.

    Args:
        episode: Folder, MCAP file, id, beginning of an id, or ``latest``.
        data: Data folder to look ids up in; None takes ``$STATION_DATA``, else ``./data``.

    Raises:
        EpisodeError: not found, ambiguous, or not an episode of ours; one line that says what is there.
    """
    raise NotImplementedError
