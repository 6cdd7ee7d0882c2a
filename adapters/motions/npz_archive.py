"""Reads members of a numpy ``.npz`` archive from anywhere: of bounded size, and without unpickling."""

from __future__ import annotations

import io
import tokenize
import zipfile
import zlib
from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np

from adapters.motions.raw import MAX_BYTES
from station.errors import BadFile

_DAMAGED = (
    zipfile.BadZipFile, zlib.error, tokenize.TokenError, ValueError, OSError, EOFError, KeyError, MemoryError,
    RuntimeError, OverflowError, TypeError, SyntaxError,
)  # fmt: skip
"""What zipfile and numpy raise of an archive that is damaged, encrypted or packed in a way that they do not know."""


def read(
    path: Path, data: bytes, wanted: Collection[str], *, what: str, ignored: Collection[str] = ()
) -> tuple[dict[str, np.ndarray[Any, Any]], list[str]]:
    """Return the wanted members that there are, and the names of all.

    Args:
        path: The file, for messages.
        data: Its content.
        wanted: Names of members.
        what: What it should be, for messages: ``.npz motion``.
        ignored: Those of the wanted that are left out where they hold objects.

    Raises:
        BadFile: torn, too large when it is unpacked, or a wanted member holds objects.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            unpacked = sum(entry.file_size for entry in archive.infolist())
        if unpacked > MAX_BYTES:
            raise BadFile(f"{path}: {unpacked / 1e6:.0f} MB unpacked, at most {MAX_BYTES / 1e6:.0f} MB are read")
        found = {}
        with np.load(io.BytesIO(data), allow_pickle=False) as archive:
            for name in [name for name in wanted if name in archive.files]:
                try:
                    found[name] = archive[name]
                except ValueError:
                    if name not in ignored:
                        raise
            return found, archive.files
    except _DAMAGED as error:
        reason = " ".join(str(error).split())[:100]
        raise BadFile(f"{path}: not a readable {what} ({reason}); fetch or export it again") from error
