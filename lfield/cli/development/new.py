"""`lfield new NAME`: the directory of a new mission, which runs at once."""

from __future__ import annotations

import argparse
import re
import shlex
from pathlib import Path

from lfield.errors import UsageError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        "name", metavar="NAME", help="name of the mission: lower-case letters, digits and hyphens"
    )
    parser.add_argument("--into", metavar="DIR", type=Path, help="directory to create (default: NAME)")


def run(args: argparse.Namespace) -> int:
    """Write the files and print their names. Raises UsageError, OutputFileError."""
    from lfield.mission.skeleton import coordinator_name, reserved_names, write_mission

    name, folder = args.name, args.into or Path(args.name)
    if not re.fullmatch(r"[a-z][a-z0-9]{0,30}(-[a-z0-9]{1,30}){0,5}", name):
        raise UsageError(
            f"'{name}' cannot be the name of a mission; use lower-case letters, digits and hyphens, as in "
            "box-search"
        )
    if (coordinator := coordinator_name(name)) in reserved_names():
        raise UsageError(f"'{name}' cannot be the name of a mission: {coordinator} already is a type of L")
    if folder.exists() and not (folder.is_dir() and not any(folder.iterdir())):
        reason = "is not empty" if folder.is_dir() else "is no directory"
        raise UsageError(f"{folder} exists and {reason}; nothing was written")
    for path in write_mission(name, folder):
        print(path)
    print(f"\nnext: cd {shlex.quote(str(folder))} && lfield up --deploy mission.dL --all --sim --until-done")
    return 0
