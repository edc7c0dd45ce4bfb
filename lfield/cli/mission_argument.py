"""The mission that a command is about: a bundle, or a deployment with its files beside it."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from lfield.errors import UsageError

if TYPE_CHECKING:
    from lfield.mission.team import Team


def add_mission(parser: argparse.ArgumentParser) -> None:
    """Declare it: `lfield ps mission.lfm`, or `lfield ps --deploy mission.dL`."""
    parser.add_argument(
        "mission", metavar="MISSION", nargs="?", type=Path, help="a bundle (.lfm) or deployment (.dL)"
    )
    parser.add_argument("--deploy", metavar="MISSION", type=Path, help="the same")


def mission_path(args: argparse.Namespace) -> Path:
    """The file that was named, once. Raises UsageError."""
    if (args.mission is None) == (args.deploy is None):
        raise UsageError("name one mission: a bundle (mission.lfm), or a deployment (--deploy mission.dL)")
    path: Path = args.mission or args.deploy
    return path


def running_team(args: argparse.Namespace) -> Team:
    """The team of the mission at the addresses where it runs: those of `--map`, else those published here."""
    from lfield.mission.team import parse_maps
    from lfield.mission.team_file import open_team
    from lfield.operator import whereabouts

    team = open_team(mission_path(args))
    return team.at(whereabouts.find(team.deployment) | parse_maps(args.map, team))
