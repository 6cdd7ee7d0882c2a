"""The parts of a manifest, one struct each; `station.episode.storage.manifest` puts them together."""

from __future__ import annotations

from typing import Any

import msgspec

from station.episode.storage.anchor import Anchor
from station.episode.storage.layout import SIGNALS


class Task(msgspec.Struct, kw_only=True):
    """What was to be done: short name as given, and the instruction in words."""

    name: str = "untitled"
    instruction: str = ""


class Operator(msgspec.Struct, kw_only=True):
    """Who commanded the robot, and through what.

    Attributes:
        interface: Command source, for example ``motion`` or ``pico``.
        id: Name or number of the person.
        details: Anything else that the request said of them.
    """

    interface: str = ""
    id: str = ""
    details: dict[str, Any] = {}


class Robot(msgspec.Struct, kw_only=True):
    """The robot: suffix of its keys, and what its server said of it (model, hash, hands, network, mode)."""

    suffix: str = ""
    facts: dict[str, Any] = {}


class Policy(msgspec.Struct, kw_only=True):
    """The policy, as its server stated it before the first message.

    Attributes:
        server: The low-level server that ran it.
        name, checkpoint, sha256, runtime, command: As in `station.protocols.PolicySpec`.
        rate_hz: Rate of its loop [Hz].
        facts: Everything that the server said of it, gains and joint names included.
    """

    server: str = ""
    name: str = ""
    checkpoint: str = ""
    sha256: str = ""
    runtime: str = ""
    command: str = ""
    rate_hz: float | None = None
    facts: dict[str, Any] = {}


class Stream(msgspec.Struct, kw_only=True):
    """One channel of the recording: one key as one source wrote it.

    Attributes:
        key: Key on the bus.
        source: Source of a native writer (``name.pid.boot.token``), "" for a foreign one.
        writer: Server name, or ``foreign``.
        role: Role by contract, or ``unknown``.
        contract: Whether the key has one; its text is in the MCAP channel.
        encoding: ``json``, ``application/octet-stream``, ``application/x-deleted``, or ``protobuf`` for pictures.
        file: Which file its messages are in.
        count: Messages in the file.
        lost: Sequence numbers of this source that are not in the file, between its first and its last, without as many
            as the recorder dropped.
        dropped: Writes that the recorder saw and did not keep, because the disk was too slow.
        dropped_bulky: How many of those were images or other bulky values, which go first.
        repeated: Messages whose sequence number did not grow.
        rate_hz: Mean rate between the first and the last message; None for fewer than two.
        longest_gap_s: Longest time between two messages [s]; None for fewer than two.
        first_s, last_s: Arrival of the first and last message, relative to the start of the episode [s].
    """

    key: str
    source: str = ""
    writer: str = "foreign"
    role: str = "unknown"
    contract: bool = False
    encoding: str = ""
    file: str = SIGNALS
    count: int = 0
    lost: int = 0
    dropped: int = 0
    dropped_bulky: int = 0
    repeated: int = 0
    rate_hz: float | None = None
    longest_gap_s: float | None = None
    first_s: float | None = None
    last_s: float | None = None


class RecordedFile(msgspec.Struct, kw_only=True):
    """A file of the recording, as it was when it was closed; `station.episode.storage.file_hashes` takes its measure.

    Attributes:
        name: Its name, ``signals.mcap`` or ``cameras.mcap``.
        bytes: Its size.
        summary_crc: Checksum of its MCAP summary, 8 hexadecimal digits; "" where it has none.
        sha256: Of all its bytes; "" for pictures, which are gigabytes.
        chunks_sha256: Of the checksums of its chunks, in order, for pictures; "" for signals.
    """

    name: str
    bytes: int
    summary_crc: str = ""
    sha256: str = ""
    chunks_sha256: str = ""


class Timing(msgspec.Struct, kw_only=True):
    """When, and on which clocks.

    Attributes:
        started: ISO 8601 with offset, of the start request.
        ended: The same of the end, "" while recording.
        anchor: The clock of every log time in the file; None only in a manifest that is not ours.
        preroll_s: How long before the start request the first message came [s].
        duration_s: From the start request to the end [s]; None while recording.
        clock_offsets: Offsets to other hosts' clocks, where they were measured [s].
    """

    started: str = ""
    ended: str = ""
    anchor: Anchor | None = None
    preroll_s: float = 0.0
    duration_s: float | None = None
    clock_offsets: dict[str, float] = {}


class Event(msgspec.Struct, kw_only=True):
    """One event of the bus: when it arrived [s from the start], its name, severity, source, and its numbers."""

    at_s: float
    name: str
    severity: str = "info"
    source: str = ""
    numbers: dict[str, Any] = {}


class Mark(msgspec.Struct, kw_only=True):
    """Something that the operator marked: when [s from the start], and the label."""

    at_s: float
    label: str = ""


