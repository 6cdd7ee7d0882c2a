"""Finding `station_kord`, the native bridge: imported only when a session is opened, so that nothing else needs it."""

from __future__ import annotations

from typing import Any

from station.errors import StationError


def kord() -> Any:
    """Import and return `station_kord`, the native bridge to Kassow controllers and their simulator.

    Raises:
        StationError: it is not installed, or was built for another Python.
    """
    try:
        import station_kord
    except ImportError as error:
        raise StationError(
            f"the bridge to Kassow controllers is not installed ({error}); build it in the station's folder with "
            "`pip install ./bridges/kord` (needs a C++17 compiler and CMake)"
        ) from None
    return station_kord
