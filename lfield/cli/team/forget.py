"""`lfield forget`: ends a coordinator that is in doubt, lost or parked by a person's word, on every host."""

from __future__ import annotations

import argparse

from lfield import exits
from lfield.cli.mission_argument import add_running_mission, meant_parties, meant_runs


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare its options."""
    parser.add_argument("agent", metavar="AGENT", help="the coordinator")
    add_running_mission(parser)


def run(args: argparse.Namespace) -> int:
    """0 when every host has heard it, 69 when one did not answer, or when the coordinator is alive."""
    from lfield.operator.addressed import names_of
    from lfield.operator.ask import STATUS, ask_parties, forget, silent, tell_silent
    from lfield.operator.whereabouts import insist_on_doubt

    parties = meant_parties(args, meant_runs(args))
    names = names_of(parties)
    before = ask_parties(parties, STATUS)
    if not all(isinstance(answer, Exception) for answer in before.values()):
        insist_on_doubt(args.agent, before, names)
    answers = ask_parties(parties, forget(args.agent))
    for place, answer in answers.items():
        if not isinstance(answer, Exception) and answer.starts:
            starts = ", ".join(map(str, answer.starts))
            print(f"{names[place]}: {args.agent}, start {starts}, is given up as lost")
    unheard = silent({names[place]: answer for place, answer in answers.items()})
    tell_silent(unheard, f"has not heard it; should it have {args.agent}, that goes on there: ")
    return exits.UNAVAILABLE if unheard else exits.DONE
