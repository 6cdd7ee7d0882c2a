"""What a browser may open: the page and its files, its two sockets, the stop, and what it asks once."""

from __future__ import annotations

import asyncio
import contextlib
import getpass
from collections import deque
from collections.abc import Awaitable, Callable, Collection
from typing import TYPE_CHECKING, Any

import msgspec
from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.requests import HTTPConnection, Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Mount, Route, WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.websockets import WebSocket, WebSocketDisconnect

from station.printable import printable
from station.software import software
from station.web.asks import Ask
from station.web.doorkeeper import Doorkeeper
from station.web.keyring import Role
from station.web.shown import Shown
from station.web.sign_in import PAGE, SignIn
from station.web.sockets import SIGNED_OUT, object_of, serve_feeds, until_first
from station.web.stop_route import StopRoute

if TYPE_CHECKING:
    from starlette.types import ASGIApp

MOST_SOCKETS = 64
_MOST_EVENTS = 500  # that wait for a slow page
_PER_S = 100  # messages of a page, beyond which it waits; a stop never does
_TEXT = 500
_WHOLE = ("state", "keys", "episodes")  # of these only the newest counts


class Pages:
    """The application.

    Args:
        shown: What it shows.
        hosts: Names that it may be opened as.
        port: Its port.
        is_secure: Whether it is served with TLS.

    Attributes:
        app: To be served.
    """

    def __init__(self, shown: Shown, hosts: Collection[str], port: int, *, is_secure: bool) -> None:
        self._shown = shown
        self._sign_in = SignIn(shown.keyring, PAGE / "index.html", port, is_secure=is_secure)
        self._stop = StopRoute(shown.stops, shown.keyring)
        self._news: set[News] = set()
        self._sockets = 0
        self._holder: News | None = None
        routes = [
            *self._sign_in.routes,
            Route("/api/me", self._me),
            Route("/api/scene", self._scene),
            Route("/api/episode", self._episode),
            Route("/api/episode/sheet", self._sheet),
            self._stop.route,
            WebSocketRoute("/ws/news", self._join_news),
            WebSocketRoute("/ws/view", self._join_view),
            Mount("/page", StaticFiles(directory=PAGE)),
        ]
        self.app: ASGIApp = Doorkeeper(Starlette(routes=routes), hosts, is_secure=is_secure)

    @property
    def viewers(self) -> int:
        """How many pages are open."""
        return len(self._news)

    def tell(self, told: dict[str, Any]) -> None:
        """Tell all pages: something, or by its name that one of the whole states is new."""
        for page in self._news:
            page.tell(told)

    # -- Asked once ---------------------------------------------------------------------------------------------------
    async def _me(self, request: Request) -> Response:
        if (role := self._role(request)) is None:
            return _error("sign in first", 401)
        return _json({"role": role, "stop_key": self._shown.keyring.stop_key, "station": self._shown.title,
                      "version": software().version or "unknown"})  # fmt: skip

    async def _scene(self, request: Request) -> Response:
        if self._role(request) is None:
            return _error("sign in first", 401)
        name = request.query_params.get("robot", "")
        found = await run_in_threadpool(self._shown.scene, name)
        return _error(f"no robot {printable(name, 80)!r}", 404) if found is None else _json(found)

    async def _episode(self, request: Request) -> Response:
        if self._role(request) is None:
            return _error("sign in first", 401)
        found = await run_in_threadpool(self._shown.takes.detail, request.query_params.get("id", ""))
        return _error("no such episode", 404) if found is None else _json(found)

    async def _sheet(self, request: Request) -> Response:
        if self._role(request) is None:
            return _error("sign in first", 401)
        found = await run_in_threadpool(self._shown.takes.sheet, request.query_params.get("id", ""))
        return _error("no pictures", 404) if found is None else Response(found, media_type="image/png")

    def _role(self, request: HTTPConnection) -> Role | None:
        return self._sign_in.role(request)

    # -- Sockets ------------------------------------------------------------------------------------------------------
    async def _join_news(self, socket: WebSocket) -> None:
        role = self._role(socket)
        if role is None or self._sockets >= MOST_SOCKETS:
            await socket.close(SIGNED_OUT if role is None else 1013)
            return
        await socket.accept()
        page = News(self, socket, role)
        self._news.add(page)
        self._sockets += 1
        if role == "operator" and self._holder is None:
            self._holder = page
        page.tell({"t": "state"})
        try:
            await until_first(page.send(), page.receive())
        finally:
            self._sockets -= 1
            self._news.discard(page)
            if self._holder is page:
                self._holder = None
            self.tell({"t": "state"})

    async def _join_view(self, socket: WebSocket) -> None:
        if self._role(socket) is None or self._sockets >= MOST_SOCKETS:
            await socket.close(SIGNED_OUT)
            return
        await socket.accept()
        self._sockets += 1
        try:
            await serve_feeds(socket, self._shown.feeds, self._shown.address.clock, self._shown.players)
        finally:
            self._sockets -= 1

    # -- For the sockets of news --------------------------------------------------------------------------------------
    def whole(self, page: News, name: str) -> dict[str, Any]:
        """Return one of the whole states, for a page."""
        if name == "keys":
            return self._shown.keys()
        if name == "episodes":
            return self._shown.episodes()
        holder = self._holder
        desk = {"is_mine": holder is page, "holder": "" if holder is None else holder.who, "viewers": len(self._news)}
        return {**self._shown.state(), "desk": desk}

    def first_words(self) -> list[dict[str, Any]]:
        """Return what a page is told of before it came."""
        return self._shown.events()

    async def answer(self, page: News, said: dict[str, Any]) -> dict[str, Any]:
        """Do what an operator's page asks for; return the answer."""
        try:
            ask = msgspec.convert(said, Ask)
        except (msgspec.ValidationError, ValueError) as error:
            return {
                "t": "answer",
                "id": str(said.get("id", ""))[:80],
                "ok": False,
                "text": printable(str(error), _TEXT),
            }
        done, text = await self._asked(page, ask)
        return {"t": "answer", "id": ask.id, "ok": done, "text": text}

    async def stopped(self, page: News, said: dict[str, Any]) -> dict[str, Any]:
        """Press the stop for a page; return what became of it."""
        press = str(said.get("id", ""))[:80]
        if not press or not self._shown.keyring.is_stop_key(str(said.get("key", ""))):
            return {"t": "stop", "id": press, "said": "not-taken", "text": "no key of the stop; press the robot's own"}
        return {"t": "stop", **await self._stop.press(press, page.where)}

    async def _asked(self, page: News, ask: Ask) -> tuple[bool, str]:
        if page.role != "operator":
            return False, "a viewer's page asks for nothing but the stop; open the operator's link"
        if ask.what == "desk.take":
            self._holder = page
            self.tell({"t": "state"})
            return True, "the desk is yours"
        if self._holder is not page:
            if self._holder is not None:
                return False, f"the desk is with {self._holder.who}; take it first"
            self._holder = page
        return await self._shown.do(ask, page.who)


