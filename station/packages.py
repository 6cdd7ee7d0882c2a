"""Our top-level packages beside `station`: others use the same names, and may hide ours or write over it."""

from __future__ import annotations

import importlib.util
import os
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from station.errors import StationError

if TYPE_CHECKING:
    from importlib.metadata import Distribution

HOME = Path(__file__).parents[1]
"""Folder that holds all of them, `station` as well: ``site-packages``, or a checkout."""

RUNBOOKS = HOME / "runbooks"
"""Folder of the runbooks that ship."""

IMPORTED = ("adapters", "servers")
"""Those that Python finds by their names."""

DISTRIBUTION = "teleop-station"
_ELSE = "or give the station an environment of its own"


def docs() -> Path:
    """Return the folder of the pages of the docs: of a checkout, or those that were installed."""
    installed = HOME / "station" / "docs"
    return installed if installed.is_dir() else HOME / "docs"


class Foreign(NamedTuple):
    """A foreign package under the name of one of ours.

    Attributes:
        name: Of the package.
        found: What was found, and where ours is expected.
        remedy: What to do.
        is_hiding: Whether Python imports it in place of ours; else both are in one folder.
    """

    name: str
    found: str
    remedy: str
    is_hiding: bool

    def __str__(self) -> str:
        return f"package {self.name}: {self.found}; {self.remedy}"


def expect_ours() -> None:
    """Check, without importing anything, whether Python would import our packages and no others.

    Raises:
        StationError: another package hides one of ours.
    """
    for name in IMPORTED:
        if (foreign := hiding(name)) is not None:
            raise StationError(str(foreign))


def hiding(name: str) -> Foreign | None:
    """Return what Python imports in place of a package of ours; None where it is ours."""
    spec = importlib.util.find_spec(name)
    places = [] if spec is None else [*(spec.submodule_search_locations or ()), spec.origin or ""]
    ours = HOME / name
    if not places:
        return Foreign(name, f"not found; expected {ours}", f"pip install --force-reinstall {DISTRIBUTION}", True)
    if places[0] == str(ours) or os.path.realpath(places[0]) == os.path.realpath(ours):
        return None
    place = Path(places[0])
    owner = _owner(name, place.parent)
    of = f", of the distribution {owner.name} {owner.version}," if owner is not None else ""
    found = f"Python imports {place}{of} in place of ours, {ours}"
    return Foreign(name, found, f"{_remedy(place, owner)}, {_ELSE}", True)


def sharing(name: str) -> Foreign | None:
    """Return the distribution that has put a package of this name into the folder of ours; None for none."""
    owner = _owner(name, HOME)
    if owner is None:
        return None
    found = (
        f"{owner.name} {owner.version} is in the same folder, {HOME / name}; one has written over files of the other"
    )
    again = f"pip uninstall {owner.name}, then pip install --force-reinstall --no-deps {DISTRIBUTION}"
    return Foreign(name, found, f"{again}, {_ELSE}", False)


def foreign() -> Iterator[Foreign]:
    """Yield what stands in the way of our packages; reads what every distribution beside them has installed."""
    for name in IMPORTED:
        if (found := hiding(name) or sharing(name)) is not None:
            yield found


def _remedy(place: Path, owner: Distribution | None) -> str:
    folder = os.path.realpath(place.parent)
    if folder in map(os.path.realpath, filter(None, os.environ.get("PYTHONPATH", "").split(os.pathsep))):
        return f"take {place.parent} off $PYTHONPATH"
    if owner is not None:
        return f"pip uninstall {owner.name}"
    if folder == os.getcwd():
        return "start the station in another folder"
    return f"take {place.parent} off Python's path"


def _owner(name: str, folder: Path) -> Distribution | None:
    """Return the distribution, other than ours, that has installed a package into a folder."""
    from importlib.metadata import distributions

    files = (f"\n{name}/__init__.py,", f"\n{name}.py,")
    for each in distributions(path=[str(folder)]):
        recorded = f"\n{each.read_text('RECORD') or ''}"  # of some distributions ten thousand lines
        if any(file in recorded for file in files) and each.name != DISTRIBUTION:
            return each
    return None
