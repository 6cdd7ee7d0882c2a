"""Whether a library is installed, without importing it."""

from __future__ import annotations

import importlib.metadata

from station.errors import StationError


def version(library: str) -> str | None:
    """Return the version of a library that is installed; None for one that is not, and for ""."""
    try:
        return importlib.metadata.version(library) if library else None
    except importlib.metadata.PackageNotFoundError:
        return None


def expect(who: str, library: str, extra: str = "") -> None:
    """Check that a library is installed; "", for none, always is.

    Args:
        who: What needs it, for the message: ``a gamepad``.
        library: Name of the distribution.
        extra: Of our package, which brings it; "" for none.

    Raises:
        StationError: it is not; the message says how to install it.
    """
    if library and version(library) is None:
        what = f"'teleop-station[{extra}]'" if extra else library
        raise StationError(f"{who} needs {library}, which is not installed; pip install {what}")
