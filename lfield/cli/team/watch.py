"""`lfield watch`: a page in the browser that shows a running team, and has STOP on it."""

from __future__ import annotations

import argparse
import asyncio
import signal
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from lfield import exits
from lfield.cli.mission_argument import (
    add_running_mission,
    meant_parties,
    meant_party,
    meant_runs,
    named_mission,
)
from lfield.errors import KeysError, PluginError, UsageError
from lfield.text.suggest import listed

if TYPE_CHECKING:
    from lfield.authority.pages.page_keys import PageKeys
    from lfield.mission.team import Team
    from lfield.operator.addressed import Party
    from lfield.operator.web.tiles import Tiles


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare its options."""
    add_running_mission(parser)
    parser.add_argument(
        "--port",
        metavar="N",
        type=_port,
        default=0,
        help="port of the page (default: any free port)",
    )
    parser.add_argument(
        "--listen",
        metavar="ADDRESS",
        type=_address,
        help="serve the page on a network at this address, with HTTPS",
    )
    parser.add_argument(
        "--page-keys",
        metavar="DIR",
        type=Path,
        help="keys of the page, from 'lfield keys page ADDRESS'",
    )
    parser.add_argument(
        "--tiles", metavar="FILE", type=Path, help="background of the map: a raster MBTiles file"
    )


def _port(text: str) -> int:
    if not text.isdecimal() or not 1 <= int(text[:9]) <= 65535:
        raise argparse.ArgumentTypeError(f"a port is a number from 1 to 65535, not '{text}'")
    return int(text)


def _address(text: str) -> str:
    from lfield.authority.pages.names import spelled

    try:
        return spelled(text)
    except KeysError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def run(args: argparse.Namespace) -> int:
    """130, after a Ctrl-C: it shows a team for as long as somebody wants to look."""
    from lfield.operator.addressed import only_mission, open_team
    from lfield.operator.web.tiles import Tiles

    page_keys = _page_keys(args)
    _need_nicegui()
    tiles = Tiles(args.tiles) if args.tiles else None
    path = named_mission(args) or only_mission(meant_runs(args))
    team = open_team(path)
    party = meant_party(args)
    try:
        asyncio.run(_watch(args, path, team, party, tiles, page_keys))
    except (KeyboardInterrupt, asyncio.CancelledError):
        print("no longer looking, and nothing else has changed")
        return exits.INTERRUPTED
    return exits.DONE


def _page_keys(args: argparse.Namespace) -> PageKeys | None:
    """What a page on a network is served with, else None. Raises UsageError, KeysError."""
    if args.listen is None:
        if args.page_keys is not None:
            raise UsageError("--page-keys is for a page on a network: say where with --listen ADDRESS")
        return None
    if args.page_keys is None:
        raise UsageError(
            "--listen takes --page-keys DIR, or anybody on the way could press the buttons: "
            f"'lfield keys page {args.listen}' makes them"
        )
    from lfield.authority.pages.page_keys import read_page

    keys = read_page(args.page_keys)
    if refusal := keys.refusal(args.listen, time.time()):
        raise KeysError(refusal)
    return keys


def _need_nicegui() -> None:
    """Raises PluginError where it is not installed."""
    from importlib.util import find_spec

    if find_spec("nicegui") is None:
        raise PluginError("'lfield watch' needs nicegui on this computer: pip install 'lfield[watch]'")


def _end_with_ctrl_c() -> None:
    """Ctrl-C ends the task that runs, once: the next would cut off what the end still takes."""
    loop, task = asyncio.get_running_loop(), asyncio.current_task()
    # What a shell has put into the background does not hear it.
    if task is None or signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        return

    def end() -> None:
        loop.add_signal_handler(signal.SIGINT, lambda: None)
        task.cancel()

    loop.add_signal_handler(signal.SIGINT, end)


async def _watch(
    args: argparse.Namespace,
    path: Path,
    team: Team,
    party: Party,
    tiles: Tiles | None,
    page_keys: PageKeys | None,
) -> None:
    from lfield.clock import SystemClock
    from lfield.operator.sight.watched import watched
    from lfield.operator.web.server import Served, serve
    from lfield.operator.web.site import on_a_network, on_this_computer

    def found() -> Sequence[Party]:
        return meant_parties(args, meant_runs(args))

    def tell(line: str) -> None:
        print(line, flush=True)

    if page_keys is None:
        site = await on_this_computer(args.port, tell)
    else:
        site = await on_a_network(args.listen, args.port, page_keys, tell)
    _end_with_ctrl_c()
    if not party.runs:
        where = listed([f"{host} at {address}" for host, address in party.addresses.items()])
        tell(f"nobody runs {path} on this computer: the page waits for {where}")
    async with watched(path, team, party, found, args.keys) as shown:
        served = Served(
            f"{path.absolute().parent.name}/{path.stem}", shown, shown.actions, SystemClock(), tiles
        )
        await serve(served, site, lambda link: tell(f"open this link: {link}"))
