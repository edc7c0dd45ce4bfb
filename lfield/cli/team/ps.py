"""`lfield ps`: what runs where."""

from __future__ import annotations

import argparse
import sys

from lfield import exits
from lfield.cli.mission_argument import add_running_mission, meant_parties, meant_runs, named_mission


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare its options."""
    add_running_mission(parser)
    parser.add_argument("--json", action="store_true", help="print the answers of the hosts as JSON")


def run(args: argparse.Namespace) -> int:
    """0 when every host answered, 69 when one or more did not."""
    from lfield.cli.views import picture, run_table
    from lfield.operator.addressed import names_of
    from lfield.operator.ask import STATUS, ask_parties, by_host, heard, tell_silent, unheard
    from lfield.operator.places import unseen

    runs = meant_runs(args)
    parties = meant_parties(args, runs)
    answers = ask_parties(parties, STATUS, args.keys)
    names = names_of(parties)
    named = {names[place]: answer for place, answer in answers.items()}
    silent = unheard(answers, names)
    if named_mission(args) is None and unseen():
        print(f"lfield: {unseen()}", file=sys.stderr)
    if args.json:
        print(picture.as_json(named) if named_mission(args) else run_table.as_json(parties, answers))
        return exits.UNAVAILABLE if silent else exits.DONE
    if named_mission(args) is None:
        run_table.show(runs)
    for party in parties:
        if named_mission(args) is None or len(parties) > 1:
            print(f"\n{party.id}")
        shown = by_host(answers, party)
        picture.show(heard(shown) if party.user else shown)
    tell_silent(silent)
    return exits.UNAVAILABLE if silent else exits.DONE
