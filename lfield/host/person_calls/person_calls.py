"""Portal calls of persons to the resources of one host: at most once each, by the access rules. Sans-IO.

A call is identified by the id that its client has drawn. The id is kept longer than the client repeats the
call, so a repetition never starts it again; the results of the last calls are kept to answer repetitions. An
incarnation of the host does not start a call that an earlier incarnation may have started.

Checked before a call starts, as for a coordinator: access rules, pause, reservations, and in a mission with
leases the lease of this host.
"""

from __future__ import annotations

import heapq
from collections import Counter, deque

from msgspec import Struct

from lfield.host.context import HostContext, Part
from lfield.host.effects import AnswerPersonCall, WriteLogOnce
from lfield.host.person_calls.call_limits import CallLimits
from lfield.host.team.part_interfaces import CoordinatorOperations, LeaseRules, ReservationRules
from lfield.replication.transfer.transfer_sender import LIMIT, RESTARTED, UNREACHABLE
from lfield.text import log_messages
from lfield.vm.agent import CANCELLED, Agent, TeamMember
from lfield.vm.deadlines import TIME_LIMIT
from lfield.vm.engine_interface import Trap
from lfield.vm.machine import Machine
from lfield.vm.pending_call import PendingCall
from lfield.vm.person_calls.person_portals import PortalMismatch
from lfield.vm.person_calls.value_codec import UnsendableValue, decode_values, encode_values
from lfield.wire.fields import truncate
from lfield.wire.person_calls.portal_call_messages import (
    MAX_RESULT,
    CallOutcome,
    PortalCallRequest,
    PortalCallResult,
    RefusalCode,
)

#: Seconds for which an id is kept after the time limit of its call: longer than a client repeats the call.
KEEP_ID = 120.0
#: The most ids that are kept, of all callers and of one, and the most bytes of the results.
MAX_IDS, MAX_IDS_OF_ONE, MAX_RESULTS = 32768, 4096, 4 << 20
#: The reasons of refusals that stay: their ids need not be kept.
LASTING: frozenset[RefusalCode] = frozenset({"not-permitted", "no-portal"})


class PersonCaller(Struct, frozen=True):
    """The caller of a portal: a person of the authority, or a user of the host's own computer (`name` '')."""

    name: str
    label: str


class PersonCall(Struct, eq=False):
    """A call. Before its start it may wait for a reservation; `result` is set when it has ended."""

    order: PortalCallRequest
    caller: PersonCaller
    number: int
    expires_at: float
    pending: PendingCall | None = None
    result: PortalCallResult | None = None
    is_expired: bool = False

    @property
    def start_key(self) -> tuple[str, int]:
        """The key of the call in the queue of a reserved resource. No name of a coordinator contains a space,
        so no coordinator has this key.
        """
        return self.caller.label, self.number


