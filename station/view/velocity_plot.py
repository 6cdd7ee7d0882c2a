"""Velocities of the base, commanded and measured, as curves: panels for any page, and a page of walks."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from station.view import plot_style as style
from station.view.picture_file import page, save

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_TITLES = ("forward vx [m/s]", "left vy [m/s]", "turn wz [rad/s]")
_LEGEND = "commanded (orange), measured (blue), means over 1 s"
_ROW_IN, _HEAD_IN, _FOOT_IN = 1.55, 0.5, 0.4
_LEAST_SPAN = 0.4  # a gait sways by as much


class Walk(NamedTuple):
    """A row of the page.

    Attributes:
        name: What it is called.
        times_s: n instants, shape (n,).
        commanded, measured: vx, vy [m/s], wz [rad/s], shape (n, 3).
        path: Places of the base in the plane [m], shape (m, 2).
    """

    name: str
    times_s: ArrayLike
    commanded: ArrayLike
    measured: ArrayLike
    path: ArrayLike


def draw(panels: Sequence[Axes], times_s: ArrayLike, commanded: ArrayLike, measured: ArrayLike) -> None:
    """Draw each velocity in a panel of its own, commanded in orange and measured in blue.

    Args:
        panels: Three of them, for vx, vy, wz.
        times_s: n instants, shape (n,) [s].
        commanded, measured: Shape (n, 3) [m/s, m/s, rad/s].
    """
    times, asked, came = np.asarray(times_s), np.reshape(commanded, (-1, 3)), np.reshape(measured, (-1, 3))
    for column, (axes, name) in enumerate(zip(panels, _TITLES, strict=True)):
        style.title(axes, name, _LEGEND if column == len(_TITLES) - 1 else "")
        style.asked(axes, times, asked[:, column])
        style.measured(axes, times, came[:, column])
        style.scale(axes, np.concatenate([asked[:, column], came[:, column]]), least=_LEAST_SPAN)


def save_walks(walks: Sequence[Walk], path: Path) -> Path:
    """Draw a row for each walk, its three velocities and its path, write the page as PNG, and return its path.

    Raises:
        StationError: the file cannot be written.
    """
    height_in = _HEAD_IN + len(walks) * _ROW_IN + _FOOT_IN
    with page(style.WIDTH_PX / style.DPI, height_in) as figure:
        grid = figure.add_gridspec(
            len(walks), 4, left=0.03, right=0.985, top=1 - _HEAD_IN / height_in, bottom=_FOOT_IN / height_in,
            hspace=0.6, wspace=0.16, width_ratios=(1, 1, 1, 0.7),
        )  # fmt: skip
        for row, walk in enumerate(walks):
            panels = [figure.add_subplot(grid[row, column]) for column in range(3)]
            draw(panels, walk.times_s, walk.commanded, walk.measured)
            panels[0].annotate(walk.name, (0, 1), (0, 15), xycoords="axes fraction", textcoords="offset points",
                               fontsize=9, fontweight="bold", color=style.INK)  # fmt: skip
            _draw_path(figure.add_subplot(grid[row, 3]), np.reshape(walk.path, (-1, 2)))
        return save(figure, path)


def _draw_path(axes: Axes, places: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> None:
    style.title(axes, "path from above [m]", figure="starts at the dot")
    axes.plot(*places.T, color=style.MEASURED, linewidth=1.2)
    axes.plot(*places[:1].T, "o", color=style.MEASURED, markersize=4)
    axes.set_aspect("equal", adjustable="datalim")
    axes.margins(0.08)
