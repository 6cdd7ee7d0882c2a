"""What the pictures of an episode are worth: torn, resized, repeated, frozen, black, white, empty, or badly exposed.

Every picture is tried by its bytes: whether it is a whole JPEG file, of the size of the first one, and whether it is
the picture before once more, byte for byte. Two pictures a second of each camera (at most 600) are decoded
too, in grey, at an eighth to a half of their size, beside the reading of the file.

Of depth a picture is a whole PNG file if every chunk has its checksum. What its values are like says nothing of its
worth, but for this: whether anything was measured at all.

A sensor has noise and never gives the same bytes twice; a simulated camera may, before a robot that stands still. So a
picture that stays the same counts against a camera only for the time in which joints surely moved, as
`station.episode.quality.motion` measures it.
"""

from __future__ import annotations

import importlib
import io
from array import array
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from types import TracebackType
from typing import Any, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from station import depth, jpeg
from station.bus import codec
from station.episode.quality import swapped_cameras
from station.episode.quality.finding_parts import DepthQuality, PictureQuality, Seen
from station.episode.quality.picture_views import TILES, ViewMeter, exchanged, likeness
from station.episode.reading import frames
from station.episode.reading.messages import Ints, Message
from station.episode.reading.reader import EpisodeReader
from station.protocols import Floats

Spans = Sequence[tuple[int, int]]
"""Times from and to, in order, none touching the next [ns since the epoch]."""

BLACK_MEAN, BLACK_P99 = 12.0, 24.0
"""Mean and 99th percentile of grey, 0 to 255: a picture below both shows nothing. A dim room has lights above them."""
WHITE, WHITE_SHARE = 250, 0.6
"""From this grey on a pixel is blown out; with a greater share of such ones a picture is."""
FLAT_STD = 1.5
"""Standard deviation of grey below which a picture shows one colour: a cap, a test picture, no signal."""
JUMP, JUMP_LIKENESS = 30.0, 0.95
"""Change of the mean grey from one picture looked at to the next, and how alike they are but for brightness, up to 1:
with more than both it was the exposure, or the light, and not what is seen."""

_LEAST_APART_S, _MOST_APART_S = 0.5, 10.0  # from one picture that is looked at to the next
_MOST_SAMPLES = 600  # of each camera
_FREEZE_NS = 500_000_000  # the same picture for longer is a freeze, for less it is a repeat
_LEAST_WIDTH, _LEAST_HEIGHT = 160, 120  # that is decoded [px]
_CUT_TILES = 3  # rows of tiles at the lower end, of one colour
_MOST_PIXELS = 40_000_000  # of a picture that is opened; a camera has 2 to 12 million
_FIRST = 2  # pictures looked at that make the first view
_MOST_SIZES = 8
_MOST_PENDING, THREADS = 32, 2

Grey = NDArray[np.uint8]


class PictureMeter:
    """Takes the messages of an episode with their stamps, and tells at the end what its pictures are worth.

    To be used as a context: it decodes in threads of its own, which end with it.

    Args:
        reader: The episode.
    """

    def __init__(self, reader: EpisodeReader) -> None:
        self._start_ns = reader.start_ns
        apart_ns = _apart_ns(reader.manifest.timing.duration_s)
        videos = {channel.topic for channel in reader.channels() if channel.video}
        depths = set(frames.depths(reader).values())
        self._cameras = {
            key: _Camera(name, key, apart_ns, is_video=key in videos, is_depth=key in depths)
            for name, key in frames.all_pictures(reader).items()
        }
        self._decoder, self._decode = decoder() if self._cameras else ("", _by_pillow)
        self._pool = ThreadPoolExecutor(THREADS, thread_name_prefix="pictures") if self._cameras else None
        self._pending: deque[tuple[_Camera, int, Future[Look | float | None]]] = deque()

    def __enter__(self) -> PictureMeter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=kind is not None)

    def feed(self, message: Message) -> None:
        """Add a message; those of other keys are passed over."""
        camera = self._cameras.get(message.topic)
        if camera is None or message.channel.is_deletion:
            return
        taken_ns = frames.captured_ns(message)
        if camera.feed(message.data, taken_ns) and self._pool is not None:
            task = (
                partial(measured_share, message.data) if camera.is_depth else partial(look, self._decode, message.data)
            )
            self._pending.append((camera, taken_ns, self._pool.submit(task)))
            if len(self._pending) > _MOST_PENDING:
                self._gather()

    def result(self, moves: Spans) -> list[PictureQuality]:
        """Return what each camera's pictures are worth, by name.

        Args:
            moves: When joints surely moved.
        """
        while self._pending:
            self._gather()
        taken = {camera.name: camera for camera in self._cameras.values() if camera.taken}
        swaps = exchanged({name: camera.views for name, camera in taken.items()})
        found = [camera.result(self._start_ns, moves, self._decoder) for camera in taken.values()]
        for place, one in enumerate(found):
            if one.name in swaps:
                other, at_ns = swaps[one.name]
                found[place] = msgspec.structs.replace(
                    one, exchanged_with=other, exchanged_s=_s(at_ns - self._start_ns)
                )
        return found

    def _gather(self) -> None:
        camera, taken_ns, found = self._pending.popleft()
        camera.add_look(taken_ns, found.result())


