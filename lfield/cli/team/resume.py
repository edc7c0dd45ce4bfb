"""`lfield resume`: a mission that was paused goes on."""

from __future__ import annotations

import argparse
import sys

from lfield import exits
from lfield.cli.mission_argument import add_running_mission, meant_parties, meant_runs
from lfield.text.visible import in_one_line


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare its options."""
    add_running_mission(parser)


def run(args: argparse.Namespace) -> int:
    """0 when every host goes on, 1 when one refused that, 69 when one did not answer."""
    from lfield.operator.addressed import names_of
    from lfield.operator.ask import ask_parties, pause, tell_silent, unheard

    parties = meant_parties(args, meant_runs(args))
    names = names_of(parties)
    answers = ask_parties(parties, pause(lift=True), args.keys)
    refused = False
    for place, answer in answers.items():
        if isinstance(answer, Exception):
            continue
        if answer.trouble:
            refused = True
            print(in_one_line(f"{names[place]}: {answer.trouble}"), file=sys.stderr)
        else:
            print(f"{names[place]}: goes on")
            for device, held in answer.devices.items():
                if held:
                    print(in_one_line(f"{names[place]}: {device}: {held}"))
    unreached = unheard(answers, names)
    tell_silent(unreached, "NOT REACHED, it stays as it is: ")
    if unreached:
        return exits.UNAVAILABLE
    return exits.FAILED if refused else exits.DONE
