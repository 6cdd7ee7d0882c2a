"""The manifest of an episode: what was recorded, by whom, with what; typed here, YAML on disk.

The blueprint's names are kept: ``episode_id task operator robot policy streams timing quality_flags``. Reading
tolerates keys that we do not know, at any depth of the known structure, and writing gives them back, so a field
that another tool added survives us. What we write ourselves is typed: a misspelt field cannot be constructed.
"""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any, Literal

import msgspec
import yaml

from station.episode.anchor import Anchor
from station.episode.atomic import write_atomic
from station.episode.layout import MANIFEST
from station.errors import EpisodeError

VERSION = 1
MAX_EVENTS = 500
MAX_MARKS = 500

State = Literal["recording", "finished", "failed"]

_Loader: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
_Dumper: Any = getattr(yaml, "CSafeDumper", yaml.SafeDumper)


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
        encoding: ``json``, ``application/octet-stream``, or ``application/x-deleted``.
        count: Messages in the file.
        lost: Sequence numbers of this source that are not in the file, between its first and its last.
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
    count: int = 0
    lost: int = 0
    repeated: int = 0
    rate_hz: float | None = None
    longest_gap_s: float | None = None
    first_s: float | None = None
    last_s: float | None = None


class Timing(msgspec.Struct, kw_only=True):
    """When, and on which clocks.

    Attributes:
        started: ISO 8601 with offset, of the start request.
        ended: The same of the end, "" while recording.
        anchor: The clock of every log time in the file; None only in a manifest that is not ours.
        preroll_s: How long before the start request the first message came [s].
        duration_s: From the start request to the end [s]; None while recording.
        clock_offsets: Offsets to other hosts' clocks, where somebody measured them [s].
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


class Hole(msgspec.Struct, kw_only=True):
    """A span of which writes are missing, or may be: seconds from the start, and why."""

    from_s: float
    to_s: float | None = None
    reason: str = ""


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
        restarts: How often a recorder took this episode up again.
        messages, bytes: Messages in the file, and its size on disk.
        dropped: Writes that arrived and could not be kept (full queue, failed disk).
        lag_p50_ms, lag_p99_ms: From arrival of a write to its place in the file [ms].
        software: Version and revision of the recorder's code.
        config: Its configuration.
        ended_by: Why the episode ended: ``stop``, ``discard``, ``shutdown``, ``bus-lost`` or a disk error.
    """

    backend: str = ""
    is_lossless: bool = False
    bus: str = ""
    restarts: int = 0
    messages: int = 0
    bytes: int = 0
    dropped: int = 0
    lag_p50_ms: float | None = None
    lag_p99_ms: float | None = None
    software: dict[str, Any] = {}
    config: dict[str, Any] = {}
    ended_by: str = ""


class Manifest(msgspec.Struct, kw_only=True):
    """Everything that is known of an episode without reading its signals.

    Attributes:
        state: ``recording`` on disk without a live recorder means that the recorder was killed.
        servers: What every server stated on ``station:config:<name>``, by server name.
        motions: First statement of each motion file on a ``command_source`` key, with that key.
        runbook: Steps and answers, who and when, as the supervisor gave them.
        events, marks: Bounded; what did not fit is counted beside them and stays in the signals.
        quality: What a later measurement (`check`) found; free form.
        recovery: Notes of whoever repaired or resumed the episode.
        foreign: Keys of the document that we do not know; kept, and given back where they were.
    """

    manifest_version: int = VERSION
    episode_id: str = ""
    state: State = "recording"
    task: Task = msgspec.field(default_factory=Task)
    operator: Operator = msgspec.field(default_factory=Operator)
    robot: Robot = msgspec.field(default_factory=Robot)
    policy: Policy = msgspec.field(default_factory=Policy)
    motions: list[dict[str, Any]] = []
    servers: dict[str, dict[str, Any]] = {}
    cameras: list[dict[str, Any]] = []
    streams: list[Stream] = []
    timing: Timing = msgspec.field(default_factory=Timing)
    runbook: dict[str, Any] = {}
    recorder: Recorder = msgspec.field(default_factory=Recorder)
    events: list[Event] = []
    events_not_listed: int = 0
    marks: list[Mark] = []
    holes: list[Hole] = []
    quality_flags: QualityFlags = msgspec.field(default_factory=QualityFlags)
    quality: dict[str, Any] = {}
    recovery: list[dict[str, Any]] = []
    foreign: dict[str, Any] = {}


def load_manifest(path: Path) -> Manifest:
    """Read a manifest; `path` is the file or the folder of the episode.

    Raises:
        EpisodeError: missing, not YAML, or a field of the wrong type; one line that names it.
    """
    file = path / MANIFEST if path.is_dir() else path
    try:
        data = file.read_bytes()
    except OSError as error:
        raise EpisodeError(f"{file}: cannot read the manifest: {error.strerror}; is this the folder of an episode?") from error
    return parse_manifest(data, str(file))


def parse_manifest(data: bytes, name: str) -> Manifest:
    """Read a manifest from bytes, for example from the attachment inside the MCAP file; `name` is for messages.

    Raises:
        EpisodeError: not YAML, or a field of the wrong type.
    """
    try:
        document = yaml.load(data, Loader=_Loader)  # noqa: S506  (a safe loader in C)
    except (yaml.YAMLError, UnicodeDecodeError, ValueError, RecursionError) as error:
        raise EpisodeError(f"{name}: not YAML: {' '.join(str(error).split())[:200]}") from error
    if not isinstance(document, dict):
        raise EpisodeError(f"{name}: expected a mapping with episode_id, task, …; came {type(document).__name__}")
    try:
        manifest = msgspec.convert(document, Manifest)
    except msgspec.ValidationError as error:
        raise EpisodeError(f"{name}: {error}") from error
    manifest.foreign = _foreign_keys(document, Manifest)
    return manifest


def save_manifest(manifest: Manifest, path: Path) -> bytes:
    """Write a manifest so that either the old or the new one survives a crash; return the bytes written.

    `path` is the file or the folder of the episode.

    Raises:
        EpisodeError: the disk refused it.
    """
    file = path / MANIFEST if path.is_dir() else path
    data = dump_manifest(manifest)
    try:
        write_atomic(file, data)
    except OSError as error:
        raise EpisodeError(f"{file}: cannot write the manifest: {error.strerror}") from error
    return data


def dump_manifest(manifest: Manifest) -> bytes:
    """Return a manifest as YAML."""
    document = msgspec.to_builtins(manifest)
    _merge(document, document.pop("foreign"))
    text = yaml.dump(document, Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=120, default_flow_style=None)
    return bytes(text, "utf-8")


def snapshot(manifest: Manifest) -> Manifest:
    """Return a copy that later changes of the original do not reach."""
    return copy.deepcopy(manifest)


def _foreign_keys(document: dict[Any, Any], kind: type[msgspec.Struct]) -> dict[str, Any]:
    """Return what of a document `kind` has no field for, in the document's own nesting."""
    found: dict[str, Any] = {}
    known = {field.name: field.type for field in msgspec.structs.fields(kind)}
    for key, value in document.items():
        inner = known.get(key)
        if inner is None:
            found[key] = value
        elif isinstance(inner, type) and issubclass(inner, msgspec.Struct) and isinstance(value, dict):
            nested = _foreign_keys(value, inner)
            if nested:
                found[key] = nested
    return found


def _merge(document: dict[str, Any], extra: dict[str, Any]) -> None:
    for key, value in extra.items():
        if isinstance(value, dict) and isinstance(document.get(key), dict):
            _merge(document[key], value)
        else:
            document.setdefault(key, value)
