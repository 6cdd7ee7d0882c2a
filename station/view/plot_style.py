"""How plots look: colours, sizes, and panels without clutter. Imports nothing heavy."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from station.protocols import Floats
from station.view.phases import TRACKING
from station.view.run import Run

if TYPE_CHECKING:
    from matplotlib.axes import Axes

WIDTH_PX, DPI = 1600, 100
_NAME_PX, _FIGURE_PX = 6.8, 6.0  # of a character in a title, on average

INK, SOFT, FAINT, PAPER = "#1f2933", "#6b7785", "#e4e8ed", "#ffffff"
ASKED, MEASURED, SECOND = "#f59e42", "#1c4e80", "#8fb3d6"
FELL = "#d64545"

RC: dict[str, Any] = {
    "font.family": "DejaVu Sans",  # comes with matplotlib, so every machine draws the same page
    "font.size": 8.0,
    "text.color": INK,
    "axes.edgecolor": "#c3cad3",
    "axes.labelcolor": SOFT,
    "axes.linewidth": 0.8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.titley": 1.0,  # found by itself, it takes half of the time of drawing
    "axes.axisbelow": True,
    "axes.grid": True,
    "axes.grid.axis": "y",
    "axes.xmargin": 0.0,
    "grid.color": "#eef1f4",
    "grid.linewidth": 0.8,
    "xtick.color": SOFT,
    "ytick.color": SOFT,
    "xtick.labelsize": 7.0,
    "ytick.labelsize": 7.0,
    "xtick.major.size": 2.5,
    "ytick.major.size": 0.0,
    "path.simplify": True,
}
"""Settings of matplotlib, for `matplotlib.rc_context`."""


def headline(run: Run, errors: Mapping[str, float] | None = None) -> str:
    """Return what a page says of a run in a line; `errors` are those of its joints [rad]."""
    parts = [f"{run.policy} follows {run.motion}" if run.policy and run.motion else run.policy or run.motion]
    parts.append(f"{run.end_s:.1f} s")
    if errors:
        worst = max(errors, key=lambda joint: errors[joint])
        mean = sum(errors.values()) / len(errors)
        parts.append(f"mean joint error {mean:.3f} rad, worst {worst.replace('_', ' ')} {errors[worst]:.3f} rad")
    if run.can_fall:
        parts.append({0: "no fall", 1: "1 fall"}.get(len(run.falls_s), f"{len(run.falls_s)} falls"))
    return "   ·   ".join(part for part in parts if part)


def title(axes: Axes, name: str, figure: str = "", *, figure_colour: str = SOFT) -> None:
    """Write the name of a panel above its left end, and a figure above its right end.

    Where a panel is too narrow for both, the figure stands within it, at the top right.
    """
    axes.set_title(name, loc="left", fontsize=8.5, pad=3, color=INK)
    if not figure:
        return
    if _NAME_PX * len(name) + _FIGURE_PX * len(figure) < axes.get_position().width * WIDTH_PX:
        axes.set_title(figure, loc="right", fontsize=7.5, pad=3, color=figure_colour)
    else:
        axes.text(1.0, 1.0, figure, ha="right", va="top", fontsize=7.5, color=figure_colour, transform=axes.transAxes)


def mark(axes: Axes, run: Run) -> None:
    """Shade where the command was not simply followed, and draw where clips begin and where the robot fell."""
    for span in run.gate:
        if span.name != TRACKING:
            axes.axvspan(span.start_s, span.end_s, color="#f4f6f8", linewidth=0, zorder=0)
    for span in run.phases[1:]:
        axes.axvline(span.start_s, color=FAINT, linewidth=0.8, zorder=0.5)
    for at_s in run.falls_s:
        axes.axvline(at_s, color=FELL, linewidth=1.2, zorder=3)


def asked(axes: Axes, times_s: Floats, values: Floats) -> None:
    """Draw a curve of what was asked for."""
    axes.plot(times_s, values, color=ASKED, linewidth=2.4, solid_joinstyle="round", gid="asked", zorder=1.5)


def measured(axes: Axes, times_s: Floats, values: Floats) -> None:
    """Draw a curve of what was measured."""
    axes.plot(times_s, values, color=MEASURED, linewidth=1.0, solid_joinstyle="round", gid="measured", zorder=2)


def scale(axes: Axes, values: Floats, *, least: float) -> None:
    """Fit the y-axis to the finite of some values, never to less than a span of `least`."""
    known = values[np.isfinite(values)]
    low, high = (float(known.min()), float(known.max())) if len(known) else (0.0, 0.0)
    middle, half = (low + high) / 2, max(high - low, least) / 2 * 1.12
    axes.set_ylim(middle - half, middle + half)
    axes.locator_params(axis="y", nbins=4)


def time_axis(axes: Axes, limits: tuple[float, float], *, ticks: int, unit: str = "") -> None:
    """Give a panel the time axis of the page [s], with round numbers."""
    axes.set_xlim(limits)
    axes.locator_params(axis="x", nbins=ticks, steps=[1, 2, 5, 10])
    axes.xaxis.set_major_formatter(lambda value, _: f"{value:g}{unit}")
