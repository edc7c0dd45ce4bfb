"""The mission that a command is about: a bundle, or a deployment with its files beside it."""

from __future__ import annotations

import argparse
from pathlib import Path


def add_mission(parser: argparse.ArgumentParser) -> None:
    """Declare it: `lfield ps mission.lfm`, or `lfield ps --deploy mission.dL`."""
    named = parser.add_mutually_exclusive_group(required=True)
    named.add_argument("--deploy", metavar="MISSION", type=Path, help="a deployment (.dL) or bundle (.lfm)")
    named.add_argument("mission", metavar="MISSION", nargs="?", type=Path, help="the same")


def add_running_mission(parser: argparse.ArgumentParser) -> None:
    """Declare it, and where its hosts are reached."""
    add_mission(parser)
    parser.add_argument(
        "--map", metavar="NAME=ADDR:PORT", action="append", default=[], help="where a host is reached"
    )


def mission_path(args: argparse.Namespace) -> Path:
    """The file that was named."""
    path: Path = args.mission or args.deploy
    return path