class Edit(msgspec.Struct, kw_only=True):
    """Something that a person changed after the recording.

    Attributes:
        at: When, ISO 8601 with offset.
        by: Who.
        what: ``success``, ``tags`` or ``task``; ``bin``: moved there (`after` says why) or back (`before`).
        before, after: What was there, and what is.
        undone: When and by whom it was undone, "" while it stands.
    """

    at: str
    by: str
    what: str
    before: Any = None
    after: Any = None
    undone: str = ""


class Hole(msgspec.Struct, kw_only=True):
    """A span of which writes are missing, or may be.

    Attributes:
        from_s, to_s: From when to when [s from the start].
        reason: Why.
        lost: Writes that are missing there by the sequence numbers of writers that number them; None until it is known.
    """

    from_s: float
    to_s: float | None = None
    reason: str = ""
    lost: int | None = None


class QualityFlags(msgspec.Struct, kw_only=True):
    """Verdicts of people and of events.

    Attributes:
        success: What the operator said; None when nobody did.
        falls: Number of ``fall`` events.
        operator_reset: Whether the operator reset the robot or an e-stop during the episode.
        estop: Whether an e-stop was pressed.
        discarded: Marked as not to be used. Discarding never deletes.
    """

    success: bool | None = None
    falls: int = 0
    operator_reset: bool = False
    estop: bool = False
    discarded: bool = False


class Recorder(msgspec.Struct, kw_only=True):
    """How it was recorded.

    Attributes:
        backend: Tap that was used: ``replication``, ``notifications`` or ``poll``.
        is_lossless: Whether that tap can promise every write.
        bus: Address of the bus, without credentials.
        bulk: That of its bulk bus, which depth and clouds came from; "" where they came from the bus.
        restarts: How often a recorder took this episode up again.
        messages, bytes: Messages in the file, and its size on disk.
        dropped: Writes that arrived and could not be kept (full queue, failed disk, too many keys).
        not_mirrored: Writes of anybody that changed a key to a value that the tap could not know (HSET, COPY of a key
            that it never saw, …).
        not_mirrored_by: The same by command and key, the first hundred of them.
        unseen_keys: Keys that were beyond what a tap that polls can look at.
        leave_out: Keys that were left out by wish, or beginnings of keys.
        lag_p50_ms, lag_p99_ms: From arrival of a write to its place in the file [ms].
        software: Version and revision of the recorder's code.
        config: Its configuration.
        ended_by: Why the episode ended: ``stop``, ``discard``, ``shutdown``, ``bus-lost``, ``disk-full``, ``killed``
            (repaired) or a disk error.
    """

    backend: str = ""
    is_lossless: bool = False
    bus: str = ""
    bulk: str = ""
    restarts: int = 0
    messages: int = 0
    bytes: int = 0
    dropped: int = 0
    not_mirrored: int = 0
    not_mirrored_by: dict[str, int] = {}
    unseen_keys: int = 0
    leave_out: list[str] = []
    lag_p50_ms: float | None = None
    lag_p99_ms: float | None = None
    software: dict[str, Any] = {}
    config: dict[str, Any] = {}
    ended_by: str = ""


class CompactedCamera(msgspec.Struct, kw_only=True):
    """What became of the pictures of one camera.

    Attributes:
        pictures: How many there are, every one of them compared with its JPEG file.
        psnr_db, psnr_worst_db: Peak signal-to-noise ratio over all samples of luma and chroma, mean of the pictures and
            that of the worst one [dB]; 100 is no difference.
    """

    pictures: int
    psnr_db: float
    psnr_worst_db: float


class Compacted(msgspec.Struct, kw_only=True):
    """How the JPEG pictures of an episode became video.

    Attributes:
        at: When, ISO 8601 with offset.
        software: Version and revision of the code that did it.
        encoder: Its name and settings.
        cameras: What became of each camera's pictures, by its key.
        made_of: The file of pictures that is gone.
        bytes: Size of the one that took its place.
        verdict: That of a check of the JPEG pictures which stands for these; "" where there was none that stood.
    """

    at: str
    software: dict[str, Any]
    encoder: dict[str, Any]
    cameras: dict[str, CompactedCamera]
    made_of: RecordedFile
    bytes: int = 0
    verdict: str = ""


class AuditDifference(msgspec.Struct, frozen=True, kw_only=True):
    """A recorded key that is not what it is computed to be again.

    Attributes:
        key: The key.
        of: Keys that it was computed from.
        compared, different: Values that were computed, and those that differ.
        first_s: When the first of them was, from the start of the episode [s].
    """

    key: str
    of: list[str]
    compared: int
    different: int
    first_s: float | None = None


class AuditFound(msgspec.Struct, kw_only=True):
    """What an audit found (`station.episode.replaying.in_short`); nothing is proven of what was not compared.

    Attributes:
        compared: Vectors that were computed again: commands, observations, actions, targets.
        different: Those that are not what was recorded, to the last bit, and states of the gate that are not.
        not_proven: Steps of which something could not be compared; one counts for each thing.
        not_audited: Robots that were not audited, and why, a line each.
        differences: Keys that differ, in the order of a step.
    """

    compared: int = 0
    different: int = 0
    not_proven: int = 0
    not_audited: list[str] = []
    differences: list[AuditDifference] = []
