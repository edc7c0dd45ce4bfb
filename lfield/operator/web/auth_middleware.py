"""ASGI middleware that authenticates every request and WebSocket by a session cookie or a login link."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Iterable, MutableMapping
from typing import Any
from urllib.parse import parse_qs

from lfield.operator.web.page_sessions import OLD_LINK, PageRequest, PageSessions

Scope = MutableMapping[str, Any]
Message = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[Message]]
Send = Callable[[Message], Awaitable[None]]
App = Callable[[Scope, Receive, Send], Awaitable[None]]

#: The page can contact its own server only, and for pictures a tile server that the operator has named. Vue
#: compiles templates in the page, hence 'unsafe-eval'.
_POLICY = (
    "default-src 'self'; script-src 'self' 'unsafe-inline' 'unsafe-eval'; style-src 'self' 'unsafe-inline'; "
    "img-src 'self' data:%s; font-src 'self' data:; connect-src 'self'; object-src 'none'; base-uri 'none'; "
    "form-action 'self'; frame-ancestors 'none'"
)


class SecurityHeaders:
    """An ASGI application whose answers forbid other servers, except pictures of `tile_origin`."""

    def __init__(self, app: App, tile_origin: str = "") -> None:
        self._app = app
        policy = _POLICY % (f" {tile_origin}" if tile_origin else "")
        self._headers = [
            (b"content-security-policy", policy.encode()),
            (b"referrer-policy", b"no-referrer"),
            (b"x-content-type-options", b"nosniff"),
        ]

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        async def sent(message: Message) -> None:
            if message["type"] == "http.response.start":
                message["headers"] = [*message["headers"], *self._headers]
            await send(message)

        await self._app(scope, receive, sent)


class AuthMiddleware:
    """An ASGI application with authentication. `on_login` is called after a link was used up;
    `on_authenticated` gets the address and port of each peer that has a session.
    """

    def __init__(
        self,
        app: App,
        page_sessions: PageSessions,
        cookie: str,
        on_login: Callable[[], None],
        on_authenticated: Callable[[tuple[str, int]], None],
    ) -> None:
        self._app, self._page_sessions, self._on_login, self._on_authenticated = (
            app,
            page_sessions,
            on_login,
            on_authenticated,
        )
        # Browsers accept a cookie with this prefix over https only, and only from this host.
        self._cookie = f"__Host-{cookie}" if page_sessions.secure else cookie

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
            return
        request = self._request(scope)
        token = _token(scope)
        if token is not None and not self._page_sessions.address_refusal(request):
            await self._log_in(token, request, send)
        elif refusal := self._page_sessions.refusal(request):
            await _refuse(scope, refusal, send)
        else:
            self._on_authenticated(scope["client"])
            await self._app(scope, receive, send)

    def _request(self, scope: Scope) -> PageRequest:
        headers = {name: value.decode("latin-1") for name, value in scope["headers"]}
        acts = scope["type"] == "websocket" or scope["method"] not in ("GET", "HEAD")
        sessions = cookie_values(scope["headers"], self._cookie)
        return PageRequest(headers.get(b"host", ""), headers.get(b"origin", ""), sessions, acts)

    async def _log_in(self, token: str, request: PageRequest, send: Send) -> None:
        session = self._page_sessions.log_in(token)
        if session is None and self._page_sessions.refusal(request):
            await _answer(send, 403, OLD_LINK)
            return
        headers = [(b"location", b"/")]
        if session is not None:
            cookie = f"{self._cookie}={session}; Path=/; HttpOnly; SameSite=Strict"
            cookie += "; Secure" if self._page_sessions.secure else ""
            headers.append((b"set-cookie", cookie.encode()))
            self._on_login()
        # The redirect removes the token from the address bar.
        await _answer(send, 303, "", headers)


def cookie_values(headers: Iterable[tuple[bytes, bytes]], name: str) -> tuple[str, ...]:
    """The values of all cookies of that name in the `cookie` headers of a request (RFC 6265, section 5.4).

    Browsers send the cookies of all ports of an address. They also accept cookies that violate the grammar,
    with which `http.cookies` finds none, so the values are not parsed further.
    """
    pairs = (
        pair.partition("=")
        for header, value in headers
        if header == b"cookie"
        for pair in value.decode("latin-1").split(";")
    )
    return tuple(value.strip() for key, equals, value in pairs if equals and key.strip() == name)


def _token(scope: Scope) -> str | None:
    if scope["type"] != "http" or scope["path"] != "/" or scope["method"] != "GET":
        return None
    found = parse_qs(scope["query_string"].decode("latin-1")).get("token")
    return found[0] if found else None


async def _refuse(scope: Scope, reason: str, send: Send) -> None:
    if scope["type"] == "websocket":
        await send({"type": "websocket.close", "code": 1008, "reason": "refused"})
    else:
        await _answer(send, 403, reason)


async def _answer(
    send: Send, status: int, text: str, headers: list[tuple[bytes, bytes]] | None = None
) -> None:
    kind = [(b"content-type", b"text/plain; charset=utf-8"), (b"cache-control", b"no-store")]
    start = {"type": "http.response.start", "status": status, "headers": [*kind, *(headers or [])]}
    await send(start)
    await send({"type": "http.response.body", "body": text.encode()})