class News:
    """One page's socket of states, requests and the stop."""

    def __init__(self, pages: Pages, socket: WebSocket, role: Role) -> None:
        self._pages, self._socket, self.role = pages, socket, role
        self.where = socket.client.host if socket.client is not None else "?"
        self.who = f"{getpass.getuser()}@{self.where}"
        self._whole = dict.fromkeys(_WHOLE)
        self._events: deque[dict[str, Any]] = deque(pages.first_words(), maxlen=_MOST_EVENTS)
        self._woken = asyncio.Event()
        self._sending = asyncio.Lock()
        self._running: set[asyncio.Task[None]] = set()

    def tell(self, told: dict[str, Any]) -> None:
        """Have the page told something, soon; of whole states the newest."""
        if told["t"] in _WHOLE:
            self._whole[told["t"]] = None
        else:
            self._events.append(told)
        self._woken.set()

    async def send(self) -> None:
        """Send what is to be told, as fast as the page takes it."""
        while True:
            self._woken.clear()
            while self._whole or self._events:
                if self._whole:
                    name = next(iter(self._whole))
                    del self._whole[name]
                    await self._put(self._pages.whole(self, name))
                else:
                    await self._put(self._events.popleft())
            await self._woken.wait()

    async def receive(self) -> None:
        """Take what the page says; a stop is pressed at once, whatever else it waits for."""
        allowed, loop = float(_PER_S), asyncio.get_running_loop()
        at_s = loop.time()
        while True:
            said = object_of(await self._socket.receive_text())
            kind, now_s = said.get("t"), loop.time()
            allowed, at_s = min(_PER_S, allowed + (now_s - at_s) * _PER_S) - 1, now_s
            if kind == "stop":
                self._begin(self._pages.stopped, said)
            elif allowed < 0:
                await asyncio.sleep(-allowed / _PER_S)
            elif kind == "ping":
                await self._put({"t": "pong", "id": said.get("id") if isinstance(said.get("id"), int) else 0})
            elif kind == "ask":
                self._begin(self._pages.answer, said)

    def _begin(self, act: Callable[[News, dict[str, Any]], Awaitable[dict[str, Any]]], said: dict[str, Any]) -> None:
        async def run() -> None:
            answer = await act(self, said)
            with contextlib.suppress(WebSocketDisconnect, RuntimeError):  # the page is gone; it was done all the same
                await self._put(answer)

        task = asyncio.create_task(run())
        self._running.add(task)
        task.add_done_callback(self._running.discard)

    async def _put(self, told: dict[str, Any]) -> None:
        text = _encoded(told)
        async with self._sending:
            await self._socket.send_text(text)


def _encoded(told: Any) -> str:
    return msgspec.json.encode(told).decode()  # NaN becomes null, as a browser's JSON has none


def _json(told: Any, status: int = 200) -> Response:
    return Response(msgspec.json.encode(told), status, media_type="application/json")


def _error(text: str, status: int) -> Response:
    return JSONResponse({"error": text}, status)
