"""Where a reference is looked for, in order: as a path, below ``$STATION_ASSETS``, in the cache, in the program."""

from __future__ import annotations

import glob
import os
from fnmatch import fnmatchcase
from pathlib import Path, PurePosixPath
from typing import Literal, NamedTuple

from station.assets import collection as collections
from station.assets.collection import Collection, PinnedFile, stays_inside
from station.errors import AssetMissing, BadFile, did_you_mean

ENVIRONMENT_VARIABLE = "STATION_ASSETS"

_LIST = "`station assets list` shows what there is"

Place = Literal["path", "environment", "cache", "built in"]


class FoundFile(NamedTuple):
    """A file that a reference names, and the place where it was found."""

    path: Path
    place: Place


def root() -> Path | None:
    """Return the folder with upstream data that ``$STATION_ASSETS`` names, or None when it is not set."""
    value = os.environ.get(ENVIRONMENT_VARIABLE)
    return Path(value).expanduser().resolve() if value else None


def cache() -> Path:
    """Return the folder that files are fetched into, ``$XDG_CACHE_HOME/station/assets``; not necessarily there."""
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base).absolute() if base else Path.home() / ".cache") / "station" / "assets"


def resolve(reference: str | os.PathLike[str]) -> Path:
    """Return the file that a reference names.

    Raises:
        AssetMissing: a file of a collection that is in none of the places.
        BadFile: a plain path that does not exist, or a file of the cache that is cut short or damaged.
    """
    return find(reference).path


def find(reference: str | os.PathLike[str]) -> FoundFile:
    """Return the file that a reference names, and where it was found.

    Raises:
        AssetMissing, BadFile: as in `resolve`.
    """
    text = os.fspath(reference)
    try:
        return _find(text)
    except (OSError, RuntimeError) as error:  # too long for a path, not to be read, or ~ of a user that is not here
        why = error.strerror if isinstance(error, OSError) else str(error)
        raise BadFile(f"{text[:100]}{'…' * (len(text) > 100)}: {why}") from None


def _find(text: str) -> FoundFile:
    parts = split(text)
    if parts is None:
        path = Path(text).expanduser().absolute()  # it ends in manifests, which are read from other folders
        if not path.exists():
            raise BadFile(f"{text}: no such file{_near(path)}")
        return FoundFile(path, "path")
    name, relative = parts
    for place, folder in folders(name):
        if (path := folder / relative).exists():
            if place == "cache":
                _refuse_damaged(name, relative)
            return FoundFile(path, place)
    known = collections.registered(name)
    if known and (built_in := known.built_in.get(relative)):
        return FoundFile(built_in, "built in")
    raise AssetMissing(_missing(name, relative, known))


def expand(reference: str) -> list[Path]:
    """Return every file that a reference or pattern names, sorted; at least one.

    Raises:
        AssetMissing, BadFile: as in `resolve`, or when a pattern matches nothing.
    """
    return [resolve(name) for name in references(reference)]


def references(pattern: str) -> list[str]:
    """Return the reference of every file that a pattern matches, sorted; what is no pattern, as it is.

    Raises:
        AssetMissing, BadFile: the pattern matches nothing.
    """
    if not glob.has_magic(pattern):
        return [pattern]
    parts = split(pattern)
    if parts is None:
        absolute = str(Path(pattern).expanduser().absolute())
        if not (found := sorted(glob.glob(absolute))):
            raise BadFile(f"{pattern}: no file matches {absolute}")
        return found
    name, relative = parts
    known = collections.registered(name)
    matched = {m for _, folder in folders(name) for m in glob.glob(relative, root_dir=folder)}
    matched |= {m for m in (known.built_in if known else ()) if _matches(m, relative)}
    if not matched:
        raise AssetMissing(_missing(name, relative, known))
    return [f"{name}:{m}" for m in sorted(matched)]


def is_reference(reference: str | os.PathLike[str]) -> bool:
    """Whether this names a file of a collection, and is no plain path.

    Raises:
        BadFile: the path leaves its collection.
    """
    return split(os.fspath(reference)) is not None