class PersonCalls(Part):
    """The calls of one host, by id."""

    def __init__(
        self,
        context: HostContext,
        team: CoordinatorOperations,
        leases: LeaseRules,
        reservations: ReservationRules,
        machine: Machine,
    ) -> None:
        self._access, self._incarnation, self._own_host = (
            context.mission.access,
            context.incarnation,
            context.name,
        )
        self._members = {m.id: m for m in context.mission.team.members}
        self._hosts = context.mission.team.hosts
        self._team, self._leases, self._reservations, self._machine = team, leases, reservations, machine
        self._clock, self._out, self._log = context.clock, context.effects.append, context.log
        #: All calls whose ids are kept, and the calls that have not ended, by id.
        self._calls: dict[bytes, PersonCall] = {}
        self._active: dict[bytes, PersonCall] = {}
        #: A heap of the times when ids are dropped, and the number of ids by caller.
        self._drops: list[tuple[float, bytes]] = []
        self._id_counts: Counter[str] = Counter()
        #: The ended calls with a kept result, in order, and the bytes of all these results.
        self._results: deque[PersonCall] = deque()
        self._result_bytes = 0
        self._limits = CallLimits(context.clock.monotonic())
        self._number = 0

    # --- orders of persons ----------------------------------------------------------------------------

    def call(self, order: PortalCallRequest, caller: PersonCaller) -> None:
        """Start a call, join one with the same id, or answer with its result."""
        now = self._clock.monotonic()
        known = self._calls.get(order.id)
        if known is not None:
            if known.caller != caller:
                self._refuse(order, caller, "not-permitted", "another caller has used this id")
            elif known.result is not None:
                self._out(AnswerPersonCall(known.result))
            return
        if order.incarnation != self._incarnation:
            attempt = f"{self._own_host} has restarted since the first attempt"
            text = f"{attempt}, and may have executed the call before"
            self._answer(PortalCallResult(order.id, "unknown", "restarted", text))
            return
        reason = self._refusal(order, caller, now)
        if reason is not None and (reason[0] in LASTING or not self._has_space(caller)):
            self._refuse(order, caller, *reason)
            return
        call = self._add(order, caller, now)
        if reason is None:
            self._start(call)
        else:
            self._end(call, "refused", *reason)
        self._update_due()

    def cancel(self, id: bytes, caller: PersonCaller) -> None:
        """A person cancels their call."""
        call, now = self._calls.get(id), self._clock.monotonic()
        if call is not None and call.caller == caller:
            self._cancel(call, f"{caller.label} has cancelled the call")
            if call.result is not None:
                self._answer(call.result)
        elif call is None and self._has_space(caller) and not self._limits.refusal(caller.label, 0, 0, now):
            # The call may arrive after its cancellation, over another link.
            call = self._add(PortalCallRequest(id, self._incarnation, "-", "-", b"", 1.0), caller, now)
            self._end(call, "refused", "cancelled", "the call was cancelled before it started")
        self._update_due()

    def _add(self, order: PortalCallRequest, caller: PersonCaller, now: float) -> PersonCall:
        """A new call, which has not started."""
        self._number += 1
        call = PersonCall(order, caller, self._number, now + order.limit)
        self._calls[order.id] = self._active[order.id] = call
        self._id_counts[caller.label] += 1
        return call

    def _has_space(self, caller: PersonCaller) -> bool:
        """Whether one more id can be kept."""
        return len(self._calls) < MAX_IDS and self._id_counts[caller.label] < MAX_IDS_OF_ONE

    def _refusal(
        self, order: PortalCallRequest, caller: PersonCaller, now: float
    ) -> tuple[RefusalCode, str] | None:
        """The reason why a call may not start, by code and sentence."""
        if self._team.is_halted:
            return "stopping", f"{self._own_host} is stopping"
        member = self._members.get(order.resource)
        if member is None or member.kind != "resource":
            return "no-portal", f"the mission has no resource '{order.resource}'"
        if order.is_assistant and (reason := self._access.assistant_refusal(caller.name)):
            return "not-permitted", reason
        if reason := self._access.person_refusal(caller.name, member, order.portal):
            return "not-permitted", reason
        if self._hosts[member.host] != self._own_host:
            return "no-portal", f"{member.id} is on {self._hosts[member.host]}, not on {self._own_host}"
        if self._team.paused:
            return "paused", "the mission is paused; 'lfield resume' continues it"
        if self._leases.has_to_wait:
            return "paused", f"{self._own_host} has no lease: no majority of the members responds"
        if not self._has_space(caller):
            return "busy", f"{self._own_host} has executed very many calls of persons in the last minutes"
        own = sum(call.caller.label == caller.label for call in self._active.values())
        busy = self._limits.refusal(caller.label, len(self._active), own, now)
        return ("busy", busy) if busy else None

    # --- the life of a call ---------------------------------------------------------------------------

    def _start(self, call: PersonCall) -> None:
        """Start the call, or let it wait for the reservation of its resource."""
        order, machine = call.order, self._machine
        try:
            resource = self._live_resource(self._members[order.resource])
            method, values = machine.person_portals.find(
                resource, order.portal, decode_values(order.arguments)
            )
            if resource.reserved and not self._reservations.may_serve_person(call.start_key, resource.id):
                return
            pending = PendingCall(
                call.caller.label, 0, call.number, resource.id, order.portal, is_of_person=True
            )
            machine.person_portals.start(pending, resource, method, values)
        except PortalMismatch as error:
            self._end(call, "refused", "arguments" if error.has_portal else "no-portal", str(error))
        except UnsendableValue as error:
            self._end(call, "refused", "arguments", str(error))
        except Trap as trap:
            self._end(call, "thrown", trap.kind, f"{trap.message}; the call has not started")
        else:
            call.pending = pending
            self._log(
                log_messages.PORTAL_CALLED.line(
                    caller=call.caller.label, resource=order.resource, portal=order.portal
                )
            )

    def _live_resource(self, member: TeamMember) -> Agent:
        resource = self._machine.agents.get(member.id)
        if resource is None or resource.ended:
            reason = f"it died of {resource.report.splitlines()[0]}" if resource else "it has not started yet"
            raise Trap(UNREACHABLE, f"{member.id} is not available: {reason}")
        return resource

    def _poll_waiting(self) -> None:
        """Start the calls that have waited for a reserved resource, or end the calls that are denied."""
        for start in self._reservations.drain_retried_persons():
            for call in [each for each in self._active.values() if each.start_key == start]:
                if call.pending is None:
                    self._start(call)

    def on_completed(self, pending: PendingCall) -> None:
        """The portal of a call has ended (`HostInterface.on_call_completed`)."""
        portals = self._machine.person_portals
        portals.on_completed(pending)
        call = next((each for each in self._active.values() if each.pending is pending), None)
        if call is None:
            return
        if pending.state == "done":
            try:
                value = encode_values([portals.result(pending)], MAX_RESULT)
            except UnsendableValue as error:
                reason = f"the portal has returned, and its result cannot be sent: {error}"
                self._end(call, "thrown", LIMIT, reason)
            else:
                self._end(call, "returned", value=value)
        else:
            kind, message = portals.exception(pending)
            if call.is_expired and kind == CANCELLED:
                kind, message = TIME_LIMIT, f"the time limit of {call.order.limit:g} s has expired"
            self._end(call, "thrown", kind, message)
        self._update_due()

    def _cancel(self, call: PersonCall, reason: str, kind: str = CANCELLED) -> None:
        if call.result is not None:
            return
        if call.pending is not None:
            self._machine.person_portals.cancel(call.pending, reason)
            return
        self._reservations.abandon_person(call.start_key)
        self._end(call, "thrown", kind, f"{reason}; the call has not started")

    def abandon_waiting(self, reason: str) -> None:
        """Calls that wait do not start: the mission was paused, or the host stops."""
        for call in list(self._active.values()):
            if call.pending is None:
                self._cancel(call, reason, RESTARTED)

    def on_halted(self) -> None:
        """The host stops: the portals that run are not continued."""
        self.abandon_waiting("its host is stopping")
        for call in list(self._active.values()):
            self._end(call, "unknown", "stopped", "its host has stopped while the portal was running")
        self._update_due()

    def _end(
        self, call: PersonCall, outcome: CallOutcome, kind: str = "", message: str = "", *, value: bytes = b""
    ) -> None:
        order = call.order
        result = PortalCallResult(order.id, outcome, kind, truncate(message), value)
        call.result = result
        del self._active[order.id]
        drop_at = max(call.expires_at, self._clock.monotonic()) + KEEP_ID
        heapq.heappush(self._drops, (drop_at, order.id))
        if value:
            self._results.append(call)
            self._result_bytes += len(value)
        if outcome == "refused":
            self._note_refusal(order, call.caller, message)
        else:
            how = truncate("returned" if outcome == "returned" else f"{kind}: {message}")
            self._log(
                log_messages.PORTAL_CALL_ENDED.line(
                    caller=call.caller.label, resource=order.resource, portal=order.portal, outcome=how
                )
            )
        self._answer(result)
        self._drop_old_results()

    def _refuse(self, order: PortalCallRequest, caller: PersonCaller, kind: RefusalCode, reason: str) -> None:
        """Refuse a call whose id is not kept: the call had no effect."""
        self._note_refusal(order, caller, reason)
        self._answer(PortalCallResult(order.id, "refused", kind, truncate(reason)))

    def _note_refusal(self, order: PortalCallRequest, caller: PersonCaller, reason: str) -> None:
        line = log_messages.PORTAL_CALL_REFUSED.line(
            caller=caller.label, resource=order.resource, portal=order.portal, reason=reason
        )
        self._out(WriteLogOnce(line))

    def _answer(self, found: PortalCallResult) -> None:
        self._out(AnswerPersonCall(found))

    def _drop_old_results(self) -> None:
        """Keep the newest results only; the ids of the other calls are kept."""
        while self._result_bytes > MAX_RESULTS:
            self._drop_result(self._results.popleft())

    def _drop_result(self, call: PersonCall) -> None:
        if call.result is not None:
            self._result_bytes -= len(call.result.value)
            text = "the call has ended, and its result is no longer kept"
            call.result = PortalCallResult(call.order.id, "unknown", "dropped", text)

    # --- time -----------------------------------------------------------------------------------------

    def _update_due(self) -> None:
        dues = [call.expires_at for call in self._active.values() if not call.is_expired]
        self.due = min([*dues, *(when for when, _ in self._drops[:1])], default=None)
        self.is_polled = any(call.pending is None for call in self._active.values())

    def on_tick(self, now: float) -> None:
        """A time limit has expired, a call waits, or an id need not be kept any more."""
        for call in list(self._active.values()):
            if not call.is_expired and now >= call.expires_at:
                call.is_expired = True
                reason = f"the time limit of {call.order.limit:g} s has expired"
                self._cancel(call, reason, TIME_LIMIT)
        self._poll_waiting()
        while self._drops and self._drops[0][0] <= now:
            _, id = heapq.heappop(self._drops)
            call = self._calls.pop(id)
            self._id_counts[call.caller.label] -= 1
            if not self._id_counts[call.caller.label]:
                del self._id_counts[call.caller.label]
            if call in self._results:
                self._results.remove(call)
                self._drop_result(call)
        self._update_due()
