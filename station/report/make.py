"""Putting a report together, episode by episode, into one file."""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence
from datetime import datetime
from pathlib import Path
from typing import TextIO

from station.contract import Contract
from station.episode.reading.reader import EpisodeReader
from station.episode.storage.folder import signals_file
from station.episode.storage.whole_file import named_file
from station.errors import EpisodeError
from station.report import data_page, episode_page, story, tracking_plot
from station.report.gather import Episode, UnreadableEpisode
from station.report.html import Html, join, tag
from station.software import software
from station.view import camera_strip

STYLE = Path(__file__).with_name("style.css")
PICTURED = 40
"""Episodes drawn though they were not named: the rejected first, then the usable, then the newest."""

# A page that shows what strangers wrote runs no script and fetches nothing, whatever slipped through.
_POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"
_PICTURES, _PICTURE_PX = 7, 220  # of each camera
_URGENCY = {"reject": 0, "usable": 1, "good": 2}


def write(
    path: Path,
    episodes: Sequence[Episode],
    unread: Sequence[UnreadableEpisode],
    *,
    title: str,
    pictured: int = PICTURED,
    tell: Callable[[], None] = lambda: None,
) -> int:
    """Write a report, replacing the file as a whole or not at all; return how many episodes have pictures.

    Args:
        path: The file.
        episodes: What to report on, oldest first.
        unread: What could not be read.
        title: Title of the page.
        pictured: How many episodes are drawn that were not named; those that were named always are.
        tell: Called after each episode.

    Raises:
        StationError: the file cannot be written.
    """
    drawn = _chosen(episodes, pictured)
    with named_file(path) as file:
        text = io.TextIOWrapper(file, encoding="utf-8")
        _write(text, episodes, unread, title, drawn, tell)
        text.detach()  # its text is in the file, which stays open until it is on the disk
    return len(drawn)


def _chosen(episodes: Sequence[Episode], most: int) -> set[int]:
    """Return the places of the episodes that are drawn."""
    named = {place for place, episode in enumerate(episodes) if episode.is_named}
    others = [place for place in range(len(episodes)) if place not in named]
    others.sort(key=lambda place: (_URGENCY[episodes[place].quality.verdict], -place))
    return named | set(others[:most])


def _write(
    file: TextIO, episodes: Sequence[Episode], unread: Sequence[UnreadableEpisode], title: str, drawn: set[int],
    tell: Callable[[], None],
) -> None:  # fmt: skip
    file.write('<!DOCTYPE html>\n<html lang="en">\n' + _head(title) + "\n<body><main>\n")
    file.write(data_page.summary(episodes, unread, title=title, pictured=len(drawn)))
    recorded: dict[str, Contract] = {}
    for place, episode in enumerate(episodes):
        file.write(
            "\n" + (_drawn(episode, recorded) if place in drawn else episode_page.section(episode, None, None, {}))
        )
        tell()
    keys = sorted({stream.key for episode in episodes for stream in episode.quality.streams})
    file.write("\n" + (data_page.columns(keys, recorded) or ""))
    file.write("\n" + _foot() + "\n</main></body></html>\n")


def _drawn(episode: Episode, recorded: dict[str, Contract]) -> Html:
    """Return the section of an episode with all that can be drawn of it."""
    try:
        reader = EpisodeReader(signals_file(episode.folder))
        told = story.read(reader)
        recorded.update(told.contracts)
        plot = tracking_plot.draw(told, episode.quality.joint_errors_rad(told.robot))
        strips = camera_strip.strips(reader, camera_strip.evenly(reader, _PICTURES), _PICTURE_PX)
        return episode_page.section(episode, told, plot, strips)
    except EpisodeError as error:
        return episode_page.section(episode, None, None, {}, problem=f"nothing is drawn: {error}")


def _head(title: str) -> Html:
    return tag(
        "head",
        tag("meta", charset="utf-8"),
        tag("meta", http_equiv="Content-Security-Policy", content=_POLICY),
        tag("meta", name="viewport", content="width=device-width, initial-scale=1"),
        tag("title", title),
        Html(f"<style>{STYLE.read_text(encoding='utf-8')}</style>"),
    )


def _foot() -> Html:
    code = software()
    made = f"Made {datetime.now().astimezone():%Y-%m-%d %H:%M} by Teleop Station {code.version} {code.revision[:12]}."
    text = "Every number comes from the recorded files; `station check` says how each is measured."
    return tag("footer", join([made, " ", text]))
