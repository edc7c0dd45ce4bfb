"""The arguments that name the mission of a command: a bundle, a deployment, or a run on this computer."""

from __future__ import annotations

import argparse
import os
import shlex
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from lfield.errors import NoMissionRunning, UsageError
from lfield.text.suggestions import listed

if TYPE_CHECKING:
    from lfield.operator.runs import Run
    from lfield.operator.targets import TargetTeam


def add_mission(parser: argparse.ArgumentParser, *, required: bool = True) -> None:
    """Declare the mission: `lfield up mission.lfm`, or `lfield up --deploy mission.dL`."""
    named = parser.add_mutually_exclusive_group(required=required)
    what = "deployment (.dL) or bundle (.lfm)" + (
        ""
        if required
        else " (default: all missions that run on this computer, else the hosts of the inventory)"
    )
    # Positional arguments stand first in the help.
    named.add_argument("mission", metavar="MISSION", nargs="?", type=Path, help=what)
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


def inventory_addresses(args: argparse.Namespace) -> Mapping[str, str]:
    """The addresses of the hosts of the inventory, by name. Raises ProgramError, InputFileError."""
    from lfield.inventory.location import find_inventory

    inventory = find_inventory(args.inventory, os.environ)
    return {} if inventory is None else {name: host.address for name, host in inventory.hosts.items()}


def add_running_mission(parser: argparse.ArgumentParser) -> None:
    """Declare the mission or the run, and the addresses of its hosts.

    Default: all runs on this computer, and without one the hosts of the inventory.
    """
    add_mission(parser, required=False)
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
    """The runs that this user may see, or the named one. Raises UsageError, NoMissionRunning."""
    from lfield.operator.runs import no_runs_hint, runs_here
    from lfield.operator.targets import select_runs

    runs = select_runs(runs_here(), args.run)
    if named_mission(args) is not None:
        return runs
    if args.map:
        raise UsageError("--map is for the hosts of a mission: name the mission too")
    if not runs and not inventory_addresses(args):
        raise NoMissionRunning(f"no mission is running on this computer: {no_runs_hint()}")
    return runs


def selected_teams(args: argparse.Namespace, runs: list[Run]) -> list[TargetTeam]:
    """The hosts of the named mission, or of all these runs. Raises UsageError.

    Without a run of this user, and with --inventory, the hosts of the inventory.
    """
    parties = _selected_teams(args, runs)
    _configure_zenoh(args, parties)
    return parties


def _configure_zenoh(args: argparse.Namespace, parties: Sequence[TargetTeam]) -> None:
    """Use the routers of --inventory for addresses in a fabric, else those of the run, else the default
    inventory's: the addresses may be those of a run."""
    from lfield.net.transport import has_zenoh
    from lfield.net.zenoh.config import NETWORK

    addresses = [address for party in parties for address in party.addresses.values()]
    if NETWORK.config is not None or not any(map(has_zenoh, addresses)):
        return
    known = [run.manifest.zenoh for party in parties for run in party.runs if not run.user]
    config = next((each for each in known if each is not None), None)
    if config is None or args.inventory is not None:
        inventory_addresses(args)
    else:
        NETWORK.configure(config)


def _selected_teams(args: argparse.Namespace, runs: list[Run]) -> list[TargetTeam]:
    from lfield.operator.targets import TargetTeam, open_team, targets_of_runs, targets_of_team

    path = named_mission(args)
    if path is None:
        parties = targets_of_runs(runs)
        if not args.run and (args.inventory or all(run.user for run in runs)):
            addresses = inventory_addresses(args)
            parties = [TargetTeam((), addresses), *parties] if addresses else parties
        return parties
    team = open_team(path)
    if args.run and runs[0].manifest.deployment != team.deployment.hex():
        raise UsageError(f"{runs[0].id} is not a run of {path}")
    return targets_of_team(team, runs, args.map, lambda: inventory_addresses(args))


def selected_team(args: argparse.Namespace) -> TargetTeam:
    """The one named or running team; prints to stderr which runs of other users were left out.

    Raises UsageError, NoMissionRunning.
    """
    from lfield.operator.targets import single_target

    parties = selected_teams(args, selected_runs(args))
    party = single_target(parties)
    foreign = [other.id for other in parties if other.user and other is not party]
    if foreign:
        print(
            f"lfield: runs of other users are not included; select one with --run: {listed(foreign)}",
            file=sys.stderr,
        )
    return party
