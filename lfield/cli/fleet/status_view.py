"""The state of services, as a table, as sentences and as JSON."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING

from lfield.authority.peer_verification import format_time
from lfield.cli.views.team_state_view import new_table
from lfield.operator.fleet.active_missions import (
    ActiveMission,
    IdleCoordinator,
    active_missions,
    divided_hosts,
    idle_coordinators,
    is_idle,
    left_behind,
)
from lfield.text.suggestions import listed
from lfield.text.terminal_escape import escape_line
from lfield.wire.fields import short_digest
from lfield.wire.service_messages import BallotState, BundleInfo, ServiceStatus

if TYPE_CHECKING:
    from rich.table import Table

#: A clock of a robot that differs by more seconds from that of the desk is reported.
MAX_CLOCK_OFFSET = 60.0


def status_table(statuses: Mapping[str, ServiceStatus]) -> Table:
    """One row for each host."""
    table = new_table("host", "bundle", "mission", "signed by", "lfield", "runs")
    for host, status in statuses.items():
        info = bundle_info(status, status.active)
        run = status.run
        runs = run.phase if run.status is None or run.phase == "running" else f"{run.phase} ({run.status})"
        row = (
            host,
            short_digest(status.active) or "none",
            info.name if info else "",
            info.by if info else "",
        )
        table.add_row(*map(escape_line, (*row, status.version, runs)))
    return table


def differing_versions(statuses: Mapping[str, ServiceStatus]) -> str:
    """The sentence about hosts with different versions of lfield; '' if all have the same."""
    if len({status.version for status in statuses.values()}) < 2:
        return ""
    each = listed([f"{host}: {status.version}" for host, status in statuses.items()])
    return escape_line(f"the versions of lfield differ ({each}): 'lfield provision' updates all robots")


def status_lines(statuses: Mapping[str, ServiceStatus]) -> Iterator[str]:
    """Sentences about unusual states: the reason why a host waits, an open ballot, unfinished
    coordinators.
    """
    if divided := divided_hosts(statuses):
        yield escape_line(
            f"the active bundles of {listed(divided)} differ, and hosts with different bundles do not link: "
            "'lfield push' activates one on all hosts of a mission"
        )
    if versions := differing_versions(statuses):
        yield versions
    missions = [(each, _idle(each, statuses)) for each in active_missions(statuses)]
    for mission, idle in missions:
        if is_idle(mission, idle):
            yield escape_line(f"no coordinator of {mission.name} runs:")
        yield from (escape_line(f"{coordinator.host}: {coordinator.reason}") for coordinator in idle)
        if hosts := left_behind(mission, statuses):
            yield escape_line(
                f"{listed(hosts)}: waits for the hosts on which the mission has ended, until they have been "
                "silent for 300 s; 'lfield stop' ends it"
            )
    reported = {(coordinator.host, coordinator.agent) for _, idle in missions for coordinator in idle}
    for host, status in statuses.items():
        run = status.run
        if run.reason:
            yield escape_line(f"{host}: {run.phase}: {run.reason}")
        if status.ballot is not None and status.ballot.outcome == "open":
            yield escape_line(f"{host}: {open_ballot_text(status.ballot)}")
        for coordinator in status.unfinished:
            if (host, coordinator.agent) in reported:
                continue
            where = f" ({coordinator.where})" if coordinator.where and coordinator.where != host else ""
            yield escape_line(f"{host}: coordinator {coordinator.agent} {coordinator.state}{where}")
        if status.refusal and not status.unfinished:
            yield escape_line(f"{host}: no activation now: {status.refusal}")
        offset = status.time - time.time()
        if abs(offset) > MAX_CLOCK_OFFSET:
            yield escape_line(f"{host}: its clock shows {format_time(status.time)}; set it")


def _idle(mission: ActiveMission, statuses: Mapping[str, ServiceStatus]) -> list[IdleCoordinator]:
    """The coordinators that do not run. One of an unreached host may run there."""
    return [
        coordinator for coordinator in idle_coordinators(mission, statuses) if coordinator.host in statuses
    ]


def bundle_info(status: ServiceStatus, digest: bytes) -> BundleInfo | None:
    """The description of a bundle that the host has stored."""
    return next((info for info in status.bundles if info.digest == digest), None)


def open_ballot_text(state: BallotState) -> str:
    """The sentence about an open ballot."""
    ballot = state.ballot
    assert ballot is not None
    return (
        f"activation of {short_digest(ballot.digest)} by {ballot.by} has no result yet: the votes of "
        f"{listed(state.missing)} are unknown; no mission starts until they are known"
    )


def status_data(status: ServiceStatus) -> dict[str, object]:
    """The state as JSON data; digests in hex."""
    info, run = bundle_info(status, status.active), status.run
    ballot = status.ballot
    return {
        "version": status.version,
        "bundle": status.active.hex(),
        "previous": status.previous.hex(),
        "mission": info.name if info else "",
        "signed_by": info.by if info else "",
        "signed_at": info.at if info else None,
        "stored": [each.digest.hex() for each in status.bundles],
        "run": {
            "phase": run.phase,
            "bundle": run.bundle.hex(),
            "reason": run.reason,
            "since": run.since,
            "exit_status": run.status,
        },
        "ballot": None
        if ballot is None
        else {
            "id": ballot.id.hex(),
            "bundle": ballot.ballot.digest.hex() if ballot.ballot else "",
            "by": ballot.ballot.by if ballot.ballot else "",
            "votes": ballot.votes,
            "reasons": ballot.reasons,
            "outcome": ballot.outcome,
        },
        "unfinished": [
            {
                "agent": coordinator.agent,
                "state": coordinator.state,
                "where": coordinator.where,
                "mission": coordinator.mission,
            }
            for coordinator in status.unfinished
        ],
        "refusal": status.refusal,
        "time": status.time,
    }
