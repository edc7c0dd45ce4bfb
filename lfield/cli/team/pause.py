"""`lfield pause`: no agent of a mission runs any more, and its devices go to rest, until `lfield resume`."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from lfield import exits
from lfield.cli.mission_argument import add_running_mission, meant_parties, meant_runs
from lfield.cli.team.estop import all_confirmed, all_reached, way_down

if TYPE_CHECKING:
    from lfield.errors import LfieldError
    from lfield.operator.addressed import Place
    from lfield.wire.observing import EmergencyStopped


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare its options."""
    add_running_mission(parser)
    parser.add_argument(
        "--no-wait", action="store_true", help="end when all have confirmed, without looking at the way down"
    )


def run(args: argparse.Namespace) -> int:
    """0 when every host is paused and every device was seen at rest, else 3; 69 where nothing runs at all."""
    from lfield.operator.addressed import names_of
    from lfield.operator.ask import asked_in_turn, pause, reached

    parties = meant_parties(args, meant_runs(args))
    names = names_of(parties)
    answers: dict[Place, EmergencyStopped | LfieldError] = {}
    confirmed = everybody = True
    for some in asked_in_turn(parties, pause(), args.keys):
        confirmed &= all_confirmed(some, names, "safe")
        everybody &= all_reached(some, names)
        answers |= some
    if not (parties[0].runs or any(reached(answer) for answer in answers.values())):
        return exits.UNAVAILABLE
    if args.no_wait:
        return exits.DONE if confirmed and everybody else exits.UNSAFE
    down = way_down(parties, answers, names, args.keys)
    return exits.worst((exits.DONE if everybody else exits.UNSAFE, down))
