"""zarr, or one line that says how to get it."""

from __future__ import annotations

import importlib
from typing import Any

from station.errors import StationError

_CURE = "install it with `pip install 'teleop-station[zarr]'`"


def _load() -> Any:
    try:
        library = importlib.import_module("zarr")
    except ImportError as error:
        raise StationError(f"Zarr files need zarr ({error}); {_CURE}") from error
    version = str(library.__version__)
    if int(version.partition(".")[0]) < 3:
        raise StationError(f"Zarr files need zarr 3 or newer, and {version} is installed; {_CURE}")
    return library


zarr: Any = _load()  # its types come and go with its releases

FORMAT = 2
"""Of the files: diffusion_policy and UMI pin zarr 2, which reads no other; zarr 3 reads both."""


def compressor() -> Any:
    """Return what every array is compressed with: part of each release of zarr, lossless."""
    blosc = importlib.import_module("numcodecs").Blosc
    return blosc("zstd", clevel=1, shuffle=blosc.SHUFFLE)
