"""HTTP server of the page: its routes, and a uvicorn server that ends with the command.

Only this module and page.py import NiceGUI, so it is loaded only when a page is served.
"""

from __future__ import annotations

import asyncio
import secrets
import socket
from collections.abc import Callable, Generator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import msgspec
import uvicorn
from fastapi import FastAPI, Request, Response
from nicegui import ui

from lfield.clock import Clock
from lfield.operator.dashboard.operator_actions import OperatorActions
from lfield.operator.team_model.team_state import TeamStateSource
from lfield.operator.web.answer_json import order_json, query_json
from lfield.operator.web.auth_middleware import AuthMiddleware, SecurityHeaders
from lfield.operator.web.button_orders import REASON, buttons, refusal, stop_reason
from lfield.operator.web.page import page
from lfield.operator.web.page_sessions import PageSessions
from lfield.operator.web.page_site import PageSite
from lfield.operator.web.page_snapshots import PageSnapshots, ReplayControl
from lfield.operator.web.tiles.background import NO_BACKGROUND, PageBackground
from lfield.wire.fields import MAX_INPUT, Name

#: The longest body of a request, in bytes: the longest question has 4000 characters.
_MAX_BODY = 20_000
#: Keep-alive time of an idle connection (s).
_IDLE = 3600


class _Line(msgspec.Struct):
    """A line of input from the page."""

    host: Name
    agent: Name
    text: Annotated[str, msgspec.Meta(max_length=MAX_INPUT, pattern=r"\A[^\n]*\Z")]
    pressed: Any = None


class ServedPage(msgspec.Struct, frozen=True):
    """The inputs of a page: state of the team, permitted actions, clock, and background of the map.

    A page of recordings has a `replay`, which is its source, and no actions: no order can be sent.
    """

    title: str
    source: TeamStateSource
    actions: OperatorActions | None
    clock: Clock
    background: PageBackground = NO_BACKGROUND
    replay: ReplayControl | None = None


async def serve(served: ServedPage, site: PageSite, print_link: Callable[[str], None]) -> None:
    """Serve the page until cancelled; `print_link` gets each login link."""
    sessions = PageSessions(site.addresses, lambda: secrets.token_urlsafe(24), site.scheme)

    def show_link() -> None:
        print_link(site.link(sessions.token))

    app = FastAPI(openapi_url=None)
    _add_routes(app, served)
    ui.run_with(
        app,
        title=served.title,
        favicon=Path(__file__).parent / "browser" / "icon.svg",
        dark=None,
        tailwind=False,
        show_welcome_message=False,
        binding_refresh_interval=None,
        cache_control_directives="no-cache",
        gzip_middleware_factory=None,
    )
    protected = AuthMiddleware(app, sessions, f"lfield-{site.port}", show_link, site.limiter.on_authenticated)
    config = uvicorn.Config(
        SecurityHeaders(protected, tiles.origin if (tiles := served.background.tiles) is not None else ""),
        log_config=None,
        # Forwarded-For headers are not trusted: the peer is the other end of the socket.
        proxy_headers=False,
        access_log=False,
        lifespan="on",
        # After a pause, a process handles its timers first. A shorter keep-alive could close a connection on
        # which a button press has arrived meanwhile.
        timeout_keep_alive=_IDLE,
        # Do not wait for open pages.
        timeout_graceful_shutdown=1,
    )
    server = _Server(config, site)
    serving = asyncio.create_task(server.serve([]))
    show_link()
    try:
        await asyncio.shield(serving)
    finally:
        server.should_exit = True
        await asyncio.gather(serving, return_exceptions=True)
        site.close()


class _Server(uvicorn.Server):
    """A server whose signals are handled by the command and whose sockets belong to a `PageSite`."""

    def __init__(self, config: uvicorn.Config, site: PageSite) -> None:
        super().__init__(config)
        self._site = site

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        await super().startup(sockets)
        self._site.limiter.start(self._protocol)

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        self._site.close()
        await super().shutdown(sockets)

    def _protocol(self) -> asyncio.Protocol:
        protocol_class: Callable[..., asyncio.Protocol] = self.config.http_protocol_class
        return protocol_class(
            config=self.config, server_state=self.server_state, app_state=self.lifespan.state
        )

    @contextmanager
    def capture_signals(self) -> Generator[None, None, None]:
        yield


