"""What a source of pictures is to the camera server and to the command line. Knows no source and no bus."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol, runtime_checkable

import msgspec

from station.bus.sample import Sample
from station.errors import StationError

Newest = Callable[[str], Sample | None]
"""Returns the newest value of a key that a camera asked for; None when there is none."""


class SensorError(StationError):
    """A sensor that is missing, refused, torn out or misconfigured; one line that says what to do."""


class CameraError(SensorError):
    """A camera that is missing, busy, refused, torn out or misconfigured; one line that says what to do."""


class Picture(NamedTuple):
    """One picture.

    Attributes:
        jpeg: A whole JPEG file.
        capture_ns: When it was taken, on this machine's monotonic clock [ns].
        depth: Depth of the same moment, as `station.depth` has it; b"" for none.
    """

    jpeg: bytes
    capture_ns: int
    depth: bytes = b""


class Drops(msgspec.Struct):
    """Pictures, or clouds, that never came to the bus, by reason; each counts since the sensor was opened.

    Attributes:
        lost: The sensor took them, and they never came: holes in its own numbering.
        skipped: They were here, but a newer one was too.
        torn: They were not whole: no JPEG file, no cloud; or marked as damaged.
    """

    lost: int = 0
    skipped: int = 0
    torn: int = 0

    @property
    def total(self) -> int:
        """All of them."""
        return self.lost + self.skipped + self.torn

    def __add__(self, other: Drops) -> Drops:
        return Drops(self.lost + other.lost, self.skipped + other.skipped, self.torn + other.torn)


class PictureSettings(msgspec.Struct, frozen=True, kw_only=True):
    """What a lab wants of pictures; None leaves it to the source.

    Attributes:
        fps: Pictures per second [Hz].
        width, height: Size [px].
        quality: JPEG quality of pictures that the station encodes, 1 to 100.
        depth: Whether depth is wanted beside each picture; of a kind that `has_depth`.
    """

    fps: float | None = None
    width: int | None = None
    height: int | None = None
    quality: int = 90
    depth: bool = False


@runtime_checkable
class Camera(Protocol):
    """A source of pictures, opened by its constructor, which raises `CameraError` when it cannot be used.

    It takes pictures from the first `read` on, so that none is old, or counted as dropped, before anybody wants one.

    Attributes:
        drops: What it has dropped so far; it goes on counting there.
    """

    drops: Drops

    def read(self, timeout_s: float) -> Picture | None:
        """Return the newest picture that was not given before, waiting for one no longer than a time [s].

        Older ones that have queued up are left out and counted, so that an old picture is never given.

        Raises:
            CameraError: the camera is gone, and this object will never give a picture again.
        """
        ...

    def why_silent(self) -> str:
        """Return in one line why there may be no picture, and what to do; "" when nothing is known."""
        ...

    def facts(self) -> dict[str, Any]:
        """Return what a manifest says of this camera.

        Always ``width``, ``height`` [px] (None before the first picture of a stream), ``fps`` [Hz] (None where the
        source does not say), ``format``, ``device``, ``capture`` (what the time of capture means), ``exposure`` (None
        where it is not known); where known ``serial``, ``intrinsics`` and ``mount``, as `station.optics.Optics.facts`.
        Of a camera that gives depth ``depth``: ``step_m`` [m], ``range_m``, the nearest and the farthest that it
        measures [m], ``is_aligned``, whether a pixel sees what that of the picture sees; and what differs of the above.
        """
        ...

    def close(self) -> None:
        """Release the camera; a second call does nothing."""
        ...


def _no_keys(_options: Any) -> Sequence[str]:
    return ()


@dataclass(frozen=True, kw_only=True)
class CameraKind:
    """A kind of camera; registered under ``station.cameras``, imports nothing heavy.

    Attributes:
        name: As the setting `source` of the camera server has it.
        about: What it is, in a line.
        library: The package that it needs; "" for none.
        extra: The extra of this package that brings the library; "" for none.
        options: Type of its options.
        open: Opens a camera of options, wishes, and what gives the newest value of a key; imports what is heavy.
        keys: Returns the keys of the bus that a camera of these options looks at.
        has_depth: Whether it can give depth beside its pictures.
        plugged_in: Returns each one that can be seen now, as a person is told; raises `CameraError` where nobody can
            tell: no library, no permission. None for a kind that is not plugged in.
    """

    name: str
    about: str
    library: str
    extra: str
    options: type[msgspec.Struct]
    open: Callable[[Any, PictureSettings, Newest], Camera]
    keys: Callable[[Any], Sequence[str]] = _no_keys
    has_depth: bool = False
    plugged_in: Callable[[], Sequence[str]] | None = None
