"""Hops of coordinators between hosts: two-phase transfer protocol of one host. Sans-IO.

Method calls are events; they return effects. Time is a parameter in seconds; blocks are opaque bytes.
`lfield/docs/mobility.md` explains the protocol and its guarantees; chapter III of the thesis has the three
steps of a hop, appendix I the shadow.

Invariant: two copies of one start of a coordinator never run at the same time.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

from lfield.replication.transfer.coordinator_copies import LIVE_STATES, CopyTable
from lfield.replication.transfer.copy_recovery import CopyRecovery, newest_resumable, stop_below, termination
from lfield.replication.transfer.effects import CoordinatorStarted, DropTerminated, ResumeCopy
from lfield.replication.transfer.termination import Termination
from lfield.replication.transfer.transfer_receiver import TransferReceiver
from lfield.replication.transfer.transfer_sender import TransferSender
from lfield.wire.coordinator_messages import (
    TERMINATED,
    CoordinatorState,
    Terminated,
    TerminatedAck,
    Transfer,
    TransferAccepted,
    TransferQuery,
    TransferRefused,
)
from lfield.wire.messages import Hello

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable

    from lfield.journal.records import CoordinatorRecord
    from lfield.replication.locate.outcomes import CoordinatorOutcome
    from lfield.replication.transfer.coordinator_copies import CoordinatorCopy
    from lfield.replication.transfer.effects import Effect, Send
    from lfield.replication.transfer.transfer_receiver import InjectHook
    from lfield.wire.coordinator_messages import Outcome
    from lfield.wire.framing import Buffer


class RestoreHook(Protocol):
    """Loads a stored copy into the machine; see `Mobility.resume_restored`."""

    def __call__(self, copy: CoordinatorCopy, *, runs: bool) -> Callable[[int], Buffer] | None:
        """Return the function that makes the block to send, or None if the copy cannot continue."""


#: The messages for `Mobility.on_message`.
MobilityMessage = TransferAccepted | TransferRefused | TransferQuery | Terminated | TerminatedAck


class Mobility:
    """The coordinators of one host: hops from and to this host, and termination.

    `own` is the Hello of this host without `coordinators`: name, incarnation, program and `max_block`.
    `peers` are the hosts of the deployment, `agents` its coordinators. `unreachable_after` is the time
    in seconds that a coordinator waits for a host.

    A host calls `start` for its own coordinators before any handshake, `on_linked` and `on_unlinked` for
    links, `on_transfer`, `on_oversize` and `on_message` for messages, and `tick` at `next_deadline`.
    """

    def __init__(
        self,
        own: Hello,
        peers: Collection[str],
        agents: Collection[str],
        unreachable_after: float = 10.0,
    ) -> None:
        self._own, self._unreachable_after = own, unreachable_after
        self._copies = CopyTable(agents, own.mission_hash if own.journal_id else b"")
        self._links: dict[str, Hello] = {}
        self._termination = Termination(own.host, peers, self._copies, self._links)
        self._sender = TransferSender(own, self._copies, self._links, self._termination, unreachable_after)
        self._receiver = TransferReceiver(own, self._copies, self._sender, self._termination)
        self._recovery = CopyRecovery(own.host, self._copies, self._termination)

    def start(self, agent: str, generation: int) -> list[Effect]:
        """Start a coordinator here. `generation` must be new, and greater than those of earlier starts."""
        copy = self._copies.find_or_create(agent, generation)
        if copy is None or copy.state != "ABSENT":
            raise ValueError(f"{agent} cannot be started as generation {generation}")
        copy.mark_running(0, 0)
        return [*self._copies.persist(copy), CoordinatorStarted(agent, generation)]

    def save(self, agent: str, block: Buffer) -> list[Effect]:
        """Store the running copy of `agent`, frozen by the caller, at a portal call of this host."""
        for copy in self._copies.starts_of(agent):
            if copy.state == "RUN":
                copy.save(bytes(block))
                return [*self._copies.persist(copy), ResumeCopy(agent, copy.generation)]
        raise ValueError(f"{agent} does not run here")

    def restore(self, records: Iterable[CoordinatorRecord], parked: Iterable[CoordinatorRecord] = ()) -> None:
        """Load the journal records of the coordinators. `resume_restored` continues the copies that can run
        here. `parked` are records of another mission: they are reported, and their numbers are not reused.
        """
        self._copies.park(parked)
        for record in records:
            copy = self._copies.find_or_create(record.agent, record.generation)
            if copy is not None:
                copy.restore(record)
                self._termination.on_restored(copy)

    def resume_restored(self, put: RestoreHook, now: float) -> list[Effect]:
        """Continue the restored copies: `put(copy, runs=...)` loads a copy into the machine. There the copy
        is frozen at its portal call, or continues if `runs` is true. `put` returns the `seal` for its
        departure, or None if the block is unreadable.
        """
        effects: list[Effect] = []
        for copy in self._copies:
            if not copy.is_restored:
                continue
            if runs := copy.state == "RUN":
                copy.mark_continued()
                if copy.doubt_reason:
                    continue
            copy.reload(put(copy, runs=runs))
            if copy.make_block is not None and not runs:
                effects += self._sender.on_restored(copy, now)
        return effects

    def depart(self, agent: str, host: str, seal: Callable[[int], Buffer], now: float) -> list[Effect]:
        """Start a hop: send the running copy of `agent`, frozen by the caller, to `host`.

        `seal(sequence)` writes the number into the block's header and returns the block. `seal` is called
        once for each transmission, immediately if there is a link. The bytes must then stay unchanged until
        Resume, Departed, Supersede or Finished.
        """
        for copy in self._copies.starts_of(agent):
            if copy.state == "RUN":
                copy.freeze(host, seal, now + self._unreachable_after)
                return self._sender.depart(copy)
        raise ValueError(f"{agent} does not run here")

    def cancel_departure(self, agent: str, generation: int) -> bool:
        """Cancel the departure of a coordinator.

        True: nothing was sent, and the coordinator runs here again. False: it is not departing, or may have
        left.
        """
        copy = self._copies.find(agent, generation)
        return copy is not None and self._sender.cancel(copy)

    def on_ended(self, agent: str, generation: int, outcome: Outcome, detail: str = "") -> list[Effect]:
        """A copy here has ended: notify every host. 'lost': an operator declares a copy in doubt lost."""
        copy = self._copies.find(agent, generation)
        if copy is None or not (copy.doubt_reason if outcome == "lost" else copy.state in ("RUN", "FROZEN")):
            raise ValueError(f"{agent} of generation {generation} cannot end here as {outcome!r}")
        return self._termination.terminate(copy, outcome, detail)

    def declare_lost(self, agent: str, detail: str) -> tuple[list[int], list[Effect]]:
        """An operator declares this agent lost, in any mission.

        Starts that are known to be alive continue. Returns the starts that end here.
        """
        generations = {
            copy.generation
            for copy in self._copies.starts_of(agent)
            if copy.state == "MOVED" or copy.doubt_reason
        }
        generations |= {generation for name, generation in self._copies.parked if name == agent}
        effects = self._termination.declare_lost(agent, sorted(generations), detail)
        return [effect.generation for effect in effects if isinstance(effect, DropTerminated)], effects

    def set_delay_rule(self, is_delayed: Callable[[Terminated], bool]) -> None:
        """Set the rule for remote terminations that are stored and confirmed only by `on_terminated`."""
        self._termination.set_delay_rule(is_delayed)

    def on_terminated(self, ended: Terminated) -> list[Effect]:
        """A coordinator has ended on another host, and the record may now be written."""
        return self._termination.on_delay_over(ended)

    def termination(self, agent: str) -> CoordinatorCopy | None:
        """The newest terminated start of an agent; None if a later start is here."""
        return termination(self._copies.starts_of(agent))

    def unconfirmed_by(self, agent: str, generation: int) -> Collection[str]:
        """The hosts that have not confirmed a termination announced by this host."""
        return self._termination.unconfirmed_by(agent, generation)

    def fence(self, agent: str, generation: int, reason: str) -> list[Effect]:
        """Fence all starts before `generation`: copies of them here stop."""
        return stop_below(self._copies.starts_of(agent), generation, reason)

    def newest_copy(self, agent: str) -> CoordinatorCopy | None:
        """The copy from which an agent could resume here, or the coordinator itself; None without either."""
        return newest_resumable(self._copies.starts_of(agent))

    def recoverable_state(self, agent: str) -> CoordinatorState | None:
        """The state for a recovery here if the coordinator's holder were lost; None if it runs here."""
        copy = self._recovery.newest_copy(agent)
        return None if copy is None else copy.state_message()

    def recover(
        self, agent: str, generation: int, put: Callable[[CoordinatorCopy], Callable[[int], Buffer] | None]
    ) -> list[Effect]:
        """Resume a coordinator whose holder is lost as the new start `generation`.

        The number must be a recovery number above all known ones, and `recoverable_state` must not be None.
        `put(copy)` loads the block into the machine, frozen; None if it is unreadable (recorded).
        """
        return self._recovery.recover(agent, generation, put)

    @property
    def state_ids(self) -> dict[str, int]:
        """The state id of each linked host; see `Hello.state_id`."""
        return {host: peer.state_id for host, peer in self._links.items()}

    def on_linked(self, peer: Hello) -> list[Effect]:
        """A link to a host opened; `peer` is its Hello."""
        effects = self._on_states(peer.host, peer.state_id, peer.coordinators)
        self._links[peer.host] = peer
        return effects + self._sender.on_linked(peer) + self._termination.on_linked(peer.host)

    def on_states(self, host: str, records: Iterable[CoordinatorState]) -> list[Effect]:
        """A host reports its records, in a Hello or in an answer."""
        return self._on_states(host, self.state_ids.get(host, 0), records)

    def _on_states(self, host: str, state_id: int, records: Iterable[CoordinatorState]) -> list[Effect]:
        effects: list[Effect] = []
        for known in records:
            effects += self._on_state(host, state_id, known)
        return effects

    def broadcast_outcomes(self, found: Iterable[CoordinatorOutcome]) -> list[Effect]:
        """Send all known terminations to every reachable host, because this host is about to shut down. Of
        the losses, only those proven now (`found`) are sent.
        """
        effects: list[Effect] = []
        for outcome in found:
            if outcome.outcome == "lost":
                effects += self._termination.declare_lost(outcome.agent, outcome.starts, outcome.detail)
        return effects + self._termination.broadcast_all()

    def proven_losses(self, since: float) -> set[str]:
        """The coordinators that a host shutting down has reported as lost, with proof, since this time."""
        return self._termination.proven_losses(since)

    def on_backpressure(self, host: str, problem: str) -> list[Effect]:
        """A host reports why it cannot store arriving coordinators, or '' when it can store them again."""
        return self._sender.on_backpressure(host, problem)

    def needs_probe(self, host: str) -> bool:
        """Whether a linked host must answer a probe first: none is sent to it before `on_probe_answer`."""
        return self._sender.needs_probe(host)

    def on_probe_answer(self, host: str) -> list[Effect]:
        """The answer to the probe has arrived."""
        return self._sender.on_probe_answer(host)

    def pending_queries(self) -> list[tuple[Send, bool]]:
        """The queries to relay because there is no link, each with whether it is about a copy in doubt."""
        return self._sender.pending_queries()

    def prove_outcome(self, query: TransferQuery) -> TransferAccepted | TransferRefused | None:
        """The proof of this host about a transfer that was sent to another host."""
        return self._receiver.prove_outcome(query)

    def on_unlinked(self, host: str) -> None:
        """The last link to a host closed. Messages in transit may have arrived or not."""
        self._links.pop(host, None)
        self._sender.on_unlinked(host)

    def on_transfer(self, host: str, header: Transfer, block: Buffer, inject: InjectHook) -> list[Effect]:
        """A coordinator has arrived from `host`; it is injected or refused before the return."""
        return self._receiver.on_transfer(host, header, block, inject)

    def on_oversize(self, host: str, header: Transfer, size: int) -> list[Effect]:
        """A coordinator from `host` was not read, because its block has `size` bytes."""
        return self._receiver.on_oversize(host, header, size)

    def on_message(self, host: str, message: MobilityMessage, now: float) -> list[Effect]:
        """An answer, a query or a termination arrived from `host`."""
        match message:
            case TransferAccepted():
                return self._sender.on_accepted(message)
            case TransferRefused():
                return self._sender.on_refused(host, message, now)
            case TransferQuery():
                return self._receiver.on_query(host, message)
            case Terminated():
                return self._termination.on_notice(host, message, now)
            case TerminatedAck():
                return self._termination.on_ack(host, message)

    def tick(self, now: float) -> list[Effect]:
        """End the waits that have exceeded their time limits."""
        effects: list[Effect] = []
        for copy in self._copies:
            if now >= copy.deadline:
                effects += self._sender.on_deadline(copy, now)
        return effects

    def postpone(self, now: float) -> None:
        """The host was stalled until now: restart all time-outs."""
        self._sender.postpone(now)

    def next_deadline(self) -> float | None:
        """The time when `tick` is due next, or None."""
        waiting = (self._sender.due(c) for c in self._copies if c.is_alive and c.state != "RUN")
        return min(waiting, default=None)

    def known_states(self) -> list[CoordinatorState]:
        """The records of every coordinator of this mission, for handshakes and `lfield ps`.

        Includes terminations of coordinators of other missions that were parked here.
        """
        return [copy.state_message() for copy in self._copies if copy.state != "ABSENT"]

    def handshake_states(self, waiting: Iterable[Transfer] = ()) -> list[CoordinatorState]:
        """As `known_states`, with parked coordinators, whose home may be another host now.

        Includes arrivals that are `waiting` to be admitted: possibly no other host knows of them.
        """
        parked = self._copies.parked_states()
        arriving = [self._receiver.arriving_state(header) for header in waiting]
        return self.known_states() + parked + [known for known in arriving if known]

    @property
    def parked(self) -> list[CoordinatorRecord]:
        """The records that wait here for another mission."""
        return list(self._copies.parked.values())

    @property
    def has_losses(self) -> bool:
        """Whether any start of a coordinator is known to be lost."""
        return any(copy.outcome == "lost" for copy in self._copies)

    def is_superseded(self, agent: str, generation: int) -> bool:
        """Whether a start was stopped in favour of another one."""
        copy = self._copies.find(agent, generation)
        return copy is not None and copy.outcome == "superseded"

    def is_departing(self, agent: str, generation: int) -> bool:
        """Whether a copy that is frozen here waits to move to another host, or may have moved."""
        copy = self._copies.find(agent, generation)
        return copy is not None and copy.state in ("FROZEN", "PREPARED")

    def is_in_doubt(self, agent: str, generation: int) -> bool:
        """Whether the state of a copy that was sent from here is unknown."""
        copy = self._copies.find(agent, generation)
        return copy is not None and bool(copy.doubt_reason)

    def was_sent(self, agent: str, generation: int) -> bool:
        """Whether a start has left, may have left, or has ended, by its present or pending record."""
        copy = self._copies.find(agent, generation)
        return copy is not None and copy.state in ("PREPARED", "MOVED", "EXITED")

    def end_reason(self, agent: str, generation: int) -> str:
        """The reason why a start may not continue, as far as is known here; '' if it may."""
        copy = self._copies.find(agent, generation)
        if copy is None or copy.state != "EXITED":
            return ""
        return copy.detail if copy.outcome == "superseded" else f"{agent} has ended ({copy.outcome})"

    def has_unconfirmed(self, hosts: Collection[str]) -> bool:
        """Whether one of these hosts has not confirmed a termination that was announced to it."""
        return self._termination.has_unconfirmed(hosts)

    def announce_end(self, agent: str) -> list[Effect]:
        """The home of a coordinator does not start it again: announce that its last end is that of
        this run.
        """
        return self._termination.announce_end(agent)

    @property
    def ended_in_this_run(self) -> Collection[tuple[str, int]]:
        """The starts that are known to have ended in this run of the mission."""
        return self._termination.ended_in_this_run

    def needed_hosts(self) -> set[str]:
        """The hosts that a copy waits for (a link or an answer), and hosts with missing confirmations."""
        waiting = (copy for copy in self._copies if copy.state in ("FROZEN", "PREPARED") or copy.is_displaced)
        return {copy.target for copy in waiting} | self._termination.unconfirmed_hosts

    def shadow(self, agent: str, generation: int) -> Buffer | None:
        """The block of a copy that moved on, as it was sent."""
        copy = self._copies.find(agent, generation)
        return copy.block if copy is not None and copy.state == "MOVED" else None

    def _on_state(self, host: str, state_id: int, record: CoordinatorState) -> list[Effect]:
        if record.state == "EXITED":
            ended = Terminated(
                record.agent, record.generation, record.outcome or "lost", record.detail, record.where
            )
            return self._termination.on_remote_termination(ended)
        if record.state == "PARKED":
            return []
        effects = self._sender.on_state(host, state_id, record)
        effects += self._termination.fence(record.agent, record.generation, host)
        own_copy = self._copies.find(record.agent, record.generation)
        # A host that was down when this start ended still has the copy; the home may have made another start.
        is_outdated = own_copy is not None and own_copy.outcome in TERMINATED
        if record.state in LIVE_STATES and not is_outdated:
            effects += self._termination.compare_starts(host, record)
        return effects
