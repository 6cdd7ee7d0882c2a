"""A contact sheet: a run on a page, a picture per moment with its time and what was being played.

With cameras a column is a moment: the robot, and below it what each camera saw.
"""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from station import rotations
from station.episode.reading import frames
from station.episode.reading.reader import EpisodeReader
from station.episode.storage.whole_file import named_file
from station.errors import StationError
from station.protocols import FALL_TILT_RAD, Floats
from station.view import camera_strip, offscreen
from station.view import plot_style as style
from station.view.camera_strip import Thumbnail
from station.view.find_model import find_path
from station.view.offscreen import Pictures
from station.view.phases import Span
from station.view.run import Run, read_run

if TYPE_CHECKING:
    from PIL.Image import Image
    from PIL.ImageDraw import ImageDraw
    from PIL.ImageFont import FreeTypeFont


COLUMNS, ROWS = 5, 3
_MARGIN, _GAP, _HEAD, _CAPTION = 32, 16, 88, 40  # px
_CELL = (style.WIDTH_PX - 2 * _MARGIN - (COLUMNS - 1) * _GAP) // COLUMNS
_PICTURE = 340  # height of a picture [px]
_CORNER = 8

_LYING_S = 0.8  # after a fall begins: by then one sees it
_SHORTEST_S = 0.25  # a part that is shorter gets no picture of its own
_BLENDS = frozenset(("waiting", "entering", "paused", "leaving", "done"))


def save_sheet(
    reader: EpisodeReader, path: Path, *, robot: str = "", robot_model: str | Path | None = None, gl: str | None = None
) -> list[str]:
    """Draw an episode as a contact sheet, write it as PNG, and return what is to be said of it.

    Args:
        reader: The episode.
        path: The file; replaced as a whole, or not at all.
        robot: Suffix of the robot, see `station.view.phases.robot_of`.
        robot_model: MJCF of the robot, path or ``collection:path``; None for the one that the episode names.
        gl: How MuJoCo draws, see `station.view.offscreen.render`.

    Raises:
        CannotRender: this machine has no way to draw.
        StationError: the episode holds no pose of a robot, no model of it is here, or the file cannot be written.
    """
    run = read_run(reader, robot)
    shown = moments(run, COLUMNS * (1 if frames.all_pictures(reader) else ROWS))
    if run.measured is None or not shown:
        raise StationError(f"{run.episode_id}: no contact sheet, it holds no pose of a robot")
    model, warnings = find_path(reader.manifest.servers.values(), run.robot, robot_model)
    if model is None:
        raise StationError(f"{run.episode_id}: no contact sheet, {warnings[-1]}")
    rows = [moment.row for moment in shown]
    pictures = offscreen.render(
        model, run.measured.root[rows], run.measured.joints, run.measured.q[rows], width=_CELL, height=_PICTURE, gl=gl
    )
    strips = camera_strip.strips(reader, [moment.at_s for moment in shown], _CELL)
    with named_file(path) as file:
        _page(run, shown, pictures, strips).save(file, format="PNG", optimize=True)
    return warnings


class _Fonts(NamedTuple):
    """The page's fonts: those that come with matplotlib, so that every machine draws the same page."""

    title: FreeTypeFont
    line: FreeTypeFont
    name: FreeTypeFont
    time: FreeTypeFont

    @classmethod
    def load(cls) -> _Fonts:
        import matplotlib as mpl
        from PIL import ImageFont

        folder = Path(mpl.get_data_path()) / "fonts" / "ttf"
        named = (
            ("DejaVuSans-Bold.ttf", 22),
            ("DejaVuSans.ttf", 15),
            ("DejaVuSans-Bold.ttf", 15),
            ("DejaVuSans.ttf", 14),
        )
        return cls(*(ImageFont.truetype(str(folder / name), size) for name, size in named))


