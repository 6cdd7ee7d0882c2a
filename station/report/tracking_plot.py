"""How well an episode was tracked, as a picture: error over time, the joints that were furthest off, all joints."""

from __future__ import annotations

import io
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from station.report.story import Story, Tracks
from station.view import plot_style as style
from station.view import velocity_plot
from station.view.picture_file import page
from station.view.run import Run

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_WIDTH_IN, _HEIGHT_IN, _VELOCITIES_IN = 15.0, 5.6, 4.2
_SMALLER = {"font.size": 9.5, "xtick.labelsize": 8.5, "ytick.labelsize": 8.5}  # than the page it is shown in
_SHOWN = 3  # joints as curves
_BARS = 16  # joints as bars
_COLOURS = 48  # of the picture's palette; lines and text need no more
_LEAST_SPAN_RAD = 0.2
_LEAST_ERROR_RAD = 0.01  # an arm follows within milliradians


def draw(story: Story, errors: Mapping[str, float]) -> bytes | None:
    """Return the picture of an episode as PNG, or None where nothing tells how it was tracked.

    Args:
        story: What happened in it.
        errors: Mean error of each joint that was compared [rad].
    """
    if story.tracks is not None:
        with page(_WIDTH_IN, _HEIGHT_IN, _SMALLER) as figure:
            _draw(figure, story, story.tracks, errors)
            return _png(figure)
    if len(story.velocities):
        with page(_WIDTH_IN, _VELOCITIES_IN, _SMALLER) as figure:
            _draw_velocities(figure, story)
            return _png(figure)
    return None


def _draw(figure: Figure, story: Story, tracks: Tracks, errors: Mapping[str, float]) -> None:
    grid = figure.add_gridspec(
        1 + _SHOWN, 2, width_ratios=(3.6, 1), height_ratios=(1.35, *[1] * _SHOWN), left=0.035, right=0.99, top=0.945,
        bottom=0.055, hspace=0.52, wspace=0.2,
    )  # fmt: skip
    run, limits = _run_and_limits(story)
    order = sorted(range(len(tracks.joints)), key=lambda column: -errors.get(tracks.joints[column], -1.0))
    error = figure.add_subplot(grid[0, 0])
    _draw_error(error, run, tracks)
    panels = [error]
    for row, column in enumerate(order[:_SHOWN], 1):
        panels.append(figure.add_subplot(grid[row, 0]))
        _draw_joint(panels[-1], run, tracks, column, errors, with_legend=row == 1)
    for axes in panels:
        style.time_axis(axes, limits, ticks=12, unit=" s" if axes is panels[-1] else "")
        axes.tick_params(axis="x", labelbottom=axes is panels[-1])
    _draw_bars(figure.add_subplot(grid[:, 1]), tracks, order[:_BARS], errors)


def _draw_velocities(figure: Figure, story: Story) -> None:
    run, limits = _run_and_limits(story)
    grid = figure.add_gridspec(3, 1, left=0.035, right=0.99, top=0.93, bottom=0.08, hspace=0.5)
    panels = [figure.add_subplot(grid[row]) for row in range(3)]
    rows = story.velocities
    velocity_plot.draw(panels, rows[:, 0], rows[:, 1:4], rows[:, 4:])
    for axes in panels:
        style.mark(axes, run)
        style.time_axis(axes, limits, ticks=12, unit=" s" if axes is panels[-1] else "")


def _run_and_limits(story: Story) -> tuple[Run, tuple[float, float]]:
    run = Run(episode_id="", robot=story.robot, gate=story.gate, phases=story.phases)
    return run, (min(story.first_s, 0.0), max(story.last_s, story.first_s + 0.1))


def _draw_error(axes: Axes, run: Run, tracks: Tracks) -> None:
    style.title(axes, "joint error [rad]: mean over the joints, and the greatest", "grey: the command was not followed")
    style.mark(axes, run)
    axes.fill_between(tracks.times_s, 0, tracks.most_rad, color=style.SECOND, linewidth=0, alpha=0.45)
    axes.plot(tracks.times_s, tracks.mean_rad, color=style.MEASURED, linewidth=1.3)
    usual = float(np.percentile(tracks.most_rad, 99.5))
    axes.set_ylim(0, max(1.15 * usual, _LEAST_ERROR_RAD))  # a single leap must not flatten all else
    axes.locator_params(axis="y", nbins=4)


def _draw_joint(
    axes: Axes, run: Run, tracks: Tracks, column: int, errors: Mapping[str, float], *, with_legend: bool
) -> None:
    joint = tracks.joints[column]
    told = "commanded (orange), measured (blue)" if with_legend else ""
    mean = f", mean error {errors[joint]:.3f}" if joint in errors else ""
    style.title(axes, f"{joint.replace('_', ' ')} [rad]{mean}", told)
    style.mark(axes, run)
    style.asked(axes, tracks.times_s, tracks.asked[:, column])
    style.measured(axes, tracks.times_s, tracks.measured[:, column])
    style.scale(axes, np.concatenate([tracks.asked[:, column], tracks.measured[:, column]]), least=_LEAST_SPAN_RAD)


def _draw_bars(axes: Axes, tracks: Tracks, columns: list[int], errors: Mapping[str, float]) -> None:
    style.title(axes, "mean |error| while tracking [rad]", "" if len(columns) == len(tracks.joints) else "worst first")
    values = [errors.get(tracks.joints[column], 0.0) for column in columns]
    axes.barh(
        range(len(columns)), values, 0.62, color=[style.MEASURED] * _SHOWN + [style.SECOND] * (len(columns) - _SHOWN)
    )
    axes.set_yticks(range(len(columns)), [tracks.joints[column].replace("_", " ") for column in columns])
    axes.set_ylim(len(columns) - 0.4, -0.6)
    axes.set_xlim(0, 1.1 * max(*values, _LEAST_ERROR_RAD))
    axes.grid(visible=True, axis="x")
    axes.grid(visible=False, axis="y")
    axes.locator_params(axis="x", nbins=4)


def _png(figure: Figure) -> bytes:
    """Return a figure as PNG with a palette: a third of the size."""
    from PIL import Image

    drawn, small = io.BytesIO(), io.BytesIO()
    figure.savefig(drawn, format="png")
    with Image.open(drawn) as picture:
        picture.convert("RGB").quantize(_COLOURS, dither=Image.Dither.NONE).save(small, format="png", optimize=True)
    return small.getvalue()
