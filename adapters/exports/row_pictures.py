"""Pictures of a camera row by row, in one pass over the file and one picture in memory at a time.

Which picture a row shows was decided when the rows were made (`station.export.resample`); here it is brought there.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from adapters.exports.lerobot.plan import Camera
from station.episode.reading.messages import Ints
from station.episode.reading.reader import EpisodeReader
from station.errors import EpisodeError

_MOST_BAD = 0.01  # of a camera's pictures; more is no transmission error but a fault of the camera


@dataclass(frozen=True)
class Shown:
    """What the rows of a camera show.

    Attributes:
        numbers: Which picture, in order of arrival, each of n rows shows, shape (n,).
        bad: Pictures that could not be read; the one before stands in their place.
    """

    numbers: Ints
    bad: int


class RowPictures:
    """Gives each row of a camera its picture.

    Args:
        what: Episode and camera, for messages.
        rows: Which picture in order of arrival each row shall show, never descending, shape (n,).
        read: Returns the picture of a file, None for what cannot be read; raises `EpisodeError` for one that does
            not fit.
        show: Called with every row's number and its picture, row by row.
    """

    def __init__(
        self, what: str, rows: Ints, read: Callable[[bytes], Any | None], show: Callable[[int, Any], None]
    ) -> None:
        self._what, self._rows, self._read, self._show = what, rows, read, show
        self._shown: list[int] = []
        self._arrived = self._bad = 0
        self._last: tuple[int, Any] | None = None

    def feed(self, file: bytes) -> None:
        """Add the next picture in order of arrival.

        Raises:
            EpisodeError: nothing can stand in the first row.
        """
        row, number = len(self._shown), self._arrived
        self._arrived += 1
        if row == len(self._rows) or self._rows[row] != number:
            return
        picture = self._read(file)
        if picture is not None:
            self._last = number, picture
        else:
            self._bad += 1
        if self._last is None:
            raise EpisodeError(f"{self._what}: picture {number}, the first one of the rows, cannot be read")
        shown, picture = self._last
        while row < len(self._rows) and self._rows[row] == number:
            self._show(row, picture)
            self._shown.append(shown)
            row += 1

    def finish(self) -> Shown:
        """Return what the rows show, once all pictures came.

        Raises:
            EpisodeError: too many could not be read.
        """
        if self._bad > max(1, _MOST_BAD * len(set(self._rows.tolist()))):
            raise EpisodeError(f"{self._what}: {self._bad} pictures cannot be read")
        return Shown(np.array(self._shown, dtype=np.int64), self._bad)


def feed_all(reader: EpisodeReader, cameras: Mapping[str, RowPictures]) -> None:
    """Give the cameras of some keys all pictures of an episode, in one pass.

    Raises:
        EpisodeError: a picture does not fit, or the file is damaged.
    """
    for message in reader.messages(cameras.keys()):
        if not message.channel.is_deletion:
            cameras[message.topic].feed(message.data)


def show_all(reader: EpisodeReader, cameras: Mapping[Camera, RowPictures]) -> dict[str, Any]:
    """Bring every picture to its rows; return, by name of each camera, how many rows' pictures differ and were bad.

    Raises:
        EpisodeError: as `feed_all` and `RowPictures.finish`.
    """
    feed_all(reader, {camera.key: rows for camera, rows in cameras.items()})
    shown = {camera.name: rows.finish() for camera, rows in cameras.items()}
    return {name: {"bad": one.bad, "distinct": len(np.unique(one.numbers))} for name, one in shown.items()}
