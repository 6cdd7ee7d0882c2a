"""TWIST2's recorder (`server_data_record.py`): ``TASK/episode_NNNN/{data.json, rgb/NNNNNN.jpg}``.

It polled ten keys of the bus at 30 Hz and wrote what they held, beside a picture, so the values go back to their keys
as the stock scripts wrote them, one write per tick. It kept no time per key: a key that stood still looks alive.
"""

from __future__ import annotations

import itertools
import json
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from adapters.foreign import twist2_file
from adapters.foreign.twist2_file import INDEX, PICTURE, TIMES, VECTORS, Document
from adapters.robots.g1 import twist_keys
from station.bus import codec, contracts, keys
from station.foreign.kind import ForeignKind, ForeignWrite, Recording, Times

_RATE_HZ = 30.0  # of the stock recorder, where the file does not say
_FASTEST_HZ = 1000.0
_CAMERA = PICTURE
_UNKNOWN = (
    "what the keys held between two ticks: the recorder polled them",
    "how old each value was: a key that had no writer any more was recorded as if it were alive",
    "when each picture was taken: t_img is when it was copied",
    "the policy, its checkpoint and rate, and what the robot was really sent",
    "the robot's joint velocities and orientation beyond roll and pitch",
    "whether the task succeeded; whether the robot fell",
    "the camera and its calibration",
)


def find(folder: Path) -> Sequence[Path]:
    """Return the recordings of a folder: itself, those of a task, or those of several tasks."""
    if (folder / twist2_file.NAME).is_file():
        return [folder]
    found = (path for pattern in ("episode_*", "*/episode_*") for path in folder.glob(pattern))
    return sorted(path for path in found if path.is_dir())


def read(folder: Path) -> Recording:
    """Read a recording.

    Raises:
        BadFile: not what TWIST2's recorder writes; names file and field.
    """
    document = twist2_file.load(folder)
    times, at_ns = _times(document)
    author, image = document.info.get("author"), document.info.get("image")
    has_pictures = any(entry.get(PICTURE) is not None for entry in document.data)
    camera = {"name": _CAMERA, "key": keys.camera_image(_CAMERA), "said": _modest(image)}
    whole = folder.resolve()
    return Recording(
        path=whole,
        number=whole.name.removeprefix("episode_"),
        sha256=document.sha256,
        task=whole.parent.name or "untitled",
        operator=author if isinstance(author, str) else "",
        robot=twist_keys.TWIST2_ROBOT,
        times=times,
        length_ns=at_ns[-1],
        cameras=[camera] if has_pictures else [],
        facts={"info": _modest(document.info), "text": _modest(document.text)},
        unknown=[*_UNKNOWN, *_never(document)],
        odd=list(_odd(document)),
        writes=partial(_writes, folder, document, at_ns),
    )


def _writes(folder: Path, document: Document, at_ns: Sequence[int]) -> Iterator[ForeignWrite]:
    for number, (entry, now_ns) in enumerate(zip(document.data, at_ns, strict=True)):
        for name, value in entry.items():
            if value is None or name in (INDEX, PICTURE):
                continue
            # Python's own encoder wrote the key's value, and reads and writes numbers without changing them.
            yield ForeignWrite(VECTORS.get(name, name), json.dumps(value).encode(), now_ns)
        if (file := entry.get(PICTURE)) is not None:
            yield ForeignWrite(keys.camera_image(_CAMERA), twist2_file.picture(folder, number, file), now_ns)


def _times(document: Document) -> tuple[Times, Sequence[int]]:
    """Return where the times come from, and each entry's, from the first [ns].

    The recorder's own clock at each tick is the best there is; without it, the operator's or the robot's, if they
    went on all the time; else they are unknown.
    """
    notes = {
        twist2_file.T_IMAGE: "t_img, the recorder's wall clock as it copied the picture of a tick, in milliseconds",
        twist_keys.T_ACTION: "t_action, the wall clock of whoever commanded, in milliseconds; t_img cannot be used",
        twist_keys.T_STATE: "t_state, the wall clock of the robot's server, in milliseconds; t_img cannot be used",
    }
    for name in TIMES:
        stamps: list[Any] = [entry.get(name) for entry in document.data]
        if all(stamps) and all(a < b for a, b in itertools.pairwise(stamps)):
            times = Times(source="measured", note=notes[name], started_ns=stamps[0] * 1_000_000)
            return times, [(stamp - stamps[0]) * 1_000_000 for stamp in stamps]
    rate_hz = _nominal_hz(document.info)
    note = "no time that was written down goes on from entry to entry; places in the list stand for times"
    times = Times(source="nominal", note=note, rate_hz=rate_hz)
    return times, [round(number / rate_hz * 1e9) for number in range(len(document.data))]


def _nominal_hz(info: Mapping[str, Any]) -> float:
    image = info.get("image")
    fps = image.get("fps") if isinstance(image, dict) else None
    is_rate = isinstance(fps, (int, float)) and not isinstance(fps, bool) and 0 < fps <= _FASTEST_HZ
    return float(fps) if is_rate else _RATE_HZ  # type: ignore[arg-type]


def _never(document: Document) -> Iterator[str]:
    for name in (*VECTORS, *TIMES, PICTURE):
        if all(entry.get(name) is None for entry in document.data):
            yield f"{name}: in no entry"


def _odd(document: Document) -> Iterator[str]:
    """Yield what looks wrong, field by field."""
    entries = len(document.data)
    for name in (*VECTORS, *TIMES, PICTURE):
        values = [entry.get(name) for entry in document.data]
        if 0 < (missing := values.count(None)) < entries:
            yield f"{name}: missing in {missing} of {entries} entries"
    for name, key in VECTORS.items():
        contract = contracts.contract(key)
        expected = len(contract.elements) if contract else 0
        lengths = [len(entry[name]) for entry in document.data if entry.get(name) is not None]
        if other := [length for length in lengths if length != expected]:
            yield f"{name}: {len(other)} of {len(lengths)} values have {other[0]} numbers, expected {expected}"
    for name in TIMES:
        stamps = [entry[name] for entry in document.data if entry.get(name) is not None]
        if len(stamps) > 1 and stamps.count(stamps[0]) == len(stamps):
            yield f"{name}: the same in every entry: whoever writes it did not run"
        elif back := sum(b < a for a, b in itertools.pairwise(stamps)):
            yield f"{name}: goes back {back} times"
    numbers = [entry.get(INDEX) for entry in document.data]
    if numbers != list(range(entries)):
        yield f"{INDEX}: not 0 to {entries - 1} in order: entries were left out or put together"
    if document.others:
        yield f"fields that the stock recorder does not write, kept as keys of that name: {', '.join(document.others)}"


def _modest(value: Any) -> Any:
    """Return what fits into a manifest."""
    return value if codec.is_modest(value, values=500, depth=6) else "too large to be kept; see its file"


KIND = ForeignKind(
    name="twist2",
    summary="TWIST2's recorder: episode_NNNN folders with data.json and rgb/.",
    recorder="TWIST2's recorder",
    find=find,
    read=read,
)