def _apart_ns(duration_s: float | None) -> int:
    """Return how far apart pictures are looked at, in an episode of some seconds by its own word [ns]."""
    length_s = codec.number(duration_s) or 0.0
    return round(min(max(_LEAST_APART_S, length_s / _MOST_SAMPLES), _MOST_APART_S) * 1e9)


class Look(NamedTuple):
    """What one picture shows, in grey of 0 to 255.

    Attributes:
        mean, std, p99: Of all pixels.
        white_share: Share of the pixels that are blown out, 0..1.
        sharpness: Variance of the Laplacian.
        thumb: Means of 12x12 tiles, shape (12, 12).
        is_cut: Whether its lower end, a quarter or more, is of one colour.
        pixels: All that was decoded, to be compared.
    """

    mean: float
    std: float
    p99: float
    white_share: float
    sharpness: float
    thumb: Floats
    is_cut: bool
    pixels: bytes

    @property
    def is_black(self) -> bool:
        """Whether it shows nothing for want of light."""
        return self.mean < BLACK_MEAN and self.p99 < BLACK_P99

    @property
    def is_white(self) -> bool:
        """Whether most of it is blown out."""
        return self.white_share > WHITE_SHARE

    @property
    def is_flat(self) -> bool:
        """Whether it shows one colour, and is neither black nor white."""
        return self.std < FLAT_STD and not self.is_black and not self.is_white


class _Tally:
    """How many of something there are, and when the first was."""

    def __init__(self) -> None:
        self.count, self.first_ns = 0, 0

    def add(self, at_ns: int) -> None:
        self.first_ns = self.first_ns if self.count else at_ns
        self.count += 1

    def seen(self, start_ns: int) -> Seen:
        return Seen(self.count, _s(self.first_ns - start_ns) if self.count else None)


class _Runs:
    """How long something stayed the same: times of the repeats within short runs, and long runs from and to [ns]."""

    def __init__(self) -> None:
        self.repeats, self.freezes = array("q"), list[tuple[int, int]]()
        self._first_ns, self._run = 0, array("q")

    def feed(self, at_ns: int, *, is_repeat: bool) -> None:
        if is_repeat:
            self._run.append(at_ns)
        else:
            self.end()
            self._first_ns = at_ns

    def end(self) -> None:
        """Put the run that is open where it belongs."""
        if self._run and self._run[-1] - self._first_ns >= _FREEZE_NS:
            self.freezes.append((self._first_ns, self._run[-1]))
        else:
            self.repeats.extend(self._run)
        self._run = array("q")


