"""Access to the page: by a link, once each; any other request is refused."""

from __future__ import annotations

import asyncio
from itertools import count
from urllib.parse import quote

import pytest

from lfield.operator.web.auth_middleware import AuthMiddleware, SecurityHeaders, cookie_values
from lfield.operator.web.page_sessions import (
    FOREIGN_ADDRESS,
    FOREIGN_PAGE,
    MAX_SESSIONS,
    NO_SESSION,
    PageRequest,
    PageSessions,
)

HERE = "127.0.0.1:8000"
OURS = f"http://{HERE}"


@pytest.fixture
def door() -> PageSessions:
    secrets = (f"secret-{number}" for number in count())
    return PageSessions((HERE,), lambda: next(secrets))


def test_a_link_opens_one_browser(door):
    first = door.token
    session = door.log_in(first)
    assert session is not None
    assert door.log_in(first) is None
    assert door.refusal(PageRequest(HERE, sessions=(session,))) == ""
    assert door.token != first
    assert door.log_in(door.token) not in (None, session)


@pytest.mark.parametrize("token", ["", "secret", "sécret-0", "secret-00"])
def test_a_wrong_token_opens_no_session(door, token):
    assert door.log_in(token) is None
    assert door.token == "secret-0"


def test_without_a_session_a_request_is_refused(door):
    assert door.refusal(PageRequest(HERE)) == NO_SESSION
    assert door.refusal(PageRequest(HERE, sessions=("guessed",))) == NO_SESSION


def test_a_foreign_host_header_is_refused(door):
    session = door.log_in(door.token)
    assert door.refusal(PageRequest("evil.example:8000", sessions=(session,))) == FOREIGN_ADDRESS
    assert door.refusal(PageRequest("127.0.0.1:9000", sessions=(session,))) == FOREIGN_ADDRESS


@pytest.mark.parametrize("origin", ["", "null", "http://evil.example", "http://127.0.0.1:9000"])
def test_only_our_page_may_act(door, origin):
    session = door.log_in(door.token)
    assert door.refusal(PageRequest(HERE, origin, (session,), is_action=True)) == FOREIGN_PAGE
    assert door.refusal(PageRequest(HERE, OURS, (session,), is_action=True)) == ""


def test_the_oldest_of_too_many_sessions_ends(door):
    sessions = [door.log_in(door.token) for _ in range(MAX_SESSIONS + 1)]
    assert door.refusal(PageRequest(HERE, sessions=(sessions[0],))) == NO_SESSION
    assert all(not door.refusal(PageRequest(HERE, sessions=(session,))) for session in sessions[1:])


# --- the middleware in front of an application ---------------------------------------------------


class Inside:
    """An application that records its requests."""

    def __init__(self) -> None:
        self.asked: list[str] = []

    async def __call__(self, scope, receive, send) -> None:
        self.asked.append(scope.get("path", scope["type"]))
        if scope["type"] == "http":
            await send({"type": "http.response.start", "status": 200, "headers": []})
            await send({"type": "http.response.body", "body": b"in"})


def knock(
    gate: AuthMiddleware, path: str, method: str = "GET", kind: str = "http", **headers: str
) -> list[dict]:
    """The answers of the middleware."""
    path, _, query = path.partition("?")
    fields = {"host": HERE, **headers}
    scope = {
        "type": kind,
        "path": path,
        "method": method,
        "client": ("127.0.0.1", 4711),
        "query_string": query.encode(),
        "headers": [(name.encode(), value.encode("latin-1")) for name, value in fields.items()],
    }
    if kind == "websocket":
        del scope["method"]
    sent: list[dict] = []

    async def send(message) -> None:
        sent.append(message)

    async def receive() -> dict:
        raise AssertionError("nothing is read before somebody is let in")

    asyncio.run(gate(scope, receive, send))
    return sent


@pytest.fixture
def inside() -> Inside:
    return Inside()


@pytest.fixture
def known() -> list[tuple[str, int]]:
    return []


@pytest.fixture
def gate(inside, door, known) -> AuthMiddleware:
    return AuthMiddleware(inside, door, "lfield-8000", lambda: None, known.append)


def entered(gate: AuthMiddleware, address: PageSessions) -> str:
    """The cookie of a browser with a session."""
    (start, _) = knock(gate, f"/?token={quote(address.token)}")
    headers = dict(start["headers"])
    assert (start["status"], headers[b"location"]) == (303, b"/")
    cookie = headers[b"set-cookie"].decode()
    assert "HttpOnly" in cookie
    assert "SameSite=Strict" in cookie
    return cookie.partition(";")[0]


