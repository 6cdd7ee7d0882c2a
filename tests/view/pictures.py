"""Pictures as a test looks at them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from station.view import offscreen
from station.view.offscreen import CannotRender
from tests.view.robots import tiny


def pixels(path: Path) -> NDArray[np.uint8]:
    """Read a whole PNG, shape (height, width, 3)."""
    with Image.open(path) as picture:
        assert picture.format == "PNG"
        return np.asarray(picture.convert("RGB"))


def share(picture: NDArray[np.uint8], colour: str, *, within: int = 24) -> float:
    """Return the share of pixels that have a colour such as ``#d64545``, or nearly."""
    wanted = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)])
    return float((np.abs(picture.astype(int) - wanted).max(axis=2) <= within).mean())


@pytest.fixture(scope="session")
def drawing_machine(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Skip on a machine without any working OpenGL."""
    posture = np.array([[0.0, 0, 0.8, 1, 0, 0, 0]])
    try:
        offscreen.render(tiny(tmp_path_factory.mktemp("gl")), posture, (), np.empty((1, 0)), width=16, height=16)
    except CannotRender as error:
        pytest.skip(str(error))
