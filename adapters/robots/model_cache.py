"""Compiled MuJoCo models, kept in the user's cache folder: a meshed robot compiles in seconds, loads in a third of one.

A cached file is named for everything that it was made of and for its own checksum, so it is never stale, and a torn
one is recognised before MuJoCo reads it and made anew.
"""

from __future__ import annotations

import ctypes
import hashlib
import logging
import os
import re
import tempfile
import zlib
from collections.abc import Callable
from pathlib import Path
from xml.etree import ElementTree

import mujoco

from station.errors import BadFile

log = logging.getLogger(__name__)

SIZE_LIMIT_BYTES = 1 << 30
"""Size of the whole cache; the models used longest ago go first. One meshed G1 takes 44 MB, and 87 MB to be drawn."""

Prepare = Callable[[mujoco.MjSpec], None]


def load(path: Path, prepare: Prepare, *, salt: bytes = b"") -> mujoco.MjModel:
    """Return the compiled model of an MJCF file, from the cache when nothing that it is made of has changed.

    Args:
        path: The MJCF file.
        prepare: Changes the parsed model before it is compiled.
        salt: What, beside the files, the outcome of `prepare` depends on.

    Raises:
        BadFile: no such file, no MJCF, a file that it names is missing, or `prepare` refused it.
    """
    key = model_hash(path, salt)
    model = _from_cache(key)
    if model is None:
        compiled = _compile(path, prepare)
        _keep(compiled, key)
        if (model := _from_cache(key)) is None:
            return compiled
        del compiled
        _give_memory_back()
    return model


def model_hash(path: Path, salt: bytes = b"") -> str:
    """Return a hash over an MJCF file, all that it includes and names (meshes, textures), and MuJoCo's version."""
    digest = hashlib.sha256(f"{mujoco.__version__}\0".encode() + salt)
    for part in _files_of(path):
        digest.update(f"\0{part.name}\0".encode())
        digest.update(hashlib.sha256(part.read_bytes()).digest())
    return digest.hexdigest()


def folder() -> Path:
    """Return the folder of the cache, ``$XDG_CACHE_HOME/station/models``; not necessarily there."""
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "station" / "models"


def _files_of(path: Path) -> list[Path]:
    """The MJCF file itself, then every file it names that exists (the compiler complains about the others)."""
    found, queue = [], [path]
    while queue:
        current = queue.pop(0)
        found.append(current)
        root = _parse(current)
        bases = {path.parent, current.parent}
        for compiler in root.iter("compiler"):
            for name in ("meshdir", "texturedir", "assetdir"):
                bases.add(path.parent / compiler.get(name, ""))
        for element in root.iter():
            named = element.get("file")
            places = [base / named for base in sorted(bases) if (base / named).is_file()] if named else []
            target = queue if element.tag == "include" else found
            target.extend(place for place in places if place not in found and place not in queue)
    return found


def _parse(path: Path) -> ElementTree.Element:
    if not path.is_file():
        raise BadFile(f"{path}: no such file; expected a MuJoCo model (.xml)")
    try:
        # A file that the user names as their robot model; expat refuses entity bombs since 2.4.
        return ElementTree.parse(path).getroot()
    except (ElementTree.ParseError, UnicodeDecodeError) as error:
        raise BadFile(f"{path}: not a MuJoCo model: {error}") from None


def _compile(path: Path, prepare: Prepare) -> mujoco.MjModel:
    # What it read from files is not asked for again; of a meshed robot that is 150 MB.
    mujoco.mj_setCacheCapacity(mujoco.mj_getCache(), 0)
    try:
        spec = mujoco.MjSpec.from_file(str(path))
        prepare(spec)
        return spec.compile()
    except (ValueError, mujoco.FatalError) as error:
        raise BadFile(f"{path}: MuJoCo refused it: {' '.join(str(error).split())}") from None


def _give_memory_back() -> None:
    """Have the C library give what it freed back to the system: 130 MB after a meshed robot was compiled."""
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)  # of glibc
    if trim is not None:
        trim(0)


_NAME = re.compile(r"(?P<key>[0-9a-f]{64})-(?P<crc>[0-9a-f]{8})\.mjb")


def _from_cache(key: str) -> mujoco.MjModel | None:
    for path in sorted(folder().glob(f"{key}-*.mjb")):
        matched = _NAME.fullmatch(path.name)
        try:
            if matched and zlib.crc32(path.read_bytes()) == int(matched["crc"], 16):
                os.utime(path)  # the clock of `_trim`
                return mujoco.MjModel.from_binary_path(str(path))
            log.warning("%s: torn, is made anew", path)
            path.unlink()
        except (OSError, ValueError) as error:
            log.warning("%s: cannot be used (%s), is made anew", path, error)
    return None


def _keep(model: mujoco.MjModel, key: str) -> None:
    target = folder()
    try:
        target.mkdir(mode=0o700, parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(dir=target, suffix=".part")
        os.close(handle)
        temporary = Path(name)
        try:
            mujoco.mj_saveModel(model, name, None)
            checksum = zlib.crc32(temporary.read_bytes())
            temporary.replace(target / f"{key}-{checksum:08x}.mjb")
        finally:
            temporary.unlink(missing_ok=True)
        _trim(target)
    except OSError as error:  # a full or read-only disk costs seconds at the next start, nothing else
        log.warning("%s: the compiled model is not kept: %s", target, error)


def _trim(target: Path) -> None:
    files = sorted(target.glob("*.mjb"), key=lambda path: path.stat().st_mtime, reverse=True)
    total = 0
    for newest, path in enumerate(files):
        total += path.stat().st_size
        if newest and total > SIZE_LIMIT_BYTES:
            path.unlink(missing_ok=True)
