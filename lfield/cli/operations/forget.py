"""`lfield forget`: terminate a coordinator that is in doubt, lost or suspended, on every host."""

from __future__ import annotations

import argparse

from lfield import exit_status
from lfield.cli.mission_argument import add_running_mission, selected_runs, selected_teams
from lfield.errors import CoordinatorAlive


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("agent", metavar="AGENT", help="id of the coordinator")
    add_running_mission(parser)


def run(args: argparse.Namespace) -> int:
    """Returns 0 when every host has answered; raises CoordinatorAlive when it is alive or no copy was
    given up.

    69 when a host did not answer.
    """
    from lfield.operator.client import SNAPSHOT, ask_teams, forget, print_unanswered, unanswered
    from lfield.operator.coordinator_location import require_in_doubt
    from lfield.operator.targets import display_names, trusted_targets
    from lfield.operator.team_model.host_model import host_states

    targets = trusted_targets(selected_teams(args, selected_runs(args)))
    names = display_names(targets)
    before = host_states(ask_teams(targets, SNAPSHOT, args.keys))
    if any(host.linked for host in before.values()):
        require_in_doubt(args.agent, before, names)
    answers = ask_teams(targets, forget(args.agent), args.keys)
    given_up = False
    for place, answer in answers.items():
        if not isinstance(answer, Exception) and answer.starts:
            starts = ", ".join(map(str, answer.starts))
            print(f"{names[place]}: {args.agent}, start {starts}, is given up as lost")
            given_up = True
    unanswered_hosts = unanswered({names[place]: answer for place, answer in answers.items()})
    print_unanswered(unanswered_hosts, f"no answer; a copy of {args.agent} there would continue: ")
    if not given_up:
        raise CoordinatorAlive(_nothing_released(args.agent, answers=len(unanswered_hosts) < len(answers)))
    return exit_status.UNAVAILABLE if unanswered_hosts else exit_status.DONE


def _nothing_released(agent: str, *, answers: bool) -> str:
    """The reason why no host has given up a copy: the state may have changed since the snapshot."""
    if not answers:
        return f"no host has answered: it is unknown whether a copy of {agent} was given up"
    return (
        f"no copy of {agent} was given up: no host that answers has it in doubt, lost or parked any more; "
        "'lfield ps' shows where it is"
    )
