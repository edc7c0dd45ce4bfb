"""Waits until every coordinator of a deployment has terminated, is certainly lost, or is unreachable.

While all hosts are linked, terminations are announced to every host. While a host is missing, was restarted
or has ended, the reachable hosts are queried, a few at a time. The wait lasts as long as any host has contact
with the missing host. A host with proof of a loss announces it before it stops, so that the others are
equally certain.
"""

from __future__ import annotations

import asyncio
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from typing import cast

from msgspec.structs import replace

from lfield.host.host import Host
from lfield.host.inputs import ContactRestored, OutcomesFound, SilenceChecked
from lfield.replication.locate.outcomes import (
    CoordinatorOutcome,
    OutcomeResolver,
    UnavailableHosts,
    local_outcomes,
)
from lfield.text import log_messages
from lfield.text.suggestions import listed
from lfield.wire.coordinator_messages import CoordinatorState, Locate

#: Seconds between two queries while a host is missing, the time-out of a query, and the time for which a
#: termination is announced before this host stops.
ASK_EVERY, ANSWER_WITHIN, LINGER = 0.5, 1.0, 2.0
#: The number of hosts queried at a time.
MAX_PARALLEL_QUERIES = 8
#: Seconds for which an announced loss is valid without a query: the coordinator may be started again later.
STATUS_MAX_AGE = 1.5
#: The maximum duration of a failover after the interval of its coordinator: seconds, and leases in addition.
FAILOVER_TIME, FAILOVER_LEASES = 5.0, 3.0


async def wait_until_done(host: Host, lost_after: float) -> list[CoordinatorOutcome]:
    """The outcomes of all coordinators. The function does not wait for a host without contact for
    `lost_after` seconds.

    It waits for a host that has not started yet as long as a portal call to that host waits, if that is
    longer. It waits for a coordinator that has not started yet until a host that its start needs has
    certainly ended, and for a coordinator that a majority may recover until a failover would have ended.
    """
    unmet = max(lost_after, host.options.unreachable_after)
    homes = {member.id: host.team.hosts[member.host] for member in host.team.initial_coordinators}
    judge = OutcomeResolver(homes)
    started = _StartedByOthers(host, homes)
    membership = host.core.membership
    remembered, failovers = _PendingRestarts(host, homes, lost_after, unmet), _PendingFailovers(host)
    # Announcements during the start of this host count as well.
    since = 0.0
    while True:
        host.changed.clear()
        outcomes = local_outcomes(homes, host.mobility.known_states(), host.mobility.proven_losses(since))
        is_connected = membership.is_fully_connected(host.clock.monotonic())
        if is_connected:
            host.apply(ContactRestored())
        if homes.keys() - outcomes.keys() and (
            membership.ended or not is_connected or host.mobility.has_losses
        ):
            records = await _query_states(host)
            now = host.clock.monotonic()
            outcomes = judge.resolve(
                records, _unavailable(host, _unavailable_hosts(host, records, lost_after, unmet))
            )
            outcomes |= local_outcomes(
                homes, host.mobility.known_states(), host.mobility.proven_losses(now - STATUS_MAX_AGE)
            )
        unstartable = host.core.startup.unstartable(membership.ended)
        outcomes |= {
            agent: CoordinatorOutcome(agent, "lost", reason) for agent, reason in unstartable.items()
        }
        for agent in remembered.pending_agents() | failovers.pending_agents(outcomes):
            outcomes.pop(agent, None)
        if not homes.keys() - outcomes.keys() and not await started.find_more():
            await _broadcast_outcomes(host, outcomes.values())
            await _wait_for_finality(host, lost_after)
            return [outcomes[agent] for agent in sorted(homes)]
        await _wait_for_change(host, ASK_EVERY)
        since = host.clock.monotonic() - STATUS_MAX_AGE


class _StartedByOthers:
    """The coordinators that others have started: the mission lasts until they have ended, too.

    `homes` has the home of each coordinator that the mission waits for. Coordinators that run or have run are
    added to `homes`: the outcome of the last run of each counts.
    """

    def __init__(self, host: Host, homes: dict[str, str]) -> None:
        self._host, self._homes = host, homes

    async def find_more(self) -> bool:
        """Query the hosts when all known coordinators have ended; returns whether there are others.

        A home makes a start before the coordinator that asked for it ends, so the home reports this start.
        """
        team = self._host.team
        waiting = team.startable.keys() - self._homes.keys()
        if not waiting:
            return False
        records = await _query_states(self._host)
        rows = [row for rows in records.values() for row in rows if row.agent in waiting]
        ended = {(row.agent, row.generation) for row in rows if row.state == "EXITED"}
        running = {row.agent for row in rows if (row.agent, row.generation) not in ended}
        # A host announces an end before it answers.
        ended_now = {agent for agent, _ in self._host.mobility.ended_in_this_run if agent in waiting}
        self._homes.update({agent: team.homes[agent] for agent in running | ended_now})
        return bool(running | ended_now)


