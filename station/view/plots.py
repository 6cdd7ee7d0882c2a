"""Command against state as one page: each joint as asked and as measured, root, gate, clips and falls.

Limbs are columns and each joint has its row, so left and right stand side by side; the two have one span. A robot
without those limbs has its joints below each other (`station.view.plots`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from station import rotations
from station.episode.quality import rule_file
from station.episode.quality.standing import standing
from station.episode.reading.reader import EpisodeReader
from station.errors import StationError
from station.protocols import FALL_TILT_RAD, Floats
from station.view import plot_style as style
from station.view import velocity_plot
from station.view.layout import GATE_COLOURS
from station.view.phases import TRACKING, Span
from station.view.picture_file import page, save
from station.view.run import Joints, Run, read_run

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.gridspec import GridSpec


_HEAD_IN, _LANES_IN, _ROOT_IN, _ROW_IN, _FOOT_IN = 0.72, 0.52, 1.35, 1.36, 0.42
_LEFT_IN, _RIGHT_IN = 0.55, 0.25
_NAMES_IN = 0.55  # what the names beside the bars stick out to the left
_LEAST_SPAN_RAD = 0.2  # a joint that stands still must not look as if it trembled
_LEAST_ERROR_RAD = 0.01

_CLIPS = ("#cfe1f2", "#e3edf7")  # neighbours differ
_PALE = "#eceff2"
_BLENDS = frozenset(("waiting", "entering", "paused", "leaving", "done"))
_LETTER_PX, _PAD_PX = 5.4, 8.0  # of the labels' font
_BAR = 0.78  # of the height of a lane

_LEAST_JOINT_SPAN_RAD = 0.05  # a joint that stands still must not look as if it trembled


def save_plot(reader: EpisodeReader, path: Path, *, robot: str = "") -> Path:
    """Draw a robot of an episode, see `phases.robot_of`, on a page, write it as PNG, and return its path.

    Raises:
        StationError: the episode holds no joints, or the file cannot be written.
    """
    run = read_run(reader, robot)
    return save_run(run, standing(reader, rule_file.shipped()).joint_errors_rad(run.robot), path)


def save_run(run: Run, errors: Mapping[str, float], path: Path) -> Path:
    """Like `save_plot`, of a run that has been read and the mean errors of its joints [rad]."""
    if run.commanded is None and run.measured is None:
        raise StationError(f"{run.episode_id}: no plot, it holds neither a command nor a state with joints")
    names = _joint_names(run)
    if not names:
        raise StationError(f"{run.episode_id}: no plot, nothing names the joints of {run.robot or 'its robot'}")
    has_limbs = len(run.groups) > 1 and any(joint in limb for limb in run.groups.values() for joint in names)
    below_in = len(names) * _ROW_IN
    if has_limbs:
        below_in = _root_in(run) + _velocity_in(run) + _places(run.groups, errors).rows * _ROW_IN
    height_in = _HEAD_IN + _LANES_IN + below_in + _FOOT_IN
    with page(style.WIDTH_PX / style.DPI, height_in) as figure:
        (_draw if has_limbs else _draw_joints)(figure, run, errors)
        return save(figure, path)


class _Places(NamedTuple):
    """Rows of a page, and where there is room beside the joints: columns of lean and path, column of the errors."""

    rows: int
    lean: int
    path: int
    errors: int


def _places(groups: Mapping[str, tuple[str, ...]], bars: Mapping[str, float]) -> _Places:
    """Return where what is no joint is drawn: below short limbs, in rows of its own where all are as long."""
    lengths = [len(limb) for limb in groups.values()]
    errors, *others = sorted(range(len(lengths)), key=lambda column: (lengths[column], column))
    lean, path = sorted((*others, *others)[:2])
    rows = max(*lengths, lengths[errors] + 2 * bool(bars), lengths[lean] + 1, lengths[path] + 1 + (lean == path))
    return _Places(rows, lean, path, errors)


def _draw(figure: Figure, run: Run, errors: Mapping[str, float]) -> None:
    from matplotlib.gridspec import GridSpec

    height_in, root_in = float(figure.get_figheight()), _root_in(run)
    _head(figure, run, errors)
    velocity_in = _velocity_in(run)
    heights = (_LANES_IN, root_in - 0.3) if root_in else (_LANES_IN,)
    top = GridSpec(
        len(heights), 1, figure, left=_LEFT_IN / 16, right=1 - _RIGHT_IN / 16, top=1 - _HEAD_IN / height_in,
        bottom=1 - (_HEAD_IN + sum(heights)) / height_in, height_ratios=heights, hspace=0.42,
    )  # fmt: skip
    limits = _draw_lanes(figure.add_subplot(top[0]), run)
    if root_in:
        root = figure.add_subplot(top[1])
        _draw_height(root, run)
        style.time_axis(root, limits, ticks=12, unit=" s")
    if velocity_in:
        top_in = _HEAD_IN + _LANES_IN + root_in + 0.2
        beside = GridSpec(
            1, 3, figure, left=_LEFT_IN / 16, right=1 - _RIGHT_IN / 16, top=1 - top_in / height_in,
            bottom=1 - (top_in + velocity_in - 0.45) / height_in, wspace=0.12,
        )  # fmt: skip
        panels = [figure.add_subplot(beside[column]) for column in range(3)]
        _draw_velocities(panels, run, limits)
    places = _places(run.groups, errors)
    below = GridSpec(
        places.rows, len(run.groups), figure, left=_LEFT_IN / 16, right=1 - _RIGHT_IN / 16,
        top=1 - (_HEAD_IN + _LANES_IN + root_in + velocity_in + 0.42) / height_in, bottom=_FOOT_IN / height_in,
        hspace=0.5, wspace=0.18,
    )  # fmt: skip
    _draw_limbs(figure, below, run, errors, limits)
    if run.can_fall:
        _draw_lean(figure.add_subplot(below[places.rows - 1, places.lean]), run, limits)
        _draw_path(figure.add_subplot(below[places.rows - 1 - (places.path == places.lean), places.path]), run)
    if errors:
        first = len([*run.groups.values()][places.errors])
        _draw_errors(figure.add_subplot(below[first:, places.errors]), run, errors)


def _root_in(run: Run) -> float:
    """Return the height of the panel of the base's height [in]; 0 where nothing asked for it or measured it."""
    return _ROOT_IN if run.heights is not None or run.has_place else 0.0


