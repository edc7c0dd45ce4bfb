"""Dead-man's switch: detects devices whose last controlling coordinator is not confirmed alive. Sans-IO.

A coordinator *uses* a device when a portal that it has called actuates it. From then on the coordinator is
confirmed alive

  - while a copy of it is here, or a host reports a copy;
  - while the host to which it moved cannot be queried, but any other host has contact with that host: the
    coordinator may be there.

The host in the newest record is queried regularly, and reports where the coordinator moved next. When these
queries do not find it for half of the time-out, other hosts are queried too. A terminated coordinator is not
confirmed any more: the devices that it left, perhaps in hover, have the same time-out. A later start of it
counts as the same coordinator.

A person uses a device likewise, and counts as alive while a portal call of that person runs here.
"""

from __future__ import annotations

from collections.abc import Container, Iterable
from typing import Protocol

from msgspec import Struct, structs

from lfield.driver.binding import DeviceBinding
from lfield.host.effects import MakeDeviceSafe
from lfield.replication.locate.outcomes import UnavailableHosts
from lfield.replication.membership.membership import SUSPICION_TIMEOUT
from lfield.replication.transfer.coordinator_copies import LIVE_STATES
from lfield.replication.transfer.effects import Send
from lfield.wire.coordinator_messages import CoordinatorState, Locate

#: Seconds between two checks, while a device depends on a coordinator.
CHECK_EVERY = 1.0
#: The number of hosts queried at a time when the expected host does not know the coordinator.
MAX_PARALLEL_QUERIES = 8


class MembershipView(Protocol):
    """The liveness of other hosts: `lfield.replication.membership.membership.Membership`."""

    @property
    def links(self) -> list[str]:
        """The hosts that can be queried."""

    def unavailable_hosts(
        self, answered: Container[str], now: float, lost_after: float, unmet: float
    ) -> UnavailableHosts:
        """Classify the hosts that did not answer."""


class _Coordinator(Struct):
    """A coordinator: the times when it was last confirmed alive and last reported, and its newest record."""

    alive_at: float
    last_contact: float
    newest: CoordinatorState | None = None

    @property
    def location(self) -> str:
        """The host to which the coordinator was last known to move, or on which it was; '' if unknown."""
        return self.newest.where if self.newest is not None and not _is_ended(self.newest) else ""

    def mark_alive(self, now: float) -> None:
        """A host has a copy of the coordinator."""
        self.alive_at = self.last_contact = now

    def on_state(self, host: str, record: CoordinatorState, now: float) -> None:
        """A host reports the coordinator."""
        if record.state in LIVE_STATES:
            self.mark_alive(now)
            record = structs.replace(record, where=host)
        if self.newest is None or _order(record) >= _order(self.newest):
            self.newest = record


class DeadmanMonitor:
    """The devices whose bindings define a dead-man's switch; all times are in seconds."""

    def __init__(self, devices: Iterable[DeviceBinding]) -> None:
        self._policies = {device.name: device.without_policy for device in devices if device.without_policy}
        #: The used devices with their users, and those coordinators.
        self._users: dict[str, set[str]] = {}
        self._coordinators: dict[str, _Coordinator] = {}
        self._turn = 0
        #: The time when `check` is due; None while no device depends on a coordinator.
        self.due: float | None = None

    def on_used(self, device: str, coordinator: str, now: float) -> None:
        """A portal that this coordinator has called actuates a device of this host."""
        if device not in self._policies:
            return
        self._users.setdefault(device, set()).add(coordinator)
        self._coordinators.setdefault(coordinator, _Coordinator(now, now)).mark_alive(now)
        self.due = now + CHECK_EVERY if self.due is None else self.due

    def on_running(self, callers: Iterable[str], now: float) -> None:
        """Portal calls of these persons are running here, and use the devices."""
        for caller in callers:
            if caller in self._coordinators:
                self._coordinators[caller].mark_alive(now)

    def on_states(self, host: str, records: Iterable[CoordinatorState], now: float) -> None:
        """A host reports its records of coordinators."""
        for record in records:
            if record.agent in self._coordinators:
                self._coordinators[record.agent].on_state(host, record, now)

    def check(
        self, own_host: str, own: Iterable[CoordinatorState], others: MembershipView, now: float
    ) -> list[MakeDeviceSafe | Send]:
        """The hosts to query, and the devices to make safe. `own` are the records of `own_host`."""
        self.on_states(own_host, own, now)
        unavailable = others.unavailable_hosts((), now, SUSPICION_TIMEOUT, SUSPICION_TIMEOUT)
        agents, queried_hosts = list(self._coordinators), set[str]()
        for name, known in self._coordinators.items():
            where, can_be_asked = known.location, known.location in others.links
            if where in unavailable.reachable_by_others and not can_be_asked:
                known.last_contact = now
            patience = min(
                self._policies[device].after for device in self._users if name in self._users[device]
            )
            if now - known.alive_at >= patience / 2.0:
                queried_hosts |= self._next_hosts(others.links)
            if now - known.alive_at >= patience / 4.0 and can_be_asked:
                queried_hosts.add(where)
        orphans = [self._orphan(device) for device in list(self._users) if self._is_orphaned(device, now)]
        self.due = now + CHECK_EVERY if self._users else None
        return [*orphans, *(Send(host, Locate(agents)) for host in sorted(queried_hosts))]

    def _next_hosts(self, links: list[str]) -> set[str]:
        """Some of the hosts; the next call returns others."""
        if not links:
            return set()
        first, self._turn = self._turn % len(links), self._turn + MAX_PARALLEL_QUERIES
        return set([*links[first:], *links[:first]][:MAX_PARALLEL_QUERIES])

    def _is_orphaned(self, device: str, now: float) -> bool:
        last = max(self._coordinators[name].last_contact for name in self._users[device])
        return now - last >= self._policies[device].after

    def _orphan(self, device: str) -> MakeDeviceSafe:
        """Make a device safe: the device depends on no coordinator until it is used again."""
        users, policy = self._users.pop(device), self._policies[device]
        described = ", ".join(self._describe(name) for name in sorted(users))
        for name in users - set().union(*self._users.values()):
            del self._coordinators[name]
        reason = f"no coordinator that used it ({described}) has been confirmed alive for {policy.after:g} s"
        return MakeDeviceSafe(device, policy.do, reason, tuple(sorted(users)))

    def _describe(self, name: str) -> str:
        newest = self._coordinators[name].newest
        if newest is not None and _is_ended(newest):
            return f"{name}, {newest.outcome}"
        return f"{name}, last known at {newest.where}" if newest and newest.where else name


def _is_ended(record: CoordinatorState) -> bool:
    """Whether a record is a termination. A loss is only presumed."""
    return record.state == "EXITED" and record.outcome != "lost"


def _order(record: CoordinatorState) -> tuple[int, bool, int]:
    """Sort key: later on the coordinator's path is greater."""
    return record.generation, _is_ended(record), record.sequence
