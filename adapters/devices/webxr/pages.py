"""The pages of a headset or a phone: one that drives, on a socket of its own, and pictures on another."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Mount, Route, WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.websockets import WebSocket

from adapters.devices.webxr.headset import Headset
from station.clock import Clock
from station.operator.voice import Cue
from station.web import sign_in
from station.web.doorkeeper import Doorkeeper
from station.web.feeds import Feeds
from station.web.keyring import Keyring
from station.web.sockets import SIGNED_OUT, object_of, serve_feeds, until_first
from station.web.stop_route import StopRoute
from station.web.stops import Stops

if TYPE_CHECKING:
    from starlette.types import ASGIApp

    from station.web.web_server import Listening

PAGE = Path(__file__).with_name("page")

_REFUSED = 1008
_FIRST_PINGS, _FIRST_PING_S, _PING_S = 8, 0.02, 0.25
_MOST_TOLD = 32  # that wait for a slow page
_MOST_VIEWERS = 8


class HeadsetPages:
    """The application.

    Args:
        headset: Takes what the page that drives sends.
        listening: Where it is served.
        stops: Presses the stop.
        cameras: Names of the feeds of both eyes, and whether there are two.
        clock: Of the process.

    Attributes:
        app: To be served.
        feeds: Pictures go in here, in the event loop.
    """

    def __init__(
        self, headset: Headset, listening: Listening, stops: Stops, cameras: Mapping[str, str], clock: Clock
    ) -> None:
        keyring = Keyring()
        self.feeds = Feeds()
        self._headset, self._keyring, self._cameras, self._clock = headset, keyring, cameras, clock
        is_secure = listening.url.startswith("https:")
        self._sign_in = sign_in.SignIn(keyring, PAGE / "index.html", listening.server.port, is_secure=is_secure)
        self._viewers = 0
        self._told: asyncio.Queue[dict[str, Any]] | None = None  # of the page that drives
        routes = [
            *self._sign_in.routes,
            Route("/api/me", self._me),
            StopRoute(stops, keyring, "headset").route,
            WebSocketRoute("/ws/pose", self._drive),
            WebSocketRoute("/ws/view", self._view),
            Mount("/page", StaticFiles(directory=sign_in.PAGE)),
            Mount("/xr", StaticFiles(directory=PAGE)),
        ]
        self.app: ASGIApp = Doorkeeper(Starlette(routes=routes), listening.hosts, is_secure=is_secure)

    def tell(self, cue: Cue) -> None:
        """Tell the page that drives what happens."""
        self._say({"t": "cue", "words": cue.words, "tune": cue.tune, "urgent": cue.is_urgent})

    def _say(self, told: dict[str, Any]) -> None:
        if self._told is not None and self._told.qsize() < _MOST_TOLD:
            self._told.put_nowait(told)

    async def _me(self, request: Request) -> Response:
        if self._sign_in.role(request) is None:
            return JSONResponse({"error": "sign in first"}, 401)
        return JSONResponse({"stop_key": self._keyring.stop_key, "eyes": sorted(self._cameras)})

    async def _view(self, socket: WebSocket) -> None:
        if self._sign_in.role(socket) is None or self._viewers >= _MOST_VIEWERS:
            await socket.close(SIGNED_OUT)
            return
        await socket.accept()
        self._viewers += 1
        try:
            await serve_feeds(socket, self.feeds, self._clock)
        finally:
            self._viewers -= 1

    async def _drive(self, socket: WebSocket) -> None:
        if self._sign_in.role(socket) != "operator":
            await socket.close(SIGNED_OUT, "a viewer's page drives nothing; open the operator's link")
            return
        await socket.accept()
        page = self._headset.join()
        if not page:
            await socket.close(_REFUSED, "another page drives; close that one first")
            return
        told: asyncio.Queue[dict[str, Any]] = asyncio.Queue()
        self._told = told
        try:
            await until_first(self._send(socket, told), self._ask_time(page, told), self._receive(socket, page))
        finally:
            self._headset.leave(page)
            if self._told is told:
                self._told = None

    async def _send(self, socket: WebSocket, told: asyncio.Queue[dict[str, Any]]) -> None:
        while True:
            said = await told.get()
            number = self._headset.ping(said["page"]) if said["t"] == "ping" else 0  # asked as it leaves
            await socket.send_text(json.dumps({"t": "ping", "id": number} if number else said))

    async def _ask_time(self, page: int, told: asyncio.Queue[dict[str, Any]]) -> None:
        """Ask the page for its time, often at first; end when another page has its place."""
        asked = 0
        while self._headset.is_driving(page):
            if told.qsize() < _MOST_TOLD:
                told.put_nowait({"t": "ping", "page": page})
            asked += 1
            await asyncio.sleep(_FIRST_PING_S if asked < _FIRST_PINGS else _PING_S)

    async def _receive(self, socket: WebSocket, page: int) -> None:
        while True:
            message = await socket.receive()
            if message["type"] == "websocket.disconnect":
                return
            if (data := message.get("bytes")) is not None:
                self._headset.on_frame(page, data)
                continue
            said = object_of(message.get("text") or "")
            kind = said.get("t")
            if kind == "pong" and isinstance(number := said.get("id"), int):
                at = said.get("at_ms")
                self._headset.pong(page, number, float(at) if isinstance(at, int | float) else float("nan"))
            elif kind == "let-go":
                self._headset.let_go(page, str(said.get("why", "")))
            elif kind == "about":
                about = said.get("about")
                if isinstance(about, dict):
                    self._headset.about(page, {str(name): str(value) for name, value in about.items()})
