"""The manifest of an episode: what was recorded, by whom, with what; typed here, YAML on disk.

The blueprint's names are kept: ``episode_id task operator robot policy streams timing quality_flags``. Reading
tolerates keys that we do not know, in any mapping outside lists, and writing gives them back, so a field that another
tool added survives us. What we write ourselves is typed: a misspelt field cannot be constructed.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import msgspec
import yaml

from station import safe_yaml
from station.atomic_file import refuse_special, write_atomic
from station.episode.storage import bounds
from station.episode.storage.layout import MANIFEST
from station.episode.storage.manifest_parts import (
    Compacted,
    Edit,
    Event,
    Hole,
    Mark,
    Operator,
    Policy,
    QualityFlags,
    RecordedFile,
    Recorder,
    Robot,
    Stream,
    Task,
    Timing,
)
from station.errors import EpisodeError

__all__ = [
    "Compacted",
    "Edit",
    "Event",
    "Hole",
    "Manifest",
    "Mark",
    "Operator",
    "Policy",
    "QualityFlags",
    "RecordedFile",
    "Recorder",
    "Robot",
    "State",
    "Stream",
    "Task",
    "Timing",
    "add_edit",
    "add_hole",
    "add_recovery",
    "dump_manifest",
    "facts_of",
    "load_manifest",
    "parse_manifest",
    "save_manifest",
    "snapshot",
    "words_of_shortened",
]

VERSION = 1
MAX_BYTES = 4_000_000
"""As `bounds.size_of` estimates it: half of what a reader takes; an hour of a station has 0.2 MB."""
MAX_EVENTS = 500
MAX_MARKS = 500
MAX_STREAMS = 2000  # a reader takes 200 000 values of YAML
MAX_HOLES = 1000
MAX_RECOVERY = 500
MAX_EDITS = 500

State = Literal["recording", "finished", "failed"]

_Dumper: Any = getattr(yaml, "CSafeDumper", yaml.SafeDumper)


class LaterManifest(EpisodeError):
    """A manifest that a later station wrote: not broken, and not ours to mend."""


class Manifest(msgspec.Struct, kw_only=True):
    """Everything that is known of an episode without reading its signals.

    Attributes:
        state: ``recording`` on disk without a live recorder means that the recorder was killed.
        servers: What every server stated on ``station:config:<name>``, by server name.
        cameras: Whose pictures there are, once it is closed: ``name``, ``key``, ``pictures``, size [px] and rate [Hz];
            of depth also ``step_m``, what a step of it is [m], ``range_m``, ``is_aligned`` and ``intrinsics``, where
            stated. More of each camera stands in `servers`, by its ``key``. Of an imported recording, what is known of
            its cameras.
        motions: First statement of each motion file on a ``command_source`` key, with that key.
        runbook: Steps and answers, who and when, as the supervisor gave them.
        streams: Bounded; of a client that invents keys, the first ones, and how many more are in the signals.
        events, marks: Bounded; what did not fit is counted beside them and stays in the signals.
        holes: Bounded: the last one reaches to the end of all that did not fit, which are counted beside them.
        files: The files of the recording as they were when they were closed; none while it is recorded, and in
            episodes of earlier stations.
        compacted: How its JPEG pictures became video (`station episodes compact`); None where they are as recorded.
        tags: Words that people put on it, sorted.
        edits: What people changed after the recording: when, who, what was there before. The newest ones; how many
            older ones there were is counted beside them.
        quality: What a later measurement (`check`) found; free form.
        recovery: A note for each time that a recorder took the episode up again (``kind: resumed``), or that a repair
            closed it (``kind: repaired``): when, how long nothing was recorded, what was cut. The newest ones; how many
            older ones there were is counted beside them.
        shortened: By section, how many texts, numbers and members others wrote that were too large or too many for a
            manifest: cut, or left out. The signals hold them whole.
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
    streams_not_listed: int = 0
    timing: Timing = msgspec.field(default_factory=Timing)
    runbook: dict[str, Any] = {}
    recorder: Recorder = msgspec.field(default_factory=Recorder)
    events: list[Event] = []
    events_not_listed: int = 0
    marks: list[Mark] = []
    holes: list[Hole] = []
    holes_not_listed: int = 0
    files: list[RecordedFile] = []
    compacted: Compacted | None = None
    quality_flags: QualityFlags = msgspec.field(default_factory=QualityFlags)
    tags: list[str] = []
    edits: list[Edit] = []
    edits_not_listed: int = 0
    quality: dict[str, Any] = {}
    recovery: list[dict[str, Any]] = []
    recovery_not_listed: int = 0
    shortened: dict[str, int] = {}
    foreign: dict[str, Any] = {}


def add_hole(manifest: Manifest, hole: Hole) -> None:
    """Put a hole into a manifest; of a bus that comes and goes for days, one long hole stands for all further ones."""
    if len(manifest.holes) < MAX_HOLES:
        manifest.holes.append(hole)
    else:
        manifest.holes[-1].to_s = hole.to_s
        manifest.holes_not_listed += 1


