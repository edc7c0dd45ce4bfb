"""`lfield rollback`: activates the previous bundle on all robots or none, or ends an undecided activation."""

from __future__ import annotations

import argparse
import asyncio
import json
from typing import TYPE_CHECKING

from lfield.cli.fleet.desk import (
    VOTE_GOES_ON,
    add_desk,
    add_without,
    explained_interrupt,
    failure_status,
    open_desk,
    report_unreached,
)
from lfield.client.service_desk import TIMEOUT, FleetDesk, split_answers
from lfield.errors import UsageError
from lfield.text.suggestions import listed
from lfield.text.terminal_escape import escape_line
from lfield.wire.fields import short_digest

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from lfield.errors import LfieldError
    from lfield.wire.service_messages import BallotState, ServiceStatus


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    add_without(parser, "leave out this host, which cannot join until it has the bundle")
    parser.add_argument(
        "--lost",
        metavar="HOST",
        default="",
        help="do not activate, but abort an undecided activation: HOST, whose vote is unknown, is "
        "permanently lost",
    )
    add_desk(parser)


def run(args: argparse.Namespace) -> int:
    """Returns 0 when the previous bundle is active on all hosts; else as `lfield push`."""
    desk = open_desk(args)
    desk.addresses([*args.without, *([args.lost] if args.lost else [])])
    if args.lost:
        return _abort(desk, args)
    hosts = [host for host in desk.hosts if host not in args.without]
    if not hosts:
        raise UsageError("no host is left: --without names all of them")
    with explained_interrupt(VOTE_GOES_ON):
        return asyncio.run(_rollback(desk, hosts, args))


async def _rollback(desk: FleetDesk, hosts: list[str], args: argparse.Namespace) -> int:
    from lfield.cli.fleet.ballot_report import PushReport
    from lfield.cli.fleet.push import service_states, vote
    from lfield.operator.fleet.active_missions import bundle_info

    links = desk.links(hosts)
    try:
        statuses, silent = split_answers(await service_states(links))
        # Only the mission that is active counts, not every robot of the inventory.
        now = _hosts_of_mission(statuses, silent, args.without)
        failed = {host: error for host, error in silent.items() if host in now}
        digest = b"" if failed else _common_previous(statuses, now, args.without)
        info = bundle_info(statuses, digest) if digest else None
        # A host that only the previous mission has takes part in the vote.
        earlier_hosts = [host for host in (info.hosts if info else now) if host not in args.without]
        failed |= {host: error for host, error in silent.items() if host in earlier_hosts}
        if failed:
            report_unreached(failed, "; nothing was changed")
            return failure_status(failed)
        voting = {host: statuses[host] for host in dict.fromkeys([*now, *earlier_hosts]) if host in statuses}
        report = PushReport(digest, as_json=args.json)
        report.start(f"bundle {short_digest(digest)}")
        return await vote(desk, links, digest, voting, report)
    finally:
        links.close()


def _hosts_of_mission(
    statuses: Mapping[str, ServiceStatus], silent: Mapping[str, LfieldError], without: Sequence[str]
) -> list[str]:
    """The hosts of the active mission that are not left out and in the inventory.

    If the active mission is unknown: all hosts with a bundle, and those that do not answer.
    """
    from lfield.operator.fleet.active_missions import active_missions

    found = active_missions(statuses, without)
    if len(found) == 1:
        return [host for host in found[0].hosts if host in statuses or host in silent]
    return [*(host for host, status in statuses.items() if status.active or status.previous), *silent]


def _common_previous(
    statuses: Mapping[str, ServiceStatus], hosts: Sequence[str], without: Sequence[str]
) -> bytes:
    """The previous bundle of all these hosts. Raises UsageError if they differ."""
    found = {host: statuses[host].previous for host in hosts}
    if len(set(found.values())) > 1:
        each = [_way_back(digest, found, statuses, without) for digest in dict.fromkeys(found.values())]
        raise UsageError(f"nothing was changed: the previous bundles differ: {'; '.join(each)}")
    digest = next(iter(found.values()), b"")
    if not digest:
        raise UsageError("no host has had another bundle: there is nothing to go back to")
    return digest


def _way_back(
    digest: bytes, found: Mapping[str, bytes], statuses: Mapping[str, ServiceStatus], without: Sequence[str]
) -> str:
    """The previous bundles to which some hosts would return, and the commands for that."""
    from lfield.operator.fleet.active_missions import bundle_info

    own = [host for host, previous in found.items() if previous == digest]
    if not digest:
        return f"{listed(own)}: no other bundle was active there"
    others, info = [host for host in found if host not in own], bundle_info(statuses, digest)
    name = f"{info.name}, " if info is not None else ""
    options = "".join(f" --without {host}" for host in (*without, *others))
    command = f"'lfield rollback{options}'"
    if info is not None and (remaining := [host for host in others if host in info.hosts]):
        # Without these hosts the mission would not be complete.
        command = f"'lfield push' activates it there and on {listed(remaining)}"
    return f"{listed(own)}: {name}bundle {short_digest(digest)}: {command}"


def _abort(desk: FleetDesk, args: argparse.Namespace) -> int:
    """Report a vote against the activation for the lost host; returns the exit status."""
    from lfield.wire.service_messages import BallotState, VoteReport

    others = [host for host in desk.hosts if host != args.lost and host not in args.without]
    statuses, failed = split_answers(desk.statuses(others))
    open_ballots = {
        host: status.ballot
        for host, status in statuses.items()
        if status.ballot is not None
        and status.ballot.outcome == "open"
        and args.lost not in status.ballot.votes
    }
    if not open_ballots:
        raise UsageError(f"no reachable host waits for the vote of {args.lost}: 'lfield status' shows votes")
    _require_unknown_result(open_ballots, statuses, {args.lost, *args.without})
    ended = []
    for host, ballot in open_ballots.items():
        report = VoteReport(ballot.id, {args.lost: "no"})
        answers, refused = split_answers(desk.command([host], report, BallotState, TIMEOUT))
        failed |= refused
        ended += [host for answer in answers.values() if answer.outcome == "aborted"]
    report_unreached(failed, "")
    if args.json:
        errors = {host: error.as_data() for host, error in failed.items()}
        print(json.dumps({"aborted": ended, "errors": errors}))
    elif ended:
        print(escape_line(f"activation aborted on {listed(ended)}"))
    return failure_status(failed)


def _require_unknown_result(
    open_ballots: Mapping[str, BallotState], statuses: Mapping[str, ServiceStatus], lost: set[str]
) -> None:
    """Raises UsageError if a host that is not lost may know that the bundle is active."""
    hosts = {host for each in open_ballots.values() if each.ballot is not None for host in each.ballot.hosts}
    if unknown := sorted(hosts - lost - statuses.keys()):
        raise UsageError(
            f"{listed(unknown)} may know the result: repeat this when it answers; --without if it is lost"
        )
    ids = {each.id for each in open_ballots.values()}
    for host, status in statuses.items():
        known = status.ballot
        if known is not None and known.id in ids and known.outcome == "activated":
            raise UsageError(f"{host} knows that the bundle is active: the others learn it from there")
