"""The door in front of the server: every request and every WebSocket goes through here (ASGI)."""

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

#: The browser itself refuses to ask anybody else for anything. Vue makes code of templates in the page.
_POLICY = (
    "default-src 'self'; script-src 'self' 'unsafe-inline' 'unsafe-eval'; style-src 'self' 'unsafe-inline'; "
    "img-src 'self' data:; font-src 'self' data:; connect-src 'self'; object-src 'none'; base-uri 'none'; "
    "form-action 'self'; frame-ancestors 'none'"
)
_HEADERS = [
    (b"content-security-policy", _POLICY.encode()),
    (b"referrer-policy", b"no-referrer"),
    (b"x-content-type-options", b"nosniff"),
]


class AuthMiddleware:
    """An application (ASGI) behind a door. `on_login` is called when a link was used: the next is another.

    `on_authenticated` is told who has brought a session, by the address and port of that connection.
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
        # A cookie of that name comes from https alone, browsers see to it, and from this very host.
        self._cookie = f"__Host-{cookie}" if page_sessions.secure else cookie

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
            return
        knock = self._request(scope)
        token = _token(scope)
        if token is not None and not self._page_sessions.address_refusal(knock):
            await self._log_in(token, knock, send)
        elif refusal := self._page_sessions.refusal(knock):
            await _refuse(scope, refusal, send)
        else:
            self._on_authenticated(scope["client"])
            await self._app(scope, receive, _with_policy(send))

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
        # The link does not stay in the address bar.
        await _answer(send, 303, "", headers)


def cookie_values(headers: Iterable[tuple[bytes, bytes]], name: str) -> tuple[str, ...]:
    """The values of all cookies of that name in the `cookie` headers of a request (RFC 6265, section 5.4).

    Browsers send the cookies of every program on the same address, whatever its port. Their text is not
    parsed: a browser accepts cookies that do not follow the grammar, and `http.cookies` then finds none.
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


def _with_policy(send: Send) -> Send:
    async def sent(message: Message) -> None:
        if message["type"] == "http.response.start":
            message["headers"] = [*message["headers"], *_HEADERS]
        await send(message)

    return sent


async def _refuse(scope: Scope, why: str, send: Send) -> None:
    if scope["type"] == "websocket":
        await send({"type": "websocket.close", "code": 1008, "reason": "refused"})
    else:
        await _answer(send, 403, why)


async def _answer(
    send: Send, status: int, text: str, headers: list[tuple[bytes, bytes]] | None = None
) -> None:
    kind = [(b"content-type", b"text/plain; charset=utf-8"), (b"cache-control", b"no-store")]
    start = {"type": "http.response.start", "status": status, "headers": [*kind, *_HEADERS, *(headers or [])]}
    await send(start)
    await send({"type": "http.response.body", "body": text.encode()})