def _velocity_in(run: Run) -> float:
    """Return the height of the panels of the base's velocity [in]; 0 where none was commanded and measured."""
    return _ROOT_IN if len(run.velocities) else 0.0


def _draw_velocities(panels: Sequence[Axes], run: Run, limits: tuple[float, float]) -> None:
    rows = run.velocities
    velocity_plot.draw(panels, rows[:, 0], rows[:, 1:4], rows[:, 4:])
    for axes in panels:
        style.mark(axes, run)
        style.time_axis(axes, limits, ticks=5)


def _draw_joints(figure: Figure, run: Run, errors: Mapping[str, float]) -> None:
    """Draw the page of a robot that is all joints."""
    from matplotlib.gridspec import GridSpec

    height_in = float(figure.get_figheight())
    _head(figure, run, errors)
    sides = {"left": _LEFT_IN / 16, "right": 1 - _RIGHT_IN / 16}
    lanes_end = 1 - (_HEAD_IN + _LANES_IN) / height_in
    lanes = GridSpec(1, 1, figure, top=1 - _HEAD_IN / height_in, bottom=lanes_end, **sides)
    limits = _draw_lanes(figure.add_subplot(lanes[0]), run)
    below = GridSpec(len(_joint_names(run)), 1, figure, top=lanes_end - 0.42 / height_in,
                     bottom=_FOOT_IN / height_in, hspace=0.35, **sides)  # fmt: skip
    _draw_all_joints(figure, below, run, errors, limits)


def _draw_lanes(axes: Axes, run: Run) -> tuple[float, float]:
    """Draw what played and what the gate did; return the limits of the page's time [s]."""
    limits = (0.0, max(run.end_s, 0.1))
    axes.set_xlim(limits)
    draw_lanes(axes, run, width_px=(16 - _LEFT_IN - _RIGHT_IN) * style.DPI)
    return limits


