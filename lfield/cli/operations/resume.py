"""`lfield resume`: resume a paused mission."""

from __future__ import annotations

import argparse
import sys

from lfield import exit_status
from lfield.cli.mission_argument import add_running_mission, selected_runs, selected_teams
from lfield.text.terminal_escape import escape_line


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    add_running_mission(parser)


def run(args: argparse.Namespace) -> int:
    """Returns 0 when every host has resumed, 69 when one did not answer or refused."""
    from lfield.operator.client import ask_teams, pause, print_unanswered, unanswered_by_name
    from lfield.operator.targets import display_names

    targets = selected_teams(args, selected_runs(args))
    names = display_names(targets)
    answers = ask_teams(targets, pause(lift=True), args.keys)
    refused = False
    for place, answer in answers.items():
        if isinstance(answer, Exception):
            continue
        if answer.trouble:
            refused = True
            print(escape_line(f"{names[place]}: {answer.trouble}"), file=sys.stderr)
        else:
            print(f"{names[place]}: resumed")
            for device, held in answer.devices.items():
                if held:
                    print(escape_line(f"{names[place]}: {device}: {held}"))
    unreached = unanswered_by_name(answers, names)
    print_unanswered(unreached, "NOT REACHED, unchanged: ")
    return exit_status.UNAVAILABLE if unreached or refused else exit_status.DONE
