"""The mission that a command is about: a bundle, or a deployment with its files beside it."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from lfield.mission.team import Team


def add_mission(parser: argparse.ArgumentParser) -> None:
    """Declare it: `lfield ps mission.lfm`, or `lfield ps --deploy mission.dL`."""
    named = parser.add_mutually_exclusive_group(required=True)
    named.add_argument("--deploy", metavar="MISSION", type=Path, help="a deployment (.dL) or bundle (.lfm)")
    named.add_argument("mission", metavar="MISSION", nargs="?", type=Path, help="the same")


def mission_path(args: argparse.Namespace) -> Path:
    """The file that was named."""
    path: Path = args.mission or args.deploy
    return path


def running_team(args: argparse.Namespace) -> Team:
    """The team of the mission where it runs."""
    from lfield.operator.whereabouts import open_team

    return where_it_runs(open_team(mission_path(args)), args)


def where_it_runs(team: Team, args: argparse.Namespace) -> Team:
    """The team at the addresses of `--map`, else at those published on this computer."""
    from lfield.mission.team import parse_maps
    from lfield.operator import whereabouts

    return team.at(whereabouts.find(team.deployment) | parse_maps(args.map, team))
