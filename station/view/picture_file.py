"""Drawing a page with matplotlib, and writing pictures where a person wants them."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from station.episode.storage.whole_file import named_file
from station.view import plot_style as style

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@contextmanager
def page(width_in: float, height_in: float, settings: Mapping[str, Any] | None = None) -> Iterator[Figure]:
    """Give an empty page in our style, to be drawn and saved within the block.

    Args:
        width_in, height_in: Its size [in].
        settings: Of matplotlib, over those of our style.
    """
    logging.getLogger("matplotlib").setLevel(logging.WARNING)  # else the first plot of a machine tells of its fonts
    import matplotlib as mpl
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    with mpl.rc_context({**style.RC, **(settings or {})}):
        figure = Figure(figsize=(width_in, height_in), dpi=style.DPI, facecolor=style.PAPER)
        FigureCanvasAgg(figure)  # of its own, so that no display is looked for
        yield figure


def save(figure: Figure, path: Path) -> Path:
    """Write a page as PNG, and return the path.

    Raises:
        StationError: the file cannot be written.
    """
    with named_file(path) as file:
        figure.savefig(file, format="png")
    return path
