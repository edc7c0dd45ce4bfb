"""`lfield ps`: the hosts and agents of running missions."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from lfield import exit_status
from lfield.cli.mission_argument import (
    add_running_mission,
    mission_path,
    named_mission,
    selected_runs,
    selected_teams,
)
from lfield.errors import AddressError, NoMissionRunning

if TYPE_CHECKING:
    from lfield.operator.targets import HostRef


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    add_running_mission(parser)
    parser.add_argument("--json", action="store_true", help="print the answers of the hosts as JSON")


def run(args: argparse.Namespace) -> int:
    """Returns 0 when every host answered, 69 when one or more did not. Raises NoMissionRunning."""
    # First: without a running mission the rest is not imported.
    runs = selected_runs(args)
    from lfield.cli.views import run_table, team_status_view
    from lfield.client.status_json import runs_data, status_data
    from lfield.operator.client import (
        FULL_SNAPSHOT,
        SNAPSHOT,
        ask_teams,
        by_host,
        print_unanswered,
        unanswered_by_name,
    )
    from lfield.operator.run_dirs import unreadable_hint
    from lfield.operator.targets import display_names
    from lfield.operator.team_model.host_model import host_states

    targets = selected_teams(args, runs)
    answers = ask_teams(targets, FULL_SNAPSHOT if args.json else SNAPSHOT, args.keys)
    if named_mission(args) is not None and not any(target.runs for target in targets):
        _require_running(mission_path(args), answers)
    names = display_names(targets)
    hosts = host_states(answers)
    silent = unanswered_by_name(answers, names)
    if named_mission(args) is None and unreadable_hint():
        print(f"lfield: {unreadable_hint()}", file=sys.stderr)
    if args.json:
        named = {names[place]: host for place, host in hosts.items()}
        is_team = named_mission(args) is not None or not runs
        print(json.dumps(status_data(named) if is_team else runs_data(targets, hosts), indent=2))
        return exit_status.UNAVAILABLE if silent else exit_status.DONE
    if named_mission(args) is None and runs:
        run_table.show(runs)
    for target in targets:
        if (named_mission(args) is None and runs) or len(targets) > 1:
            print(f"\n{target.id}" if target.runs else "\nhosts of the inventory")
        states = by_host(hosts, target)
        if target.user:
            states = {name: host for name, host in states.items() if host.linked}
        team_status_view.show(states)
    print_unanswered(silent)
    return exit_status.UNAVAILABLE if silent else exit_status.DONE


def _require_running(mission: Path, answers: Mapping[HostRef, object]) -> None:
    """Raise NoMissionRunning when no host of a mission that has no run on this computer can be reached."""
    if all(isinstance(answer, AddressError) for answer in answers.values()):
        reason = next(iter(answers.values()))
        raise NoMissionRunning(
            f"{mission} is not running: no run on this computer, no host reached: {reason}"
        )
