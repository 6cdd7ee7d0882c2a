"""Video by PyAV: encoded picture by picture, counted, and put one behind the other without encoding again."""

from __future__ import annotations

import contextlib
import ctypes
import os
import threading
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path
from typing import Any, Literal

from adapters.exports.lerobot.av_library import DEPTH_PIXELS, PIXELS, Codec, av
from station.errors import EpisodeError
from station.video import X264

_ENCODERS: dict[Codec | Literal["hevc"], tuple[str, dict[str, str]]] = {
    # One thread each: episodes are converted side by side, and the bytes do not depend on the machine.
    "h264": ("libx264", X264),
    # Preset 10 and not LeRobot's 12: in 23 of 519 frames of a counter preset 12 left out what had just changed.
    "av1": ("libsvtav1", {"preset": "10", "crf": "30", "svtav1-params": "lp=1"}),
    # Depth, whose 12 bits come back as they are; no pictures that refer to later ones, as of the others.
    "hevc": ("libx265", {"preset": "ultrafast", "x265-params": "lossless=1:bframes=0:pools=none:log-level=error"}),
}

_TASKS = Path("/proc/self/task")


class VideoWriter:
    """An mp4 file of a fixed rate, one call per picture.

    Args:
        file: To be written.
        height, width: Even numbers of pixels; any of depth.
        fps: Pictures per second.
        codec: How they are encoded; ``hevc`` for depth.
        gop: Every so many pictures one is a key frame, the first one included: to show any other, a reader decodes
            from the key frame before it.
    """

    def __init__(self, file: Path, height: int, width: int, fps: int, codec: Codec | Literal["hevc"], gop: int) -> None:
        os.environ.setdefault("SVT_LOG", "1")  # errors alone: else every video is told of on standard error
        encoder, options = _ENCODERS[codec]
        self._period = Fraction(1, fps)
        self._count = 0
        self._container = _create(file)
        stream: Any = self._container.add_stream(encoder, rate=fps, options={**options, "g": str(gop)})
        pixels = DEPTH_PIXELS if codec == "hevc" else PIXELS
        stream.height, stream.width, stream.pix_fmt = height, width, pixels
        context = stream.codec_context
        context.thread_count = 1
        context.color_range, context.colorspace = _LIMITED_RANGE, _BT601
        with kept_scheduling():
            context.open()
        self._stream = stream

    def add(self, picture: Any) -> None:
        """Encode a picture (an `av.VideoFrame` of the video's size and pixel format) as the next one."""
        # A frame decoded from JPEG is of type I, and encoders obey the type of a frame: each would be a key frame.
        picture.pict_type = av.video.frame.PictureType.NONE
        picture.pts, picture.time_base = self._count, self._period
        self._count += 1
        self._container.mux(self._stream.encode(picture))

    def close(self) -> None:
        """Write what is left, and the index."""
        self._container.mux(self._stream.encode())
        self._container.close()

    def abandon(self) -> None:
        """Release the file as it is."""
        self._container.close()


_LIMITED_RANGE, _BT601 = 1, 5  # AVCOL_RANGE_MPEG, AVCOL_SPC_BT470BG: what players take for small untagged video


def _create(file: Path) -> Any:
    """Begin a file whose index will stand at its beginning, so that a player on a network finds it."""
    return av.open(str(file), "w", format="mp4", options={"movflags": "faststart"})


def packets(file: Path) -> Iterator[Any]:
    """Iterate over the encoded pictures of a video, in order."""
    with av.open(str(file)) as container:
        yield from (packet for packet in container.demux(video=0) if packet.size)


def expect_frames(file: Path, rows: int, what: str) -> None:
    """Count the pictures of a finished video.

    Raises:
        EpisodeError: there are not as many as rows; `what` names the video.
    """
    found = sum(1 for _ in packets(file))
    if found != rows:
        raise EpisodeError(f"{what}: {found} pictures in its video for {rows} rows; export it again")