class _Camera:
    """The pictures of one camera so far."""

    def __init__(self, name: str, key: str, apart_ns: int, *, is_video: bool, is_depth: bool) -> None:
        self.name, self._key, self._apart_ns, self._is_video = name, key, apart_ns, is_video
        self.is_depth, self._head = is_depth, depth.head if is_depth else jpeg.head
        self.views = ViewMeter()
        self.taken = array("q")
        self._last: bytes | None = None
        self._sizes: dict[tuple[int, int], None] = {}  # in order
        self._torn, self._resized, self._repeats = _Tally(), _Tally(), 0
        self._same_bytes, self._same_pixels = _Runs(), _Runs()
        self._due_ns = 0
        self._looks = 0
        self._unreadable, self._black, self._white, self._flat, self._jumps = (_Tally() for _ in range(5))
        self._before: Look | None = None
        self._brightness, self._sharpness = array("d"), array("d")
        self._first: list[Floats] = []
        self._shares = array("d")
        self._blind, self._blind_since_ns, self._longest_blind = _Tally(), 0, (0, 0)

    def feed(self, data: bytes, taken_ns: int) -> bool:
        """Add the next picture; return whether it is to be looked at."""
        self.taken.append(taken_ns)
        is_repeat = data == self._last  # the first bytes of the noise already differ: it costs nothing
        self._last = data
        self._repeats += is_repeat
        self._same_bytes.feed(taken_ns, is_repeat=is_repeat)
        known = self._head(data)
        if known is None:
            self._torn.add(taken_ns)
            return False
        size = known.width, known.height
        if self._sizes and size != next(iter(self._sizes)):
            self._resized.add(taken_ns)
        if len(self._sizes) < _MOST_SIZES:
            self._sizes[size] = None
        if taken_ns < self._due_ns:
            return False
        self._due_ns = taken_ns + self._apart_ns
        return True

    def add_look(self, taken_ns: int, look: Look | float | None) -> None:
        """Add what a picture shows, of depth how much, in the order of the pictures; None for what is not decoded."""
        self._looks += 1
        if look is None:
            self._before = None
            self._unreadable.add(taken_ns)
        elif isinstance(look, float):
            self._add_depth(taken_ns, look)
        else:
            self._add_colour(taken_ns, look)

    def _add_depth(self, taken_ns: int, share: float) -> None:
        self._shares.append(share)
        if share > 0.0:
            self._blind_since_ns = 0
            return
        self._blind.add(taken_ns)
        self._blind_since_ns = self._blind_since_ns or taken_ns
        lasted_ns = taken_ns - self._blind_since_ns
        if self._blind.count == 1 or lasted_ns > self._longest_blind[0]:
            self._longest_blind = lasted_ns, self._blind_since_ns

    def _add_colour(self, taken_ns: int, look: Look) -> None:
        before, self._before = self._before, look
        self._brightness.append(look.mean)
        self._sharpness.append(look.sharpness)
        shows_nothing = look.is_black or look.is_white or look.is_flat
        sharpness = None if shows_nothing else look.sharpness / look.std**2
        self.views.add(taken_ns, look.thumb, sharpness, is_cut=look.is_cut)
        if len(self._first) < _FIRST:
            self._first.append(look.thumb)
        for tally, is_so in ((self._black, look.is_black), (self._white, look.is_white), (self._flat, look.is_flat)):
            if is_so:
                tally.add(taken_ns)
        # A video may show a still scene without its noise; of its pictures the bytes tell which were the same.
        is_same = not self._is_video and before is not None and before.pixels == look.pixels
        self._same_pixels.feed(taken_ns, is_repeat=is_same)
        if before is not None and _is_jump(before, look):
            self._jumps.add(taken_ns)

    def result(self, start_ns: int, moves: Spans, decoder_name: str) -> PictureQuality:
        self._same_bytes.end()
        self._same_pixels.end()
        moving, repeats = _within(self.taken, moves), _within(self._same_bytes.repeats, moves)
        freezes = [*self._same_bytes.freezes, *self._same_pixels.freezes]
        longest = max(freezes, key=lambda span: span[1] - span[0], default=None)
        views = self.views.result(start_ns)
        frozen_ns, frozen_from_ns = max(((_overlap_ns(span, moves), span[0]) for span in freezes), default=(0, 0))
        return PictureQuality(
            name=self.name,
            key=self._key,
            pictures=len(self.taken),
            sizes=[f"{width}x{height}" for width, height in self._sizes],
            resized=self._resized.seen(start_ns),
            torn=self._torn.seen(start_ns),
            repeats=self._repeats,
            moving=len(moving),
            repeats_moving=Seen(len(repeats), _s(int(repeats[0]) - start_ns) if len(repeats) else None),
            still_s=_s(longest[1] - longest[0]) if longest else 0.0,
            still_at_s=_s(longest[0] - start_ns) if longest else None,
            frozen_s=_s(frozen_ns),
            frozen_at_s=_s(frozen_from_ns - start_ns) if frozen_ns else None,
            looked_at=self._looks,
            decoder="pillow" if self.is_depth else decoder_name,
            unreadable=self._unreadable.seen(start_ns),
            black=self._black.seen(start_ns),
            white=self._white.seen(start_ns),
            flat=self._flat.seen(start_ns),
            exposure_jumps=self._jumps.seen(start_ns),
            **views._asdict(),
            brightness=round(float(np.mean(self._brightness)), 1) if self._brightness else None,
            sharpness=round(float(np.median(self._sharpness)), 1) if self._sharpness else None,
            first_view=swapped_cameras.first_view(np.mean(self._first, axis=0)) if self._first else "",
            depth=self._depth(start_ns) if self.is_depth else None,
        )

    def _depth(self, start_ns: int) -> DepthQuality:
        lasted_ns, since_ns = self._longest_blind
        return DepthQuality(
            measured_share=round(float(np.mean(self._shares)), 4) if self._shares else None,
            blind=self._blind.seen(start_ns),
            blind_s=_s(lasted_ns),
            blind_at_s=_s(since_ns - start_ns) if self._blind.count else None,
        )


def _s(nanoseconds: int) -> float:
    return round(nanoseconds * 1e-9, 3)