def _add_routes(app: FastAPI, served: ServedPage) -> None:
    tiles = served.background.tiles
    background = None
    if tiles is not None:
        background = {"min_zoom": tiles.min_zoom, "max_zoom": tiles.max_zoom, "credit": tiles.credit}
        background["url"] = tiles.address
    actions, replay = served.actions, served.replay
    snapshots = PageSnapshots(
        served.source,
        lambda: {} if actions is None else actions.denied_orders,
        background,
        served.clock.monotonic,
        replay,
    )
    page(served.title, is_recorded=replay is not None)
    if actions is not None:
        _add_actions(app, actions, served.clock)
    if replay is not None:
        _add_replay(app, replay)

    @app.get("/snapshot")
    async def snapshot(after: int = 0, point: int = 0, epoch: int = 0) -> Response:
        return _json(snapshots.snapshot(after, epoch, point))

    @app.get("/drawings")
    async def drawings() -> Response:
        return _json(msgspec.json.encode(served.background.drawings))

    @app.get("/plots")
    async def plots() -> Response:
        return _json(snapshots.plots())

    @app.get("/tiles/{zoom}/{column}/{row}")
    async def tile(zoom: int, column: int, row: int) -> Response:
        found = tiles.tile(zoom, column, row) if tiles is not None else None
        if found is None:
            return Response(status_code=404)
        return Response(found.data, media_type=found.kind, headers={"Cache-Control": "max-age=3600"})


def _add_actions(app: FastAPI, actions: OperatorActions, clock: Clock) -> None:
    @app.post("/order")
    async def order(request: Request) -> Response:
        body = await _body(request)
        action, pressed, now = body.get("action"), body.get("pressed"), clock.monotonic()
        execute = buttons(actions, stop_reason(REASON, pressed, now)).get(str(action))
        if execute is None:
            return _refused("unknown action")
        # The hosts would refuse a denied order too; this saves the requests.
        for denied, reason in actions.denied_orders.items():
            if denied == action:
                return _refused(reason, 403)
        if reason := refusal(action, pressed, now):
            return _refused(reason, 409)
        return _json(order_json(await execute()))

    @app.post("/input")
    async def enter_line(request: Request) -> Response:
        body = await _body(request)
        try:
            line = msgspec.convert(body, _Line)
        except msgspec.ValidationError as error:
            return _refused(f"not a line of input for an agent of a host: {error}")
        if reason := refusal("type", line.pressed, clock.monotonic()):
            return _refused(reason, 409)
        problem = await actions.enter(line.host, line.agent, line.text)
        return _refused(problem, 409) if problem else _json(b"{}")

    @app.post("/query")
    async def query(request: Request) -> Response:
        text = (await _body(request)).get("text")
        if not isinstance(text, str) or not text.strip():
            return _refused("empty query: enter a capability or a taxonomy id")
        return _json(query_json(await actions.query(text)))


def _add_replay(app: FastAPI, replay: ReplayControl) -> None:
    @app.post("/replay")
    async def move(request: Request) -> Response:
        if reason := replay.request(await _body(request)):
            return _refused(reason)
        return _json(b"{}")


async def _body(request: Request) -> dict[str, Any]:
    """The body of a request, {} if it is not a JSON object of at most `_MAX_BODY`."""
    body = bytearray()
    async for part in request.stream():
        body += part
        if len(body) > _MAX_BODY:
            return {}
    try:
        return msgspec.json.decode(body, type=dict[str, Any])
    except msgspec.MsgspecError:
        return {}


def _json(data: bytes) -> Response:
    return Response(data, media_type="application/json", headers={"Cache-Control": "no-store"})


def _refused(reason: str, status: int = 400) -> Response:
    return Response(reason, status_code=status, media_type="text/plain")
