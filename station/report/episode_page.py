"""The part of a report that is about one episode."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from station.episode.quality import timing
from station.episode.quality.findings import Quality
from station.episode.storage.manifest import Manifest
from station.report import episode_tables
from station.report.gather import Episode
from station.report.html import Html, details, join, picture, table, tag
from station.report.story import EventRow, Story, lasting
from station.view.camera_strip import Thumbnail
from station.view.phases import Span

_MOST_REASONS = 12

_STATES = frozenset(
    ("tracking", "playing", "entering", "waiting", "done", "holding", "returning", "leaving", "stopped", "faulted",
     "paused")
)  # fmt: skip
_LABEL_PERCENT = 1.1  # of the width that a letter of a label takes, at the least width of a page
_SEVERITIES = frozenset(("warning", "error"))
_TICKS = (1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 900, 1800, 3600, 7200)
_MOST_TICKS = 9


def anchor(episode: Episode) -> str:
    """Return what links to an episode's section point at."""
    return f"ep-{episode.name}"


def badge(verdict: str) -> Html:
    """Return a verdict as a word on its colour."""
    return tag("span", verdict, class_=f"badge {verdict}" if verdict in ("good", "usable", "reject") else "badge")


def section(
    episode: Episode,
    story: Story | None,
    plot: bytes | None,
    strips: Mapping[str, Sequence[Thumbnail | None]],
    *,
    problem: str = "",
) -> Html:
    """Return the section of an episode.

    Args:
        episode: The episode.
        story: What happened in it; None for a short section, without time line and pictures.
        plot: PNG of how it was tracked.
        strips: Small pictures by camera.
        problem: Why there is no time line, in a line.
    """
    quality = episode.quality
    body = [
        _header(episode),
        tag("p", episode.manifest.task.instruction, class_="soft") if episode.manifest.task.instruction else None,
        _reasons(quality),
        *(tag("p", f"Not judged: {line}.", class_="soft") for line in timing.told(quality.not_judged)),
        _facts(episode),
        tag("p", problem, class_="bad") if problem else None,
    ]
    if story is not None:
        body += [tag("h3", "What happened when"), time_line(story, quality, episode.manifest)]
    if plot is not None:
        body += [
            tag("h3", "How it was followed"),
            picture(plot, "png", "commanded and measured", class_="plot"),
        ]
    body += [_strip(name, pictures) for name, pictures in strips.items() if any(pictures)]
    body += _tables(quality), _events(story), _provenance(episode)
    return tag("section", body, class_=f"card episode {quality.verdict}", id=anchor(episode))


def _tables(quality: Quality) -> Html:
    halves = tag("div", episode_tables.latency(quality)), tag("div", episode_tables.motion(quality))
    streams = details(f"Streams ({len(quality.streams)})", episode_tables.streams(quality.streams))
    return join(
        [tag("div", halves, class_="two"), episode_tables.arms(quality), episode_tables.cameras(quality), streams]
    )


def _provenance(episode: Episode) -> Html:
    return details("Where it comes from: operator, commands, software, hashes", episode_tables.provenance(episode))


def _header(episode: Episode) -> Html:
    verdict = badge(episode.quality.verdict)
    top = tag("a", "↑ all episodes", href="#top", class_="top")
    discarded = badge("discarded") if episode.quality.discarded else None
    task = tag("span", episode.manifest.task.name, class_="soft")
    return tag("header", tag("h2", episode.name), verdict, discarded, task, top)


def _reasons(quality: Quality) -> Html | None:
    if not quality.reasons:
        return None
    items = [
        tag("li", tag("b", reason.rule), " ", reason.text, class_=reason.verdict)
        for reason in quality.reasons[:_MOST_REASONS]
    ]
    more = len(quality.reasons) - _MOST_REASONS
    return tag("ul", items, tag("li", f"and {more} more", class_="soft") if more > 0 else None, class_="reasons")


def _facts(episode: Episode) -> Html:
    manifest, quality = episode.manifest, episode.quality
    success = {None: "not said", True: "yes", False: "no"}[quality.success]
    started = episode.started
    facts = {
        "started": "" if started is None else f"{started:%Y-%m-%d %H:%M:%S}",
        "length": f"{quality.length_s:.1f} s, {quality.messages} messages",
        "operator": f"{manifest.operator.id or '–'} by {manifest.operator.interface or '–'}",
        "task succeeded": success,
        "robot": manifest.robot.suffix,
        "policy": manifest.policy.name,
        "lost · dropped": f"{sum(stream.lost for stream in quality.streams)} · {quality.dropped} writes",
        "falls · resets · stops": f"{quality.falls} · {quality.resets} · {quality.estops}",
    }
    if quality.discarded:
        facts["discarded because"] = episode.discarded_for or "nobody said why"
    cells = [tag("div", tag("span", name), value) for name, value in facts.items() if value]
    return tag("div", cells, class_="facts")


