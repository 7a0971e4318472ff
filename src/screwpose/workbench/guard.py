"""Who may ask: this machine's own pages, or those who know the token; and no more than a case's files at once.

A page of another site can send requests to a server on this machine, and a name that it controls can point here. So
the Host must be ours, and so must the Origin of whatever changes something or opens a socket.
"""

import hmac
from collections.abc import Sequence
from http.cookies import CookieError, SimpleCookie
from urllib.parse import parse_qs, quote, urlsplit

from starlette.responses import PlainTextResponse, RedirectResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

LOOPBACK = ("127.0.0.1", "localhost", "::1", "[::1]")
LARGEST_UPLOAD_BYTES = 200 * 2**20
COOKIE = "screwpose-token"
_SAFE_METHODS = {"GET", "HEAD", "OPTIONS"}
# NiceGUI writes its start-up script and styles into the page, compiles Vue's templates in the browser, and three.js
# reads its pictures through blobs; nothing may come from, or go to, another place.
POLICY = (
    "default-src 'self'; script-src 'self' 'unsafe-inline' 'unsafe-eval'; style-src 'self' 'unsafe-inline'; "
    "img-src 'self' data: blob:; font-src 'self' data:; connect-src 'self' ws://{host} wss://{host}; worker-src 'self' "
    "blob:; object-src 'none'; base-uri 'none'; form-action 'self'; frame-ancestors 'none'"
)


class Guard:
    """An ASGI application before another: it lets through what may pass.

    Parameters
    ----------
    hosts : names under which this server may be asked.
    token : what every request must know; None on the loopback.
    """

    def __init__(self, app: ASGIApp, hosts: Sequence[str], port: int, token: str | None) -> None:
        self._app = app
        self._hosts = {one.lower() for one in hosts}
        self._port = port
        self._token = token

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        headers = {key.decode("latin-1"): value.decode("latin-1") for key, value in scope["headers"]}
        problem = self._problem(scope, headers)
        if problem is not None:
            await _refuse(scope, receive, send, *problem)
            return
        if self._token is not None and scope["type"] == "http" and _asked_token(scope):
            # Out of the address, where it would stay in the history, into a cookie that no script can read.
            response = RedirectResponse(quote(scope["path"]), 303)
            response.set_cookie(COOKIE, self._token, httponly=True, samesite="strict")
            await response(scope, receive, send)
            return
        await self._app(scope, _limited(receive), _with_headers(send, headers.get("host", "")))

    def _problem(self, scope: Scope, headers: dict[str, str]) -> tuple[int, str] | None:
        if not self._is_ours(headers.get("host", "")):
            return 421, "this server does not answer to that name"
        changes = scope["type"] == "websocket" or scope["method"] not in _SAFE_METHODS
        origin = headers.get("origin")
        if origin is not None and not self._is_ours(origin.partition("//")[2]):
            return 403, "a page of another site may not ask"
        if changes and headers.get("sec-fetch-site", "same-origin") not in ("same-origin", "none"):
            return 403, "a page of another site may not ask"
        if self._token is not None and not self._knows_token(scope, headers):
            return 401, "open the address with the token that the server printed"
        length = headers.get("content-length", "0")
        if not length.isdecimal() or int(length[:20]) > LARGEST_UPLOAD_BYTES:
            return 413, f"more than {LARGEST_UPLOAD_BYTES // 2**20} MB at once"
        return None

    def _is_ours(self, netloc: str) -> bool:
        try:
            parts = urlsplit(f"//{netloc}")
            port = parts.port
        except ValueError:
            return False
        return (parts.hostname or "").lower() in self._hosts and (port or 80) == self._port

    def _knows_token(self, scope: Scope, headers: dict[str, str]) -> bool:
        assert self._token is not None
        try:
            cookie = SimpleCookie(headers.get("cookie", "")).get(COOKIE)
        except CookieError:
            cookie = None
        given = _asked_token(scope) or (cookie.value if cookie else "")
        return hmac.compare_digest(given.encode(), self._token.encode())


def _asked_token(scope: Scope) -> str | None:
    values = parse_qs(scope.get("query_string", b"").decode("latin-1")).get("token")
    return values[0] if values else None


async def _refuse(scope: Scope, receive: Receive, send: Send, status: int, words: str) -> None:
    if scope["type"] == "websocket":
        await receive()  # the request to connect
        await send({"type": "websocket.close", "code": 1008, "reason": words})
        return
    await PlainTextResponse(f"screwpose: {words}\n", status)(scope, receive, send)


def _limited(receive: Receive) -> Receive:
    """The same, ending where a body is larger than it may be, whatever it said of its length."""
    seen = 0

    async def limited() -> Message:
        nonlocal seen
        message = await receive()
        seen += len(message.get("body", b"")) if message["type"] == "http.request" else 0
        return {"type": "http.disconnect"} if seen > LARGEST_UPLOAD_BYTES else message

    return limited


def _with_headers(send: Send, host: str) -> Send:
    own = [
        (b"content-security-policy", POLICY.format(host=host).encode("latin-1")),
        (b"x-content-type-options", b"nosniff"),
        (b"referrer-policy", b"no-referrer"),
        (b"cross-origin-resource-policy", b"same-origin"),
        (b"cross-origin-opener-policy", b"same-origin"),
    ]

    async def sending(message: Message) -> None:
        if message["type"] == "http.response.start":
            said = [(bytes(key).lower(), value) for key, value in message.get("headers", [])]
            known = {key for key, _ in said}  # a file that was exported has a stricter policy of its own
            message = {**message, "headers": [*said, *(one for one in own if one[0] not in known)]}
        await send(message)

    return sending
