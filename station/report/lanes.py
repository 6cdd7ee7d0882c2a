"""The time line of an episode: what played, what the gate did, what became of the bus, and what happened, one below
another."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from station.episode.quality.findings import Quality
from station.episode.storage.manifest import Manifest
from station.report.html import Html, tag
from station.report.story import Happened, Story, lasting
from station.view.phases import Span

_STATES = frozenset(
    ("tracking", "playing", "entering", "waiting", "done", "holding", "returning", "leaving", "stopped", "faulted",
     "paused")
)  # fmt: skip
_LABEL_PERCENT = 1.1  # of the width that a letter of a label takes, at the least width of a page
_SEVERITIES = frozenset(("warning", "error"))
_TICKS = (1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 900, 1800, 3600, 7200)
_MOST_TICKS = 9


def time_line(story: Story, quality: Quality, manifest: Manifest) -> Html:
    """Return the lanes of an episode, all on one scale."""
    scale = _Scale(min(story.first_s, 0.0), max(story.last_s, story.first_s + 0.1))
    marks = [Happened(mark.at_s, f"mark: {mark.label}", "mark", "", "") for mark in manifest.marks]
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


def _dot(scale: _Scale, event: Happened) -> Html:
    title = f"{event.at_s:.2f} s  {event.source} {event.name} {event.text}".strip()
    known = event.severity if event.severity in _SEVERITIES or event.severity == "mark" else None
    return tag("b", class_=known, style=f"left:{scale.at(event.at_s):.3f}%", title=title)
