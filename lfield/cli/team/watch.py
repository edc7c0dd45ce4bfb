"""`lfield watch`: a page in the browser that shows a running team, and has STOP on it."""

from __future__ import annotations

import argparse
import asyncio
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
from lfield.errors import PluginError

if TYPE_CHECKING:
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
        help="of this computer; any that is free if none is given",
    )
    parser.add_argument(
        "--tiles", metavar="FILE", type=Path, help="a background for the map: an MBTiles file with pictures"
    )


def _port(text: str) -> int:
    if not text.isdecimal() or not 1 <= int(text[:9]) <= 65535:
        raise argparse.ArgumentTypeError(f"a port is a number from 1 to 65535, not {text!r}")
    return int(text)


def run(args: argparse.Namespace) -> int:
    """130, after a Ctrl-C: it shows a team for as long as somebody wants to look."""
    from lfield.operator.addressed import only_mission, open_team
    from lfield.operator.web.tiles import Tiles

    _need_nicegui()
    tiles = Tiles(args.tiles) if args.tiles else None
    path = named_mission(args) or only_mission(meant_runs(args))
    team = open_team(path)
    party = meant_party(args)
    try:
        asyncio.run(_watch(args, path, team, party, tiles))
    except KeyboardInterrupt:
        print("no longer looking, and nothing else has changed")
        return exits.INTERRUPTED
    return exits.DONE


def _need_nicegui() -> None:
    """Raises PluginError where it is not installed."""
    from importlib.util import find_spec

    if find_spec("nicegui") is None:
        raise PluginError("the page needs nicegui, on this computer only: pip install 'lfield[watch]'")


async def _watch(args: argparse.Namespace, path: Path, team: Team, party: Party, tiles: Tiles | None) -> None:
    from lfield.clock import SystemClock
    from lfield.operator.sight.watched import watched
    from lfield.operator.web.server import Served, listening, serve

    def found() -> Sequence[Party]:
        return meant_parties(args, meant_runs(args))

    opened = listening(args.port)
    async with watched(path, team, party, found, args.keys) as shown:
        served = Served(
            f"{path.absolute().parent.name}/{path.stem}", shown, shown.actions, SystemClock(), tiles
        )
        await serve(served, opened, lambda link: print(f"open this link: {link}", flush=True))
