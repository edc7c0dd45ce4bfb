"""`lfield estop`: every device of a running mission into its safe state, and who did not confirm."""

from __future__ import annotations

import argparse
import sys
from typing import TYPE_CHECKING

from lfield.cli.mission_argument import add_running_mission, mission_path

if TYPE_CHECKING:
    from lfield.operator.ask import Answers
    from lfield.wire.messages import EmergencyStopped


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare its options."""
    add_running_mission(parser)
    parser.add_argument("--reason", metavar="TEXT", default="", help="a sentence for the logs of the hosts")
    parser.add_argument(
        "--lift", action="store_true", help="the emergency is over: programs may release their devices again"
    )


def run(args: argparse.Namespace) -> int:
    """0 when every device of every host has confirmed, 69 when one did not or a host was not reached."""
    from lfield.operator.ask import ask_team, emergency_stop, silent, tell_silent
    from lfield.operator.whereabouts import open_team

    reason = f"the emergency stop was pressed{': ' if args.reason else ''}{args.reason}"
    request = emergency_stop(reason, lift=args.lift)
    answers = ask_team(open_team(mission_path(args)), args.map, request)
    confirmed = _tell(answers, "may be released" if args.lift else "safe")
    tell_silent(silent(answers), "NOT REACHED, its devices have not confirmed: ")
    return 0 if confirmed and not silent(answers) else 69


def _tell(answers: Answers[EmergencyStopped], word: str) -> bool:
    """A line for each device of the hosts that answered, on stderr what is wrong; whether all is well."""
    well = True
    for host, answer in answers.items():
        if isinstance(answer, Exception):
            continue
        if not answer.devices:
            print(f"{host}: has no devices")
        for device, problem in answer.devices.items():
            well = well and not problem
            print(
                f"{host}: {device}: {f'NOT CONFIRMED: {problem}' if problem else word}",
                file=sys.stderr if problem else sys.stdout,
            )
    return well
