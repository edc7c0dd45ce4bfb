"""`lfield pause`: no agent of a mission runs any more, and its devices go to rest, until `lfield resume`."""

from __future__ import annotations

import argparse

from lfield.cli.mission_argument import add_running_mission, meant_parties, meant_runs
from lfield.cli.team.estop import came_of, told_in_turn


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare its options."""
    add_running_mission(parser)
    parser.add_argument(
        "--no-wait", action="store_true", help="exit when all devices have confirmed, before they are at rest"
    )


def run(args: argparse.Namespace) -> int:
    """0 when every host is paused and every device was seen at rest, else 3; 69 where nothing runs at all."""
    from lfield.operator.addressed import names_of
    from lfield.operator.ask import pause

    parties = meant_parties(args, meant_runs(args))
    names = names_of(parties)
    told = told_in_turn(parties, pause(), args.keys, names, "safe")
    return came_of(parties, told, names, args.keys, looks=not args.no_wait)
