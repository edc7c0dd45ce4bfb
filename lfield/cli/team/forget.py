"""`lfield forget`: ends a coordinator that is in doubt, lost or parked by a person's word, on every host."""

from __future__ import annotations

import argparse

from lfield import exits
from lfield.cli.mission_argument import add_running_mission, meant_parties, meant_runs
from lfield.errors import CoordinatorAlive


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare its options."""
    parser.add_argument("agent", metavar="AGENT", help="id of the coordinator")
    add_running_mission(parser)


def run(args: argparse.Namespace) -> int:
    """0 when every host has heard it; raises CoordinatorAlive when it is alive or nothing was given up.

    69 when a host did not answer.
    """
    from lfield.operator.addressed import believed_of, names_of
    from lfield.operator.ask import STATUS, ask_parties, forget, silent, tell_silent
    from lfield.operator.whereabouts import insist_on_doubt

    parties = believed_of(meant_parties(args, meant_runs(args)))
    names = names_of(parties)
    before = ask_parties(parties, STATUS, args.keys)
    if not all(isinstance(answer, Exception) for answer in before.values()):
        insist_on_doubt(args.agent, before, names)
    answers = ask_parties(parties, forget(args.agent), args.keys)
    given_up = False
    for place, answer in answers.items():
        if not isinstance(answer, Exception) and answer.starts:
            starts = ", ".join(map(str, answer.starts))
            print(f"{names[place]}: {args.agent}, start {starts}, is given up as lost")
            given_up = True
    unheard = silent({names[place]: answer for place, answer in answers.items()})
    tell_silent(unheard, f"has not answered; should it have {args.agent}, that goes on there: ")
    if not given_up:
        raise CoordinatorAlive(_nothing(args.agent, heard=len(unheard) < len(answers)))
    return exits.UNAVAILABLE if unheard else exits.DONE


def _nothing(agent: str, *, heard: bool) -> str:
    """Why no host has given anything up: what one said a moment ago may be over."""
    if not heard:
        return f"no host has answered: nothing of {agent} is known to be given up"
    return (
        f"nothing of {agent} was given up: no host that answers has it in doubt, lost or parked any more; "
        "'lfield ps' shows where it is"
    )
