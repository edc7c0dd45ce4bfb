"""How coordinators move between hosts: a pure state machine, one per host.

Events come in as method calls, effects go out as a list, time is a parameter in seconds; there is no
input or output in here, and blocks are opaque bytes. `lfield/docs/mobility.md` explains the protocol and
what it does not guarantee; chapter III of the thesis has the three steps of a hop, appendix I the shadow.

The rule everything serves: of one start of a coordinator, never two copies run.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

from lfield.mobility.arrivals import Arrivals
from lfield.mobility.copies import LIVE, UNREADABLE, Copies
from lfield.mobility.departures import Departures
from lfield.mobility.effects import Began, Finished, Go
from lfield.mobility.endings import Endings
from lfield.mobility.recoveries import Recoveries, bar, newest, termination
from lfield.wire.coordinators import Accepted, Ended, EndedAck, Inquire, Known, Refused, Transfer
from lfield.wire.messages import Hello

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable

    from lfield.journal.pages import CopyPage
    from lfield.mobility.copies import Copy
    from lfield.mobility.effects import Effect, Refusal, Send
    from lfield.mobility.fates import Fate
    from lfield.wire.coordinators import Outcome
    from lfield.wire.framing import Buffer


class Put(Protocol):
    """Puts a copy that was kept into the machine; see `Mobility.wake`."""

    def __call__(self, copy: Copy, *, runs: bool) -> Callable[[int], Buffer] | None:
        """What gives the block to send, None when the copy cannot go on."""


#: The messages for `Mobility.receive`.
MobilityMessage = Accepted | Refused | Inquire | Ended | EndedAck


class Mobility:
    """The coordinators of one host: coming, going and ending.

    `own` is what this host says in greetings (its `coordinators` are not looked at): it gives the host's
    name, incarnation, program and `max_block`. `peers` are the other hosts of the deployment, `agents` its
    coordinators. `inject(header, block)` puts a copy that arrived into the machine, in place of whatever
    copy of that agent the host holds, and returns None, or a Refusal if it cannot; it must copy the block
    and must not call back. `unreachable_after` is how long, in seconds, a coordinator waits for a host.

    A host calls `start` for its own coordinators before it greets anybody, `linked` and `unlinked` as
    links come and go, `arrive`, `oversize` and `receive` with what the links bring, and `tick` at
    `next_deadline`.
    """

    def __init__(
        self,
        own: Hello,
        *,
        peers: Collection[str],
        agents: Collection[str],
        inject: Callable[[Transfer, Buffer], Refusal | None],
        unreachable_after: float = 10.0,
    ) -> None:
        self._own = own
        self._copies = Copies(agents, own.mission if own.memory else b"")
        self._links: dict[str, Hello] = {}
        self._endings = Endings(own.host, frozenset(peers) - {own.host}, self._copies, self._links)
        self._departures = Departures(own, self._copies, self._links, self._endings, unreachable_after)
        self._arrivals = Arrivals(own, self._copies, self._departures, self._endings, inject)
        self._recoveries = Recoveries(own.host, self._copies, self._endings)

    def start(self, agent: str, generation: int) -> list[Effect]:
        """A coordinator starts here. `generation` must be new, and greater than those of earlier starts."""
        copy = self._copies.enter(agent, generation)
        if copy is None or copy.state != "ABSENT":
            raise ValueError(f"{agent} cannot be started as generation {generation}")
        copy.run(0, 0)
        return [*self._copies.keep(copy), Began(agent, generation)]

    def save(self, agent: str, block: Buffer) -> list[Effect]:
        """The running copy of `agent`, frozen by the caller, calls a portal of this host: keep it there."""
        for copy in self._copies.of(agent):
            if copy.state == "RUN":
                copy.block, copy.restored = bytes(block), False
                return [*self._copies.keep(copy), Go(agent, copy.generation)]
        raise ValueError(f"{agent} does not run here")

    def restore(self, pages: Iterable[CopyPage], parked: Iterable[CopyPage] = ()) -> None:
        """What the journal of this host has of the coordinators. Those that can go on here: see `wake`.

        `parked` are of another mission: others are told of them, and their numbers are not used again.
        """
        self._copies.parked = {(page.agent, page.generation): page for page in parked}
        for page in pages:
            copy = self._copies.enter(page.agent, page.generation)
            if copy is not None:
                copy.restore(page)
                self._endings.restored(copy)

    def wake(self, put: Put, now: float) -> list[Effect]:
        """Go on with what was restored: `put(copy, runs=...)` has it in the machine again.

        There it is frozen at its portal call, or goes on if it `runs`. `put` returns the `seal` for its
        departure, or None if the block is none.
        """
        effects: list[Effect] = []
        for copy in self._copies:
            if not copy.restored:
                continue
            runs = copy.state == "RUN"
            if runs and copy.doubt:
                copy.restored = False
                continue
            copy.restored = not runs
            copy.seal = put(copy, runs=runs)
            if copy.seal is None:
                copy.doubt, copy.unreadable = UNREADABLE, True
            elif not runs:
                effects += self._departures.woken(copy, now)
        return effects

    def depart(self, agent: str, host: str, seal: Callable[[int], Buffer], now: float) -> list[Effect]:
        """The running copy of `agent`, frozen by the caller, wants to go to `host`.

        `seal(sequence)` writes the number into the block's header and returns the block. It is called once
        for each time the block is sent, at once if there is a link. The bytes must then stay as they are
        until Resume, Departed, Supersede or Finished.
        """
        for copy in self._copies.of(agent):
            if copy.state == "RUN":
                return self._departures.depart(copy, host, seal, now)
        raise ValueError(f"{agent} does not run here")

    def give_up(self, agent: str, generation: int) -> bool:
        """Nobody wants to wait any longer for the departure of a coordinator.

        True: nothing was sent, and it runs here again. False: it is not about to leave, or it may be gone.
        """
        copy = self._copies.find(agent, generation)
        return copy is not None and self._departures.give_up(copy)

    def ended(self, agent: str, generation: int, outcome: Outcome, detail: str = "") -> list[Effect]:
        """A copy held here has ended: tell every host. 'lost': somebody gives up a copy in doubt."""
        copy = self._copies.find(agent, generation)
        if copy is None or not (copy.doubt if outcome == "lost" else copy.state in ("RUN", "FROZEN")):
            raise ValueError(f"{agent} of generation {generation} cannot end here as {outcome!r}")
        return self._endings.end(copy, outcome, detail)

    def forget(self, agent: str, detail: str) -> tuple[list[int], list[Effect]]:
        """A person says that this agent is lost, of whatever mission it is.

        Whatever is known to be alive goes on. Returns the starts that end here.
        """
        gone = {copy.generation for copy in self._copies.of(agent) if copy.state == "MOVED" or copy.doubt}
        gone |= {generation for name, generation in self._copies.parked if name == agent}
        effects = self._endings.lose(agent, sorted(gone), detail)
        return [effect.generation for effect in effects if isinstance(effect, Finished)], effects

    def delay(self, is_delayed: Callable[[Ended], bool]) -> None:
        """Endings elsewhere of which this is true are neither kept nor confirmed until `terminated`."""
        self._endings.is_delayed = is_delayed

    def terminated(self, ended: Ended) -> list[Effect]:
        """A coordinator has ended elsewhere, and that may come to the disk now."""
        return self._endings.terminated(ended)

    def termination(self, agent: str) -> Copy | None:
        """The newest start of it that is known to have ended; None when a later one is here."""
        return termination(self._copies.of(agent))

    def unconfirmed_by(self, agent: str, generation: int) -> Collection[str]:
        """The hosts that have not confirmed an ending that this host tells of."""
        return self._endings.unconfirmed_by(agent, generation)

    def bar(self, agent: str, generation: int, reason: str) -> list[Effect]:
        """No start of it before `generation` may run any more: those that are here stop."""
        return bar(self._copies.of(agent), generation, reason)

    def newest(self, agent: str) -> Copy | None:
        """What it could go on from here, or the coordinator itself; None for neither."""
        return newest(self._copies.of(agent))

    def recoverable(self, agent: str) -> Known | None:
        """What this host could go on with if the holder of a coordinator were gone; None if it runs here."""
        copy = self._recoveries.newest(agent)
        return None if copy is None else copy.known()

    def recover(
        self, agent: str, generation: int, put: Callable[[Copy], Callable[[int], Buffer] | None]
    ) -> list[Effect]:
        """The holder of a coordinator is gone for good: a new start of it, `generation`, goes on here.

        That must be a recovery's number above all that are known, and `recoverable` must have something.
        `put(copy)` has its block in the machine, frozen; None: it cannot be read, which is all that is noted.
        """
        return self._recoveries.recover(agent, generation, put)

    @property
    def memories(self) -> dict[str, int]:
        """What each linked host answers from; see `Hello.remembers`."""
        return {host: peer.remembers for host, peer in self._links.items()}

    def linked(self, peer: Hello) -> list[Effect]:
        """A link to a host is up; `peer` is what it said in its greeting."""
        effects = self._told(peer.host, peer.remembers, peer.coordinators)
        self._links[peer.host] = peer
        return effects + self._departures.linked(peer) + self._endings.linked(peer.host)

    def told(self, host: str, records: Iterable[Known]) -> list[Effect]:
        """A host says what it knows, in a greeting or because it was asked."""
        return self._told(host, self.memories.get(host, 0), records)

    def _told(self, host: str, memory: int, records: Iterable[Known]) -> list[Effect]:
        effects: list[Effect] = []
        for known in records:
            effects += self._learn(host, memory, known)
        return effects

    def pass_on(self, found: Iterable[Fate]) -> list[Effect]:
        """This host is about to go: tell every host that can be reached of all endings known here.

        Of losses, only of those that it has proof of now, in `found`.
        """
        effects: list[Effect] = []
        for fate in found:
            if fate.outcome == "lost":
                effects += self._endings.lose(fate.agent, fate.starts, fate.detail)
        return effects + self._endings.pass_on()

    def proven(self, since: float) -> set[str]:
        """The coordinators that a host which goes has told to be lost, with proof, since then."""
        return self._endings.proven(since)

    def room(self, host: str, trouble: str) -> list[Effect]:
        """A host says why it can keep no coordinator that comes, or with '' that it can again."""
        return self._departures.room(host, trouble)

    def ask(self, host: str) -> bool:
        """Whether a linked host is to be asked for a sign of life: nothing is sent there before it has
        `answered`."""
        return self._departures.ask(host)

    def answered(self, host: str) -> list[Effect]:
        """The sign of life has come."""
        return self._departures.answered(host)

    def questions(self) -> list[tuple[Send, bool]]:
        """What to ask through other hosts, as there is no link; and whether it is about a copy in doubt."""
        return self._departures.questions()

    def vouch(self, asked: Inquire) -> Accepted | Refused | None:
        """What this host can prove about a transfer that was sent to another one."""
        return self._arrivals.vouch(asked)

    def unlinked(self, host: str) -> None:
        """The last link to a host is gone. What was on its way may have arrived or not."""
        self._links.pop(host, None)
        self._departures.unlinked(host)

    def arrive(self, host: str, header: Transfer, block: Buffer) -> list[Effect]:
        """A coordinator has arrived from `host`; it is injected before this returns, or refused."""
        return self._arrivals.arrive(host, header, block)

    def oversize(self, host: str, header: Transfer, size: int) -> list[Effect]:
        """A coordinator from `host` was not even read, because its block has `size` bytes."""
        return self._arrivals.oversize(host, header, size)

    def receive(self, host: str, message: MobilityMessage, now: float) -> list[Effect]:
        """An answer, a question or an ending came from `host`."""
        match message:
            case Accepted():
                return self._departures.accepted(host, message)
            case Refused():
                return self._departures.refused(host, message, now)
            case Inquire():
                return self._arrivals.inquire(host, message)
            case Ended():
                return self._endings.on_ended(host, message, now)
            case EndedAck():
                return self._endings.on_ack(host, message)

    def tick(self, now: float) -> list[Effect]:
        """Time has passed: give up what has waited too long."""
        effects: list[Effect] = []
        for copy in self._copies:
            if now >= copy.deadline:
                effects += self._departures.overdue(copy)
        return effects

    def postpone(self, now: float) -> None:
        """Time stood still until now: whatever waits has all its time again."""
        self._departures.postpone(now)

    def next_deadline(self) -> float | None:
        """When `tick` has something to do next, or None."""
        waiting = (c.deadline for c in self._copies if c.alive and c.state != "RUN")
        return min(waiting, default=None)

    def knowledge(self) -> list[Known]:
        """What this host knows of every coordinator of its mission, for greetings and `lfield ps`.

        And how those of another one ended that were parked here.
        """
        return [copy.known() for copy in self._copies if copy.state != "ABSENT"]

    def greeting(self, waiting: Iterable[Transfer] = ()) -> list[Known]:
        """The same, with what is parked here: its home may be another host now.

        And with those that have come and are `waiting` to be taken in: nobody else may know of them any more.
        """
        parked = [
            Known(
                page.agent,
                page.generation,
                page.sequence,
                page.hops,
                "MOVED" if page.state == "MOVED" else "PARKED",
                page.target if page.state == "MOVED" else "",
            )
            for page in self._copies.parked.values()
        ]
        arriving = [self._arrivals.arriving(header) for header in waiting]
        return self.knowledge() + parked + [known for known in arriving if known]

    @property
    def parked(self) -> list[CopyPage]:
        """What waits here for another mission."""
        return list(self._copies.parked.values())

    @property
    def lost(self) -> bool:
        """Whether a start of any coordinator is known here to be lost."""
        return any(copy.outcome == "lost" for copy in self._copies)

    def superseded(self, agent: str, generation: int) -> bool:
        """Whether a start was stopped because another goes on."""
        copy = self._copies.find(agent, generation)
        return copy is not None and copy.outcome == "superseded"

    def leaves(self, agent: str, generation: int) -> bool:
        """Whether a copy that is frozen here wants to another host, or may be there."""
        copy = self._copies.find(agent, generation)
        return copy is not None and copy.state in ("FROZEN", "PREPARED")

    def in_doubt(self, agent: str, generation: int) -> bool:
        """Whether nobody knows what became of a copy that was sent from here."""
        copy = self._copies.find(agent, generation)
        return copy is not None and bool(copy.doubt)

    def is_sent(self, agent: str, generation: int) -> bool:
        """Whether a start has left, may have left, or is over: a page of it says so, or is about to."""
        copy = self._copies.find(agent, generation)
        return copy is not None and copy.state in ("PREPARED", "MOVED", "EXITED")

    def over(self, agent: str, generation: int) -> str:
        """Why a start goes on nowhere, as far as is known here; '' when it may."""
        copy = self._copies.find(agent, generation)
        if copy is None or copy.state != "EXITED":
            return ""
        return copy.detail if copy.outcome == "superseded" else f"{agent} has ended ({copy.outcome})"

    def unconfirmed(self, hosts: Collection[str]) -> bool:
        """Whether one of these hosts has yet to confirm an ending that it was told of."""
        return self._endings.unconfirmed(hosts)

    @property
    def telling(self) -> set[tuple[str, int]]:
        """The starts of whose endings this host tells the others until they confirm."""
        return self._endings.telling

    def wanted(self) -> set[str]:
        """The hosts that a copy here wants to go to or waits for, and those that must confirm an ending."""
        waiting = (copy for copy in self._copies if copy.state in ("FROZEN", "PREPARED") or copy.gave_way)
        return {copy.target for copy in waiting} | self._endings.untold

    def shadow(self, agent: str, generation: int) -> Buffer | None:
        """The block of a copy that moved on, as it left."""
        copy = self._copies.find(agent, generation)
        return copy.block if copy is not None and copy.state == "MOVED" else None

    def _learn(self, host: str, memory: int, known: Known) -> list[Effect]:
        if known.state == "EXITED":
            ended = Ended(known.agent, known.generation, known.outcome or "lost", known.detail, known.where)
            return self._endings.learn(ended)
        if known.state == "PARKED":
            return []
        effects = self._departures.learn(host, memory, known)
        effects += self._endings.fence(known.agent, known.generation, host)
        if known.state in LIVE:
            effects += self._endings.compare(host, known)
        return effects
