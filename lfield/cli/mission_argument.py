"""The mission that a command is about: a bundle, or a deployment with its files beside it."""

from __future__ import annotations

import argparse
from pathlib import Path

from lfield.errors import UsageError


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
