"""What all sockets of pages have in common."""

from __future__ import annotations

import asyncio
import contextlib
import json
from collections.abc import Awaitable
from typing import TYPE_CHECKING, Any

from starlette.websockets import WebSocket, WebSocketDisconnect

from station.clock import Clock
from station.web.feeds import Feeds

if TYPE_CHECKING:
    from station.web.players import Players

SIGNED_OUT = 4401
"""Code of a socket that is closed because its page was not let in."""


async def serve_feeds(socket: WebSocket, feeds: Feeds, clock: Clock, players: Players | None = None) -> None:
    """Send a page the frames that it asks for, one of each feed under way, until it goes.

    Args:
        socket: Of the page.
        feeds: What is live.
        clock: For the age of what is sent.
        players: Play episodes to it; None for a page that shows none.
    """
    viewer = feeds.join()
    playback = None if players is None else players.join(viewer)

    async def send() -> None:
        while True:
            _, frame = await viewer.next()
            await socket.send_bytes(frame.packed(clock.monotonic_s()))

    async def receive() -> None:
        while True:
            said = object_of(await socket.receive_text())
            if isinstance(want := said.get("want"), list):
                viewer.want(str(name)[:200] for name in want)
            if isinstance(got := said.get("got"), str):
                viewer.got(got)
                if playback is not None:
                    playback.got(got)
            if playback is not None and "play" in said:
                playback.ask(said["play"])

    try:
        await until_first(send(), receive())
    finally:
        if playback is not None:
            playback.close()
        feeds.leave(viewer)


async def until_first(*jobs: Awaitable[None]) -> None:
    """Run some jobs until the first of them ends, as it does when its page goes."""
    tasks = [asyncio.ensure_future(job) for job in jobs]
    try:
        done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        for task in done:
            with contextlib.suppress(WebSocketDisconnect, RuntimeError, KeyError):  # bytes for a text, or the reverse
                task.result()
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


def object_of(text: str | bytes) -> dict[str, Any]:
    """Return the JSON object that a page said; an empty one for what is none."""
    try:
        found = json.loads(text)
    except (ValueError, RecursionError):
        return {}
    return found if isinstance(found, dict) else {}
