"""Fetching pinned files into the user's cache: what has not its pinned size and hash never gets its name there."""

from __future__ import annotations

import fcntl
import hashlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

import msgspec

from station.assets import collection as collections
from station.assets import places
from station.assets.collection import Bundle, Collection, PinnedFile, Upstream
from station.errors import AssetMissing, BadFile, UnknownName

_PARTIAL, _LOCK = ".partial", "lock"
_CONNECT_S, _SILENCE_S = 10.0, 30.0
_CHUNK_BYTES = 1 << 16
_ROOM = "make room, or name another cache with XDG_CACHE_HOME"
_OTHER = "it is another file, and nothing of it was kept"

OnBytes = Callable[[int], None]
"""Called with the number of bytes that just came."""


class WantedFile(msgspec.Struct, frozen=True, kw_only=True):
    """A pinned file that is asked for.

    Attributes:
        reference: Its name.
        file: How it must be.
        url: Where it comes from.
        target: Where it goes.
        here: A good copy that is found already; None when there is none.
        shadow: Another file, below ``$STATION_ASSETS``, that the reference leads to before it comes to `target`.
    """

    reference: str
    file: PinnedFile
    url: str
    target: Path
    here: Path | None = None
    shadow: Path | None = None


class FetchRequest(msgspec.Struct, frozen=True, kw_only=True):
    """A bundle that is asked for, and its files.

    Attributes:
        bundle: What is asked for.
        upstream: Where it comes from.
        folder: Where it goes, below which `Bundle.files` have their paths.
        wants: A `WantedFile` per file of the bundle.
    """

    bundle: Bundle
    upstream: Upstream
    folder: Path
    wants: list[WantedFile]

    @property
    def missing(self) -> list[WantedFile]:
        """What has to come."""
        return [want for want in self.wants if want.here is None]


def orders(names: Sequence[str]) -> list[FetchRequest]:
    """Return the bundles that some names ask for, each once.

    Args:
        names: Of bundles, of collections, or references of pinned files.

    Raises:
        UnknownName: nothing that can be fetched is called so.
        AssetMissing: ``$STATION_ASSETS`` is set to what is no folder.
    """
    registered = {key: collections.registered(key) for key in collections.names()}
    every = [(key, known, bundle) for key, known in registered.items() if known for bundle in known.bundles]
    chosen: dict[tuple[str, str], tuple[Collection, Bundle]] = {}
    for name in names:
        found = {(key, b.name): (known, b) for key, known, b in every if _asks_for(name, key, b)}
        if not found:
            raise UnknownName("asset to fetch", name, [bundle.name for _, _, bundle in every])
        chosen |= found
    return [order(key, known, bundle) for (key, _), (known, bundle) in chosen.items()]


def order(name: str, known: Collection, bundle: Bundle) -> FetchRequest:
    """Find which files of a bundle are here, whole and unchanged.

    Args:
        name: Name of the collection.
        known: The collection.
        bundle: What is wanted of it.
    """
    assert known.upstream is not None, f"collection {name} has bundles, so it says where they come from"
    wants = []
    for file in bundle.files:
        copies = [folder / file.path for _, folder in places.folders(name)]
        here = next((path for path in copies if not file.problem(path)), None)
        shadow = next((path for path in copies[:-1] if path.exists() and path != here), None)
        want = WantedFile(
            reference=f"{name}:{file.path}", file=file, url=known.upstream.url_of(file), target=copies[-1], here=here,
            shadow=shadow,
        )  # fmt: skip
        wants.append(want)
    return FetchRequest(bundle=bundle, upstream=known.upstream, folder=places.cache() / name, wants=wants)


def _asks_for(name: str, collection: str, bundle: Bundle) -> bool:
    return name in (bundle.name, collection) or any(name == f"{collection}:{file.path}" for file in bundle.files)


