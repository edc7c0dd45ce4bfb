"""Executes the effects of hops on one host: in its machine, towards other hosts, in its log. Pure."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from msgspec import structs

from lfield.host.context import HostContext
from lfield.host.effects import WAKE_WAITERS, Effect, WriteLogOnce
from lfield.host.events.migration_events import HopStep, MigrationEvents
from lfield.replication.transfer import effects as mobile
from lfield.replication.transfer.transfer_sender import RESTARTED
from lfield.text import log_messages
from lfield.vm.agent import Agent
from lfield.vm.machine import Machine
from lfield.vm.memory import layout
from lfield.wire.coordinator_messages import Terminated, Transfer, TransferAccepted, TransferRefused


class Acknowledgements(Protocol):
    """Acknowledgements of transfers; implemented by `DelayedAcks`."""

    due: float | None

    def add(self, answer: mobile.Send, accepted: TransferAccepted) -> None:
        """Delays an acknowledgement."""

    def on_sending(self, host: str, header: Transfer) -> None:
        """A coordinator is about to be sent to a host."""

    def flush(self, host: str = "") -> None:
        """Sends the acknowledgements for a host, or for all hosts."""


class EffectExecutor:
    """Executes effects, one at a time.

    `send` sends a message, relayed if there is no link; `acks` delays acknowledgements. `start` starts a
    coordinator of this host.
    """

    def __init__(
        self,
        context: HostContext,
        machine: Machine,
        migrations: MigrationEvents,
        acks: Acknowledgements,
        send: Callable[[Effect], None],
        start: Callable[[str, int], None],
    ) -> None:
        self._machine, self._agents, self._migrations, self._acks = machine, machine.agents, migrations, acks
        self._hops, self._now, self._log = migrations.hops, context.clock.monotonic, context.log
        self._effects, self._send, self._start = context.effects, send, start
        self._hybrid_clock = context.recorder.hybrid_clock
        #: The coordinators that wait at a portal call here until they are on disk.
        self.saving: set[str] = set()

    def execute(self, effect: mobile.Effect) -> None:
        """Execute one effect that does not wait for the disk."""
        match effect:
            # The effects of every hop come first.
            case mobile.SendTransfer():
                if self._acks.due is not None:
                    self._acks.on_sending(effect.host, effect.header)
                leaving = self._agents.get(effect.header.agent)
                target: tuple[str, str | int]
                if leaving is not None and leaving.called_portal >= 0:
                    target = leaving.called_resource, leaving.called_portal
                else:
                    target = self._migrations.target_of(effect.header.agent)
                now = self._now()
                header = structs.replace(effect.header, stamp=self._hybrid_clock.tick(now))
                self._hops.append((HopStep.SENT, now, effect.host, header, *target))
                self._effects.append(mobile.SendTransfer(effect.host, header, effect.block))
            case mobile.ResumeCopy():
                agent = self._agents.get(effect.agent)
                sequence = None if agent is None else agent.block.w[layout.W_SEQUENCE]
                stamp = self._hybrid_clock.last
                self._hops.append(
                    (HopStep.RUNNING, self._now(), effect.agent, effect.generation, sequence, stamp)
                )
                self.saving.discard(effect.agent)
                is_it = agent is not None and agent.block.w[layout.W_GENERATION] == effect.generation
                if agent is not None and is_it and agent.frozen:
                    self._machine.unfreeze(agent, is_persisted=True)
            case mobile.Send():
                match effect.message:
                    case TransferAccepted() as accepted:
                        self._acks.add(effect, accepted)
                    case TransferRefused() | Terminated() as message:
                        self._acks.flush(effect.host)
                        stamp = self._hybrid_clock.tick(self._now())
                        self._send(mobile.Send(effect.host, structs.replace(message, stamp=stamp)))
                    case _:
                        self._acks.flush(effect.host)
                        self._send(effect)
            case mobile.MarkMigrated():
                self._hops.append((HopStep.CONFIRMED, self._now(), effect, self._hybrid_clock.last))
                agent = self._frozen_agent(effect.agent, effect.generation)
                # The coordinator may have returned while this effect waited for the disk: its sequence is
                # higher then.
                if agent is not None and agent.block.w[layout.W_SEQUENCE] <= effect.sequence:
                    self._machine.release(agent)
            case _:
                self._execute_rare(effect)

    def _execute_rare(self, effect: mobile.Effect) -> None:
        match effect:
            case mobile.CoordinatorStarted():
                self._migrations.on_effect(effect)
                self._start(effect.agent, effect.generation)
            case mobile.ResumeWithException():
                if (agent := self._frozen_agent(effect.agent, effect.generation)) is not None:
                    agent.block.w[layout.W_SEQUENCE] = effect.sequence
                    self.resume(agent, effect.kind, effect.reason, recovered=effect.recovered)
            case mobile.MarkInDoubt():
                self._migrations.on_effect(effect)
                self._log(log_messages.AGENT_IN_DOUBT.line(agent=effect.agent, reason=effect.reason))
                self._send(WAKE_WAITERS)
            case mobile.TerminateCopy():
                self._log(log_messages.AGENT_STOPPED.line(agent=effect.agent, reason=effect.reason))
                self._drop(effect)
            case mobile.DropTerminated():
                self._drop(effect)
            case mobile.LogAnomaly():
                self._send(
                    WriteLogOnce(log_messages.MIGRATION_ANOMALY.line(agent=effect.agent, host=effect.host))
                )

    def resume(self, agent: Agent, kind: str, reason: str, *, recovered: bool = False) -> None:
        """Resume a frozen coordinator with an exception, which names the resource that it has called."""
        self._migrations.on_failed(agent, kind, reason, recovered=recovered)
        called = self._machine.itinerary.current_target(agent)
        if called and kind == RESTARTED:
            # A coordinator in a `reserve` has called no portal, so only the resource is named.
            reason = f"{reason} ({'.'.join(filter(None, (called[0].id, called[1])))})"
        self._machine.resume(agent, kind, reason, called[0].id if called else "", recovered=recovered)

    def _frozen_agent(self, identity: str, generation: int) -> Agent | None:
        """The frozen copy of a coordinator that is here, if the copy is of that start."""
        agent = self._agents.get(identity)
        return agent if agent and agent.frozen and agent.generation == generation else None

    def _drop(self, effect: mobile.TerminateCopy | mobile.DropTerminated) -> None:
        self._migrations.on_effect(effect)
        self.saving.discard(effect.agent)
        agent = self._agents.get(effect.agent)
        if agent and agent.generation == effect.generation:
            self._machine.drop(agent)
        self._send(WAKE_WAITERS)
