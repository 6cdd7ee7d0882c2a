"""Upstream data that the project does not carry: found under ``STATION_ASSETS``.

A reference is a plain path, or ``collection:relative/path`` for a file below ``$STATION_ASSETS/collection``,
for example ``twist2:motions/0807_yanjie_walk_001.pkl``. Patterns with ``*``, ``?`` or ``[`` may name many files.
"""

from __future__ import annotations

import glob
import hashlib
import os
from pathlib import Path

from station.errors import AssetMissing, BadFile, did_you_mean

ENVIRONMENT_VARIABLE = "STATION_ASSETS"


def root() -> Path | None:
    """Return the folder with upstream data, or None when the user has not named one."""
    value = os.environ.get(ENVIRONMENT_VARIABLE)
    return Path(value).expanduser().resolve() if value else None


def resolve(reference: str | os.PathLike[str]) -> Path:
    """Return the file that a reference names.

    Raises:
        AssetMissing: the reference needs upstream data that is not there.
        BadFile: a plain path that does not exist.
    """
    text = os.fspath(reference)
    path = _locate(text)
    if path.exists():
        return path
    if _collection(text):
        raise AssetMissing(f"{text}: no file {path}{_near(path)}; `station assets list` shows what there is")
    raise BadFile(f"{text}: no such file{_near(path)}")


def expand(reference: str) -> list[Path]:
    """Return every file that a reference or pattern names, sorted; at least one.

    Raises:
        AssetMissing, BadFile: as in `resolve`, or when a pattern matches nothing.
    """
    if not glob.has_magic(reference):
        return [resolve(reference)]
    pattern = _locate(reference)
    found = sorted(Path(p) for p in glob.glob(str(pattern)))
    if not found:
        raise BadFile(f"{reference}: no file matches {pattern}")
    return found


def sha256(path: Path) -> str:
    """Return the SHA-256 of a file, as hex digits."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def _collection(text: str) -> str | None:
    head, colon, _ = text.partition(":")
    # A single letter before the colon would be a drive, a slash a path: neither is a collection.
    return head if colon and len(head) > 1 and "/" not in head else None


def _locate(text: str) -> Path:
    collection = _collection(text)
    if collection is None:
        return Path(text).expanduser().absolute()  # it ends in manifests, which are read from other folders
    base = root()
    if base is None:
        raise AssetMissing(
            f"{text}: needs upstream data, but {ENVIRONMENT_VARIABLE} is not set; "
            f"set it to the folder that holds {collection}/"
        )
    if not base.is_dir():
        raise AssetMissing(
            f"{text}: ${ENVIRONMENT_VARIABLE} names {base}, which is not a folder; "
            f"set it to the one that holds {collection}/"
        )
    return base / collection / text.partition(":")[2]


def _near(path: Path) -> str:
    siblings = [p.name for p in path.parent.iterdir()] if path.parent.is_dir() else []
    return did_you_mean(path.name, siblings) if siblings else f" (there is no folder {path.parent})"
