"""`lfield start`: coordinators that wait for missing hosts are started, without the hosts that are named."""

from __future__ import annotations

import argparse
import sys
from typing import TYPE_CHECKING

from lfield import exits
from lfield.cli.mission_argument import add_running_mission, meant_parties, meant_runs
from lfield.errors import LfieldError, UsageError
from lfield.text.suggest import did_you_mean, listed
from lfield.text.visible import in_one_line

if TYPE_CHECKING:
    from lfield.operator.addressed import Party
    from lfield.wire.observing import StartResponse, StartStatus


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare its options."""
    add_running_mission(parser)
    parser.add_argument(
        "--without",
        metavar="HOST",
        action="append",
        default=[],
        help="host to start without (repeatable)",
    )


def run(args: argparse.Namespace) -> int:
    """0 when no coordinator waits any more on the hosts that answer, 1 when one still does.

    69 when a host did not answer that is not left out: coordinators may still wait there.
    """
    from lfield.operator.addressed import names_of
    from lfield.operator.ask import ask_parties, tell_silent, unheard
    from lfield.operator.observing import Request
    from lfield.wire.observing import StartRequest, StartResponse

    parties = meant_parties(args, meant_runs(args))
    _check_hosts(args.without, parties)
    names = names_of(parties)
    # The answer takes as long as the disks of the hosts need; what is asked twice is done once.
    request = Request(StartRequest(args.without), StartResponse, 8.0, again=True)
    answers = ask_parties(parties, request, args.keys)
    waits = [place for place, answer in answers.items() if _tell(names[place], answer)]
    left_out = {place: answer for place, answer in answers.items() if place.host not in args.without}
    unreached = unheard(left_out, names)
    tell_silent(unreached, "NOT REACHED, what waits there still waits: ")
    if waits:
        return exits.FAILED
    return exits.UNAVAILABLE if unreached else exits.DONE


def _check_hosts(without: list[str], parties: list[Party]) -> None:
    """Raises UsageError for a host that none of the teams has: a misspelt name leaves nobody out."""
    hosts = sorted({place.host for party in parties for place in party.places})
    for host in without:
        if host not in hosts:
            hint = did_you_mean(host, hosts) or f"its hosts: {', '.join(hosts)}"
            raise UsageError(f"--without {host}: the mission has no host '{host}': {hint}")


def _tell(host: str, answer: StartResponse | LfieldError) -> bool:
    """Print what a host has started, on stderr what still waits there; whether something does."""
    if isinstance(answer, LfieldError):
        return False
    if answer.started:
        print(in_one_line(f"{host}: {listed(answer.started)} started"))
    if answer.trouble:
        print(in_one_line(f"{host}: nothing was done: {answer.trouble}"), file=sys.stderr)
    if answer.waiting is not None:
        print(in_one_line(f"{host}: {_waiting(answer.waiting)}"), file=sys.stderr)
    if not (answer.started or answer.trouble or answer.waiting):
        print(in_one_line(f"{host}: no coordinator waits to be started"))
    return bool(answer.trouble or answer.waiting)


def _waiting(start: StartStatus) -> str:
    who = f"{listed(start.agents)} {'is' if len(start.agents) == 1 else 'are'} not started"
    if start.held:
        return f"{who}: {start.held}"
    if not start.hosts:
        return f"{who} yet: other hosts have not said whether their vehicles are on the ground"
    return f"{who}: waiting for {listed(start.hosts)}; 'lfield ps' says why"
