"""The pictures of an episode into its file, one at a time: as pixels, or as the camera's own JPEG files; and depth."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

import numpy as np

from adapters.exports.hdf5.arrays import picture_path
from adapters.exports.hdf5.plan import Plan
from adapters.exports.lerobot.av_library import Decoder
from adapters.exports.lerobot.pictures import expect_size
from adapters.exports.lerobot.plan import Camera
from adapters.exports.row_pictures import RowPictures, show_all
from adapters.exports.row_pixels import RowPixels, about_depth
from station.episode.reading.messages import Ints
from station.episode.reading.reader import EpisodeReader
from station.export.resample import Table

LENGTHS = "compress_len"
_LEVEL = 1  # of gzip, which every build of HDF5 reads; more takes several times as long for a few percent


def write(group: Any, reader: EpisodeReader, plan: Plan, table: Table) -> dict[str, Any]:
    """Write what each row shows of every camera; return facts by camera, as those of a video.

    Raises:
        EpisodeError: a picture has another size than the data set, or too many cannot be read; names the camera.
        OSError: the disk refuses.
    """
    common = plan.rows.common
    longest = _longest(reader, [camera.key for camera in common.cameras]) if plan.encoding == "jpeg" else {}
    sinks: dict[Camera, RowPixels | _Files] = {}
    for camera in common.pictures:
        what, numbers = f"{reader.episode_id}: camera {camera.name!r}", table.pictures[camera.key].numbers
        path = picture_path(plan, camera)
        if camera.step_m is not None:
            size = (camera.height, camera.width, *((1,) if plan.layout == "robomimic" else ()))
            array = _pixels(group, path, size, np.uint16, len(numbers))
            array.attrs.update(about_depth(camera))
            sinks[camera] = RowPixels(array, camera, what, numbers)
        elif plan.encoding == "jpeg":
            sinks[camera] = _Files(group, path, camera, what, numbers, longest[camera.key])
        else:
            array = _pixels(group, path, (camera.height, camera.width, 3), np.uint8, len(numbers))
            sinks[camera] = RowPixels(array, camera, what, numbers)
    facts = show_all(reader, {camera: sink.rows for camera, sink in sinks.items()})
    lengths = [sink.lengths for sink in sinks.values() if isinstance(sink, _Files)]
    if lengths:
        group.create_dataset(LENGTHS, data=np.array(lengths))
    return facts


def _pixels(group: Any, path: str, size: tuple[int, ...], kind: type[np.generic], count: int) -> Any:
    return group.create_dataset(
        path, (count, *size), kind, chunks=(1, *size), compression="gzip", compression_opts=_LEVEL
    )


class _Files:
    """An array of JPEG files as the camera gave them, shape (n, bytes of the longest), with zeros behind each.

    Attributes:
        rows: What is fed with pictures.
        lengths: Bytes of the file of each row, shape (n,).
    """

    def __init__(self, group: Any, path: str, camera: Camera, what: str, numbers: Ints, longest: int) -> None:
        shape = (len(numbers), longest)
        self._array = group.create_dataset(path, shape, np.uint8, chunks=(1, longest))
        self._camera, self._what, self._decoder = camera, what, Decoder()
        self.rows = RowPictures(what, numbers, self._read, self._show)
        self.lengths = np.zeros(len(numbers), dtype=np.int64)

    def _read(self, jpeg: bytes) -> bytes | None:
        picture = self._decoder.picture(jpeg)  # half a file would stop a training run
        if picture is None:
            return None
        expect_size(self._what, picture, self._camera)
        return jpeg

    def _show(self, row: int, jpeg: bytes) -> None:
        self._array[row, : len(jpeg)] = np.frombuffer(jpeg, np.uint8)
        self.lengths[row] = len(jpeg)


def _longest(reader: EpisodeReader, keys: Collection[str]) -> dict[str, int]:
    """Return the size of the largest picture of each key [bytes]."""
    found = dict.fromkeys(keys, 0)
    for message in reader.messages(keys):
        found[message.topic] = max(found[message.topic], len(message.data))
    return found
