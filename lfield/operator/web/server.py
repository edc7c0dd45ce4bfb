"""Serves the page: its routes, and a server on a socket of ours that ends when the command does.

NiceGUI brings server, page and components; it is imported when a page is served, and not before.
"""

from __future__ import annotations

import asyncio
import secrets
import socket
from collections.abc import Awaitable, Callable, Generator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import uvicorn
from fastapi import FastAPI, Request, Response
from nicegui import ui

from lfield.clock import Clock
from lfield.errors import AddressError
from lfield.operator.sight.actions import Actions, Ordered
from lfield.operator.sight.seen import Sight
from lfield.operator.web.answers import answered, ordered
from lfield.operator.web.door import Door
from lfield.operator.web.gate import Gate
from lfield.operator.web.look import Looks
from lfield.operator.web.page import page
from lfield.operator.web.tiles import Tiles

LOOPBACK = "127.0.0.1"
#: What is written into the logs of the hosts when somebody presses STOP here.
REASON = "on the page of lfield watch"
#: The longest body of a request, in bytes: the longest question has 4000 characters.
_MOST_BYTES = 20_000


@dataclass(frozen=True, slots=True)
class Served:
    """What a page is of: the team, what may be done with it, a background for the map, and a clock."""

    title: str
    sight: Sight
    actions: Actions
    clock: Clock
    tiles: Tiles | None = None


def listening(port: int) -> socket.socket:
    """A socket of this computer alone; any free port for 0. Raises AddressError."""
    opened = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    opened.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        opened.bind((LOOPBACK, port))
        # Whoever opens the link at once is not turned away.
        opened.listen()
    except OSError as error:
        opened.close()
        raise AddressError(f"{LOOPBACK}:{port}", (error.strerror or str(error)).lower()) from None
    return opened


async def serve(served: Served, opened: socket.socket, tell: Callable[[str], None]) -> None:
    """Serve the page on that socket until this is cancelled; `tell` gets each link that opens it."""
    port: int = opened.getsockname()[1]
    door = Door((f"{LOOPBACK}:{port}", f"localhost:{port}"), lambda: secrets.token_urlsafe(24))

    def tell_link() -> None:
        tell(f"http://{LOOPBACK}:{port}/?token={door.token}")

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
    config = uvicorn.Config(
        Gate(app, door, f"lfield-{port}", tell_link),
        log_config=None,
        access_log=False,
        lifespan="on",
        # Pages that are open are not waited for.
        timeout_graceful_shutdown=1,
    )
    server = _Server(config)
    serving = asyncio.create_task(server.serve([opened]))
    tell_link()
    try:
        await asyncio.shield(serving)
    finally:
        server.should_exit = True
        await asyncio.gather(serving, return_exceptions=True)
        opened.close()


class _Server(uvicorn.Server):
    """One that leaves Ctrl-C to the command."""

    @contextmanager
    def capture_signals(self) -> Generator[None, None, None]:
        yield


def _add_routes(app: FastAPI, served: Served) -> None:
    tiles = served.tiles
    about = None if tiles is None else {"least": tiles.least, "most": tiles.most, "credit": tiles.credit}
    looks = Looks(served.sight, lambda: served.actions.barred, about, served.clock.monotonic)
    page(served.title)

    @app.get("/look")
    async def look(after: int = 0) -> Response:
        return _json(looks.look(after))

    @app.get("/plots")
    async def plots() -> Response:
        return _json(looks.plots())

    @app.post("/act")
    async def act(request: Request) -> Response:
        asked = (await _said(request)).get("action")
        does = _buttons(served.actions).get(str(asked))
        return _json(ordered(await does())) if does else _refused("there is no such button")

    @app.post("/query")
    async def query(request: Request) -> Response:
        text = (await _said(request)).get("text")
        if not isinstance(text, str) or not text.strip():
            return _refused("ask for something: a capability, or an id of the taxonomy")
        return _json(answered(await served.actions.query(text)))

    @app.get("/tiles/{zoom}/{column}/{row}")
    async def tile(zoom: int, column: int, row: int) -> Response:
        found = tiles.tile(zoom, column, row) if tiles is not None else None
        if found is None:
            return Response(status_code=404)
        return Response(found.data, media_type=found.kind, headers={"Cache-Control": "max-age=3600"})


def _buttons(actions: Actions) -> Mapping[str, Callable[[], Awaitable[Ordered]]]:
    """What each of them does."""
    return {
        "stop": lambda: actions.stop(REASON),
        "lift": actions.lift,
        "pause": actions.pause,
        "resume": actions.resume,
    }


async def _said(request: Request) -> dict[str, Any]:
    """The body of a request, {} where it is none."""
    body = bytearray()
    async for part in request.stream():
        body += part
        if len(body) > _MOST_BYTES:
            return {}
    try:
        return msgspec.json.decode(body, type=dict[str, Any])
    except msgspec.MsgspecError:
        return {}


def _json(data: bytes) -> Response:
    return Response(data, media_type="application/json", headers={"Cache-Control": "no-store"})


def _refused(why: str) -> Response:
    return Response(why, status_code=400, media_type="text/plain")
