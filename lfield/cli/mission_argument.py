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
    if args.mission is not None and args.deploy is not None:
        raise UsageError(f"which mission, {args.mission} or {args.deploy}? name one")
    path: Path | None = args.mission or args.deploy
    if path is None:
        raise UsageError("required: --deploy mission.dL, or a bundle (mission.lfm)")
    return path


def running_team(args: argparse.Namespace) -> Team:
    """The team of the mission where it runs."""
    from lfield.mission.team_file import open_team

    return where_it_runs(open_team(mission_path(args)), args)


def where_it_runs(team: Team, args: argparse.Namespace) -> Team:
    """The team at the addresses of `--map`, else at those published on this computer."""
    from lfield.mission.team import parse_maps
    from lfield.operator import whereabouts

    return team.at(whereabouts.find(team.deployment) | parse_maps(args.map, team))
