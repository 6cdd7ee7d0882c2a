"""How a browser is let in: by a link with a token, or by a code that somebody types, and is known again by a cookie.

A headset has no keyboard worth the name, so the code is short. It is another one every five minutes, and who guesses is
stopped after a few.
"""

from __future__ import annotations

import time
from pathlib import Path

from starlette.requests import HTTPConnection, Request
from starlette.responses import FileResponse, JSONResponse, PlainTextResponse, RedirectResponse, Response
from starlette.routing import BaseRoute, Route

from station.web.doorkeeper import Cookies
from station.web.keyring import CODE_S, Keyring, Role
from station.web.sockets import object_of

PAGE = Path(__file__).with_name("page")

_MOST_WRONG = 10  # codes in `CODE_S`: who guesses has one chance in a hundred thousand
_NO_CACHE = {"cache-control": "no-cache"}


class SignIn:
    """The page for those who are let in, and the one where they are.

    Args:
        keyring: Knows tokens and codes.
        page: File of the page.
        port: Of the server.
        is_secure: Whether it is served with TLS.

    Attributes:
        routes: Of the page and of the code.
    """

    def __init__(self, keyring: Keyring, page: Path, port: int, *, is_secure: bool) -> None:
        self._keyring, self._page = keyring, page
        self._cookies = Cookies(keyring, port, is_secure=is_secure)
        self._wrong: list[float] = []
        self.routes: list[BaseRoute] = [Route("/", self._open), Route("/pair", self._pair, methods=["POST"])]

    def role(self, request: HTTPConnection) -> Role | None:
        """Return the role of who asks; None for somebody who was not let in."""
        return self._cookies.role(request.scope)

    async def _open(self, request: Request) -> Response:
        token = request.query_params.get("token")
        if token is not None:
            if self._keyring.role_of(token) is None:
                return PlainTextResponse("This link is no longer valid: `station pair` prints the one of today.\n", 403)
            answer: Response = RedirectResponse("/", 303)
            answer.headers["set-cookie"] = self._cookies.header(token)
            return answer
        if self.role(request) is None:
            return FileResponse(PAGE / "sign-in.html", 401, headers=_NO_CACHE)
        return FileResponse(self._page, headers=_NO_CACHE)

    async def _pair(self, request: Request) -> Response:
        now_s = time.monotonic()
        self._wrong = [at_s for at_s in self._wrong if now_s - at_s < CODE_S]
        if len(self._wrong) >= _MOST_WRONG:
            wait_min = (CODE_S - (now_s - self._wrong[0])) / 60.0
            return JSONResponse({"error": f"too many wrong codes; in {wait_min:.0f} min again"}, 429)
        code = "".join(str(object_of(await request.body()).get("code", "")).split())
        if not self._keyring.is_code(code, time.time()):
            self._wrong.append(now_s)
            return JSONResponse({"error": "not the code of now: `station pair` prints it"}, 403)
        answer = JSONResponse({"ok": True})
        answer.headers["set-cookie"] = self._cookies.header(self._keyring.token("operator"))
        return answer
