"""Lanes of a plot: which clip played, and what the gate did, as labelled bars over time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from station.view import plot_style as style
from station.view.layout import GATE_COLOURS
from station.view.phases import TRACKING, Span
from station.view.run import Run

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_CLIPS = ("#cfe1f2", "#e3edf7")  # neighbours differ
_PALE = "#eceff2"
_BLENDS = frozenset(("waiting", "entering", "paused", "leaving", "done"))
_LETTER_PX, _PAD_PX = 5.4, 8.0  # of the labels' font
_BAR = 0.78  # of the height of a lane


def draw_lanes(axes: Axes, run: Run, *, width_px: float) -> None:
    """Draw what played above what the gate did; a label stands where its bar is wide enough for it.

    Args:
        axes: Where to; its x-axis is time [s] and has its limits.
        run: The run.
        width_px: Width of the axes [px].
    """
    lanes = [("motion", run.phases, _clip_colours(run.phases)), ("gate", run.gate, [_gate(s.name) for s in run.gate])]
    shown = [lane for lane in lanes if lane[1]]
    start_s, end_s = axes.get_xlim()
    px_per_s = width_px / max(end_s - start_s, 1e-9)
    for row, (_, spans, colours) in enumerate(shown):
        for span, colour in zip(spans, colours, strict=True):
            length_s = span.end_s - span.start_s
            axes.barh(row, length_s, _BAR, left=span.start_s, color=colour, edgecolor=style.PAPER, linewidth=1.0)
            if len(span.name) * _LETTER_PX + _PAD_PX <= length_s * px_per_s:
                axes.text(span.start_s + length_s / 2, row, span.name, ha="center", va="center", fontsize=7.5)
    axes.set_yticks(range(len(shown)), [name for name, _, _ in shown])
    axes.set_ylim(max(len(shown), 1) - 0.5, -0.5)
    axes.tick_params(axis="x", bottom=False, labelbottom=False)
    axes.tick_params(axis="y", labelsize=8.5, labelcolor=style.INK)
    axes.grid(visible=False)
    for side in ("left", "bottom"):
        axes.spines[side].set_visible(False)
    for at_s in run.falls_s:
        axes.axvline(at_s, color=style.FELL, linewidth=1.6)
        axes.annotate("fell", (at_s, -0.5), (3, 2), textcoords="offset points", color=style.FELL, fontsize=8.5)


def _clip_colours(spans: Sequence[Span]) -> list[str]:
    return [_PALE if span.name in _BLENDS else _CLIPS[number % 2] for number, span in enumerate(spans)]


def _gate(state: str) -> str:
    """Return a colour of the gate as in Rerun, pale enough to write on; following is what needs no attention."""
    if state == TRACKING:
        return "#d5ecd8"
    rgba = GATE_COLOURS.get(state, 0x9E9E9EFF)
    parts = [(rgba >> shift) & 0xFF for shift in (24, 16, 8)]
    return "#" + "".join(f"{round(part + 0.55 * (255 - part)):02x}" for part in parts)
