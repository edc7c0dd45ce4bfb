"""The services that the machine needs from its host."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, Protocol

from lfield.bytecode.program import DeviceCallRecord
from lfield.manifest import DeviceValue
from lfield.text.log_messages import LogLine
from lfield.vm.agent import Agent, TeamMember
from lfield.vm.engine_interface import Reading
from lfield.vm.offer_objects import FoundOffer
from lfield.vm.pending_call import CallRequest, PendingCall


class Pending:
    """The type of PENDING, which means that the answer follows later."""


PENDING: Final = Pending()


class Sequencer(Protocol):
    """The services of a home. Each method returns None, with the asking coordinator suspended, if the answer
    is not available yet. Raises Trap.
    """

    def start(self, asking: Agent, member: TeamMember, request: int) -> bool | None:
        """Start a coordinator of this host; the same `request` only once."""

    def has_started(self, member: TeamMember, request: int) -> bool:
        """Whether the last start was made for this request, and is on disk."""

    def stop(self, asking: Agent, member: TeamMember) -> bool | None:
        """Order the end of a coordinator of this host."""

    def end_of(self, asking: Agent, member: TeamMember) -> str | None:
        """The outcome of a coordinator of this host."""

    def is_running(self, asking: Agent, member: TeamMember) -> bool | None:
        """Whether a coordinator of this host runs."""


class HostInterface(Protocol):
    """The services of the host. Every method returns at once."""

    @property
    def sequencer(self) -> Sequencer:
        """Starts and stops the coordinators of this host that others may start."""

    def write(self, agent: Agent, text: str) -> None:
        """Program output: whole lines, or the rest of a line when its thread ends."""

    def on_input_awaited(self, agent: Agent, seconds: float) -> None:
        """A thread of an agent waits for a line of the operator's input, at most `seconds`."""

    def on_line_read(self, agent: Agent, text: str) -> None:
        """An agent reads a line of the operator's input."""

    def on_readers_changed(self, agents: Sequence[str]) -> None:
        """The agents that wait for a line have changed."""

    def log(self, agent: Agent, text: str) -> None:
        """A line of `print`."""

    def depart(self, agent: Agent, resource: TeamMember) -> None:
        """The suspended coordinator must migrate to the host of the resource. The host answers with
        `Machine.release` when the coordinator has left, or `Machine.resume` with the reason of the failure.
        """

    def report(self, agent: Agent, line: LogLine) -> None:
        """A line of the host's log about an agent."""

    def may_start_call(self, agent: Agent, has_side_effects: bool) -> bool:
        """Whether the portal of this host that the suspended coordinator calls may start now.

        `has_side_effects`: the portal may have side effects.

        True: the portal starts at once, with the block unchanged. False: it has not started. After
        `Machine.unfreeze` this method is called again, unless `Machine.resume` gives a reason against the
        call. For a fenced coordinator the method is called before every portal, otherwise only before portals
        with side effects while `Agent.is_persisted` is not set: the implementation sets it when the present
        block is on disk. It is set on arrival, because the block is stored then.
        """

    def acquire_reservation(self, agent: Agent, resource: TeamMember, *, nested: bool) -> int:
        """The reservation number of a resource of this host, for a suspended coordinator.

        If this start already has the resource, it keeps the resource under this number. 0: not yet; after
        `Machine.unfreeze` this method is called again, unless `Machine.resume` gives a reason against the
        reservation. After `resume` or `abandon_wait` the reservation is not granted. `nested`: the
        coordinator has another reservation and must not wait.

        Raises Trap (ReservedException, UnreachableResourceException) if refused. A coordinator whose rules
        allow no call of the resource is refused before.
        """

    def release_reservations(self, agent: Agent, held: Sequence[tuple[TeamMember, int]]) -> None:
        """A coordinator here leaves a `reserve`: these resources, here or not, and their numbers.

        The method does not wait. A release that is lost without a link takes effect at the end of the lease.
        """

    def may_serve(self, agent: Agent, resource: TeamMember, number: int) -> bool:
        """Whether a portal of a resource of this host may start for a suspended coordinator.

        `number` is the number of its reservation, 0 without one. The method is called while the resource is
        `Agent.reserved`, and for any number: before `may_start_call` for a call, before `may_start_calls` for
        each call of a `together`, where a Trap is the outcome of that call.

        False: not yet. After `Machine.unfreeze` this method is called again, unless `Machine.resume` gives a
        reason against the call, with the resource as `source`. Raises Trap (ReservedException,
        ReservationLostException).
        """

    def may_start_calls(self, agent: Agent, calls: Sequence[CallRequest]) -> bool:
        """Whether the calls of the suspended coordinator's `together` for this host may start now.

        True: the calls start at once, with the block unchanged. False: no call has started. After
        `Machine.unfreeze` this method is called again, unless `Machine.resume` gives a reason against the
        calls. It is called before every such visit: a host with a journal first stores a page per call, and
        the present block.
        """

    def on_call_completed(self, pending: PendingCall) -> None:
        """A pending call here has ended (`PendingCall.state`, `result`).

        When the host has stored the end, or at once without a journal, it calls `PendingCalls.on_persisted`;
        only then the coordinator can fetch the result.
        """

    def watch_calls(self, agent: Agent, calls: Sequence[tuple[TeamMember, int]]) -> None:
        """A coordinator waits here for the first of several calls; these (resource, number) run on other
        hosts.

        While it waits (`Agent.waits_for_any`), `PendingCalls.on_ended_elsewhere` gets the numbers of calls
        that have ended, and of calls whose host is unreachable. This is a hint: the coordinator goes to that
        host.
        """

    def request_cancels(self, agent: Agent, calls: Sequence[tuple[TeamMember, int]]) -> None:
        """A coordinator cancels calls (resource, number) on several other hosts, and goes there next.

        These hosts may cancel the calls before the coordinator arrives: `PendingCalls.cancel_started`. This
        is a hint: the coordinator itself cancels the calls when it is there.
        """

    def abandon_wait(self, agent: Agent) -> bool:
        """The limit of a suspended coordinator has expired. Returns whether it is here and can be resumed.

        True: no coordinator was sent, no call was started, and the host does not wait any more; the machine
        throws. False: the coordinator may have left, or is resumed soon by `Machine.unfreeze`, `resume` or
        `release`.
        """

    def cancel(self, agent: Agent, thread: int) -> bool:
        """Cancel the device instruction that a thread waits for, as its manifest prescribes.

        True: `Machine.throw_builtin` (CancelledException) or `answer` follows. False: the instruction cannot
        be cancelled (a landing, a safe state), and is answered as usual.
        """

    def is_superseded(self, agent: str, generation: int) -> bool:
        """Whether that start of a coordinator was stopped in favour of an earlier one."""

    def host_of(self, member: TeamMember) -> str:
        """The name of the host of an agent of the team."""

    def call_device(
        self, agent: Agent, thread: int, call: DeviceCallRecord, values: list[DeviceValue]
    ) -> DeviceValue | Pending:
        """Execute a device instruction: returns its value, or PENDING and later `Machine.answer` or
        `Machine.throw_builtin`. Raises DeviceError.
        """

    def telemetry_reading(self, agent: Agent, call: DeviceCallRecord) -> Reading | None:
        """The reading behind an immediate query answer; None if the value must be queried each time."""

    def offers(self, agent: Agent, capability: str, constraint: str | None) -> Sequence[FoundOffer]:
        """The present offers of a capability that fulfil the condition, best first.

        Only realisations with which the program was built are used (`offer_objects.realisations`). Raises
        ConstraintError, and SearchIncomplete if no offer was found and the search was not exhaustive.
        """

    def teams(
        self, agent: Agent, capability: str, constraint: str | None, size: int
    ) -> Sequence[Sequence[FoundOffer]]:
        """Combinations of `size` offers without common agents, best first. Raises the errors of `offers`."""

    def explain(self, agent: Agent, capability: str, constraint: str | None) -> str:
        """The reasons why the other agents are no offers, a line each; '' for none. Raises
        ConstraintError.
        """

    def ended(self, agent: Agent) -> None:
        """A coordinator has ended, or an agent died of an uncaught exception (`agent.report`)."""
