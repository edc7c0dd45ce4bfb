"""The sender's half of a hop: RUN, FROZEN, PREPARED, MOVED, and back to RUN after a refusal."""

from __future__ import annotations

from typing import TYPE_CHECKING

from lfield.replication.transfer.effects import (
    Effect,
    MarkInDoubt,
    MarkMigrated,
    ResumeWithException,
    Send,
    SendTransfer,
)
from lfield.wire.coordinator_messages import (
    NEVER_ARRIVED,
    SUPERSEDED,
    Transfer,
    TransferAccepted,
    TransferQuery,
    TransferRefused,
)
from lfield.wire.fields import truncate
from lfield.wire.messages import Hello

if TYPE_CHECKING:
    from collections.abc import Mapping

    from lfield.replication.transfer.coordinator_copies import CoordinatorCopy, CopyTable
    from lfield.replication.transfer.termination import Termination
    from lfield.wire.coordinator_messages import CoordinatorState

#: The L exceptions of a refused hop (appendix I names the first and the last).
UNREACHABLE = "UnreachableResourceException"
RESTARTED = "RestartException"
#: The known state of a call that was interrupted by a restart.
NOT_STARTED, MAYBE_STARTED = "this call has not begun", "this call may have begun"
LIMIT = "LimitException"
#: The reason why a paused host admits no coordinator.
PAUSED = "the mission is paused there"
#: Minimum time in seconds until an unanswered transfer is in doubt. A link may be silent for 8 s until it is
#: closed; then the answer arrives over other hosts. An earlier doubt could be reported by both hosts at once.
MIN_DOUBT_TIME = 10.0


