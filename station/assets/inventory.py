"""Every file that is known: where it comes from, how large it is, and under which licence."""

from __future__ import annotations

import fnmatch
from collections.abc import Iterator
from pathlib import Path
from typing import Literal

import msgspec

from station.assets import collection as collections
from station.assets import places
from station.assets.collection import Collection
from station.errors import UnknownName

Where = Literal["environment", "cache", "built in", "not here"]


class Item(msgspec.Struct, frozen=True, kw_only=True):
    """One file that a reference names, or could name.

    Attributes:
        reference: Its name.
        where: The place where it is found; ``not here`` when it would have to be fetched.
        path: Where that is; for what is not here, where it would be.
        size_bytes: Its size; for what is not here, the pinned one.
        licence: By SPDX name; "" when nothing is known of it.
        bundle: What ``station assets fetch`` calls it; "" when it is not pinned.
        needed_by: Reference of the file that needs it, as a model its meshes; "" when it stands for itself.
        problem: What is wrong with it; "" when nothing was found.
    """

    reference: str
    where: Where
    path: Path
    size_bytes: int
    licence: str = ""
    bundle: str = ""
    needed_by: str = ""
    problem: str = ""


def known_collections() -> list[str]:
    """Return the names of all collections: registered, below ``$STATION_ASSETS`` or in the cache."""
    bases = [base for base in (places.root(), places.cache()) if base is not None]
    return sorted({*collections.names(), *(folder.name for base in bases for folder in places.subfolders(base))})


def inventory(only: str = "", *, verify: bool = False) -> list[Item]:
    """Return every known file, sorted by reference.

    Args:
        only: Name of a collection; "" for all.
        verify: Whether whole files are compared with their pinned hashes; otherwise their sizes are.

    Raises:
        UnknownName: no such collection.
        AssetMissing: ``$STATION_ASSETS`` is set to what is no folder.
    """
    known = known_collections()
    if only and only not in known:
        raise UnknownName("collection", only, known)
    return [item for name in ([only] if only else known) for item in _items(name, verify=verify)]


def motions() -> list[str]:
    """Return the references of all motions that are made rather than read, sorted."""
    registered = {name: collections.registered(name) for name in collections.names()}
    return [f"{name}:{motion}" for name, known in registered.items() if known for motion in sorted(known.motions())]


def motions_named(pattern: str) -> list[str]:
    """Return the references that a pattern names, of motions that are made and of files; what is no pattern, as it is.

    Raises:
        AssetMissing, BadFile: the pattern matches nothing.
    """
    made = fnmatch.filter(motions(), pattern) if "*" in pattern else []
    return made or places.references(pattern)


def _items(name: str, *, verify: bool) -> Iterator[Item]:
    known = collections.registered(name) or Collection(about="")
    found: dict[str, tuple[Where, Path]] = {}
    for bundle in known.bundles:
        found |= {file.path: ("not here", places.cache() / name / file.path) for file in bundle.files}
    found |= {relative: ("built in", path) for relative, path in known.built_in.items()}
    for place, folder in reversed(places.folders(name)):
        found |= {path.relative_to(folder).as_posix(): (place, path) for path in _files(folder)}
    for relative, (where, path) in sorted(found.items()):
        yield _item(f"{name}:{relative}", where, path, known, verify=verify)


def _item(reference: str, where: Where, path: Path, known: Collection, *, verify: bool) -> Item:
    pinned = known.pinned(reference.partition(":")[2])
    if where == "built in" or pinned is None:
        licence = known.licence if where == "built in" else ""
        return Item(reference=reference, where=where, path=path, size_bytes=path.stat().st_size, licence=licence)
    bundle, file = pinned
    size_bytes, problem = file.size_bytes, ""
    if where != "not here":
        size_bytes, problem = path.stat().st_size, file.problem(path, whole=verify)
    last = f"{reference.partition(':')[0]}:{bundle.files[-1].path}"
    return Item(
        reference=reference, where=where, path=path, size_bytes=size_bytes, licence=bundle.licence,
        bundle=bundle.name, needed_by=last if bundle.last_needs_all and reference != last else "", problem=problem,
    )  # fmt: skip


def _files(folder: Path) -> list[Path]:
    return [p for p in folder.rglob("*") if p.is_file() and not p.name.startswith(".")]
