"""The arguments that name the mission of a command: a bundle, a deployment, or a run on this computer."""

from __future__ import annotations

import argparse
import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from lfield.client.team_selection import TeamSelection
from lfield.text.suggestions import listed

if TYPE_CHECKING:
    from lfield.operator.runs import Run
    from lfield.operator.targets import TargetTeam


def add_mission(parser: argparse.ArgumentParser, default: str = "") -> None:
    """Declare the mission: `lfield up mission.lfm`, or `lfield up --deploy mission.dL`.

    It is required unless `default` says what the command does without a mission.
    """
    named = parser.add_mutually_exclusive_group(required=not default)
    description = "deployment (.dL) or bundle (.lfm)" + (f" (default: {default})" if default else "")
    # Positional arguments stand first in the help.
    named.add_argument("mission", metavar="MISSION", nargs="?", type=Path, help=description)
    named.add_argument(
        "--deploy", metavar="MISSION", type=Path, action=_GivenOnce, help="another way to give MISSION"
    )


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


class _GivenOnce(argparse.Action):
    """An option that may be given once."""

    def __call__(
        self,
        parser: argparse.ArgumentParser,
        namespace: argparse.Namespace,
        values: object,
        option: object = None,
    ) -> None:
        if getattr(namespace, self.dest) is not None:
            parser.error("--deploy is given twice")
        setattr(namespace, self.dest, values)


def add_addresses(parser: argparse.ArgumentParser) -> None:
    """Declare the addresses of hosts."""
    parser.add_argument(
        "--map",
        metavar="NAME=ADDR:PORT",
        action="append",
        default=[],
        help="address of a host, instead of the one in the inventory or deployment (repeatable)",
    )
    add_inventory(parser)


def add_inventory(parser: argparse.ArgumentParser) -> None:
    """Declare the inventory."""
    parser.add_argument(
        "--inventory",
        metavar="FILE",
        type=Path,
        help="hosts and their addresses (default: $LFIELD_INVENTORY, ~/.config/lfield/inventory.yaml, "
        "/etc/lfield/inventory.yaml)",
    )


def team_selection(args: argparse.Namespace) -> TeamSelection:
    """The team that is named by the arguments of `add_running_mission`."""
    return TeamSelection(named_mission(args), args.run, args.map, args.inventory, args.keys)


def add_running_mission(parser: argparse.ArgumentParser) -> None:
    """Declare the mission or the run, and the addresses of its hosts.

    Default: all runs on this computer, and without one the hosts of the inventory.
    """
    add_mission(parser, "all missions that run on this computer, else the hosts of the inventory")
    parser.add_argument(
        "--run", metavar="ID", default="", help="id of a run on this computer, as printed by 'lfield ps'"
    )
    add_addresses(parser)
    parser.add_argument(
        "--keys",
        metavar="DIR",
        type=Path,
        help="directory with your keys, which hosts on other computers require",
    )


def mission_path(args: argparse.Namespace) -> Path:
    """The named file."""
    path = named_mission(args)
    assert path is not None
    return path


def setup_command(path: Path, host: str = "", devices: Path | None = None) -> str:
    """The command that sets up the devices of a mission, or of one of its hosts."""
    command = ["lfield", "setup", "--deploy", str(path)]
    command += ["--devices", str(devices)] if devices is not None else []
    return shlex.join([*command, *(["--host", host] if host else [])])


def named_mission(args: argparse.Namespace) -> Path | None:
    """The named file, or None."""
    path: Path | None = args.mission or args.deploy
    return path


def selected_runs(args: argparse.Namespace) -> list[Run]:
    """See `TeamSelection.runs`."""
    return team_selection(args).runs()


def selected_teams(args: argparse.Namespace, runs: list[Run]) -> list[TargetTeam]:
    """See `TeamSelection.teams`."""
    return team_selection(args).teams(runs)


def selected_team(args: argparse.Namespace) -> TargetTeam:
    """The only named or running team; prints to stderr the runs of other users that were left out.

    Raises UsageError, NoMissionRunning.
    """
    target, foreign = team_selection(args).single()
    if foreign:
        print(
            f"lfield: runs of other users are not included; select one with --run: {listed(foreign)}",
            file=sys.stderr,
        )
    return target
