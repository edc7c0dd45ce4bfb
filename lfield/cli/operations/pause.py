"""`lfield pause`: pause a mission and put its devices in their safe states, until `lfield resume`."""

from __future__ import annotations

import argparse

from lfield.cli.mission_argument import add_running_mission, selected_runs, selected_teams
from lfield.cli.operations.estop import ask_and_print, exit_status_of, nonblocking_command_output


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    add_running_mission(parser)
    parser.add_argument(
        "--no-wait",
        action="store_true",
        help="exit as soon as all devices have confirmed; do not wait until they are at rest",
    )


def run(args: argparse.Namespace) -> int:
    """Returns 0 when every host is paused and every device is at rest, else 3; 69 when no mission is
    running.
    """
    from lfield.operator.client import pause
    from lfield.operator.targets import display_names

    with nonblocking_command_output():
        targets = selected_teams(args, selected_runs(args))
        names = display_names(targets)
        replies = ask_and_print(targets, pause(), args.keys, names, "safe")
        status, _ = exit_status_of(targets, replies, names, args.keys, waits_for_rest=not args.no_wait)
        return status