class _PendingRestarts:
    """Terminations from journals, which belong to an earlier run if a home starts a new one.

    A person may first have to lift a stop, or to start another host, so there is no time limit for the new
    start.

    `homes` has the home of each coordinator; `lost_after` and `unmet` are as in
    `Membership.unavailable_hosts`.
    """

    def __init__(self, host: Host, homes: Mapping[str, str], lost_after: float, unmet: float) -> None:
        self._host, self._homes, self._bounds = host, homes, (lost_after, unmet)
        #: The starts that were alive since the start of this host, or have ended in this run.
        self._new_starts: set[tuple[str, int]] = set()

    def pending_agents(self) -> set[str]:
        """The coordinators that may still be started again."""
        if not self._host.journal_writer.journal_id:
            return set()
        newest: dict[str, int] = {}
        self._new_starts.update(self._host.mobility.ended_in_this_run)
        for row in self._host.mobility.known_states():
            if row.agent not in self._homes:
                continue
            start = row.agent, row.generation
            newest[row.agent] = max(newest.get(row.agent, 0), row.generation)
            if row.state != "EXITED":
                self._new_starts.add(start)
        old_agents = {agent for agent, _ in newest.items() - self._new_starts}
        return {agent for agent in old_agents if not self._is_settled(self._homes[agent])}

    def _is_settled(self, home: str) -> bool:
        """Whether this host is a home that has started its coordinators, or a home is unreachable."""
        host = self._host
        if home == host.name:
            return host.core.startup.is_settled
        unavailable = _unavailable_hosts(host, set(host.team.hosts) - {home}, *self._bounds)
        return home in unavailable.ended or home in unavailable.silent_for


class _PendingFailovers:
    """Coordinators under leases whose host has ended or is silent: a majority may still recover them."""

    def __init__(self, host: Host) -> None:
        self._host = host
        #: The time since when the outcome of each coordinator is unknown.
        self._since: dict[str, float] = {}

    def pending_agents(self, found: Mapping[str, CoordinatorOutcome]) -> set[str]:
        """The coordinators of unknown outcome whose failover may still be under way."""
        leases, now = self._host.core.leases, self._host.clock.monotonic()
        unknown = {agent for agent, outcome in found.items() if outcome.outcome == "unheard"}
        self._since = {agent: self._since.get(agent, now) for agent in unknown & set(leases.leased_agents)}
        if not leases.remaining:
            return set()
        longest = FAILOVER_TIME + FAILOVER_LEASES * leases.quorum.members.lease
        return {
            agent
            for agent, since in self._since.items()
            if now < since + longest + (known.interval if (known := leases.checkpoint(agent)) else 0.0)
        }


def _unavailable_hosts(
    host: Host, answered: Collection[str], lost_after: float, unmet: float
) -> UnavailableHosts:
    """See `Membership.unavailable_hosts`, which changes the state of the core."""
    return cast(UnavailableHosts, host.apply(SilenceChecked(sorted(answered), lost_after, unmet)))


def _unavailable(host: Host, unavailable: UnavailableHosts) -> UnavailableHosts:
    """Add the state ids of the hosts that answered, and whether hosts have journals."""
    return replace(
        unavailable, state_ids=host.mobility.state_ids, has_journals=bool(host.journal_writer.journal_id)
    )


async def _broadcast_outcomes(host: Host, found: Collection[CoordinatorOutcome]) -> None:
    """Announce the terminations, and wait until every reachable host has confirmed them."""
    host.dispatch(OutcomesFound(list(found)))
    end = host.clock.monotonic() + LINGER
    while host.mobility.has_unconfirmed(_reachable_hosts(host)) and host.clock.monotonic() < end:
        host.changed.clear()
        await _wait_for_change(host, ASK_EVERY)


async def _wait_for_finality(host: Host, lost_after: float) -> None:
    """Wait until terminations here are final, so that no host recovers the coordinators; without a lease,
    wait `lost_after` seconds.

    A host without a lease cannot prevent a recovery.
    """
    last_contact, is_reported = host.clock.monotonic(), False
    while names := host.core.leases.not_final_yet:
        now = host.clock.monotonic()
        last_contact = now if host.core.leases.remaining else last_contact
        if now - last_contact >= lost_after:
            host.note(log_messages.END_UNCONFIRMED.line(agents=listed(names), seconds=lost_after))
            return
        if not is_reported:
            host.note(log_messages.END_NOT_FINAL.line(agents=listed(names), host=host.name))
            is_reported = True
        host.changed.clear()
        await _wait_for_change(host, ASK_EVERY)


def _reachable_hosts(host: Host) -> set[str]:
    """The hosts that are linked, or about to be."""
    return {
        other for other in host.team.hosts if other in host.peers.incarnations or host.peers.is_new(other)
    }


async def _query_states(host: Host) -> Mapping[str, Sequence[CoordinatorState]]:
    """The coordinators that this host and every reachable host know, by host, queried now."""
    host.core.locator.clear()
    others = [
        other for other in host.team.hosts if other != host.name and other not in host.core.membership.ended
    ]
    for first in range(0, len(others), MAX_PARALLEL_QUERIES):
        if first:
            await asyncio.sleep(ASK_EVERY)
        await _query(host, others[first : first + MAX_PARALLEL_QUERIES])
    # The answers of the hosts are not the awaited change, only later messages are.
    host.changed.clear()
    return host.core.locator.answers | {host.name: host.mobility.known_states()}


async def _query(host: Host, others: Collection[str]) -> None:
    """Query some hosts, and wait for the answers of those that are linked or being dialled."""
    queried_hosts: set[str] = set()
    for other in others:
        host.peers.require_link(other)
    end = host.clock.monotonic() + ANSWER_WITHIN
    while True:
        host.changed.clear()
        linked = {other for other in others if other in host.peers.incarnations}
        for other in sorted(linked - queried_hosts):
            host.peers.send(other, Locate())
        queried_hosts |= linked
        waited_for = {other for other in others if other in linked or host.peers.is_new(other)}
        if waited_for <= host.core.locator.answers.keys() or host.clock.monotonic() >= end:
            return
        await _wait_for_change(host, max(0.0, end - host.clock.monotonic()))


async def _wait_for_change(host: Host, bound: float) -> None:
    """Wait for a change, at most `bound` seconds."""
    # Not asyncio.wait_for: before Python 3.12 it may swallow a cancellation that coincides with the change.
    with suppress(TimeoutError):
        async with asyncio.timeout(bound):
            await host.changed.wait()
