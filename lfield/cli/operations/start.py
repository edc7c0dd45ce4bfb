"""`lfield start`: starts the mission on all robots, or coordinators that wait without the missing hosts.

Without a mission the command is for the services of the robots of the inventory, if no mission runs on this
computer or --inventory names a file. On a desk with both the command refuses: a person who starts robots
would get an answer of simulated hosts with the same names, or the other way round.
"""

from __future__ import annotations

import argparse
import os
import sys
from typing import TYPE_CHECKING

from lfield import exit_status
from lfield.cli.mission_argument import add_running_mission, selected_runs, selected_teams
from lfield.errors import LfieldError, UsageError
from lfield.text.suggestions import did_you_mean, listed
from lfield.text.terminal_escape import escape_line

if TYPE_CHECKING:
    from lfield.operator.targets import TargetTeam
    from lfield.wire.observer_messages import StartResponse, StartStatus


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    add_running_mission(parser)
    parser.add_argument("--json", action="store_true", help="print one JSON object, for robots with services")
    parser.add_argument(
        "--without",
        metavar="HOST",
        action="append",
        default=[],
        help="start without this host (repeatable)",
    )


def run(args: argparse.Namespace) -> int:
    """Returns 0 when no coordinator waits on the hosts that answer, 1 when one does.

    Returns 69 when a host that is not left out did not answer: coordinators may still wait there.
    """
    from lfield.operator.runs import runs_here

    is_named = args.mission is not None or args.deploy is not None or args.run
    if not is_named and (args.inventory is not None or not runs_here()):
        from lfield.cli.fleet.mission_start import start_on_robots

        if (status := start_on_robots(args)) is not None:
            return status
    if not is_named:
        _require_one_target()
    from lfield.operator.client import ask_teams, print_unanswered, unanswered_by_name
    from lfield.operator.observer_link import Request
    from lfield.operator.targets import display_names
    from lfield.wire.observer_messages import StartRequest, StartResponse

    targets = selected_teams(args, selected_runs(args))
    _check_hosts(args.without, targets)
    names = display_names(targets)
    # The answer comes when the disks of the hosts have the start; a repeated request has no effect.
    request = Request(StartRequest(args.without), StartResponse, 8.0, is_retried=True)
    answers = ask_teams(targets, request, args.keys)
    waits = [place for place, answer in answers.items() if _print_start(names[place], answer)]
    left_out = {place: answer for place, answer in answers.items() if place.host not in args.without}
    unreached = unanswered_by_name(left_out, names)
    print_unanswered(unreached, "NOT REACHED, still waiting there: ")
    if waits:
        return exit_status.FAILED
    return exit_status.UNAVAILABLE if unreached else exit_status.DONE


def _require_one_target() -> None:
    """Raises UsageError if the robots of an inventory on a desk may be intended."""
    from lfield.inventory.location import SYSTEM, inventory_path

    path = inventory_path(None, os.environ)
    if path not in (None, SYSTEM):
        raise UsageError(
            f"a mission runs on this computer, and {path} has robots: --inventory {path} starts them, and a "
            "mission or --run ID is for this computer"
        )


def _check_hosts(without: list[str], targets: list[TargetTeam]) -> None:
    """Raises UsageError for a host that no team has."""
    hosts = sorted({place.host for target in targets for place in target.host_refs})
    for host in without:
        if host not in hosts:
            hint = did_you_mean(host, hosts) or f"its hosts: {', '.join(hosts)}"
            raise UsageError(f"--without {host}: the mission has no host '{host}': {hint}")


def _print_start(host: str, answer: StartResponse | LfieldError) -> bool:
    """Print the coordinators that a host has started, and to stderr those that wait; returns whether any
    waits.
    """
    if isinstance(answer, LfieldError):
        return False
    if answer.started:
        print(escape_line(f"{host}: {listed(answer.started)} started"))
    if answer.trouble:
        print(escape_line(f"{host}: nothing was done: {answer.trouble}"), file=sys.stderr)
    if answer.waiting is not None:
        print(escape_line(f"{host}: {_waiting(answer.waiting)}"), file=sys.stderr)
    if not (answer.started or answer.trouble or answer.waiting):
        print(escape_line(f"{host}: no coordinator waits to be started"))
    return bool(answer.trouble or answer.waiting)


def _waiting(start: StartStatus) -> str:
    subject = f"{listed(start.agents)} {'is' if len(start.agents) == 1 else 'are'} not started"
    if start.held:
        return f"{subject}: {start.held}"
    if not start.hosts:
        return f"{subject} yet: waiting for the landed state of vehicles on other hosts"
    return f"{subject}: waiting for {listed(start.hosts)}; 'lfield ps' prints the reason"