def _within(times: array[int], spans: Spans) -> Ints:
    """Return which of some times lie in a span [ns]."""
    found = np.frombuffer(times, np.int64) if times else np.empty(0, np.int64)
    if not spans:
        return found[:0]
    begins, ends = np.array(spans, dtype=np.int64).T
    place = np.searchsorted(begins, found, side="right") - 1
    within: Ints = found[(place >= 0) & (found <= ends[place])]
    return within


def _overlap_ns(span: tuple[int, int], spans: Spans) -> int:
    """Return how much of a time lies in spans [ns]."""
    begins, ends = np.array(spans, dtype=np.int64).reshape(-1, 2).T
    return int(np.maximum(0, np.minimum(ends, span[1]) - np.maximum(begins, span[0])).sum())


def _is_jump(before: Look, look: Look) -> bool:
    """Whether two pictures show the same in another brightness."""
    return abs(look.mean - before.mean) > JUMP and likeness(before.thumb, look.thumb) > JUMP_LIKENESS


def look(decode: Callable[[bytes], Grey | None], data: bytes) -> Look | None:
    """Return what a picture shows; None for one that cannot be decoded."""
    grey = decode(data)
    if grey is None:
        return None
    if min(grey.shape) < TILES:
        grey = grey.repeat(TILES, axis=0).repeat(TILES, axis=1)
    counts = np.bincount(grey.ravel(), minlength=256)
    levels, total = np.arange(256), grey.size
    mean = float(counts @ levels) / total
    rows, columns = grey.shape[0] // TILES, grey.shape[1] // TILES
    cut = grey[: rows * TILES, : columns * TILES].reshape(TILES, rows, TILES, columns)
    thumb = cut.sum(axis=1, dtype=np.uint32).sum(axis=2) / (rows * columns)
    is_cut = bool(np.ptp(thumb[-_CUT_TILES:]) < FLAT_STD and grey[-_CUT_TILES * rows :].std() < FLAT_STD)
    return Look(
        mean=mean,
        std=float(np.sqrt(max(0.0, float(counts @ (levels * levels)) / total - mean * mean))),
        p99=float(np.searchsorted(np.cumsum(counts), 0.99 * total)),
        white_share=float(counts[WHITE:].sum()) / total,
        sharpness=_sharpness(grey),
        thumb=thumb,
        is_cut=is_cut,
        pixels=grey.tobytes(),
    )


def measured_share(data: bytes) -> float | None:
    """Return the share of a depth picture in which anything was measured, 0..1; None for one that cannot be decoded."""
    steps = depth.decoded(data)
    return None if steps is None else float(np.count_nonzero(steps)) / steps.size


def _sharpness(grey: Grey) -> float:
    """Return the variance of the Laplacian: little of what is blurred, or empty."""
    wide = grey.astype(np.int16)
    laplacian = wide[:-2, 1:-1] + wide[2:, 1:-1] + wide[1:-1, :-2] + wide[1:-1, 2:] - 4 * wide[1:-1, 1:-1]
    return float(laplacian.astype(np.float32).var())


def decoder() -> tuple[str, Callable[[bytes], Grey | None]]:
    """Return the library that decodes, by name, and what makes a small grey picture of a JPEG file, None of a bad one.

    simplejpeg, which tells of damage in the middle of a picture; Pillow, which fills it up, where that is not there.
    """
    try:
        library: Any = importlib.import_module("simplejpeg")
    except ImportError:
        return "pillow", _by_pillow
    return "simplejpeg", lambda data: _by_simplejpeg(library, data)


def _by_simplejpeg(library: Any, data: bytes) -> Grey | None:
    options: Mapping[str, Any] = {"min_width": _LEAST_WIDTH, "min_height": _LEAST_HEIGHT, "fastdct": True}
    if not _is_sane(data):
        return None
    for is_strict in (True, False):
        try:
            found: Grey = library.decode_jpeg(data, "GRAY", strict=is_strict, **options)[:, :, 0]
        except ValueError as error:
            if "extraneous bytes" not in str(error):  # some cameras pad between segments: nothing is missing then
                return None
        else:
            return found
    return None


def _by_pillow(data: bytes) -> Grey | None:
    from PIL import Image

    if not _is_sane(data):
        return None
    try:
        with Image.open(io.BytesIO(data), formats=("JPEG",)) as picture:
            picture.draft("L", (_LEAST_WIDTH, _LEAST_HEIGHT))
            return np.asarray(picture.convert("L"))
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError):  # what Pillow says of broken bytes
        return None


def _is_sane(data: bytes) -> bool:
    known = jpeg.head(data)
    return known is not None and known.width * known.height <= _MOST_PIXELS
