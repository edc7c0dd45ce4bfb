"""Locates a coordinator from the state of hosts. Sans-IO.

Only the records of hosts that answered count: those of a host without a link may be old.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterator, Mapping
from typing import TypeVar

from lfield.errors import CoordinatorAlive, UsageError
from lfield.operator.team_model.team_state import HostState
from lfield.wire.coordinator_messages import CoordinatorState
from lfield.wire.observer_messages import ParkedStatus

K = TypeVar("K", bound=Hashable)

_LIVE = ("RUN", "FROZEN", "PREPARED")


def records(agent: str, hosts: Mapping[K, HostState]) -> Iterator[tuple[K, CoordinatorState]]:
    """The records of each host about an agent."""
    for place, host in hosts.items():
        if host.linked:
            yield from ((place, known) for known in host.report.coordinators if known.agent == agent)


def parked_copies(agent: str, hosts: Mapping[K, HostState]) -> Iterator[tuple[K, ParkedStatus]]:
    """The copies of an agent that hosts store for another mission."""
    for place, host in hosts.items():
        if host.linked and host.report.journal is not None:
            yield from ((place, status) for status in host.report.journal.parked if status.agent == agent)


def require_in_doubt(agent: str, hosts: Mapping[K, HostState], names: Mapping[K, str]) -> None:
    """Raises CoordinatorAlive when a host has the coordinator, and UsageError when no copy of it is in
    doubt, lost or parked.
    """
    require_no_live_copy(agent, hosts, names)
    found = list(records(agent, hosts))
    if any(known.state != "EXITED" for _, known in found) or any(parked_copies(agent, hosts)):
        return
    if not found:
        raise UsageError(f"no reachable host has a coordinator {agent}; 'lfield ps' lists them")
    last = max((known for _, known in found), key=lambda known: known.generation)
    raise UsageError(f"{agent} has ended on {last.where} ({last.outcome}): there is nothing to end")


def require_no_live_copy(agent: str, hosts: Mapping[K, HostState], names: Mapping[K, str]) -> None:
    """Raises CoordinatorAlive when a host has the coordinator, with its place and state."""
    for place, known in records(agent, hosts):
        if known.state in _LIVE:
            direction = (
                f", {_state(agent, hosts[place])}"
                if known.state == "RUN"
                else f", on its way to {known.where}"
            )
            raise CoordinatorAlive(
                f"{agent} is alive on {names[place]} (start {known.generation}){direction}: nothing was done"
            )


def _state(agent: str, host: HostState) -> str:
    return next((found.state for found in host.report.agents if found.id == agent), "not woken yet")


def doubt_advice(hosts: Mapping[str, HostState]) -> Iterator[str]:
    """A line for each coordinator that no answering host has, and that has not ended."""
    reports = {name: host.report for name, host in hosts.items() if host.linked}
    agents = {known.agent for report in reports.values() for known in report.coordinators}
    agents |= {
        status.agent for report in reports.values() if report.journal for status in report.journal.parked
    }
    for agent in sorted(agents):
        found = [known for _, known in records(agent, hosts)]
        newest = max((known for known in found), key=_age, default=None)
        if any(known.state in _LIVE for known in found):
            continue
        if any(parked_copies(agent, hosts)):
            yield f"{agent}: start its own mission again, or end it: lfield forget {agent}"
        elif newest and newest.state in ("MOVED", "IN DOUBT"):
            is_away = newest.where and newest.where not in reports
            first = f"start {newest.where} again; if it is permanently lost, " if is_away else ""
            if any(k.state in ("MOVED", "IN DOUBT") and not k.unreadable for k in found):
                first += f"continue without it: lfield recover {agent}, or "
            yield f"{agent}: {first}end it: lfield forget {agent}"


def _age(known: CoordinatorState) -> tuple[int, bool, int, int]:
    """Orders records by age; the end of a start is its newest."""
    return known.generation, known.state == "EXITED", known.hops, known.sequence
