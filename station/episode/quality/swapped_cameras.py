"""Cameras that changed places: beside the first episode of the same task that knows cameras of the same names.

By serial numbers, where the servers of cameras told them: a name whose camera had another name then. Else by what the
pictures show: where each of two cameras looks like the other one did, and neither like itself. Both limits are far
apart, so that a scene that merely changed, or two views that are alike, say nothing.
"""

from __future__ import annotations

import base64
import binascii
from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations
from pathlib import Path

import msgspec
import numpy as np

from station.episode.quality.finding_parts import CameraSwap, PictureQuality
from station.episode.reading.reader import EpisodeReader
from station.episode.storage.layout import MANIFEST
from station.episode.storage.manifest import Manifest, load_manifest
from station.errors import EpisodeError
from station.protocols import Floats

ALIKE, UNLIKE = 0.9, 0.5
"""Correlation of two first views above which they are of one camera, and below which they are not."""

_MOST_TRIED = 5  # episodes whose manifests are read


def find(reader: EpisodeReader, pictures: Sequence[PictureQuality]) -> list[CameraSwap]:
    """Return the cameras that changed places, by name; none where no earlier episode knows the same cameras."""
    names = {found.key: found.name for found in pictures}
    if len(names) < 2:
        return []
    for earlier in _earlier(reader):
        found = _by_serial(reader.manifest, earlier, names)
        if found is None:
            found = _by_likeness(pictures, earlier)
        if found is not None:
            return found
    return []


def _earlier(reader: EpisodeReader) -> Iterator[Manifest]:
    """Yield the manifests of the first episodes of the same task before this one."""
    folder = reader.folder.resolve()
    try:
        others = sorted(path for path in folder.parent.iterdir() if path.name < folder.name)
    except OSError:  # an episode may be read where its neighbours may not: there is nothing to compare it with
        return
    for other in [path for path in others if (path / MANIFEST).is_file()][:_MOST_TRIED]:
        if (known := _manifest(other)) is not None and known.task.name == reader.manifest.task.name:
            yield known


def _manifest(folder: Path) -> Manifest | None:
    try:
        return load_manifest(folder)
    except EpisodeError:  # told by the check of that episode
        return None


def _by_serial(now: Manifest, then: Manifest, names: Mapping[str, str]) -> list[CameraSwap] | None:
    """Return the swaps by serial numbers; None where not both episodes tell those of two cameras."""
    has, had = ({key: serial for key, serial in _serials(one).items() if key in names} for one in (now, then))
    if min(len(has), len(had)) < 2:
        return None
    was = {serial: key for key, serial in had.items()}
    return [
        CameraSwap(names[key], names[was[serial]], "serial", then.episode_id)
        for key, serial in sorted(has.items())
        if serial in was and was[serial] != key and had.get(key) != serial
    ]


def _serials(manifest: Manifest) -> dict[str, str]:
    """Return the serial number of each camera's device by its key; those that two cameras share tell nothing."""
    found = {
        key: serial
        for facts in (*manifest.cameras, *manifest.servers.values())
        if isinstance(key := facts.get("key"), str) and isinstance(serial := facts.get("serial"), str) and serial
    }
    told = list(found.values())
    return {key: serial for key, serial in found.items() if told.count(serial) == 1}


def _by_likeness(pictures: Sequence[PictureQuality], then: Manifest) -> list[CameraSwap] | None:
    """Return the swaps by what is seen; None where no check has looked at the earlier pictures of two cameras."""
    now = {found.name: view for found in pictures if (view := _view(found.first_view)) is not None}
    was = {found.name: view for found in _written(then) if (view := _view(found.first_view)) is not None}
    both = sorted(now.keys() & was.keys())
    if len(both) < 2:
        return None
    return [
        CameraSwap(name, before, "likeness", then.episode_id)
        for one, other in combinations(both, 2)
        if min(_likeness(now[one], was[other]), _likeness(now[other], was[one])) > ALIKE
        and max(_likeness(now[one], was[one]), _likeness(now[other], was[other])) < UNLIKE
        for name, before in ((one, other), (other, one))
    ]


def _written(manifest: Manifest) -> list[PictureQuality]:
    """Return what a check wrote of the pictures of an episode."""
    try:
        return msgspec.convert(manifest.quality.get("pictures", []), list[PictureQuality])
    except msgspec.ValidationError:
        return []


def first_view(thumb: Floats) -> str:
    """Return a small view, grey of 0 to 255, as it stands in a manifest."""
    return base64.b64encode(thumb.round().clip(0, 255).astype(np.uint8).tobytes()).decode()


def _view(written: str) -> Floats | None:
    try:
        found = np.frombuffer(base64.b64decode(written, validate=True), np.uint8).astype(np.float64)
    except (ValueError, binascii.Error):
        return None
    return found - found.mean() if len(found) and found.std() > 0 else None


def _likeness(one: Floats, other: Floats) -> float:
    """Return the correlation of two views without their means, up to 1; 0 where they are not of one size."""
    if one.shape != other.shape:
        return 0.0
    return float(one @ other / np.sqrt((one @ one) * (other @ other)))