def _strip(name: str, pictures: Sequence[Thumbnail | None]) -> Html:
    figures = [
        tag(
            "figure",
            picture(one.jpeg, "jpeg", f"{name} at {one.at_s:.1f} s")
            if one.jpeg is not None
            else tag("p", "no picture", class_="bad"),
            tag("figcaption", f"{one.at_s:.1f} s"),
        )
        for one in dict.fromkeys(pictures)
        if one is not None
    ]
    return join([tag("h3", f"Camera {name}"), tag("div", figures, class_="strip")])


def _events(story: Story | None) -> Html | None:
    if story is None or not story.events:
        return None
    rows = [
        (f"{event.at_s:.2f} s", tag("b", event.name) if event.severity == "error" else event.name, event.severity,
         event.source, event.text)
        for event in story.events
    ]  # fmt: skip
    left_out = story.events_in_all - len(story.events)
    more = tag("p", f"and {left_out} more, which `station view` shows", class_="soft") if left_out else None
    return details(f"Events ({story.events_in_all})", table(("at", "event", "severity", "by", "what"), rows), more)


def time_line(story: Story, quality: Quality, manifest: Manifest) -> Html:
    """Return the lanes of an episode, all on one scale."""
    scale = _Scale(min(story.first_s, 0.0), max(story.last_s, story.first_s + 0.1))
    marks = [EventRow(mark.at_s, f"mark: {mark.label}", "mark", "", "") for mark in manifest.marks]
    bus = [
        Span(item.at_s, item.at_s + (item.seconds or 0.0), f"{item.kind} {item.reason}")
        for item in quality.interruptions
    ]
    ended = [Span(item.at_s, item.at_s + item.seconds, f"commands ended: {item.reason}") for item in quality.pauses]
    lanes = [
        _lane("motion", _clips(scale, lasting(story.phases))),
        _lane("gate", [_span(scale, span, span.name if span.name in _STATES else "") for span in lasting(story.gate)]),
        _lane("pauses", [_span(scale, span, "pause") for span in ended]),
        _lane("bus", [_span(scale, span, "bus") for span in bus]),
        _lane("events", [_dot(scale, event) for event in (*story.events, *marks)], class_="track thin"),
    ]
    return tag("div", [lane for lane in lanes if lane], scale.axis(), class_="lanes")


class _Scale:
    """Places instants [s] on a lane, in percent."""

    def __init__(self, first_s: float, last_s: float) -> None:
        self.first_s, self.span_s = first_s, last_s - first_s

    def at(self, at_s: float) -> float:
        return min(100.0, max(0.0, 100.0 * (at_s - self.first_s) / self.span_s))

    def axis(self) -> Html:
        step = next((step for step in _TICKS if self.span_s / step <= _MOST_TICKS), self.span_s / _MOST_TICKS)
        first = int(-(-self.first_s // step))
        places = [number * step for number in range(first, int((self.first_s + self.span_s) // step) + 1)]
        labels = [
            tag(
                "span",
                f"{place:g} s",
                style=f"position:absolute;left:{self.at(place):.2f}%;transform:translateX(-50%);white-space:nowrap",
            )
            for place in places
        ]
        return tag("div", tag("span", ""), tag("div", labels, style="position:relative;height:16px"), class_="lane")


def _lane(name: str, items: Sequence[Html], class_: str = "track") -> Html | None:
    return tag("div", tag("span", name), tag("div", items, class_=class_), class_="lane") if items else None


def _clips(scale: _Scale, spans: Iterable[Span]) -> list[Html]:
    """Return the bars of what played; neighbours differ."""
    return [
        _span(scale, span, span.name if span.name in _STATES - {"playing"} else "clip odd" if number % 2 else "clip")
        for number, span in enumerate(spans)
    ]


def _span(scale: _Scale, span: Span, class_: str) -> Html:
    left, right = scale.at(span.start_s), scale.at(span.end_s)
    fits = len(span.name) * _LABEL_PERCENT < right - left
    title = f"{span.name}: {span.start_s:.2f} s to {span.end_s:.2f} s"
    style = f"left:{left:.3f}%;width:{max(right - left, 0.1):.3f}%"
    return tag("i", span.name if fits else "", class_=class_ or None, style=style, title=title)


def _dot(scale: _Scale, event: EventRow) -> Html:
    title = f"{event.at_s:.2f} s  {event.source} {event.name} {event.text}".strip()
    known = event.severity if event.severity in _SEVERITIES or event.severity == "mark" else None
    return tag("b", class_=known, style=f"left:{scale.at(event.at_s):.3f}%", title=title)
