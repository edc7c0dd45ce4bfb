"""Terminations of coordinators: their announcement to all hosts, and precedence between two starts. Sans-IO.

The home host of a coordinator may restart while the coordinator is on another host, and start it again. Then
there are two starts. The earlier one has done work and continues; the later one is superseded wherever a host
learns of both. A recovery is the exception: a host that knows of a recovery runs no earlier start, whether or
not the recovery succeeded.
"""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING

from lfield.replication.transfer.coordinator_copies import LIVE_STATES, CoordinatorCopy, CopyTable
from lfield.replication.transfer.effects import DropTerminated, Effect, Send, TerminateCopy
from lfield.replication.transfer.generations import blocks, is_recovery, outranks, stop_reason
from lfield.wire.coordinator_messages import CoordinatorState, Outcome, Terminated, TerminatedAck
from lfield.wire.fields import truncate
from lfield.wire.messages import Hello

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Mapping


class Termination:
    """The terminations of one host's copies. `hosts` are the hosts of the team, `links` the Hellos of the
    linked hosts.
    """

    def __init__(
        self, host: str, hosts: Collection[str], copies: CopyTable, links: Mapping[str, Hello]
    ) -> None:
        self._host, self._hosts, self._copies, self._links = host, hosts, copies, links
        self._unconfirmed: dict[tuple[str, int], tuple[Terminated, set[str]]] = {}
        #: The starts that are known to have ended in this run of the mission: after such an end in a journal,
        #: a home may start the coordinator again.
        self.ended_in_this_run: set[tuple[str, int]] = set()
        #: The losses reported by a host that was shutting down, and the time of the first report.
        self._losses: dict[tuple[str, int], float] = {}
        #: Whether a reported termination must not be stored or confirmed yet.
        self.is_delayed: Callable[[Terminated], bool] = lambda ended: False

    @cached_property
    def _peers(self) -> frozenset[str]:
        return frozenset(self._hosts) - {self._host}

    def set_delay_rule(self, is_delayed: Callable[[Terminated], bool]) -> None:
        """Set the rule for remote terminations that are neither stored nor confirmed yet."""
        self.is_delayed = is_delayed

    def terminate(self, copy: CoordinatorCopy, outcome: Outcome, detail: str) -> list[Effect]:
        """End a copy here, and notify every host until it confirms."""
        detail = truncate(detail)
        copy.mark_ended(outcome, detail, self._host)
        return self._copies.persist(copy) + self._announce(copy)

    def announce_end(self, agent: str) -> list[Effect]:
        """The home of a coordinator does not start it again: its last end is that of this run."""
        ends = [copy for copy in self._copies.starts_of(agent) if _is_end(copy)]
        return self._announce(max(ends, key=lambda copy: copy.generation)) if ends else []

    def _announce(self, copy: CoordinatorCopy) -> list[Effect]:
        """Notify every host of a termination of this run until it confirms."""
        self.ended_in_this_run.add((copy.agent, copy.generation))
        message = self._notice(copy)
        self._unconfirmed[copy.agent, copy.generation] = message, set(self._peers)
        return [Send(host, message) for host in sorted(self._peers & self._links.keys())]

    def _notice(self, copy: CoordinatorCopy) -> Terminated:
        start = copy.agent, copy.generation
        assert copy.outcome
        return Terminated(
            *start,
            copy.outcome,
            copy.detail,
            copy.ended_on,
            is_of_this_run=start in self.ended_in_this_run,
        )

    def on_restored(self, copy: CoordinatorCopy) -> None:
        """Restore a termination from before a restart: the confirmations are unknown."""
        if copy.outcome and copy.ended_on == self._host:
            self._unconfirmed[copy.agent, copy.generation] = self._notice(copy), set(self._peers)

    def declare_lost(self, agent: str, generations: Iterable[int], detail: str) -> list[Effect]:
        """Announce the proven loss of these starts to all linked hosts.

        The loss is not announced to hosts that link later: the coordinator may have been started again by
        then.
        """
        effects: list[Effect] = []
        for generation in generations:
            copy = self._copies.find_or_create(agent, generation)
            if copy is None or copy.is_alive or (copy.state == "EXITED" and copy.outcome != "lost"):
                continue
            detail = truncate(detail)
            if copy.state != "EXITED":
                copy.mark_ended("lost", detail, self._host)
                effects += self._copies.persist(copy)
                effects.append(DropTerminated(agent, generation, "lost", detail, self._host))
            message = Terminated(agent, generation, "lost", detail, self._host)
            self._unconfirmed[agent, generation] = message, set(self._links)
            effects += [Send(host, message) for host in sorted(self._links)]
        return effects

    def broadcast_all(self) -> list[Effect]:
        """Send every known termination except losses to all linked hosts, because this host is about to shut
        down.
        """
        effects: list[Effect] = []
        for copy in self._copies:
            if _is_end(copy):
                message = self._notice(copy)
                _, waiting = self._unconfirmed.get((copy.agent, copy.generation), (message, set[str]()))
                more = self._links.keys() - waiting - {copy.ended_on}
                self._unconfirmed[copy.agent, copy.generation] = message, waiting | more
                effects += [Send(host, message) for host in sorted(more)]
        return effects

    def has_unconfirmed(self, hosts: Collection[str]) -> bool:
        """Whether one of these hosts has not confirmed a termination."""
        return any(not waiting.isdisjoint(hosts) for _, waiting in self._unconfirmed.values())

    @property
    def unconfirmed_hosts(self) -> set[str]:
        """The hosts that have not confirmed a termination."""
        return {host for _, hosts in self._unconfirmed.values() for host in hosts}

    def on_linked(self, host: str) -> list[Effect]:
        """Repeat to a host the announcements that it has not confirmed."""
        return [Send(host, message) for message, hosts in self._unconfirmed.values() if host in hosts]

    def on_notice(self, host: str, message: Terminated, now: float) -> list[Effect]:
        """A host announces a termination."""
        effects = self.on_remote_termination(message)
        key = message.agent, message.generation
        if message.is_of_this_run:
            self.ended_in_this_run.add(key)
        copy = self._copies.find(*key)
        if copy is not None and copy.state != "EXITED" and self.is_delayed(message):
            return effects
        if copy is not None and copy.outcome == message.outcome == "lost":
            self._losses.setdefault(key, now)
        return [*effects, Send(host, TerminatedAck(message.agent, message.generation))]

    def proven_losses(self, since: float) -> set[str]:
        """The coordinators reported as lost since this time, with proof, by hosts that were shutting down."""
        return {agent for (agent, _), at in self._losses.items() if at >= since}

    def on_ack(self, host: str, message: TerminatedAck) -> list[Effect]:
        """A host confirms an announcement."""
        key = message.agent, message.generation
        if key in self._unconfirmed:
            hosts = self._unconfirmed[key][1]
            hosts.discard(host)
            if not hosts:
                del self._unconfirmed[key]
        return []

    def unconfirmed_by(self, agent: str, generation: int) -> Collection[str]:
        """The hosts that have not confirmed this termination."""
        _, hosts = self._unconfirmed.get((agent, generation), (None, ()))
        return hosts

    def on_remote_termination(self, ended: Terminated) -> list[Effect]:
        """Apply a termination on another host, unless the copy on this host disproves it, or it is
        delayed.
        """
        return self.fence(ended.agent, ended.generation, ended.host) + self._apply_termination(
            ended, self.is_delayed
        )

    def on_delay_over(self, ended: Terminated) -> list[Effect]:
        """`on_remote_termination`, for a termination whose delay is over; confirms it to the host where the
        coordinator ended.
        """
        effects = self._apply_termination(ended, lambda ended: False)
        if ended.host in self._links:
            effects.append(Send(ended.host, TerminatedAck(ended.agent, ended.generation)))
        return effects

    def _apply_termination(self, ended: Terminated, is_delayed: Callable[[Terminated], bool]) -> list[Effect]:
        parked = self._copies.parked.get((ended.agent, ended.generation))
        if parked is not None and parked.state == "RUN" and ended.outcome != "superseded":
            return []
        copy = self._copies.find_or_create(ended.agent, ended.generation)
        if copy is None or (copy.state == "EXITED" and (copy.outcome != "lost" or ended.outcome == "lost")):
            return []
        if ended.outcome == "superseded":
            return self.stop_for_other_start(copy, ended.detail, ended.host)
        # A copy on this host cannot have ended elsewhere, and cannot be lost while it may continue here.
        if copy.state in ("RUN", "FROZEN"):
            return []
        if copy.state == "PREPARED" and ended.outcome == "lost" and not self._is_unanswerable(copy):
            return []
        if is_delayed(ended):
            return []
        copy.mark_ended(ended.outcome, ended.detail, ended.host)
        return [
            *self._copies.persist(copy),
            DropTerminated(ended.agent, ended.generation, ended.outcome, ended.detail, ended.host),
        ]

    def _is_unanswerable(self, copy: CoordinatorCopy) -> bool:
        """Whether a copy in doubt waits for an answer from an incarnation that has ended: this answer will
        never arrive.
        """
        target = self._links.get(copy.target)
        return bool(copy.doubt_reason) and target is not None and target.state_id != copy.receiver_memory

    def stop_for_other_start(self, copy: CoordinatorCopy, reason: str, host: str) -> list[Effect]:
        """End a copy because `host` reports another start; other hosts need not be notified."""
        held = copy.state in LIVE_STATES
        copy.mark_ended("superseded", reason, host)
        effects = self._copies.persist(copy)
        return [*effects, TerminateCopy(copy.agent, copy.generation, reason)] if held else effects

    def compare_starts(self, host: str, known: CoordinatorState) -> list[Effect]:
        """`host` holds a live copy of a start: supersede that start, or the starts here that it outranks."""
        by = self._outranking_generation(known.agent, known.generation)
        if by is not None:
            beaten = self._copies.find_or_create(known.agent, known.generation)
            return [] if beaten is None else self._supersede(beaten, by, self._host)
        return self.supersede(known.agent, known.generation, host)

    def supersede(self, agent: str, generation: int, host: str) -> list[Effect]:
        """A start is alive on `host`: supersede all starts that it outranks."""
        effects = self.fence(agent, generation, host)
        for copy in self._copies.starts_of(agent):
            if copy.state != "EXITED" and outranks(generation, copy.generation):
                effects += self._supersede(copy, generation, host)
        return effects

    def fence(self, agent: str, generation: int, host: str) -> list[Effect]:
        """`host` knows of a start. If this start is a recovery, earlier starts stop, even if the recovery
        failed.
        """
        effects: list[Effect] = []
        for copy in self._copies.starts_of(agent) if is_recovery(generation) else ():
            if copy.state != "EXITED" and copy.generation < generation:
                effects += self.stop_for_other_start(
                    copy, stop_reason(agent, copy.generation, generation, host), host
                )
        return effects

    def terminate_outranked(self, recovery: CoordinatorCopy) -> list[Effect]:
        """End all other starts, because a recovery is made here, and every host is notified until it
        confirms.
        """
        effects: list[Effect] = []
        for copy in self._copies.starts_of(recovery.agent):
            if copy.state != "EXITED" and copy is not recovery:
                effects += self._supersede(copy, recovery.generation, self._host)
        return effects

    def displace_in_doubt(self, arrived: CoordinatorCopy) -> list[Effect]:
        """A start was injected here: an earlier start in doubt leaves the machine, which has space for one.

        This is no proof of a loss: the receiver is still queried, and the copy is still reported.
        """
        effects: list[Effect] = []
        for copy in self._copies.starts_of(arrived.agent):
            if copy.doubt_reason and copy.state == "PREPARED":
                reason = f"{copy.agent} was in doubt on {self._host} when a later start arrived"
                effects.append(TerminateCopy(copy.agent, copy.generation, reason))
                copy.displace()
                effects += self._copies.persist(copy)
        return effects

    def supersede_arrival(self, copy: CoordinatorCopy) -> list[Effect]:
        """Supersede a start that arrives on a host where a start that outranks it is alive, or a recovery is
        known.
        """
        by = self._outranking_generation(copy.agent, copy.generation)
        return [] if by is None else self._supersede(copy, by, self._host)

    def _outranking_generation(self, agent: str, generation: int) -> int | None:
        """The start that supersedes this one, as far as is known here."""
        starts = (
            c.generation
            for c in self._copies.starts_of(agent)
            if blocks(c.generation, generation, alive=c.is_alive)
        )
        return next(starts, None)

    def _supersede(self, copy: CoordinatorCopy, by: int, host: str) -> list[Effect]:
        if copy.state == "EXITED" and copy.outcome != "lost":
            return []
        reason = stop_reason(copy.agent, copy.generation, by, host)
        stop: list[Effect] = (
            [TerminateCopy(copy.agent, copy.generation, reason)] if copy.state in LIVE_STATES else []
        )
        return stop + self.terminate(copy, "superseded", reason)


def _is_end(copy: CoordinatorCopy) -> bool:
    """Whether a start has ended, but not as lost: a lost start may be continued elsewhere."""
    return copy.state == "EXITED" and copy.outcome not in ("", "lost")