def words_of_shortened(shortened: Mapping[str, int]) -> str:
    """Return in a line how much did not fit into a manifest."""
    sections = ", ".join(f"{count} of {name}" for name, count in shortened.items())
    return f"cut or left out of the manifest as too long or too many, whole in the signals: {sections}"


def add_recovery(manifest: Manifest, note: dict[str, Any]) -> None:
    """Put a note into a manifest that the episode was taken up again or repaired."""
    manifest.recovery.append(note)
    manifest.recovery_not_listed += max(0, len(manifest.recovery) - MAX_RECOVERY)
    del manifest.recovery[:-MAX_RECOVERY]


def add_edit(manifest: Manifest, edit: Edit) -> None:
    """Put a note into a manifest that a person changed something."""
    manifest.edits.append(edit)
    manifest.edits_not_listed += max(0, len(manifest.edits) - MAX_EDITS)
    del manifest.edits[:-MAX_EDITS]


def facts_of(manifest: Manifest) -> dict[str, str]:
    """Return what stands at the head of each file of an episode, so that it can be told whose it is."""
    return {
        "episode_id": manifest.episode_id,
        "task": manifest.task.name,
        "started": manifest.timing.started,
    }


def load_manifest(path: Path) -> Manifest:
    """Read a manifest; `path` is the file or the folder of the episode.

    Raises:
        EpisodeError: missing, not YAML, or a field of the wrong type; one line that names it.
    """
    file = path / MANIFEST if path.is_dir() else path
    try:
        refuse_special(file)
        data = safe_yaml.read_bytes(file)
    except OSError as error:
        raise EpisodeError(
            f"{file}: cannot read the manifest: {error.strerror}; is this the folder of an episode?"
        ) from error
    return parse_manifest(data, str(file))


def parse_manifest(data: bytes, name: str) -> Manifest:
    """Read a manifest from bytes, for example from the attachment inside the MCAP file; `name` is for messages.

    Raises:
        EpisodeError: not YAML, or a field of the wrong type.
        LaterManifest: its version is later than ours; its fields may mean something else.
    """
    try:
        document = safe_yaml.load(data)
    except safe_yaml.BadYaml as error:
        raise EpisodeError(f"{name}: {error}") from None
    if not isinstance(document, dict):
        raise EpisodeError(f"{name}: expected a mapping with episode_id, task, …; came {type(document).__name__}")
    try:
        manifest = msgspec.convert(document, Manifest)
    except msgspec.ValidationError as error:
        raise EpisodeError(f"{name}: {error}") from error
    if manifest.manifest_version > VERSION:
        raise LaterManifest(
            f"{name}: manifest of version {manifest.manifest_version}, by a later station; this one reads up to "
            f"version {VERSION}: upgrade it"
        )
    manifest.foreign = _foreign_keys(document, Manifest)
    return manifest


def save_manifest(manifest: Manifest, folder: Path) -> bytes:
    """Write an episode's manifest so that either the old or the new one survives a crash; return the bytes written.

    Raises:
        EpisodeError: the disk refused it.
    """
    file = folder / MANIFEST
    data = dump_manifest(manifest)
    try:
        write_atomic(file, data)
    except OSError as error:
        raise EpisodeError(f"{file}: cannot write the manifest: {error.strerror}") from error
    return data


def dump_manifest(manifest: Manifest) -> bytes:
    """Return a manifest as YAML that `parse_manifest` takes: what would be too large is cut, and counted."""
    most = MAX_BYTES
    while True:
        document = msgspec.to_builtins(_bounded(manifest, most))
        _merge(document, document.pop("foreign"))
        text = yaml.dump(
            document, Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=120, default_flow_style=None
        )
        data = bytes(text, "utf-8")
        if len(data) <= safe_yaml.DEFAULT.size:
            return data
        most //= 2  # lines that are indented deep take more than was estimated


def _bounded(manifest: Manifest, most: int) -> dict[str, Any]:
    """Return the fields of a manifest, cut to a size [bytes of YAML]."""
    sections = {name: getattr(manifest, name) for name in manifest.__struct_fields__}
    found = bounds.cut_each(sections, most, may_drop=False)
    document = {name: section.value for name, section in found.items()}
    shortened = dict(manifest.shortened)
    for name, (value, count) in found.items():
        counter, left_out = f"{name}_not_listed", 0
        if counter in document:
            left_out = len(sections[name]) - len(value)
            document[counter] += left_out
        if count > left_out:
            shortened[name] = shortened.get(name, 0) + count - left_out
    if len(document["holes"]) < len(manifest.holes):
        document["holes"][-1]["to_s"] = manifest.holes[-1].to_s
    return {**document, "shortened": shortened}


def snapshot(manifest: Manifest) -> Manifest:
    """Return a copy that later changes of the original do not reach."""
    return msgspec.convert(msgspec.to_builtins(manifest), Manifest)


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
