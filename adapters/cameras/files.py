"""Files as a camera: a folder of pictures, or a video, played in real time."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

from adapters.cameras.encode import Encoder, library
from adapters.cameras.pace import Pace
from station import jpeg
from station.camera.source import CameraError, Drops, Picture, PictureSettings

_JPEG = (".jpg", ".jpeg")
_PICTURES = (*_JPEG, ".png", ".bmp", ".webp", ".tif", ".tiff")
_FPS = 30.0
_DIGITS = re.compile(r"(\d+)")


_Frame = Callable[[], "bytes | None"]
"""Returns a picture as a JPEG file, or None for one that is broken."""


class FilesCamera:
    """Plays files; implements `station.camera.source.Camera`. A picture counts as taken when it is due.

    Args:
        path: A folder of pictures, in the order of the numbers in their names, or a video file.
        is_looped: Whether it begins again at the end.
        settings: The files' own size and rate unless they say otherwise; 30 Hz for pictures.

    Raises:
        CameraError: no such file or folder, no picture in it, or no library that reads it.
    """

    def __init__(self, path: Path, settings: PictureSettings, *, is_looped: bool = True) -> None:
        self.drops = Drops()
        self._path, self._is_looped = path, is_looped
        if not path.exists():
            raise CameraError(f"{path}: no such file or folder; expected a folder of pictures, or a video file")
        self._reel = _Folder(path, settings) if path.is_dir() else _Video(path, settings)
        self._fps = settings.fps or self._reel.fps or _FPS
        self._quality = settings.quality
        self._pace = Pace(self._fps)
        self._frames: Iterator[_Frame] | None = None
        self._is_over = False

    def read(self, timeout_s: float) -> Picture | None:
        """Return the picture that is due; see `Camera.read`."""
        if self._is_over:
            time.sleep(timeout_s)
            return None
        before = self._pace.index
        due_ns = self._pace.wait(timeout_s)
        if due_ns is None:
            return None
        frame = None
        for _ in range(self._pace.index - before):
            if frame is not None:
                self.drops.skipped += 1
            frame = self._next()
            if frame is None:
                return None
        data = frame() if frame is not None else None
        if data is None:
            self.drops.torn += 1
            return None
        return Picture(data, due_ns)

    def why_silent(self) -> str:
        """Return that it is over, or nothing."""
        return f"{self._path}: played to its end; set options.loop to have it begin again" if self._is_over else ""

    def facts(self) -> dict[str, Any]:
        """Return what is played, and how."""
        reel = self._reel
        facts: dict[str, Any] = {
            "width": reel.size[0],
            "height": reel.size[1],
            "fps": round(self._fps, 3),
            "fps_of_files": reel.fps,
            "format": reel.form,
            "is_passed_through": reel.passes,
            "device": str(self._path.absolute()),
            "is_looped": self._is_looped,
            "capture": "when the picture was due to be played, monotonic clock",
            "exposure": None,
        }
        return facts if reel.passes else facts | {"quality": self._quality}

    def close(self) -> None:
        """Let go of the files."""
        self._frames, self._is_over = None, True

    def _next(self) -> _Frame | None:
        for _ in range(2):
            if self._frames is None:
                self._frames = self._reel.pictures()
            frame = next(self._frames, None)
            if frame is not None:
                return frame
            self._frames = None
            if not self._is_looped:
                break
        self._is_over = True
        return None


class _Folder:
    """A folder of pictures; JPEG files are passed on as they are, unless another size is wanted.

    Attributes:
        size: Of a picture (width, height) [px].
        fps: Their own rate [Hz]; None for none.
        form: How they are stored.
        passes: Whether their bytes are passed on.
    """

    def __init__(self, folder: Path, settings: PictureSettings) -> None:
        self._files = sorted((file for file in folder.iterdir() if file.suffix.lower() in _PICTURES), key=_by_number)
        if not self._files:
            raise CameraError(f"{folder}: no pictures in it; expected files that end in {', '.join(_PICTURES)}")
        first = self._files[0]
        self.fps: float | None = None
        self.form = first.suffix.lower().removeprefix(".").replace("jpeg", "jpg")
        own = _size(first)
        self.size = (settings.width or own[0], settings.height or own[1])
        self.passes = self.size == own and all(file.suffix.lower() in _JPEG for file in self._files)
        self._encoder = None if self.passes else Encoder(settings.quality)

    def pictures(self) -> Iterator[_Frame]:
        """Iterate over them once, from the first."""
        for file in self._files:
            yield partial(self._picture, file)

    def _picture(self, file: Path) -> bytes | None:
        try:
            if self._encoder is None:
                data = file.read_bytes()
                known = jpeg.head(data)
                fits = known is not None and (known.width, known.height) == self.size
                return jpeg.readable(data, known) if known is not None and fits else None
            with _opened(file) as container:
                frame = next(_decoded(container), None)
            return None if frame is None else _encoded(self._encoder, frame, self.size)
        except (OSError, CameraError):  # one broken picture of many: counted by the caller
            return None


class _Video:
    """A video file, decoded as it is played; attributes as those of `_Folder`."""

    passes = False

    def __init__(self, file: Path, settings: PictureSettings) -> None:
        self._file, self._encoder = file, Encoder(settings.quality)
        with _opened(file) as container:
            stream = container.streams.video[0]
            rate = stream.average_rate or stream.guessed_rate
            self.fps: float | None = round(float(rate), 3) if rate else None
            self.size = (settings.width or stream.width, settings.height or stream.height)
            self.form = stream.codec_context.name
            if next(_decoded(container), None) is None:
                raise CameraError(f"{file}: no picture in it; expected a video file")

    def pictures(self) -> Iterator[_Frame]:
        """Iterate over them once, from the first."""
        with _opened(self._file) as container:
            for frame in _decoded(container):
                yield partial(_encoded, self._encoder, frame, self.size)


def _opened(file: Path) -> Any:
    """Open a file with PyAV.

    Raises:
        CameraError: there is no PyAV, or it cannot read the file.
    """
    av = library("av", "av", "a video file, or a picture that is no JPEG file,")
    try:
        container = av.open(str(file))
    except (av.error.FFmpegError, OSError) as error:
        raise CameraError(f"{file}: cannot be read: {error.strerror or error}; expected pictures or a video") from None
    if not container.streams.video:
        container.close()
        raise CameraError(f"{file}: no video in it; expected a video file")
    return container


def _decoded(container: Any) -> Iterator[Any]:
    """Iterate over the frames of the first video; None for what is broken within it.

    Raises:
        CameraError: what comes next in the file cannot be found.
    """
    failed = library("av", "av", "a video file").error.FFmpegError
    packets = container.demux(container.streams.video[0])
    while True:
        try:
            packet = next(packets, None)
        except failed as error:
            why = f"{error.strerror or error}; is the file whole?"
            raise CameraError(f"{container.name}: cannot be read to its end: {why}") from None
        if packet is None:
            return
        try:
            yield from packet.decode()
        except failed:
            yield None


def _encoded(encoder: Encoder, frame: Any, size: tuple[int, int]) -> bytes | None:
    if frame is None:
        return None
    return encoder.rgb(frame.to_ndarray(format="rgb24", width=size[0], height=size[1]))


def _size(file: Path) -> tuple[int, int]:
    if file.suffix.lower() in _JPEG:
        known = jpeg.head(file.read_bytes())
        if known is None:
            raise CameraError(f"{file}: no whole JPEG file")
        return known.width, known.height
    with _opened(file) as container:
        stream = container.streams.video[0]
        return stream.width, stream.height


def _by_number(file: Path) -> list[tuple[int, str]]:
    """Order 2.jpg before 10.jpg."""
    return [(int(part), "") if part.isdigit() else (-1, part) for part in _DIGITS.split(file.name)]
