"""What the machine asks of the host it runs on."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, Protocol

from lfield.bytecode.program import DeviceCall
from lfield.manifest import DeviceValue
from lfield.vm.agent import Agent, Member
from lfield.vm.begun import Beginning, Begun
from lfield.vm.contract import Reading
from lfield.vm.offers import Found


class Pending:
    """The type of PENDING: the answer comes later."""


PENDING: Final = Pending()


class World(Protocol):
    """The host's side. Every method returns at once."""

    def write(self, agent: Agent, text: str) -> None:
        """Program output: whole lines, or what is left of one when its thread ends."""

    def log(self, agent: Agent, text: str) -> None:
        """A line of `print`."""

    def depart(self, agent: Agent, resource: Member) -> None:
        """The frozen coordinator must get to the host of the resource. Answer by `Machine.release` when it
        has left, or by `Machine.resume` with the reason why it could not."""

    def may_begin(self, agent: Agent, acts: bool) -> bool:
        """Whether the portal of this host that the frozen coordinator calls may begin now.

        `acts` says whether it may change something.

        True: it begins at once, and the block is as it was. False: it has not begun. After `Machine.go` this
        is asked again, unless `Machine.resume` says why the call must not begin.

        Of a fenced coordinator it is asked before every portal, of another one only before a portal that acts
        and while it is not `agent.kept`: whoever implements this sets that when the block is on the disk as
        it stands at this call. It is set when a coordinator comes, since its block was told then.
        """

    def take(self, agent: Agent, resource: Member, *, nested: bool) -> int:
        """The number of the reservation of a resource of this host, for a frozen coordinator.

        A start that has the resource already has it still, by this number from now on. 0: not yet; after
        `Machine.go` this is asked again, unless `Machine.resume` says why not. Whoever is told that, or is
        given up (`give_up`), has not got it. `nested`: it has another one, and must not wait for this one.

        Raises Trap (ReservedException, UnreachableResourceException): it has not got it. A coordinator whose
        rules allow it no call of the resource is refused before.
        """

    def drop(self, agent: Agent, held: Sequence[tuple[Member, int]]) -> None:
        """A coordinator that is here leaves a `reserve`: these resources, here or not, and their numbers.

        It does not wait for anything. What nobody hears of, since there is no link, ends with its lease.
        """

    def serves(self, agent: Agent, resource: Member, number: int) -> bool:
        """Whether a portal of a resource of this host may begin for a frozen coordinator.

        `number` is that of the reservation by which it has the resource, 0: by none. This is asked while the
        resource is `Agent.reserved`, and whenever there is a number: before `may_begin` for a call, before
        `begins` for each call of a `together`, where a Trap is the outcome of that call.

        False: not yet. After `Machine.go` this is asked again, unless `Machine.resume` says why not; its
        `source` is the resource then. Raises Trap (ReservedException, ReservationLostException).
        """

    def begins(self, agent: Agent, calls: Sequence[Beginning]) -> bool:
        """Whether the calls that the frozen coordinator's `together` has for this host may begin now.

        True: they begin at once, and the block is as it was. False: nothing has begun. After `Machine.go`
        this is asked again, unless `Machine.resume` says why they must not begin. It is asked before every
        such visit: a host with a journal has a page for each call, and the block as it stands, on the disk
        first.
        """

    def came_back(self, begun: Begun) -> None:
        """A call that was begun here has come to its end (`begun.state`, `begun.parcel`).

        When the host has kept that, or at once if it keeps nothing, it calls `Machine.kept_result`; only then
        the coordinator can fetch it.
        """

    def give_up(self, agent: Agent) -> bool:
        """The time limit of a frozen coordinator is over. Whether it is here and free to hear of it.

        True: nothing was sent and nothing has begun, the host waits for it no longer; the machine throws.
        False: it may have left, or hears soon: by `Machine.go`, `resume` or `release`.
        """

    def cancel(self, agent: Agent, thread: int) -> bool:
        """The device instruction that a thread waits for shall be cancelled, as its manifest says.

        True: `Machine.refuse` (CancelledException) or `answer` will come. False: it may not be cancelled (a
        landing, a safe state): it comes to its end, and its answer comes as ever.
        """

    def superseded(self, agent: str, generation: int) -> bool:
        """Whether that start of a coordinator was stopped because an earlier one goes on."""

    def host_of(self, member: Member) -> str:
        """The name of the host where an agent of the team lives."""

    def device(
        self, agent: Agent, thread: int, call: DeviceCall, values: list[DeviceValue]
    ) -> DeviceValue | Pending:
        """Carry out a device instruction: its value, or PENDING and later `Machine.answer` or
        `Machine.refuse`. Raises DeviceError."""

    def reading(self, agent: Agent, call: DeviceCall) -> Reading | None:
        """The reading behind a query that was answered at once; None when it has to be asked each time."""

    def offers(self, agent: Agent, capability: str, constraint: str | None) -> Sequence[Found]:
        """Who offers a capability now and fulfils the condition, best first.

        Only by ways that the program was built with (`offers.ways`). Raises ConstraintError, and
        SearchGivenUp where nobody was found and not everything could be tried.
        """

    def teams(
        self, agent: Agent, capability: str, constraint: str | None, size: int
    ) -> Sequence[Sequence[Found]]:
        """Teams of so many offers that have no agent in common, best first. Raises what `offers` does."""

    def explain(self, agent: Agent, capability: str, constraint: str | None) -> str:
        """Why everybody else does not, a line each; '' when there is nobody else. Raises ConstraintError."""

    def ended(self, agent: Agent) -> None:
        """A coordinator came to its end, or an agent died of an uncaught exception (`agent.report`)."""
