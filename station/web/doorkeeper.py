"""Who is let in to a page, and from where: an ASGI application around another one.

Hosts are compared, so that a name which a stranger's DNS points here opens nothing; origins with their port, since a
browser sends a cookie to every port of a host. What a page of another origin asks is refused, and none ever gets a
header that would let it read an answer.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from http.cookies import CookieError, SimpleCookie
from typing import TYPE_CHECKING, Any

from station.web.keyring import Keyring, Role

if TYPE_CHECKING:
    from starlette.types import ASGIApp, Message, Receive, Scope, Send

_LARGEST = 64 << 10  # bytes of what is asked
_SAFE = ("GET", "HEAD")


class Doorkeeper:
    """Refuses what a page of ours would not send.

    Args:
        app: The pages.
        hosts: Names and addresses that a page may be opened as, without ports; ``*`` for any.
        is_secure: Whether the pages are served with TLS.
    """

    def __init__(self, app: ASGIApp, hosts: Collection[str], *, is_secure: bool) -> None:
        self._app, self._hosts, self._is_secure = app, frozenset(hosts), is_secure

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass on what may come in."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        if why := self._why_not(scope):
            await _refuse(scope, send, why)
            return

        async def sent(message: Message) -> None:
            if message["type"] == "http.response.start":
                message["headers"] = [*message.get("headers", ()), *self._headers(scope)]
            await send(message)

        await self._app(scope, receive, sent)

    def _why_not(self, scope: Scope) -> str:
        given = headers(scope)
        host = given.get("host", "")
        if _without_port(host) not in self._hosts and "*" not in self._hosts:
            return "this name of the machine is not known here; open the link that the console printed"
        if scope["type"] == "http" and scope["method"] in _SAFE:
            return ""
        ours = f"{'https' if self._is_secure else 'http'}://{host}"
        if given.get("origin") != ours:
            return "another origin"
        if scope["type"] == "websocket":
            return ""
        if given.get("x-station") != "1" or not given.get("content-type", "").startswith("application/json"):
            return "not from a page of ours"
        length = given.get("content-length", "")
        return "" if length.isdigit() and int(length) <= _LARGEST else f"expected at most {_LARGEST} bytes"

    def _headers(self, scope: Scope) -> Iterable[tuple[bytes, bytes]]:
        host = headers(scope).get("host", "")
        socket = f"{'wss' if self._is_secure else 'ws'}://{host}"
        policy = (
            f"default-src 'self'; img-src 'self' blob:; connect-src 'self' {socket}; object-src 'none'; "
            "base-uri 'none'; form-action 'self'; frame-ancestors 'none'"
        )
        yield b"content-security-policy", policy.encode("latin-1", "replace")
        yield b"x-content-type-options", b"nosniff"
        yield b"referrer-policy", b"no-referrer"
        yield b"cross-origin-opener-policy", b"same-origin"
        yield b"cross-origin-resource-policy", b"same-origin"


class Cookies:
    """The cookie that a page is known again by.

    Args:
        keys: Know its tokens.
        port: Of the server, part of the cookie's name: cookies know no ports.
        is_secure: Whether the pages are served with TLS.
    """

    def __init__(self, keys: Keyring, port: int, *, is_secure: bool) -> None:
        self._keys, self._is_secure = keys, is_secure
        self._name = f"{'__Host-' if is_secure else ''}station-{port}"

    def role(self, scope: Scope) -> Role | None:
        """Return the role that a request's cookie gives; None without one."""
        cookie = SimpleCookie()
        try:
            cookie.load(headers(scope).get("cookie", ""))
        except CookieError:
            return None
        found = cookie.get(self._name)
        return self._keys.role_of(found.value) if found is not None else None

    def header(self, token: str) -> str:
        """Return the header that gives a browser its cookie, for a month."""
        secure = "; Secure" if self._is_secure else ""
        return f"{self._name}={token}; Path=/; Max-Age=2592000; HttpOnly; SameSite=Strict{secure}"


def headers(scope: Scope) -> dict[str, str]:
    """Return the headers of a request by their names in small letters; of one that comes twice the last."""
    found: list[tuple[bytes, bytes]] = scope["headers"]
    return {name.decode("latin-1").lower(): value.decode("latin-1") for name, value in found}


def _without_port(host: str) -> str:
    if host.startswith("["):
        return host[1:].partition("]")[0]
    return host.partition(":")[0].lower()


async def _refuse(scope: Scope, send: Send, why: str) -> None:
    if scope["type"] == "websocket":
        await send({"type": "websocket.close", "code": 1008, "reason": why[:100]})
        return
    body = f"refused: {why}\n".encode()
    sent: list[Any] = [(b"content-type", b"text/plain; charset=utf-8"), (b"content-length", str(len(body)).encode())]
    await send({"type": "http.response.start", "status": 403, "headers": sent})
    await send({"type": "http.response.body", "body": body})
