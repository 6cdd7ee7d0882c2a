"""Pictures, poses and curves for many viewers: of each feed the newest, and one on its way to each viewer.

A viewer says when it has used a frame; only then the next one goes out to it, the newest there is. So a slow line gets
fewer frames and no old ones, and delays nobody. All runs in the event loop; `Feeds.wanted` may be read in any thread.
"""

from __future__ import annotations

import asyncio
import json
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

MOST_WANTED = 32
"""Feeds that a viewer may follow at once."""

_ALIGNED = 8


class Frame(NamedTuple):
    """A frame: what is said of it, and its bytes; `taken_s` is when, on the monotonic clock [s], for its age."""

    facts: Mapping[str, Any]
    payload: bytes
    taken_s: float

    def packed(self, now_s: float) -> bytes:
        """Return it as it goes to a page: length of the header, header, payload; the age is that at this instant."""
        header = json.dumps({**self.facts, "age_ms": round((now_s - self.taken_s) * 1e3, 1)}).encode()
        padded = header.ljust(-(-(4 + len(header)) // _ALIGNED) * _ALIGNED - 4)
        return len(padded).to_bytes(4, "little") + padded + self.payload


class Feeds:
    """The newest frame of each feed, by name, and who follows which."""

    def __init__(self) -> None:
        self._newest: dict[str, tuple[int, Frame]] = {}
        self._count = 0
        self._viewers: frozenset[Viewer] = frozenset()  # replaced, never changed: `wanted` goes through it

    @property
    def wanted(self) -> frozenset[str]:
        """Names of the feeds that somebody follows."""
        return frozenset(name for viewer in self._viewers for name in viewer.wanted)

    def put(self, frames: Mapping[str, Frame]) -> None:
        """Take newer frames of some feeds."""
        for name, frame in frames.items():
            self._count += 1
            self._newest[name] = self._count, frame
        for viewer in self._viewers:
            viewer.wake(frames)

    def newest(self, name: str) -> tuple[int, Frame] | None:
        """Return the newest frame of a feed with its number, which only grows; None where there is none."""
        return self._newest.get(name)

    def join(self) -> Viewer:
        """Return a new viewer, that follows nothing yet."""
        viewer = Viewer(self)
        self._viewers |= {viewer}
        return viewer

    def leave(self, viewer: Viewer) -> None:
        """Forget a viewer."""
        self._viewers -= {viewer}


class Viewer:
    """One page: what it follows, and what is on its way to it."""

    def __init__(self, feeds: Feeds) -> None:
        self._feeds = feeds
        self.wanted: frozenset[str] = frozenset()
        self._own: dict[str, Frame] = {}  # of feeds that are this one's alone, until they go out
        self._sent: dict[str, int] = {}  # number of the last frame of a feed
        self._under_way: set[str] = set()
        self._woken = asyncio.Event()

    def want(self, names: Iterable[str]) -> None:
        """Follow these feeds and no others."""
        self.wanted = frozenset(list(names)[:MOST_WANTED])
        self._sent = {name: number for name, number in self._sent.items() if name in self.wanted}
        self._under_way &= self.wanted
        self._woken.set()

    def got(self, name: str) -> None:
        """Take note that the page has used the frame of a feed that was on its way."""
        self._under_way.discard(name)
        self._woken.set()

    def put(self, frame: Frame) -> None:
        """Take a newer frame of a feed that is this viewer's alone."""
        self._own[frame.facts["f"]] = frame
        self._woken.set()

    def is_waiting(self, name: str) -> bool:
        """Whether a frame of a feed of its own has not gone out yet."""
        return name in self._own

    def drop(self) -> None:
        """Forget the frames of its own."""
        self._own.clear()

    def wake(self, names: Iterable[str]) -> None:
        """Look for what is new, where any of these feeds is followed and free."""
        if any(name in self.wanted and name not in self._under_way for name in names):
            self._woken.set()

    def take(self) -> tuple[str, Frame] | None:
        """Return the next frame that may go out now, the one of the feed that waited longest; None where none may."""
        for name in self._own:
            if name in self.wanted and name not in self._under_way:
                self._under_way.add(name)
                return name, self._own.pop(name)
        ready = [
            (self._sent.get(name, 0), name)
            for name in self.wanted - self._under_way
            if (found := self._feeds.newest(name)) is not None and found[0] > self._sent.get(name, 0)
        ]
        if not ready or (found := self._feeds.newest(name := min(ready)[1])) is None:
            return None
        self._sent[name] = found[0]
        self._under_way.add(name)
        return name, found[1]

    async def next(self) -> tuple[str, Frame]:
        """Wait for the next frame that may go out."""
        while (found := self.take()) is None:
            self._woken.clear()
            await self._woken.wait()
        return found
