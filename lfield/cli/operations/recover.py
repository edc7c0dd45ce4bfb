"""`lfield recover`: continue a coordinator on another host after its host is permanently lost."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from lfield import exit_status
from lfield.cli.confirmation import confirm
from lfield.cli.mission_argument import add_running_mission, selected_runs, selected_teams
from lfield.errors import CoordinatorAlive, LfieldError, UsageError
from lfield.text.terminal_escape import escape_line

if TYPE_CHECKING:
    from lfield.operator.recovery_candidates import RecoveryCandidate
    from lfield.operator.targets import TargetTeam


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("agent", metavar="AGENT", help="id of the coordinator")
    add_running_mission(parser)
    parser.add_argument("--yes", action="store_true", help="do not ask for confirmation")


def run(args: argparse.Namespace) -> int:
    """Returns 0 when the coordinator continues, 1 without confirmation, 69 when it is alive or its host
    refuses.
    """
    from lfield.operator.client import SNAPSHOT, ask_teams, print_unanswered, unanswered
    from lfield.operator.recovery_candidates import best_candidate
    from lfield.operator.targets import display_names, trusted_targets
    from lfield.operator.team_model.host_model import host_states

    targets = trusted_targets(selected_teams(args, selected_runs(args)))
    names = display_names(targets)
    answers = ask_teams(targets, SNAPSHOT, args.keys)
    if all(isinstance(answer, LfieldError) for answer in answers.values()):
        print_unanswered(unanswered({names[place]: answer for place, answer in answers.items()}))
        return exit_status.UNAVAILABLE
    candidate = best_candidate(args.agent, host_states(answers), names)
    print("\n".join(map(escape_line, candidate.lines)))
    if not _confirmed(args.agent, names[candidate.host_ref], yes=args.yes):
        return exit_status.FAILED
    _request_recovery(targets, candidate, names[candidate.host_ref], args.keys)
    return exit_status.DONE


def _confirmed(agent: str, host: str, *, yes: bool) -> bool:
    """Ask for confirmation. Raises UsageError without a terminal."""
    if yes:
        return True
    if not sys.stdin.isatty():
        raise UsageError(
            "nothing was done: no terminal to confirm on; add --yes if its last host is permanently lost"
        )
    print(f"If the last host of {agent} is not permanently lost, two copies may run.")
    return confirm(f"Type 'yes' to continue {agent} on {host}: ")


def _request_recovery(
    targets: list[TargetTeam], candidate: RecoveryCandidate, host: str, keys: Path | None
) -> None:
    """Raises CoordinatorAlive when the host refuses, AddressError when it does not answer."""
    import asyncio

    from lfield.operator.client import observer_transport, own_keys, recover
    from lfield.operator.observer_link import send_request

    address = next(
        target.host_refs[candidate.host_ref] for target in targets if candidate.host_ref in target.host_refs
    )
    transport = observer_transport(own_keys([address], keys))
    answer = asyncio.run(
        send_request(transport, address, recover(candidate.request), candidate.host_ref.host)
    )
    if not answer.generation:
        raise CoordinatorAlive(f"nothing was done: {answer.reason}")
    print(f"{host}: {candidate.request.agent} recovered, as start {answer.generation}")