def _head(figure: Figure, run: Run, errors: Mapping[str, float]) -> None:
    from matplotlib.lines import Line2D

    height_in = float(figure.get_figheight())
    left = _LEFT_IN / 16
    figure.text(left, 1 - 0.32 / height_in, run.episode_id, fontsize=14, fontweight="bold")
    figure.text(left, 1 - 0.54 / height_in, style.headline(run, errors), color=style.SOFT, fontsize=9)
    drawn = {"measured": Line2D([], [], color=style.MEASURED, linewidth=1.2)}
    if run.commanded is not None or run.heights is not None:
        drawn = {"commanded": Line2D([], [], color=style.ASKED, linewidth=2.4), **drawn}
    figure.legend([*drawn.values()], [*drawn], loc="upper right", ncols=2, frameon=False, fontsize=9,
                  bbox_to_anchor=(1 - _RIGHT_IN / 16, 1 - 0.14 / height_in), borderpad=0, handlelength=1.8)  # fmt: skip


def _draw_height(axes: Axes, run: Run) -> None:
    style.title(axes, "height of the base [m]")
    style.mark(axes, run)
    if run.heights is not None:
        style.asked(axes, *run.heights)
    if run.measured is not None and run.has_place:
        style.measured(axes, run.times_s, run.measured.root[:, 2])
    style.scale(axes, _values(axes), least=0.1)


def _draw_lean(axes: Axes, run: Run, limits: tuple[float, float]) -> None:
    style.title(axes, "lean of the base [°]")
    style.mark(axes, run)
    if run.measured is not None:
        style.measured(axes, run.times_s, np.degrees(rotations.tilt(run.measured.root[:, 3:])))
        lean = _values(axes)
        axes.set_ylim(0, max(12.0, 1.1 * float(lean.max(initial=0.0))))
        if lean.max(initial=0.0) > np.degrees(FALL_TILT_RAD) / 2:
            axes.axhline(np.degrees(FALL_TILT_RAD), color=style.FELL, linewidth=0.8, linestyle=(0, (4, 3)))
    style.time_axis(axes, limits, ticks=5)


def _draw_path(axes: Axes, run: Run) -> None:
    """Draw where the base went, seen from above, forward to the right."""
    if run.measured is None or not run.has_place:
        axes.set_visible(False)
        return
    style.title(axes, "path from above [m]", figure="starts at the dot")
    x, y = run.measured.root[:, 0], run.measured.root[:, 1]
    axes.plot(x, y, color=style.MEASURED, linewidth=1.2)
    whole = np.flatnonzero(np.isfinite(x) & np.isfinite(y))
    if len(whole):
        axes.plot(x[whole[0]], y[whole[0]], "o", color=style.MEASURED, markersize=4)
    axes.set_aspect("equal", adjustable="datalim")
    axes.margins(0.08)


def _draw_limbs(
    figure: Figure, grid: GridSpec, run: Run, errors: Mapping[str, float], limits: tuple[float, float]
) -> None:
    for column, (limb, joints) in enumerate(run.groups.items()):
        for row, joint in enumerate(joints):
            axes = figure.add_subplot(grid[row, column])
            name = joint.removeprefix("left_").removeprefix("right_").replace("_", " ")
            style.title(axes, name, f"{errors[joint]:.3f}" if joint in errors else "")
            style.mark(axes, run)
            _draw_joint(axes, run, joint)
            style.scale(axes, _both(run, joint), least=max(_LEAST_SPAN_RAD, _extent(_both(run, _twin(joint)))))
            style.time_axis(axes, limits, ticks=5)
            axes.tick_params(axis="x", labelbottom=row == len(joints) - 1)
            if row == 0:
                axes.annotate(f"{limb} [rad]", (0, 1), (0, 20), xycoords="axes fraction", textcoords="offset points",
                              fontsize=10.5, fontweight="bold", color=style.INK)  # fmt: skip


def _draw_joint(axes: Axes, run: Run, joint: str) -> None:
    for source, draw in ((run.commanded, style.asked), (run.joints, style.measured)):
        if source is not None and joint in source.names:
            draw(axes, source.times_s, source.q[:, source.names.index(joint)])


def _twin(joint: str) -> str:
    """Return the same joint on the other side: the two are drawn with one span."""
    return joint.replace("left_", "right_") if joint.startswith("left_") else joint.replace("right_", "left_")


