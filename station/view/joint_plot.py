"""Command against state of a robot that is all joints, an arm: a panel per joint, as asked and as measured."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from station.protocols import Floats
from station.view import plot_style as style
from station.view.run import Joints, Run

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from matplotlib.gridspec import GridSpec

_LEAST_SPAN_RAD = 0.05  # a joint that stands still must not look as if it trembled


def names(run: Run) -> tuple[str, ...]:
    """Return the joints of a run, in their order."""
    both = [joints.names for joints in (run.commanded, run.joints) if joints is not None]
    return tuple(dict.fromkeys(name for each in both for name in each))


def draw(figure: Figure, grid: GridSpec, run: Run, errors: Mapping[str, float], limits: tuple[float, float]) -> None:
    """Draw a panel per joint, one below the other.

    Args:
        figure: The page.
        grid: Has a row per joint.
        run: What is drawn.
        errors: Mean error by joint [rad].
        limits: Of the time axis [s].
    """
    found = names(run)
    for row, joint in enumerate(found):
        axes = figure.add_subplot(grid[row, 0])
        style.title(axes, f"{joint.replace('_', ' ')} [rad]", f"{errors[joint]:.4f}" if joint in errors else "")
        style.mark(axes, run)
        values = []
        for source, pen in ((run.commanded, style.asked), (run.joints, style.measured)):
            if source is not None and joint in source.names:
                values.append(_of(source, joint))
                pen(axes, source.times_s, values[-1])
        style.scale(axes, np.concatenate(values), least=_LEAST_SPAN_RAD)
        style.time_axis(axes, limits, ticks=12, unit=" s" if row == len(found) - 1 else "")
        axes.tick_params(axis="x", labelbottom=row == len(found) - 1)


def _of(joints: Joints, name: str) -> Floats:
    return joints.q[:, joints.names.index(name)]
