"""Who may talk to the gateway: checks Host, Origin and the token of every request, and sets the security headers.

Host must be in a list, which defeats DNS rebinding. Origin must be in it too, for each socket and each POST: another
page in the same browser cannot command. The token is in a cookie that no script can read. Files of the page itself
need no token; they hold nothing.
"""

from __future__ import annotations

import secrets
from collections.abc import Collection
from http.cookies import CookieError, SimpleCookie

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import JSONResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

OPEN = ("/static/", "/session")  # paths that need no token, beside "/"
WRONG_ORIGIN, NO_TOKEN = 4403, 4401  # close codes of sockets


def policy(port: int, nonce: str) -> str:
    """The Content-Security-Policy: no inline script, nothing from elsewhere; styles by nonce, for the editor."""
    sockets = f"ws://127.0.0.1:{port} ws://localhost:{port}"  # a policy cannot name an IPv6 address
    return (
        f"default-src 'none'; script-src 'self'; style-src 'self' 'nonce-{nonce}'; img-src 'self' blob:; "
        f"connect-src 'self' {sockets}; font-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    )


def hosts(port: int, added: Collection[str] = ()) -> list[str]:
    """The values of Host that are accepted."""
    return [*(f"{name}:{port}" for name in ("127.0.0.1", "localhost", "[::1]")), *added]


class AccessCheck:
    """ASGI middleware. `added`: further values of Host, NAME:PORT, of a proxy or a tunnel."""

    def __init__(self, app: ASGIApp, *, port: int, token: str, cookie: str, added: Collection[str] = ()) -> None:
        self._app, self._port, self._token, self._cookie = app, port, token, cookie
        self._hosts = set(hosts(port, added))
        self._origins = {f"{scheme}://{host}" for host in self._hosts for scheme in ("http", "https")}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] not in ("http", "websocket"):
            return await self._app(scope, receive, send)
        if (refused := self._refusal(scope)) is not None:
            return await _refuse(scope, receive, send, *refused)
        if scope["type"] == "websocket":
            return await self._app(scope, receive, send)
        nonce = scope.setdefault("state", {})["nonce"] = secrets.token_urlsafe(16)

        async def with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                headers["Content-Security-Policy"] = policy(self._port, nonce)
                headers["X-Content-Type-Options"] = "nosniff"
                headers["Referrer-Policy"] = "no-referrer"
                headers["Cross-Origin-Opener-Policy"] = "same-origin"
                headers["Cross-Origin-Resource-Policy"] = "same-origin"
                headers.setdefault("Cache-Control", "no-store")
            await send(message)

        return await self._app(scope, receive, with_headers)

    def _refusal(self, scope: Scope) -> tuple[int, int, str] | None:
        """HTTP status, close code and reason; None if the request is admitted."""
        headers = Headers(scope=scope)
        if headers.get("host", "") not in self._hosts:
            return 403, WRONG_ORIGIN, "this name of the host is not in the list of the console"
        origin, acts = headers.get("origin"), scope["type"] == "websocket" or scope["method"] not in ("GET", "HEAD")
        if (acts or origin is not None) and origin not in self._origins:
            return 403, WRONG_ORIGIN, "a page of another origin may not use the console"
        if scope["path"] == "/" or scope["path"].startswith(OPEN) or self._has_token(headers):
            return None
        return 401, NO_TOKEN, "open the link that `rtc console` has printed"

    def _has_token(self, headers: Headers) -> bool:
        try:
            given = SimpleCookie(headers.get("cookie", "")).get(self._cookie)
        except CookieError:
            return False
        return given is not None and same(given.value, self._token)


def same(a: str, b: str) -> bool:
    """Compare two secrets in constant time."""
    return secrets.compare_digest(a.encode(), b.encode())


async def _refuse(scope: Scope, receive: Receive, send: Send, status: int, code: int, reason: str) -> None:
    if scope["type"] == "http":
        return await JSONResponse({"error": reason}, status)(scope, receive, send)
    await receive()  # websocket.connect
    return await send({"type": "websocket.close", "code": code, "reason": reason})
