"""The door in front of the server: every request and every WebSocket goes through here (ASGI)."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Iterable, MutableMapping
from typing import Any
from urllib.parse import parse_qs

from lfield.operator.web.door import OLD_LINK, Door, Knock

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


class Gate:
    """An application (ASGI) behind a door. `entered` is called when a link was used: the next is another.

    `known` is told who has brought a session, by the address and port of that connection.
    """

    def __init__(
        self,
        app: App,
        door: Door,
        cookie: str,
        entered: Callable[[], None],
        known: Callable[[tuple[str, int]], None],
    ) -> None:
        self._app, self._door, self._entered, self._known = app, door, entered, known
        # A cookie of that name comes from https alone, browsers see to it, and from this very host.
        self._cookie = f"__Host-{cookie}" if door.secure else cookie

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
            return
        knock = self._knock(scope)
        token = _token(scope)
        if token is not None and not self._door.wrong_address(knock):
            await self._enter(token, knock, send)
        elif refusal := self._door.refusal(knock):
            await _refuse(scope, refusal, send)
        else:
            self._known(scope["client"])
            await self._app(scope, receive, _with_policy(send))

    def _knock(self, scope: Scope) -> Knock:
        headers = {name: value.decode("latin-1") for name, value in scope["headers"]}
        acts = scope["type"] == "websocket" or scope["method"] not in ("GET", "HEAD")
        sessions = cookie_values(scope["headers"], self._cookie)
        return Knock(headers.get(b"host", ""), headers.get(b"origin", ""), sessions, acts)

    async def _enter(self, token: str, knock: Knock, send: Send) -> None:
        session = self._door.enter(token)
        if session is None and self._door.refusal(knock):
            await _answer(send, 403, OLD_LINK)
            return
        headers = [(b"location", b"/")]
        if session is not None:
            cookie = f"{self._cookie}={session}; Path=/; HttpOnly; SameSite=Strict"
            cookie += "; Secure" if self._door.secure else ""
            headers.append((b"set-cookie", cookie.encode()))
            self._entered()
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
