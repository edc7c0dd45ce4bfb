"""Waits of coordinators for the first of calls on several hosts, which report their ends (decision 102).

Sans-IO. The host of the coordinator asks the hosts of its calls, again every second and at each new link. A
host answers at once for calls that have ended, and for the others when their results may be fetched. A host
that has not been reachable for `unreachable_after` counts as a host whose calls have ended: the coordinator
that goes there gets an UnreachableResourceException for these calls.
"""

from __future__ import annotations

from collections.abc import Sequence

from msgspec import Struct

from lfield.host.context import HostContext, LinkOpened, Part
from lfield.host.effects import OpenLink
from lfield.host.team.part_interfaces import HostReachability
from lfield.replication.transfer.effects import Send
from lfield.vm.agent import Agent, TeamMember
from lfield.vm.machine import Machine
from lfield.vm.pending_call import CallKey, PendingCall
from lfield.wire.coordinator_messages import CallsEnded, CancelCalls, WatchCalls

#: Seconds after which a host is asked again: the message, or the answer, may be lost.
REPEAT_AFTER = 1.0


class _Wait(Struct):
    """A coordinator that waits here: the numbers of its calls by host, and when the hosts are asked again."""

    agent: Agent
    calls: dict[str, list[int]]
    repeat_at: float


class CallWatch(Part):
    """The waits of the coordinators of one host, and the calls here that others wait for."""

    def __init__(self, context: HostContext, machine: Machine, reachability: HostReachability) -> None:
        self._machine, self._reachability, self._clock = machine, reachability, context.clock
        self._hosts, self._out = context.team.hosts, context.effects.append
        self._unreachable_after = context.unreachable_after
        self._waits: dict[str, _Wait] = {}
        #: The hosts that wait for calls here.
        self._watchers: dict[CallKey, str] = {}
        self.handles = {WatchCalls: self._on_watch, CallsEnded: self._on_ended, CancelCalls: self._on_cancel}
        self.observes = {LinkOpened: self._on_link_opened}
        machine.pending_calls.watch_results(self._on_result)

    def watch(self, agent: Agent, calls: Sequence[tuple[TeamMember, int]]) -> None:
        """See `HostInterface.watch_calls`."""
        by_host = self._by_host(calls)
        self._waits[agent.id] = _Wait(agent, by_host, self._clock.monotonic() + REPEAT_AFTER)
        for host in by_host:
            self._ask(self._waits[agent.id], host)
        self._update_due()

    def request_cancels(self, agent: Agent, calls: Sequence[tuple[TeamMember, int]]) -> None:
        """See `HostInterface.request_cancels`."""
        for host, numbers in self._by_host(calls).items():
            if self._reachability.is_linked(host):
                self._out(Send(host, CancelCalls(agent.id, agent.generation, numbers)))

    def _by_host(self, calls: Sequence[tuple[TeamMember, int]]) -> dict[str, list[int]]:
        found: dict[str, list[int]] = {}
        for resource, number in calls:
            found.setdefault(self._hosts[resource.host], []).append(number)
        return found

    @property
    def needed_hosts(self) -> set[str]:
        """The hosts whose answers coordinators here wait for."""
        return {host for wait in self._waits.values() if self._is_current(wait) for host in wait.calls}

    def on_tick(self, now: float) -> None:
        """Ask again, and end the waits for hosts that are not reachable."""
        self._waits = {name: wait for name, wait in self._waits.items() if self._is_current(wait)}
        for wait in list(self._waits.values()):
            if now < wait.repeat_at:
                continue
            wait.repeat_at = now + REPEAT_AFTER
            for host in wait.calls:
                self._ask(wait, host)
        self._update_due()

    def _is_current(self, wait: _Wait) -> bool:
        agent = wait.agent
        return agent.waits_for_any and not agent.ended and self._machine.agents.get(agent.id) is agent

    def _ask(self, wait: _Wait, host: str) -> None:
        agent, numbers = wait.agent, wait.calls[host]
        if self._reachability.is_linked(host):
            self._out(Send(host, WatchCalls(agent.id, agent.generation, numbers)))
        elif self._is_given_up(host):
            self._machine.pending_calls.on_ended_elsewhere(agent.id, agent.generation, numbers)
        else:
            self._out(OpenLink(host))

    def _is_given_up(self, host: str) -> bool:
        """Whether a host was unlinked for so long that a departure to it fails at once."""
        down_for = self._reachability.down_for(host)
        may_return = 0.0 < down_for < self._unreachable_after
        return bool(self._reachability.lost_reason(host)) and not may_return

    def _update_due(self) -> None:
        self.due = min((wait.repeat_at for wait in self._waits.values()), default=None)

    # --- events ---------------------------------------------------------------------------------------

    def _on_link_opened(self, event: LinkOpened) -> None:
        """The host may have restarted, or a message may be lost."""
        for wait in self._waits.values():
            if self._is_current(wait) and event.hello.host in wait.calls:
                self._ask(wait, event.hello.host)

    def _on_ended(self, host: str, message: CallsEnded) -> None:
        pending = self._machine.pending_calls
        pending.on_ended_elsewhere(message.agent, message.generation, message.numbers)

    def _on_cancel(self, host: str, message: CancelCalls) -> None:
        self._machine.pending_calls.cancel_started(message.agent, message.generation, message.numbers)

    def _on_watch(self, host: str, message: WatchCalls) -> None:
        start = message.agent, message.generation
        pending = {call.key: call for call in self._machine.pending_calls.calls()}
        ended = []
        for number in message.numbers:
            call = pending.get((*start, number))
            if call is not None and (call.state == "running" or not call.is_persisted):
                self._watchers[call.key] = host
            else:
                ended.append(number)
        if ended:
            self._out(Send(host, CallsEnded(*start, ended)))

    def _on_result(self, pending: PendingCall) -> None:
        """The result of a call here may be fetched."""
        host = self._watchers.pop(pending.key, "")
        if host and self._reachability.is_linked(host):
            self._out(Send(host, CallsEnded(pending.agent, pending.generation, [pending.number])))