def test_a_link_is_exchanged_for_a_cookie(gate, door, inside, known):
    cookie = entered(gate, door)
    assert known == []
    start, _ = knock(gate, "/snapshot", cookie=cookie)
    assert start["status"] == 200
    assert inside.asked == ["/snapshot"]
    assert known == [("127.0.0.1", 4711)]


@pytest.mark.parametrize(
    "foreign",
    [
        "a[]=b",
        'x={"a":1}',
        "theme=dark mode",
        "without_equals",
        "=no name",
        'open="quote',
        "a,b=c",
        "ümlaut=ä",
        "lfield-8000=of another program",
        "lfield-80=1",
        "xlfield-8000=1",
        "Path=/",
        "$Version=1",
        "a=b=c;;;",
    ],
)
@pytest.mark.parametrize("order", ["{foreign}; {own}", "{own}; {foreign}", "{foreign};{own};{foreign}"])
def test_cookies_of_other_programs_do_not_hide_the_session(gate, door, inside, foreign, order):
    """A browser sends the cookies of every program on 127.0.0.1, independently of its port."""
    cookies = order.format(foreign=foreign, own=entered(gate, door))
    start, _ = knock(gate, "/order", "POST", cookie=cookies, origin=OURS)
    assert start["status"] == 200
    knock(gate, "/_nicegui_ws/", kind="websocket", cookie=cookies, origin=OURS)
    assert inside.asked == ["/order", "/_nicegui_ws/"]


def test_cookies_may_come_in_several_headers(door, gate):
    own = entered(gate, door).partition("=")[2]
    headers = [(b"cookie", b"a[]=b"), (b"cookie", f"lfield-8000={own}".encode()), (b"cookie", b"c")]
    assert cookie_values(headers, "lfield-8000") == (own,)


def policies(gate, address, app) -> list[dict[str, str]]:
    """The directives of an answer of the page, and of a refusal."""
    cookie = entered(gate, address)
    answers = knock(app, "/", cookie=cookie), knock(app, "/")
    texts = [dict(answer[0]["headers"])[b"content-security-policy"].decode() for answer in answers]
    return [dict(part.strip().split(" ", 1) for part in text.split(";")) for text in texts]


def test_every_answer_forbids_the_browser_to_contact_other_hosts(gate, door):
    for policy in policies(gate, door, SecurityHeaders(gate)):
        assert policy["default-src"] == policy["connect-src"] == "'self'"
        assert policy["img-src"] == "'self' data:"
        assert not any("http" in each or "*" in each for each in policy.values())


def test_a_named_tile_server_is_allowed_for_images_only(gate, door):
    plain, named = (
        policies(gate, door, SecurityHeaders(gate, origin))[0]
        for origin in ("", "https://tiles.example:8443")
    )
    assert named == {**plain, "img-src": "'self' data: https://tiles.example:8443"}


@pytest.mark.parametrize(
    ("path", "method", "headers"),
    [
        ("/", "GET", {}),
        ("/snapshot", "GET", {"cookie": "lfield-8000=guessed"}),
        ("/snapshot", "GET", {"cookie": '=;;"\\'}),
        ("/?token=guessed", "GET", {}),
        ("/_nicegui/3/static/vue.js", "GET", {}),
        ("/order", "POST", {"origin": OURS}),
    ],
)
def test_a_request_without_a_session_gets_one_sentence_and_status_403(
    gate, inside, known, path, method, headers
):
    start, body = knock(gate, path, method, **headers)
    assert start["status"] == 403
    assert b"'lfield watch'" in body["body"]
    assert inside.asked == known == []


def test_a_websocket_of_another_page_is_closed(gate, door, inside):
    cookie = entered(gate, door)
    for headers in ({}, {"cookie": cookie}, {"cookie": cookie, "origin": "http://127.0.0.1:9000"}):
        (closed,) = knock(gate, "/_nicegui_ws/", kind="websocket", **headers)
        assert closed["type"] == "websocket.close"
    assert inside.asked == []
    knock(gate, "/_nicegui_ws/", kind="websocket", cookie=cookie, origin=OURS)
    assert inside.asked == ["/_nicegui_ws/"]
