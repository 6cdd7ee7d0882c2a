"""A failure of an arm's controller beside its cure: target and arm, queue, and sends over time, as one picture."""

from __future__ import annotations

import textwrap
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from station.view import picture_file
from station.view import plot_style as style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from station_kord.demonstrations import Course, Demonstration

_HEIGHT_IN = 8.4
_TITLE_CHARS = 120


def save(shown: Demonstration, faulty: Course, cured: Course, path: Path) -> Path:
    """Draw two runs side by side, write them as PNG, and return the path.

    Raises:
        StationError: the file cannot be written.
    """
    with picture_file.page(style.WIDTH_PX / style.DPI, _HEIGHT_IN) as figure:
        _draw(figure, shown, faulty, cured)
        return picture_file.save(figure, path)


def _draw(figure: Figure, shown: Demonstration, faulty: Course, cured: Course) -> None:
    grid = figure.subplots(4, 2, sharex=True, sharey="row", gridspec_kw={"height_ratios": [3, 2, 2, 2]})
    figure.suptitle(f"{shown.name}: {shown.symptom}", fontsize=11, color=style.INK, x=0.01, ha="left")
    for column, (course, verdict) in enumerate(((faulty, "fails"), (cured, "holds"))):
        _draw_course(grid[:, column], course)
        happened = f"no event; moves on for {course.still_moves_s:.2f} s after letting go"
        if course.event_s is not None:
            happened = f"{course.event}, at {course.event_s:.3f} s"
        told = "\n".join(textwrap.wrap(f"{verdict}: {happened}", _TITLE_CHARS))
        grid[0, column].set_title(f"{course.setting}\n{told}", loc="left", fontsize=8.5,
                                  color=style.FELL if course.event else style.INK)  # fmt: skip
        grid[-1, column].set_xlabel("time [s]")
    figure.subplots_adjust(left=0.06, right=0.985, top=0.885, bottom=0.06, hspace=0.16, wspace=0.05)
    for axes, label in zip(grid[:, 0], ("joint 1 [rad]", "waiting to be\nplanned [moves]", "motion still\nowed [s]",
                                        "targets sent\n[1/s]"), strict=True):  # fmt: skip
        axes.set_ylabel(label)


def _draw_course(panels: list[Axes], course: Course) -> None:
    rows, time_s = course.rows, course.time_s
    start = rows["q"][0, 0]
    arm, waiting, owed, sends = panels
    arm.plot(time_s, rows["q_target"][:, 0] - start, color=style.ASKED, lw=1.6, label="target")
    arm.plot(time_s, rows["q"][:, 0] - start, color=style.MEASURED, lw=1.2, label="arm")
    arm.legend(loc="upper left", frameon=False, fontsize=7.5)
    waiting.plot(time_s, rows["planner_backlog"], color=style.MEASURED, lw=1.2)
    full = course.buffer_len  # moves; more suspend the controller
    if rows["planner_backlog"].max() > full / 3:
        waiting.axhline(full, color=style.FELL, lw=0.8, ls="--")
        waiting.annotate("buffer is full", (0, full), xytext=(2, -9), textcoords="offset points", fontsize=7,
                         color=style.FELL)  # fmt: skip
    waiting.set_ylim(0.0, max(10.0, waiting.get_ylim()[1]))
    owed.plot(time_s, rows["queued_motion_s"], color=style.MEASURED, lw=1.2)
    sends.plot(time_s, course.sends_per_s, color=style.MEASURED, lw=1.2)
    late = np.flatnonzero(rows["late"])
    sends.plot(time_s[late], np.zeros(len(late)), "x", color=style.FELL, ms=5, clip_on=False,
               label=f"{len(late)} came late")  # fmt: skip
    if len(late):
        sends.legend(loc="upper right", frameon=False, fontsize=7.5)
    for axes in panels:
        axes.axvspan(*course.keys_s, color=style.FAINT, lw=0)
        if course.event_s is not None:
            axes.axvline(course.event_s, color=style.FELL, lw=1.0)
