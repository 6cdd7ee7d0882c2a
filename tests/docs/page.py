"""Commands that stand in a page of the docs, what the page shows of their output, and whether that is still so."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from PIL.Image import Image, Resampling
from PIL.Image import open as open_picture

_PROGRAMS = ("station", "make", "pip", "python", "git", "bash")
_COMMENT = re.compile(r"\s{2,}#.*$|\s+# .*$")
_GAP = "…"
_PICTURE = re.compile(r"!\[[^\]]+\]\((pictures/[\w-]+\.jpg)\)")
_WIDTH = 1000  # of a page's picture [px]
_MOST_UNLIKE = 8.0  # of 255, on average over a small version; another robot, or a row more, is beyond
_VARIES = re.compile(
    r"(?P<hash>\b(?=[0-9a-f]*[0-9])[0-9a-f]{8,64}\b)"
    r"|(?P<number>[-+]?\d+(?:[ \u202f.,:]\d+)*(?:e[-+]?\d+)?)"
    r"|(?P<size>\b[kMG]?B\b)"
    r"|(?P<bar>[━╸╺]+)"
    r"|(?P<space>\s+)"
)
_AS = {
    "hash": r"[0-9a-f]{8,64}",
    "number": r"[-+]?\d+(?:[ \u202f.,:]\d+)*(?:e[-+]?\d+)?",
    "size": r"[kMG]?B",
    "bar": r"[━╸╺]+",
    "space": r"\s+",
}


class Stale(AssertionError):
    """A page shows what no command prints any more."""


class Shown(NamedTuple):
    """A command of a page.

    Attributes:
        command: For a shell, without its comment.
        told: Lines of its output as the page shows them; ``…`` in place of lines, or of words, that it leaves out.
        at: Where they begin, a line of the page.
    """

    command: str
    told: list[str]
    at: int


def shown(page: Path) -> list[Shown]:
    """Return the commands of a page in their order: lines behind ``$``, and blocks that hold nothing else."""
    return [command for block in _blocks(page) for command in _commands(*block)]


def _blocks(page: Path) -> Iterator[tuple[int, list[str]]]:
    """Yield blocks for a terminal: the number of their first line, and their lines."""
    begin, lines = 0, page.read_text(encoding="utf-8").splitlines()
    is_inside = False
    for number, line in enumerate(lines):
        if not line.startswith("```"):
            continue
        if is_inside and lines[begin] in ("```", "```console", "```bash"):
            yield begin + 1, lines[begin + 1 : number]
        begin, is_inside = number, not is_inside


def _commands(first: int, lines: list[str]) -> Iterator[Shown]:
    has_prompt = any(line.startswith("$ ") for line in lines)
    at = 0
    while at < len(lines):
        is_command = lines[at].startswith("$ ") if has_prompt else lines[at].split(" ")[0] in _PROGRAMS
        if not is_command:
            at += 1
            continue
        text = _COMMENT.sub("", lines[at].removeprefix("$ "))
        while _goes_on(text):
            at += 1
            text = f"{text}\n{_COMMENT.sub('', lines[at])}"
        at += 1
        begin = at
        while has_prompt and at < len(lines) and not lines[at].startswith("$ "):
            at += 1
        yield Shown(text.replace("\\\n", ""), lines[begin:at] if has_prompt else [], first + begin)


def _goes_on(text: str) -> bool:
    """Whether a shell would wait for another line."""
    try:
        shlex.split(text)
    except ValueError:
        return True
    return text.endswith("\\")


def pictures_of(page: Path) -> list[Path]:
    """Return the pictures of a page; each is drawn by a command that names it, as PNG."""
    return [page.parent / name for name in _PICTURE.findall(page.read_text(encoding="utf-8"))]


def page_picture(made: Image) -> Image:
    """Return a picture as a page has it."""
    width, height = made.size
    return made.convert("RGB").resize((_WIDTH, round(height * _WIDTH / width)), Resampling.LANCZOS)


def unlike(made: Image, picture: Path) -> str:
    """Say how a picture that was made differs from that of a page, "" where it shows the same, moments aside."""
    if not picture.is_file():
        return "not there; `make prove` writes it"
    fresh, shown = page_picture(made), open_picture(picture)
    if fresh.size != shown.size:
        return f"{fresh.size} pixels, the page has {shown.size}"
    small = (_WIDTH // 20, fresh.height // 20)
    difference = float(np.abs(np.subtract(fresh.resize(small), shown.resize(small), dtype=np.float64)).mean())
    return "" if difference < _MOST_UNLIKE else f"shows something else: {difference:.1f} of 255 on average"


def compared(told: Sequence[str], said: Sequence[str], drawn: Sequence[str] = ()) -> list[str]:
    """Compare what a page shows with what a command said; return the page's lines with the values of this run.

    Numbers, hashes, units of bytes and widths of columns may differ, but a 0 is a 0. A line ``…`` stands for any lines,
    ``…`` within a line for any words. Empty lines do not count.

    Args:
        told: Lines of the page.
        said: Lines that stay on the screen.
        drawn: Lines that were drawn over; the page may show some of them between two ``…``.

    Raises:
        Stale: a line was not said, or not at its place; or something was said that the page does not show.
    """
    lines = [line.rstrip() for line in said if line.strip()]
    segments: list[list[str]] = [[]]
    for line in told:
        if line.strip() == _GAP:
            segments.append([])
        elif line.strip():
            segments[-1].append(line)
    fresh, at = [], 0
    for number, segment in enumerate(segments):
        is_first, is_last = number == 0, number == len(segments) - 1
        places = range(at, max(at, len(lines) - len(segment)) + 1)
        if is_last and segment:
            places = places[-1:] if not is_first or len(lines) == len(segment) else range(0)
        elif is_first and segment:
            places = places[:1]
        if (found := _first(segment, lines, places)) is not None:
            at, seen = found + len(segment), lines[found : found + len(segment)]
        elif (found := _first(segment, drawn, range(len(drawn)))) is not None and not is_first and not is_last:
            seen = drawn[found : found + len(segment)]
        else:
            raise Stale(_why(segment, lines, drawn))
        fresh += [_fresh(*pair) for pair in zip(segment, seen, strict=True)]
    values = iter(fresh)
    return [line if not line.strip() or line.strip() == _GAP else next(values) for line in told]


def _pattern(line: str) -> re.Pattern[str]:
    def like(part: str) -> str:
        made, at = "", 0
        for found in _VARIES.finditer(part):
            varies = found[0] if found[0] == "0" else _AS[str(found.lastgroup)]
            made += re.escape(part[at : found.start()]) + varies
            at = found.end()
        return f"({made}{re.escape(part[at:])})"

    return re.compile(".*?".join(map(like, line.rstrip().split(_GAP))))


def _first(segment: Sequence[str], lines: Sequence[str], places: Iterable[int]) -> int | None:
    """Return the first of some places at which all lines of a segment stand."""
    patterns = [_pattern(line) for line in segment]
    for place in places:
        seen = lines[place : place + len(segment)]
        if len(seen) == len(segment) and all(map(re.Pattern.fullmatch, patterns, seen)):
            return place
    return None


def _fresh(told: str, said: str) -> str:
    found = _pattern(told).fullmatch(said)
    assert found is not None
    return _GAP.join(found.groups())


def _why(segment: Sequence[str], said: Sequence[str], drawn: Sequence[str]) -> str:
    missing = [line for line in segment if not any(map(_pattern(line).fullmatch, [*said, *drawn]))]
    what = "not in this order, or amid other lines" if not missing else "no such line"
    return "\n".join([f"{what}:", *(missing or segment), "it said:", *said])
