"""What a collection of files holds: what is built in, and what can be fetched, pinned by revision, size and hash."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from urllib.parse import quote, urlsplit

import msgspec

from station import registry
from station.errors import BadFile

_LOOPBACK = ("127.0.0.1", "::1", "localhost")


class _Strict(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A part of a catalogue: complete, and with nothing that we do not know."""


class PinnedFile(_Strict, frozen=True, kw_only=True):
    """An upstream file as it must be.

    Attributes:
        path: Where it goes, below the collection's folder.
        upstream: Where it is in the upstream repository.
        size_bytes: Its size.
        sha256: Its hash, as hex digits.
    """

    path: str
    upstream: str
    size_bytes: int
    sha256: str

    def __post_init__(self) -> None:
        if not stays_inside(self.path):
            raise ValueError(f"path {self.path!r}: expected one that stays below the collection's folder")
        if not re.fullmatch(r"[0-9a-f]{64}", self.sha256):
            raise ValueError(f"sha256 of {self.path}: expected 64 hex digits, got {self.sha256!r}")
        if self.size_bytes <= 0:
            raise ValueError(f"size_bytes of {self.path}: expected more than 0, got {self.size_bytes}")

    def problem(self, path: Path, *, whole: bool = True) -> str:
        """Return what is wrong with a copy of this file, in a few words; "" when nothing is.

        Args:
            path: The copy.
            whole: Whether all of it is read; otherwise only its size is looked at.
        """
        if not path.is_file():
            return "is not there"
        if (size_bytes := path.stat().st_size) != self.size_bytes:
            return f"has {size_bytes} bytes, {self.size_bytes} expected"
        if whole and (came := sha256(path)) != self.sha256:
            return f"has sha256 {came[:12]}…, {self.sha256[:12]}… expected"
        return ""


class Bundle(_Strict, frozen=True, kw_only=True):
    """Files that are fetched together.

    Attributes:
        name: What ``station assets fetch`` calls it.
        about: What it is.
        licence: Its licence, by SPDX name.
        files: In the order in which they are fetched.
        last_needs_all: Whether the last file is of no use without all others, as a model without its meshes.
    """

    name: str
    about: str
    licence: str
    files: tuple[PinnedFile, ...]
    last_needs_all: bool = False

    @property
    def size_bytes(self) -> int:
        """Size of all its files."""
        return sum(file.size_bytes for file in self.files)


class Upstream(_Strict, frozen=True, kw_only=True):
    """Where files come from.

    Attributes:
        repository: ``owner/name``.
        revision: The commit.
        url: Address of a file; ``{revision}`` and ``{path}`` stand for the two.
    """

    repository: str
    revision: str
    url: str

    def __post_init__(self) -> None:
        address = urlsplit(self.url)
        # What does not leave this machine needs no encryption; a mirror for a trial is often there.
        if address.scheme != "https" and (address.scheme, address.hostname in _LOOPBACK) != ("http", True):
            raise ValueError(f"url {self.url!r}: expected https://")

    def url_of(self, file: PinnedFile) -> str:
        """Return the address of a file."""
        return self.url.replace("{revision}", self.revision).replace("{path}", quote(file.upstream))


def _no_motions() -> Sequence[str]:
    return ()


@dataclass(frozen=True, kw_only=True)
class Collection:
    """What is known of the files behind ``name:``; the name is the one that it is registered under.

    Attributes:
        about: What it is.
        upstream: Where its bundles come from; None when there are none.
        bundles: What can be fetched.
        built_in: Files that are part of the installed program, by relative path.
        licence: Licence of what is built in.
        motions: Returns the names of motions that are made rather than read, so that no file is theirs.
    """

    about: str
    upstream: Upstream | None = None
    bundles: tuple[Bundle, ...] = ()
    built_in: Mapping[str, Path] = field(default_factory=dict)
    licence: str = ""
    motions: Callable[[], Sequence[str]] = _no_motions

    def pinned(self, relative: str) -> tuple[Bundle, PinnedFile] | None:
        """Return the bundle of a file and how it must be; None when it is not pinned."""
        return next(((b, file) for b in self.bundles for file in b.files if file.path == relative), None)


class _Files(_Strict, frozen=True, kw_only=True):
    """A bundle as it is written down: names, sizes and hashes of files that share a folder, here and upstream."""

    name: str
    about: str
    licence: str
    folder: str
    upstream_folder: str
    files: list[tuple[str, int, str]]
    last_needs_all: bool = False

    def bundle(self) -> Bundle:
        files = [
            PinnedFile(
                path=(PurePosixPath(self.folder) / name).as_posix(), size_bytes=size_bytes, sha256=digest,
                upstream=(PurePosixPath(self.upstream_folder) / name).as_posix(),
            )
            for name, size_bytes, digest in self.files
        ]  # fmt: skip
        return Bundle(
            name=self.name, about=self.about, licence=self.licence, files=tuple(files),
            last_needs_all=self.last_needs_all,
        )  # fmt: skip


class _Document(_Strict, frozen=True, kw_only=True):
    about: str
    upstream: Upstream
    bundles: list[_Files]


def read_collection(path: Path) -> Collection:
    """Read a collection of upstream files from a ``.toml`` file, such as ``adapters/catalogue/twist2.toml``.

    Raises:
        BadFile: missing, or not a catalogue; the message says where it is wrong.
    """
    try:
        document = msgspec.toml.decode(path.read_bytes(), type=_Document)
        bundles = tuple(files.bundle() for files in document.bundles)
    except (OSError, ValueError) as error:  # which a DecodeError is, too
        raise BadFile(f"{path}: not a catalogue of files: {error}") from None
    return Collection(about=document.about, upstream=document.upstream, bundles=bundles)


def names() -> list[str]:
    """Return the names of all registered collections, sorted."""
    return registry.names("asset")


def registered(name: str) -> Collection | None:
    """Return the collection of a name, or None when nothing is known of it."""
    if name not in names():
        return None
    collection: Collection = registry.find("asset", name)
    return collection


def stays_inside(relative: str) -> bool:
    """Whether a relative path stays below the folder that it starts in."""
    return not relative.startswith("/") and ".." not in PurePosixPath(relative).parts


def sha256(path: Path) -> str:
    """Return the SHA-256 of a file, as hex digits."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
