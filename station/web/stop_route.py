"""The stop as a POST: for a page that was let in once, whatever became of its cookie."""

from __future__ import annotations

import asyncio
from typing import Any

import msgspec
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route

from station.printable import printable
from station.web.keyring import Keyring
from station.web.sockets import object_of
from station.web.stops import Said, Stops

_TEXT = 500


class StopRoute:
    """Presses the stop for pages.

    Args:
        stops: Presses it.
        keyring: Knows the key of the stop, which never expires.
        what: What the pages are of, for the reason that is recorded.

    Attributes:
        route: Of the POST.
    """

    def __init__(self, stops: Stops, keyring: Keyring, what: str = "console") -> None:
        self._stops, self._keyring, self._what = stops, keyring, what
        self.route = Route("/stop", self._stop, methods=["POST"])

    async def press(self, press: str, where: str) -> dict[str, Any]:
        """Press it with an id, for a page at an address; return what became of it, as a page is told."""
        reason = f"{self._what}, a page on {printable(where, 60)}"
        return said(press, await asyncio.wrap_future(self._stops.press(press, reason)))

    async def _stop(self, request: Request) -> Response:
        if not self._keyring.is_stop_key(request.headers.get("x-station-stop", "")):
            return JSONResponse({"error": "no key of the stop; press the robot's own"}, 403)
        press = str(object_of(await request.body()).get("id", ""))[:80]
        if not press:
            return JSONResponse({"error": "expected an id"}, 400)
        told = await self.press(press, request.client.host if request.client else "")
        status = 200 if told["said"] == "taken" else 503
        return Response(msgspec.json.encode(told), status, media_type="application/json")


def said(press: str, what: Said) -> dict[str, Any]:
    """Return what became of a press, as a page is told."""
    return {"id": press, "said": what.outcome, "text": printable(what.text, _TEXT)}