def split(reference: str) -> tuple[str, str] | None:
    """Return the collection and the relative path of a reference; None when it is a plain path.

    Raises:
        BadFile: the path leaves its collection.
    """
    name, colon, relative = reference.partition(":")
    # A single letter before the colon would be a drive, a slash a path: neither is a collection.
    if not colon or len(name) <= 1 or "/" in name or name.startswith("."):
        return None
    if not stays_inside(relative):
        raise BadFile(f"{reference}: leaves its collection; expected {name}:PATH/BELOW, or a plain path")
    return name, relative


def folders(name: str) -> list[tuple[Literal["environment", "cache"], Path]]:
    """Return the folders that a collection may have, in the order of the search; not necessarily there.

    Raises:
        AssetMissing: ``$STATION_ASSETS`` is set to what is no folder. Going on without it could end in another file.
    """
    base = root()
    if base is None:
        return [("cache", cache() / name)]
    if not base.is_dir():
        raise AssetMissing(
            f"{name}: ${ENVIRONMENT_VARIABLE} names {base}, which is not a folder; "
            f"set it to the one that holds {name}/, or unset it"
        )
    return [("environment", base / name), ("cache", cache() / name)]


def _refuse_damaged(name: str, relative: str) -> None:
    """Refuse a fetched file, or one that it needs, that has not the pinned size; a whole hash would cost a start."""
    known = collections.registered(name)
    pinned = known.pinned(relative) if known else None
    if pinned is None:
        return
    bundle, file = pinned
    needed: tuple[PinnedFile, ...] = (file,)
    if bundle.last_needs_all and file == bundle.files[-1]:
        needed = bundle.files
    for each in needed:
        path = cache() / name / each.path
        if problem := each.problem(path, whole=False):
            raise BadFile(
                f"{path}: {problem}: cut short or damaged; `station assets fetch {bundle.name}` gets it again"
            )


def _missing(name: str, relative: str, known: Collection | None) -> str:
    """Say that no place has a file, what to do, and where it was looked for."""
    if known and relative in known.motions():
        return f"{name}:{relative}: a motion that is made when it is played; it has no file"
    there = [str(folder) for _, folder in folders(name)] + (["the program"] if known and known.built_in else [])
    unset = "" if root() else f"; ${ENVIRONMENT_VARIABLE} is not set"
    looked = f"(looked in {' and '.join(there)}{unset})"
    bundles = [b.name for b in (known.bundles if known else ()) if any(_matches(f.path, relative) for f in b.files)]
    if bundles:
        return f"{name}:{relative}: not on this machine; `station assets fetch {bundles[0]}` gets it {looked}"
    if known is None and not any(folder.is_dir() for _, folder in folders(name)):
        others = [*collections.names(), *(p.name for p in subfolders(root()) + subfolders(cache()))]
        return f"{name}:{relative}: no collection {name!r}{did_you_mean(name, others)}; {_LIST} {looked}"
    return f"{name}:{relative}: no such file{_alike(name, relative, known)}; {_LIST} {looked}"


def _matches(relative: str, pattern: str) -> bool:
    """Whether a relative path is one that a pattern, or a path, stands for; as `glob` sees it, part by part."""
    parts, patterns = PurePosixPath(relative).parts, PurePosixPath(pattern).parts
    return len(parts) == len(patterns) and all(map(fnmatchcase, parts, patterns))


def _alike(name: str, relative: str, known: Collection | None) -> str:
    """Name the file that was probably meant: one of the same folder in any place, else one that is pinned."""
    parent = PurePosixPath(relative).parent
    there = [folder / parent for _, folder in folders(name)]
    near = {(parent / p.name).as_posix() for folder in there if folder.is_dir() for p in folder.iterdir()}
    pinned = {file.path for bundle in known.bundles for file in bundle.files} if known else set()
    near |= {path for path in [*pinned, *(known.built_in if known else ())] if PurePosixPath(path).parent == parent}
    return did_you_mean(relative, sorted(near)) or did_you_mean(relative, sorted(pinned))


def subfolders(folder: Path | None) -> list[Path]:
    """Return the folders in a folder that may be collections, sorted; none when it is not there."""
    if folder is None or not folder.is_dir():
        return []
    return sorted(p for p in folder.iterdir() if p.is_dir() and not p.name.startswith("."))


def _near(path: Path) -> str:
    if not path.parent.is_dir():
        return f" (there is no folder {path.parent})"
    return did_you_mean(path.name, [sibling.name for sibling in path.parent.iterdir()])