class Concatenation:
    """Puts videos of one camera one behind the other, packet by packet, into files of a limited size.

    Args:
        folder: Where ``chunk-000/file-000.mp4`` … go, behind those that are there.
        fps: Pictures per second of all of them.
        limit_bytes: A file that has grown beyond this is the last but one.
        per_chunk: Files per folder.
    """

    def __init__(self, folder: Path, fps: int, *, limit_bytes: int, per_chunk: int) -> None:
        self._folder, self._period = folder, Fraction(1, fps)
        self._limit, self._per_chunk = limit_bytes, per_chunk
        self._number, self._frames, self._bytes = len(list(folder.glob("*/*.mp4"))) - 1, 0, 0
        self._header = b""
        self._container: Any = None
        self._stream: Any = None

    def add(self, file: Path, rows: int) -> tuple[int, int, float, float]:
        """Append a video; return chunk, file, and where in it the video begins and ends [s].

        Raises:
            EpisodeError: it has not as many pictures as rows.
        """
        with av.open(str(file)) as source:
            template = source.streams.video[0]
            header = bytes(template.codec_context.extradata or b"")
            if self._container is None or self._bytes >= self._limit or header != self._header:
                self._next(template, header)
            count = 0
            for packet in source.demux(template):
                if not packet.size:
                    continue
                packet.stream, packet.time_base = self._stream, self._period
                packet.pts = packet.dts = self._frames + count
                packet.duration = 1
                self._bytes += packet.size
                self._container.mux(packet)
                count += 1
        if count != rows:
            raise EpisodeError(f"{file.name}: {count} pictures for {rows} rows; remove what was exported, begin anew")
        begin, self._frames = self._frames, self._frames + count
        chunk, number = divmod(self._number, self._per_chunk)
        return chunk, number, float(begin * self._period), float(self._frames * self._period)

    def close(self) -> None:
        """Finish the present file, and count its pictures.

        Raises:
            EpisodeError: not as many as were put in.
        """
        if self._container is not None:
            self._container.close()
            self._container = None
            expect_frames(self._file(), self._frames, str(self._file().relative_to(self._folder.parent)))

    def abandon(self) -> None:
        """Release the present file as it is."""
        if self._container is not None:
            self._container.close()

    def _next(self, template: Any, header: bytes) -> None:
        self.close()
        self._number, self._frames, self._bytes, self._header = self._number + 1, 0, 0, header
        self._file().parent.mkdir(parents=True, exist_ok=True)
        self._container = _create(self._file())
        self._stream = self._container.add_stream_from_template(template, opaque=True)  # copied, not encoded
        self._stream.time_base = self._period

    def _file(self) -> Path:
        chunk, number = divmod(self._number, self._per_chunk)
        return self._folder / f"chunk-{chunk:03d}" / f"file-{number:03d}.mp4"


@contextlib.contextmanager
def kept_scheduling() -> Iterator[None]:
    """Undo what a library does to the scheduling of threads, also where it fails.

    SVT-AV1, where it may (run by root, say), puts its threads and its caller's at the head of everything that runs on
    the machine, for ever: an export would starve the loop of a robot.
    """
    if not _TASKS.exists():  # no Linux
        yield
        return
    me = threading.get_native_id()
    before, own = _all(), _of(me)
    try:
        yield
    finally:
        for thread, now in _all().items():
            wanted = before.get(thread, own)
            with contextlib.suppress(ProcessLookupError, PermissionError):  # it ended; or nobody could have raised it
                if now != wanted:
                    _put_back(thread, wanted) if thread != me else _put_own_back(wanted)


def _all() -> dict[int, tuple[int, int]]:
    """Return policy and priority of every thread that there is."""
    found = {}
    for task in _TASKS.iterdir():
        with contextlib.suppress(ProcessLookupError):  # it has ended meanwhile
            found[int(task.name)] = _of(int(task.name))
    return found


def _of(thread: int) -> tuple[int, int]:
    return os.sched_getscheduler(thread), os.sched_getparam(thread).sched_priority


def _put_back(thread: int, wanted: tuple[int, int]) -> None:
    policy, priority = wanted
    os.sched_setscheduler(thread, policy, os.sched_param(priority))


def _put_own_back(wanted: tuple[int, int]) -> None:
    """Put the calling thread's scheduling back where its C library has kept it as well.

    What `pthread_setschedparam` set, glibc keeps beside the thread, hands on to each thread that it starts, and answers
    `pthread_getschedparam` with; the kernel's own call would leave that copy as it is.
    """
    policy, priority = wanted
    library = ctypes.CDLL(None)
    library.pthread_self.restype = ctypes.c_ulong
    library.pthread_setschedparam.argtypes = [ctypes.c_ulong, ctypes.c_int, ctypes.POINTER(ctypes.c_int)]
    error = library.pthread_setschedparam(library.pthread_self(), policy, ctypes.byref(ctypes.c_int(priority)))
    if error:
        raise OSError(error, os.strerror(error))