class TransferSender:
    """The hops that start on one host: its departing copies."""

    def __init__(
        self,
        own: Hello,
        copies: CopyTable,
        links: Mapping[str, Hello],
        termination: Termination,
        unreachable_after: float,
    ) -> None:
        self._own, self._copies, self._links, self._termination = own, copies, links, termination
        self._unreachable_after = unreachable_after
        #: Seconds by which a doubt is reported later than the time-out of a call.
        self._doubt_grace = max(0.0, MIN_DOUBT_TIME - unreachable_after)
        #: The state id of each linked host.
        self._state_ids: dict[str, int] = {}
        #: The linked hosts that cannot store coordinators now, with the reasons.
        self._backpressure: dict[str, str] = {}
        #: The hosts whose answer to a probe is awaited: no coordinator is sent to them before.
        self._probed: set[str] = set()

    def depart(self, copy: CoordinatorCopy) -> list[Effect]:
        """Start a hop: send a frozen copy to its target, at once if there is a link."""
        return self._send(copy)

    def on_linked(self, peer: Hello) -> list[Effect]:
        """Continue the copies that wait for this host. The host reports its free space again."""
        self._backpressure.pop(peer.host, None)
        self._probed.discard(peer.host)
        self._state_ids[peer.host] = peer.state_id
        effects: list[Effect] = []
        for copy in self._copies:
            if copy.target == peer.host and (copy.state in ("FROZEN", "PREPARED") or copy.is_displaced):
                # A restored copy is not in the machine yet, so it could not continue.
                effects += [] if copy.is_restored and copy.make_block is None else self._retry(copy, peer)
        return effects

    def pending_queries(self) -> list[tuple[Send, bool]]:
        """The queries to relay because the link is down or the receiver has no record of the transfer, each
        with whether the copy is in doubt.
        """
        waiting = (copy for copy in self._copies if copy.awaits_answer)
        return [
            (_query_for(copy), bool(copy.doubt_reason))
            for copy in waiting
            if copy.target not in self._links or self._links[copy.target].state_id != copy.receiver_memory
        ]

    def on_unlinked(self, host: str) -> None:
        """The link to a host closed, and its report of free space is void: the host may have failed."""
        self._backpressure.pop(host, None)
        self._probed.discard(host)
        self._state_ids.pop(host, None)

    def needs_probe(self, host: str) -> bool:
        """Whether a linked host must be probed: copies wait for it as without a link.

        False if no copy could be sent to it anyway.
        """
        if host not in self._backpressure:
            self._probed.add(host)
        return host in self._probed

    def on_probe_answer(self, host: str) -> list[Effect]:
        """The answer to the probe has arrived."""
        self._probed.discard(host)
        return self.on_backpressure(host, self._backpressure.get(host, ""))

    def on_restored(self, copy: CoordinatorCopy, now: float) -> list[Effect]:
        """A copy that was sent before this host restarted is in the machine."""
        copy.postpone(now + self._unreachable_after)
        peer = self._links.get(copy.target)
        return [] if peer is None else self._retry(copy, peer)

    def on_backpressure(self, host: str, problem: str) -> list[Effect]:
        """A host reports whether it can store arrivals: if not, no copy is sent, and copies wait as without a
        link.
        """
        self._backpressure.pop(host, None)
        if problem:
            self._backpressure[host] = problem
            return []
        waiting = [copy for copy in self._copies if copy.target == host and copy.state == "FROZEN"]
        return [effect for copy in waiting for effect in self._send(copy)]

    def on_accepted(self, message: TransferAccepted) -> list[Effect]:
        """The receiver has admitted the copy, or the copy has moved on: the commit point of the hop for the
        sender.

        Any host may report that the copy has moved on.
        """
        copy = self._pending(message)
        return [] if copy is None else self.mark_moved(copy, message.held)

    def on_refused(self, host: str, message: TransferRefused, now: float) -> list[Effect]:
        """The receiver does not have the copy, and will never admit it under this number."""
        copy = self._pending(message)
        if copy is None or (copy.target != host and message.kind != SUPERSEDED):
            return []
        if not copy.awaits_answer and message.kind != SUPERSEDED:
            # The copy is not in the machine yet, so it could not continue. `on_restored` sends the query
            # again.
            return []
        if copy.is_displaced and message.kind != SUPERSEDED:
            copy.mark_ended("lost", f"{host} refused it, and the copy here was displaced", self._own.host)
            return []
        copy.clear_doubt()
        if message.kind == SUPERSEDED:
            return self._termination.stop_for_other_start(copy, message.reason, host)
        if message.kind != NEVER_ARRIVED:
            return self._resume(copy, message.kind, message.reason)
        if now < copy.deadline:
            copy.return_to_frozen()
            return self._send(copy)
        return self._resume(
            copy, UNREACHABLE, f"the link to {host} broke during the transfer and was restored too late"
        )

    def on_state(self, host: str, state_id: int, record: CoordinatorState) -> list[Effect]:
        """Check whether a record of `host` proves that a copy sent from here has arrived.

        Only the copy that resulted from the transfer assigns higher numbers.
        """
        copy = self._copies.find(record.agent, record.generation)
        if copy is None or not copy.is_unanswered:
            return []
        if self._copies.has_journal and (host, state_id) == (copy.target, copy.receiver_memory):
            # The record may not be on the disk of its host yet. The host answers for the transfer when it is.
            return []
        arrived = record.sequence == copy.sequence and record.state in ("RUN", "FROZEN")
        return self.mark_moved(copy) if arrived or record.sequence > copy.sequence else []

    def mark_moved(self, copy: CoordinatorCopy, held: float = 0.0) -> list[Effect]:
        """The copy lives on another host; the block is kept as its shadow. `held`: see `MarkMigrated`."""
        copy.move()
        departed = MarkMigrated(copy.agent, copy.generation, copy.sequence, copy.target, held)
        return [departed, *self._copies.persist(copy, is_lazy=True)]

    def cancel(self, copy: CoordinatorCopy) -> bool:
        """Cancel a departure. Returns False if a transfer may have been sent."""
        if copy.state != "FROZEN":
            return False
        copy.resume(is_stored=self._copies.has_journal)
        return True

    def postpone(self, now: float) -> None:
        """Restart the time-outs of all copies that wait for a host or its answer."""
        for copy in self._copies:
            if copy.state in ("FROZEN", "PREPARED"):
                copy.postpone(now + self._unreachable_after)

    def due(self, copy: CoordinatorCopy) -> float:
        """The time when `on_deadline` has work for a live copy that is not running."""
        return copy.deadline + self._doubt_grace if copy.state == "PREPARED" else copy.deadline

    def on_deadline(self, copy: CoordinatorCopy, now: float) -> list[Effect]:
        """The deadline of a departure has passed: resume the copy if it was not sent, else mark it as in
        doubt.

        A copy that waits for a paused host waits as long as this host is linked and paused.
        """
        if copy.state == "FROZEN" and self._backpressure.get(copy.target) == PAUSED:
            copy.postpone(copy.deadline + self._unreachable_after)
            return []
        host, seconds = copy.target, self._unreachable_after
        if copy.state == "FROZEN":
            reason = f"could not be reached within {seconds:g} s; is it up?"
            if host in self._backpressure:
                reason = f"could not store {copy.agent} within {seconds:g} s: {self._backpressure[host]}"
            return self._resume(copy, UNREACHABLE, f"{host} {reason}")
        if copy.state == "PREPARED" and not copy.doubt_reason and now >= self.due(copy):
            waited = f"{seconds + self._doubt_grace:g} s"
            return self._mark_in_doubt(
                copy,
                f"{host} has not confirmed within {waited} that it received {copy.agent}; still waiting",
            )
        return []

    def _send(self, copy: CoordinatorCopy) -> list[Effect]:
        """Send under the next number, or wait frozen for a link."""
        peer = self._links.get(copy.target)
        if peer is None or copy.target in self._backpressure or copy.target in self._probed:
            return []
        assert copy.make_block is not None
        memory, has_journal = self._state_ids[peer.host], self._copies.has_journal
        block = copy.make_block(copy.sequence + 1)
        # A stored block is a copy: the coordinator may continue here and change the original.
        block = bytes(block) if has_journal else block
        copy.prepare(block, memory)
        size = len(block)
        if size > peer.max_block:
            reason = f"{copy.agent} has {size} bytes and {peer.host} takes at most {peer.max_block}"
            return self._resume(copy, LIMIT, reason)
        header = Transfer(
            copy.agent,
            copy.generation,
            copy.sequence,
            copy.hops + 1,
            self._own.program,
            memory,
            size,
        )
        effects = self._copies.persist(copy) if has_journal else []
        return [*effects, SendTransfer(peer.host, header, block)]

    def _retry(self, copy: CoordinatorCopy, peer: Hello) -> list[Effect]:
        """The link for a waiting copy is restored."""
        if copy.state == "FROZEN":
            return self._send(copy)
        if peer.state_id == copy.receiver_memory:
            return [_query_for(copy)]
        if copy.is_displaced:
            return []
        return self._mark_in_doubt(
            copy,
            f"{peer.host} was restarted before it confirmed that it received {copy.agent}; "
            "the copy here stays frozen, since another may be running",
        )

    def _mark_in_doubt(self, copy: CoordinatorCopy, reason: str) -> list[Effect]:
        if copy.doubt_reason == reason:
            return []
        copy.mark_in_doubt(reason)
        return [MarkInDoubt(copy.agent, copy.generation, copy.sequence, copy.target, reason)]

    def _resume(self, copy: CoordinatorCopy, kind: str, reason: str) -> list[Effect]:
        copy.resume(is_stored=self._copies.has_journal)
        if copy.is_restored:
            kind, reason = RESTARTED, f"{self._own.host} restarted; {NOT_STARTED}: {reason}"
            copy.mark_continued()
        return [ResumeWithException(copy.agent, copy.generation, copy.sequence, kind, truncate(reason))]

    def _pending(self, answer: TransferAccepted | TransferRefused) -> CoordinatorCopy | None:
        """The copy that awaits this answer; None if there is none any more."""
        copy = self._copies.find(answer.agent, answer.generation)
        if copy is None or not copy.is_unanswered:
            return None
        return copy if copy.sequence == answer.sequence else None


def _query_for(copy: CoordinatorCopy) -> Send:
    return Send(copy.target, TransferQuery(copy.agent, copy.generation, copy.sequence, copy.receiver_memory))