def download(wants: Iterable[WantedFile], *, on_bytes: OnBytes = lambda _: None) -> None:
    """Fetch files one after the other; each gets its name when it is whole and its hash is right.

    Raises:
        AssetMissing: the server cannot be reached, has no such file or broke off; or the cache cannot be written.
        BadFile: what came is not the pinned file.
    """
    with _partial() as folder:
        for want in wants:
            try:
                got = _get(want, folder, on_bytes)
                want.target.parent.mkdir(parents=True, exist_ok=True)
                got.replace(want.target)
            except OSError as error:
                raise AssetMissing(f"{want.target}: cannot be written: {error.strerror or error}; {_ROOM}") from error


@contextmanager
def _partial() -> Iterator[Path]:
    """Hold the folder of what is on its way; what a fetch that was killed has left there is removed."""
    folder = places.cache() / _PARTIAL
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        lock = (folder / _LOCK).open("ab")
    except OSError as error:
        raise AssetMissing(f"{folder}: cannot be written: {error.strerror}; {_ROOM}") from error
    with lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            raise AssetMissing(
                f"{folder}: another `station assets fetch` is at work there ({error.strerror}); wait until it is done"
            ) from error
        for left in folder.iterdir():
            if left.name != _LOCK:
                left.unlink()
        yield folder


def _get(want: WantedFile, folder: Path, on_bytes: OnBytes) -> Path:
    """Download a file below another name, and return it when it is the pinned one."""
    import pooch

    pooch.get_logger().setLevel("WARNING")  # it tells every download, and so do we
    name = want.file.sha256

    def through(_url: str, part: str, _pooch: object) -> None:
        with open(part, "wb") as stream:
            _transfer(want, stream, on_bytes)

    return Path(pooch.retrieve(want.url, f"sha256:{name}", fname=name, path=folder, downloader=through))


def _transfer(want: WantedFile, stream: BinaryIO, on_bytes: OnBytes) -> None:
    """Write what a server sends, and refuse what is not the pinned file."""
    import requests

    url, by_hand = want.url, f"get it on another machine and put it at {want.target}"
    came = _Came(want)
    try:
        with requests.Session() as session, session.get(url, stream=True, timeout=(_CONNECT_S, _SILENCE_S)) as answer:
            answer.raise_for_status()
            for chunk in answer.iter_content(_CHUNK_BYTES):
                came.add(chunk)
                stream.write(chunk)
                on_bytes(len(chunk))
    except requests.HTTPError as error:
        status = f"{error.response.status_code} {error.response.reason}"
        raise AssetMissing(f"{url}: the server answered {status}; {by_hand}") from error
    except requests.RequestException as error:
        if came.count:
            raise AssetMissing(f"{url}: {came.broken_off()}; try again, or {by_hand}") from error
        raise AssetMissing(f"{url}: could not be reached ({_reason(error)}); {by_hand}") from error
    came.check()


class _Came:
    """What has come of a file so far."""

    def __init__(self, want: WantedFile) -> None:
        self.count = 0
        self._file, self._url = want.file, want.url
        self._hash = hashlib.sha256()

    def add(self, chunk: bytes) -> None:
        """Count and hash what comes next; refuse more than there should be, however much more follows."""
        self.count += len(chunk)
        if self.count > self._file.size_bytes:
            raise BadFile(f"{self._url}: more than the pinned {self._file.size_bytes} bytes came; {_OTHER}")
        self._hash.update(chunk)

    def check(self) -> None:
        """Refuse what is not the pinned file."""
        if self.count < self._file.size_bytes:
            raise AssetMissing(f"{self._url}: {self.broken_off()}; try again")
        if (came := self._hash.hexdigest()) != self._file.sha256:
            raise BadFile(f"{self._url}: sha256 {came[:12]}… came, {self._file.sha256[:12]}… is pinned; {_OTHER}")

    def broken_off(self) -> str:
        """Report how much came."""
        return f"broke off after {self.count} of {self._file.size_bytes} bytes"


def _reason(error: BaseException) -> str:
    """Return the words of the system for what a network library wrapped several times over."""
    words, cause = type(error).__name__, error.__context__
    while cause is not None:
        if isinstance(cause, OSError):
            words = cause.strerror or str(cause)
        cause = cause.__context__
    return words
