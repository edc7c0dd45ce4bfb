"""Interfaces through which the parts of a host use each other.

No part imports another one (a contract in pyproject.toml): `HostCore` creates them and passes each to the
parts that need it.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from typing import Protocol

from lfield.host.effects import Effect as HostEffect
from lfield.host.migration.write_ahead import JournalContents, WriteAheadQueue
from lfield.replication.lease.core import Quorum
from lfield.replication.transfer.core import Mobility
from lfield.replication.transfer.effects import Effect
from lfield.vm.agent import Agent, TeamMember
from lfield.vm.host_interface import Sequencer
from lfield.vm.pending_call import PendingCall
from lfield.wire.coordinator_messages import CoordinatorState, LeaseRecord
from lfield.wire.messages import RelayedMessage


class MessageRelay(Protocol):
    """Sends messages, over other hosts where there is no link; implemented by `QueryRelay`."""

    def send(self, effect: HostEffect) -> None:
        """Emits an effect; relays an answer without a link."""

    def arm(self) -> None:
        """Schedules a query: a link has changed, or coordinators were restored."""

    def on_relayed(self, host: str, relayed: RelayedMessage) -> list[Effect]:
        """Processes a relayed message, or relays it to all others."""


class HostReachability(Protocol):
    """Whether other hosts can be reached; implemented by `Reachability`."""

    def is_linked(self, host: str) -> bool:
        """Whether a host is linked."""

    def lost_reason(self, host: str) -> str:
        """The reason why a call need not wait for a host, '' if it may be reached in time."""

    def down_for(self, host: str) -> float:
        """For how many seconds a formerly linked host has had no link; 0 for one never linked."""


class CallWatcher(Protocol):
    """Reports calls on other hosts that have ended; implemented by `CallWatch`."""

    def watch(self, agent: Agent, calls: Sequence[tuple[TeamMember, int]]) -> None:
        """A coordinator here waits for the first of these calls."""

    def request_cancels(self, agent: Agent, calls: Sequence[tuple[TeamMember, int]]) -> None:
        """A coordinator here cancels these calls."""


class CoordinatorOperations(Protocol):
    """The coordinators of a host; implemented by `Coordinators`."""

    mobility: Mobility
    write_ahead: WriteAheadQueue
    recovery: JournalContents
    restart_notified: set[tuple[str, int]]
    paused: bool
    ballot: bytes
    stopped: str
    is_halted: bool
    write_problem: str

    def apply_effects(self, effects: Iterable[Effect]) -> None:
        """Executes effects; effects that depend on records wait until these are durable."""

    def is_departing(self, agent: Agent) -> bool:
        """Whether a frozen coordinator leaves for another host, or may have arrived there."""

    def save(self, agent: Agent) -> bool:
        """Saves a coordinator before a portal call; returns whether the call may begin at once."""

    def recover(self, agent: str, generation: int) -> bool:
        """Continues a coordinator from its copy here; returns False if the copy is unreadable."""

    def record_existence(self) -> None:
        """Writes to the journal that this host has one."""

    def record_start(self, generation: int) -> int:
        """Writes the generation of a start to the journal; returns the number of the batch."""


class LeaseRules(Protocol):
    """The permissions of leases and fencing tokens; implemented by `TeamLeases`."""

    leased_agents: frozenset[str]
    quorum: Quorum

    @property
    def has_to_wait(self) -> bool:
        """Whether coordinators of this host have to wait for a lease before they start."""

    def request(self) -> None:
        """Requests a lease for a start."""

    def poll_gained(self) -> bool:
        """Whether the lease was gained since the last call."""

    def may_start_call(self, agent: Agent) -> bool:
        """Whether a coordinator may begin a portal call now; otherwise it waits or is stopped."""

    def end_reason(self, agent: str, generation: int) -> str:
        """The reason why a start of a coordinator may not act any more; empty if it may."""

    def actuation_deadline(self, caller: Agent | PendingCall, device: str) -> float:
        """The time until which a device may be actuated for a caller. Raises DeviceError if it may not be
        actuated.
        """

    def records(self, agents: Collection[str]) -> list[LeaseRecord]:
        """The lease records of coordinators."""

    def on_located(self, host: str, record: LeaseRecord) -> None:
        """Another host has sent a lease record."""


class SequencingDecisions(Sequencer, Protocol):
    """Starts and stops the startable coordinators of a host; implemented by `SequencingService`."""

    def abandon_wait(self, agent: Agent) -> bool:
        """Ends the wait of a coordinator; returns whether it waited."""


class ReservationRules(Protocol):
    """The permissions of persons under reservations; implemented by `ReservationService`."""

    def may_serve_person(self, start: tuple[str, int], resource: str) -> bool:
        """Whether a portal call of a person may start now; otherwise the call waits. Raises Trap if it is
        denied.
        """

    def drain_retried_persons(self) -> list[tuple[str, int]]:
        """The calls that waited and may try again; each is returned once."""

    def abandon_person(self, start: tuple[str, int]) -> None:
        """A call that waits does not start."""


class CallEnds(Protocol):
    """Uses the ends of portal calls of persons; implemented by `PersonCalls`."""

    def on_completed(self, pending: PendingCall) -> None:
        """A portal call of a person has ended."""


class StateObserver(Protocol):
    """Uses the coordinator states of other hosts; implemented by `DeviceCommands`."""

    def on_states(self, host: str, records: Iterable[CoordinatorState]) -> None:
        """Another host has sent its coordinator states."""
