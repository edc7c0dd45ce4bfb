"""The mission that a command is about: a bundle, or a deployment with its files; or all that run here."""

from __future__ import annotations

import argparse
import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from lfield.errors import NothingRuns, UsageError
from lfield.text.suggest import listed

if TYPE_CHECKING:
    from lfield.operator.addressed import Party
    from lfield.operator.runs import Run


def add_mission(parser: argparse.ArgumentParser, *, required: bool = True) -> None:
    """Declare it: `lfield up mission.lfm`, or `lfield up --deploy mission.dL`."""
    named = parser.add_mutually_exclusive_group(required=required)
    what = "deployment (.dL) or bundle (.lfm)" + (
        "" if required else " (default: all missions that run on this computer)"
    )
    # Positional arguments stand first in the help.
    named.add_argument("mission", metavar="MISSION", nargs="?", type=Path, help=what)
    named.add_argument("--deploy", metavar="MISSION", type=Path, action=_Once, help="same as MISSION")


def add_program(parser: argparse.ArgumentParser) -> None:
    """Declare the program of a mission."""
    parser.add_argument(
        "--program", metavar="FILE", type=Path, help="program, as text or compiled (default: MISSION.L)"
    )


def add_bindings(parser: argparse.ArgumentParser) -> None:
    """Declare the devices file of a mission."""
    parser.add_argument(
        "--devices", metavar="FILE", type=Path, help="device bindings (default: MISSION.devices.yaml)"
    )


class _Once(argparse.Action):
    """Of two missions the first would be forgotten silently."""

    def __call__(
        self,
        parser: argparse.ArgumentParser,
        namespace: argparse.Namespace,
        values: object,
        option: object = None,
    ) -> None:
        if getattr(namespace, self.dest) is not None:
            parser.error("--deploy names one mission, and stands here twice")
        setattr(namespace, self.dest, values)


def add_running_mission(parser: argparse.ArgumentParser) -> None:
    """Declare it, or the run, and where its hosts are reached; with neither, all that runs here is meant."""
    add_mission(parser, required=False)
    parser.add_argument(
        "--run", metavar="ID", default="", help="one run on this computer, with the id that 'ps' prints"
    )
    parser.add_argument(
        "--map", metavar="NAME=ADDR:PORT", action="append", default=[], help="address of a host"
    )
    parser.add_argument(
        "--keys", metavar="DIR", type=Path, help="directory with your keys, for hosts on a network"
    )


def mission_path(args: argparse.Namespace) -> Path:
    """The file that was named."""
    path = named_mission(args)
    assert path is not None
    return path


def setup_command(path: Path, host: str = "", devices: Path | None = None) -> str:
    """The command that sets up the devices of a mission, or of one of its hosts."""
    words = ["lfield", "setup", "--deploy", str(path)]
    words += ["--devices", str(devices)] if devices is not None else []
    return shlex.join([*words, *(["--host", host] if host else [])])


def named_mission(args: argparse.Namespace) -> Path | None:
    """The same, None when none was."""
    path: Path | None = args.mission or args.deploy
    return path


def meant_runs(args: argparse.Namespace) -> list[Run]:
    """The runs that this user may see, or the one that was named. Raises UsageError, NothingRuns."""
    from lfield.operator.addressed import picked
    from lfield.operator.runs import nothing_here, runs_here

    runs = picked(runs_here(), args.run)
    if named_mission(args) is not None:
        return runs
    if args.map:
        raise UsageError("--map is for the hosts of a mission: name the mission too")
    if not runs:
        raise NothingRuns(f"no mission runs here: {nothing_here()}")
    return runs


def meant_parties(args: argparse.Namespace, runs: list[Run]) -> list[Party]:
    """The hosts that were named: of a mission, or of all these runs. Raises UsageError."""
    from lfield.operator.addressed import open_team, parties_of, parties_of_team

    path = named_mission(args)
    if path is None:
        return parties_of(runs)
    team = open_team(path)
    if args.run and runs[0].note.deployment != team.deployment.hex():
        raise UsageError(f"{runs[0].id} is no run of {path}")
    return parties_of_team(team, runs, args.map)


def meant_party(args: argparse.Namespace) -> Party:
    """The one team that was named, or that runs here; on stderr, which other users say they run.

    Raises UsageError, NothingRuns.
    """
    from lfield.operator.addressed import only_party

    parties = meant_parties(args, meant_runs(args))
    party = only_party(parties)
    beside = [other.id for other in parties if other.user and other is not party]
    if beside:
        print(f"lfield: not asked is what other users run: --run names {listed(beside)}", file=sys.stderr)
    return party