def _both(run: Run, joint: str) -> Floats:
    """Return the finite values of a joint, commanded and measured."""
    columns = [
        source.q[:, source.names.index(joint)]
        for source in (run.commanded, run.joints)
        if source is not None and joint in source.names
    ]
    values = np.concatenate(columns) if columns else np.empty(0)
    return np.asarray(values[np.isfinite(values)])


def _extent(values: Floats) -> float:
    return float(np.ptp(values)) if len(values) else 0.0


def _values(axes: Axes) -> Floats:
    """Return the finite values of all curves of a panel."""
    drawn: list[Any] = [np.asarray(line.get_ydata(), dtype=np.float64) for line in axes.get_lines() if line.get_gid()]
    values = np.concatenate(drawn) if drawn else np.empty(0)
    return np.asarray(values[np.isfinite(values)])


def _draw_errors(axes: Axes, run: Run, errors: Mapping[str, float]) -> None:
    """Draw a bar per joint, left above right."""
    place = axes.get_position()
    axes.set_position((place.x0 + _NAMES_IN / 16, place.y0, place.width - _NAMES_IN / 16, place.height))
    style.title(axes, "mean |error| [rad]", figure="left above right")
    every = (joint for limb in run.groups.values() for joint in limb)
    names = list(dict.fromkeys(joint.removeprefix("left_").removeprefix("right_") for joint in every))
    for row, name in enumerate(names):
        if name in errors:
            axes.barh(row, errors[name], 0.5, color=style.MEASURED)
            continue
        for side, shift, colour in (("left", -0.2, style.MEASURED), ("right", 0.2, style.SECOND)):
            axes.barh(row + shift, errors.get(f"{side}_{name}", 0.0), 0.36, color=colour)
    axes.set_yticks(range(len(names)), [name.replace("_", " ") for name in names], fontsize=7.5)
    axes.set_ylim(len(names) - 0.4, -0.6)
    axes.set_xlim(0, 1.08 * max(*errors.values(), _LEAST_ERROR_RAD))
    axes.grid(visible=True, axis="x")
    axes.grid(visible=False, axis="y")
    axes.locator_params(axis="x", nbins=5)


def draw_lanes(axes: Axes, run: Run, *, width_px: float) -> None:
    """Draw what played, which policy drove and what the gate did; a label stands where its bar is wide enough for it.

    Args:
        axes: Where to; its x-axis is time [s] and has its limits.
        run: The run.
        width_px: Width of the axes [px].
    """
    lanes = [
        ("motion", run.phases, _clip_colours(run.phases)),
        ("policy", run.driving, _clip_colours(run.driving)),
        ("gate", run.gate, [_gate(span.name) for span in run.gate]),
    ]
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


def _joint_names(run: Run) -> tuple[str, ...]:
    """Return the joints of a run, in their order."""
    both = [joints.names for joints in (run.commanded, run.joints) if joints is not None]
    return tuple(dict.fromkeys(name for each in both for name in each))


def _draw_all_joints(
    figure: Figure, grid: GridSpec, run: Run, errors: Mapping[str, float], limits: tuple[float, float]
) -> None:
    """Draw a panel per joint, one below the other.

    Args:
        figure: The page.
        grid: Has a row per joint.
        run: What is drawn.
        errors: Mean error by joint [rad].
        limits: Of the time axis [s].
    """
    found = _joint_names(run)
    for row, joint in enumerate(found):
        axes = figure.add_subplot(grid[row, 0])
        style.title(axes, f"{joint.replace('_', ' ')} [rad]", f"{errors[joint]:.4f}" if joint in errors else "")
        style.mark(axes, run)
        values = []
        for source, pen in ((run.commanded, style.asked), (run.joints, style.measured)):
            if source is not None and joint in source.names:
                values.append(_values_of(source, joint))
                pen(axes, source.times_s, values[-1])
        style.scale(axes, np.concatenate(values), least=_LEAST_JOINT_SPAN_RAD)
        style.time_axis(axes, limits, ticks=12, unit=" s" if row == len(found) - 1 else "")
        axes.tick_params(axis="x", labelbottom=row == len(found) - 1)


def _values_of(joints: Joints, name: str) -> Floats:
    return joints.q[:, joints.names.index(name)]