def _page(
    run: Run, shown: Sequence[Moment], pictures: Pictures, strips: Mapping[str, Sequence[Thumbnail | None]]
) -> Image:
    from PIL import Image, ImageDraw

    fonts = _Fonts.load()
    rows, row = -(-len(shown) // COLUMNS), _CAPTION + _GAP
    heights = {camera: _height(strip) for camera, strip in strips.items()}
    height = _HEAD + rows * (_PICTURE + row) + sum(heights.values()) + len(heights) * row - _GAP + _MARGIN // 2
    page = Image.new("RGB", (style.WIDTH_PX, height), style.PAPER)
    pen = ImageDraw.Draw(page)
    pen.text((_MARGIN, 26), run.episode_id, style.INK, fonts.title)
    pen.text((_MARGIN, 56), style.headline(run), style.SOFT, fonts.line)
    corners = _rounded((_CELL, _PICTURE))
    for number, (moment, picture) in enumerate(zip(shown, pictures, strict=True)):
        left = _MARGIN + number % COLUMNS * (_CELL + _GAP)
        top = _HEAD + number // COLUMNS * (_PICTURE + _CAPTION + _GAP)
        page.paste(Image.fromarray(picture), (left, top), corners)
        said, colour = (
            (f"fallen   {moment.at_s:.1f} s", style.FELL) if moment.has_fallen else (f"{moment.at_s:.1f} s", style.SOFT)
        )
        _caption(pen, (left, top + _PICTURE), moment.name, said, colour, fonts)
        if moment.has_fallen:
            box = (left, top, left + _CELL - 1, top + _PICTURE - 1)
            pen.rounded_rectangle(box, _CORNER, outline=style.FELL, width=4)
    top = _HEAD + rows * (_PICTURE + row)
    for camera, strip in strips.items():
        for number, seen in enumerate(strip):
            if seen is not None:
                left = _MARGIN + number * (_CELL + _GAP)
                if (picture := _opened(seen)) is not None:
                    page.paste(picture, (left + (_CELL - picture.width) // 2, top), _rounded(picture.size))
                said, colour = (f"{seen.at_s:.1f} s", style.SOFT) if picture else ("no picture", style.FELL)
                _caption(pen, (left, top + heights[camera]), camera, said, colour, fonts)
        top += heights[camera] + row
    return page


def _opened(seen: Thumbnail) -> Image | None:
    from PIL import Image

    return Image.open(io.BytesIO(seen.jpeg)) if seen.jpeg is not None else None


def _height(strip: Sequence[Thumbnail | None]) -> int:
    """Return the height of a camera's row [px]: that of its highest picture."""
    opened = [_opened(seen) for seen in strip if seen is not None]
    return max((picture.height for picture in opened if picture is not None), default=0)


def _caption(pen: ImageDraw, below: tuple[int, int], name: str, said: str, colour: str, fonts: _Fonts) -> None:
    """Write below a picture, of which this is the lower left corner, a name and on the right what is said of it."""
    left, base = below[0] + 2, below[1] + 26
    pen.text((left + _CELL - 4, base), said, colour, fonts.time, anchor="rs")
    room = _CELL - 16 - fonts.time.getlength(said)
    pen.text((left, base), _fitted(name, fonts.name, room), style.INK, fonts.name, anchor="ls")


def _fitted(text: str, font: FreeTypeFont, room: float) -> str:
    """Return a text, cut where it is longer than `room` [px]."""
    if font.getlength(text) <= room:
        return text
    while text and font.getlength(f"{text}…") > room:
        text = text[:-1]
    return f"{text}…"


def _rounded(size: tuple[int, int]) -> Image:
    """Return a mask with round corners, drawn large and shrunk so that they are smooth."""
    from PIL import Image, ImageDraw

    mask = Image.new("L", (size[0] * 4, size[1] * 4), 0)
    ImageDraw.Draw(mask).rounded_rectangle((0, 0, mask.width - 1, mask.height - 1), _CORNER * 4, fill=255)
    return mask.resize(size, Image.Resampling.LANCZOS)


class Moment(NamedTuple):
    """A row of `Run.measured`, its time [s], what was played, and whether the robot had fallen."""

    row: int
    at_s: float
    name: str
    has_fallen: bool


def moments(run: Run, count: int) -> list[Moment]:
    """Return up to `count` moments in order; none where no whole pose was recorded."""
    if run.measured is None:
        return []
    whole = np.flatnonzero(np.isfinite(run.measured.root).all(axis=1) & np.isfinite(run.measured.q).all(axis=1))
    if not len(whole):
        return []
    times_s = run.times_s[whole]
    wanted_s = instants(_parts(run, times_s), count)
    for fall_s in run.falls_s:  # in place of the nearest
        wanted_s[int(np.argmin(np.abs(wanted_s - fall_s - _LYING_S)))] = fall_s + _LYING_S
    places = np.unique(np.clip(np.searchsorted(times_s, wanted_s), 0, len(whole) - 1))
    tilt_rad = rotations.tilt(rotations.normalized(run.measured.root[whole[places], 3:]))
    return [
        Moment(int(whole[place]), float(times_s[place]), _name(run, float(times_s[place])), bool(tilt > FALL_TILT_RAD))
        for place, tilt in zip(places, tilt_rad, strict=True)
    ]


def instants(parts: Sequence[Span], count: int) -> Floats:
    """Return `count` instants: at least one in each part where they suffice, and more in longer ones.

    One stands in the middle of its part, where a squat is deepest; two at its thirds, and so on.
    With more parts than instants they are spread evenly over all, whatever plays.
    """
    lengths_s = np.array([part.end_s - part.start_s for part in parts])
    if len(parts) > count:
        start_s, end_s = parts[0].start_s, parts[-1].end_s
        return np.asarray(start_s + (end_s - start_s) * (np.arange(count) + 0.5) / count)
    shares = np.ones(len(parts), dtype=int)
    while shares.sum() < count:  # the next picture goes where a picture stands for most time
        shares[int(np.argmax(lengths_s / shares))] += 1
    return np.concatenate(
        [part.start_s + (part.end_s - part.start_s) * (np.arange(share) + 1) / (share + 1)
         for part, share in zip(parts, shares, strict=True)]
    )  # fmt: skip


def _parts(run: Run, times_s: Floats) -> list[Span]:
    """Return what was played while the robot's pose was recorded; the whole recording where nothing says."""
    first_s, last_s = float(times_s[0]), float(times_s[-1])
    parts = [
        Span(max(span.start_s, first_s), min(span.end_s, last_s), span.name)
        for span in run.phases
        if span.name not in _BLENDS
    ]
    return [part for part in parts if part.end_s - part.start_s >= _SHORTEST_S] or [Span(first_s, last_s, "")]


def _name(run: Run, at_s: float) -> str:
    return next((span.name for span in run.phases if span.start_s <= at_s <= span.end_s), "")
