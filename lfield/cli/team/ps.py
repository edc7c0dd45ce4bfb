"""`lfield ps`: what runs where."""

from __future__ import annotations

import argparse

from lfield.cli.mission_argument import add_running_mission, mission_path


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare its options."""
    add_running_mission(parser)
    parser.add_argument("--json", action="store_true", help="print what the hosts say as JSON")


def run(args: argparse.Namespace) -> int:
    """0 when every host answered, 69 when one or more did not."""
    from lfield.cli.views import picture
    from lfield.operator.ask import STATUS, ask_team, silent, tell_silent
    from lfield.operator.whereabouts import open_team

    answers = ask_team(open_team(mission_path(args)), args.map, STATUS)
    if args.json:
        print(picture.as_json(answers))
    else:
        picture.show(answers)
        tell_silent(silent(answers))
    return 69 if silent(answers) else 0
