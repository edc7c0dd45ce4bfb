"""The coordinators of one host on their way out and in: carries out what mobility decides."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable
from typing import Protocol

from lfield.clock import Clock
from lfield.errors import BlockError
from lfield.mission.team import Team
from lfield.mobility.core import Mobility, MobilityMessage
from lfield.mobility.effects import (
    Departed,
    Effect,
    Finished,
    InDoubt,
    Note,
    Refusal,
    Resume,
    Send,
    SendTransfer,
    Supersede,
)
from lfield.net.peers import Peers
from lfield.vm.agent import Agent, Member
from lfield.vm.limits import Limits
from lfield.vm.machine import Machine
from lfield.vm.memory import layout
from lfield.wire.framing import Buffer
from lfield.wire.messages import Accepted, Ended, EndedAck, Hello, Outcome, Transfer


class Station(Protocol):
    """The host that coordinators leave and come to."""

    machine: Machine
    peers: Peers
    clock: Clock
    #: Set when something happened that others may wait for.
    changed: asyncio.Event

    def pump(self) -> None:
        """Let the machine run."""

    def note(self, text: str) -> None:
        """A line for the log."""


class Travel:
    """`own` is this host's greeting, `limits` gives the limits of an agent, times are in seconds."""

    def __init__(
        self,
        station: Station,
        team: Team,
        own: Hello,
        limits: Callable[[str], Limits],
        unreachable_after: float,
    ) -> None:
        self._station, self._hosts, self._limits, self._name = station, team.hosts, limits, own.host
        self._coordinators = {member.id: member for member in team.coordinators}
        self.mobility = Mobility(
            own,
            peers=team.hosts,
            agents=list(self._coordinators),
            inject=self._inject,
            unreachable_after=unreachable_after,
        )
        #: Coordinators that came before the resources here were started; None once they are.
        self._early: dict[str, tuple[str, Transfer, memoryview]] | None = {}
        #: Where each coordinator was last sent.
        self._sent_to: dict[str, str] = {}
        #: The resource that each coordinator last wanted to get to.
        self._wanted: dict[str, str] = {}
        self._loop = asyncio.get_running_loop()
        self._deadline: asyncio.TimerHandle | None = None
        self._stopped = False

    # --- out ------------------------------------------------------------------------------------------

    def depart(self, agent: Agent, resource: Member) -> None:
        """A frozen coordinator wants to the host of a resource."""
        self._wanted[agent.id] = resource.id
        image = self._station.machine.pack(agent)

        def seal(sequence: int) -> Buffer:
            agent.block.w[layout.W_SEQUENCE] = sequence
            return image

        target = self._hosts[resource.host]
        self._carry_out(self.mobility.depart(agent.id, target, seal, self._station.clock.monotonic()))

    def ended(self, agent: Agent) -> None:
        """A coordinator has come to its end here."""
        outcome: Outcome = "done" if agent.ended == "done" else "died"
        self._carry_out(self.mobility.ended(agent.id, agent.generation, outcome, agent.report))

    # --- in -------------------------------------------------------------------------------------------

    def open(self) -> None:
        """Take in the coordinators that came while the devices were opened: what they call is here now."""
        early, self._early = self._early or {}, None
        for host, header, block in early.values():
            self.arrived(host, header, block)

    def arrived(self, host: str, header: Transfer, block: memoryview) -> None:
        """A coordinator came: it runs before anything else does."""
        if self._early is not None:
            if header.agent in self._coordinators:
                self._early[header.agent] = host, header, block
            return
        effects = self.mobility.arrive(host, header, block)
        answers = [effect for effect in effects if isinstance(effect, Send)]
        if len(answers) < len(effects):
            self._carry_out(effect for effect in effects if not isinstance(effect, Send))
        self._sent_to.pop(header.agent, None)
        self._station.pump()
        # An answer is for the sender's books only, and a coordinator that is back there has brought it.
        if self._sent_to.get(header.agent) != host:
            self._carry_out(answers)

    def too_large(self, host: str, header: Transfer, size: int) -> None:
        """A coordinator came whose block was not even read."""
        self._carry_out(self.mobility.oversize(host, header, size))

    def _inject(self, header: Transfer, block: Buffer) -> Refusal | None:
        member = self._coordinators.get(header.agent)
        if member is None:
            return Refusal(
                "UnreachableResourceException", f"{self._name} knows no coordinator {header.agent}"
            )
        try:
            self._station.machine.admit(member, memoryview(block), self._limits(member.id))
        except BlockError as error:
            self._station.note(f"refused {header.agent}: {error}")
            return Refusal("UnreachableResourceException", f"{self._name} refused the coordinator: {error}")
        return None

    # --- news -----------------------------------------------------------------------------------------

    def linked(self, hello: Hello) -> None:
        """A host can be talked to."""
        self._carry_out(self.mobility.linked(hello))

    def received(self, host: str, message: MobilityMessage) -> None:
        """A host has answered, asks, or tells of an ending."""
        self._carry_out(self.mobility.receive(host, message, self._station.clock.monotonic()))
        if isinstance(message, Ended | EndedAck):
            self._station.changed.set()
        if not isinstance(message, Accepted):
            self._station.pump()

    def stop(self) -> None:
        """Nothing more will be given up for taking too long."""
        self._stopped = True
        if self._deadline:
            self._deadline.cancel()

    def _tick(self) -> None:
        self._deadline = None
        self._carry_out(self.mobility.tick(self._station.clock.monotonic()))
        self._station.pump()

    # --- what mobility decides ------------------------------------------------------------------------

    def _carry_out(self, effects: Iterable[Effect]) -> None:
        for effect in effects:
            self._effect(effect)
        self._mind_deadline()

    def _mind_deadline(self) -> None:
        """Be called back when mobility next has something to give up, or earlier.

        Every new deadline is later than those before, so a timer that is set is left as it is.
        """
        if self._deadline or self._stopped:
            return
        due = self.mobility.next_deadline()
        if due is not None:
            wait = max(0.0, due - self._station.clock.monotonic())
            self._deadline = self._loop.call_later(wait, self._tick)

    def _effect(self, effect: Effect) -> None:
        station = self._station
        match effect:
            case SendTransfer():
                self._sent_to[effect.header.agent] = effect.host
                station.peers.send_transfer(effect.host, effect.header, effect.block)
            case Send():
                station.peers.send(effect.host, effect.message)
            case Departed():
                if agent := self._held(effect.agent, effect.generation):
                    station.machine.release(agent)
            case Resume():
                if agent := self._held(effect.agent, effect.generation):
                    agent.block.w[layout.W_SEQUENCE] = effect.sequence
                    source = self._wanted[effect.agent]
                    station.machine.resume(agent, effect.kind, effect.reason, source)
            case InDoubt():
                station.note(f"{effect.agent} is in doubt: {effect.reason}")
                station.changed.set()
            case Supersede():
                station.note(f"{effect.agent} stopped: {effect.reason}")
                self._drop(effect.agent, effect.generation)
            case Finished():
                self._drop(effect.agent, effect.generation)
            case Note():
                station.note(effect.reason)

    def _held(self, identity: str, generation: int) -> Agent | None:
        """The frozen copy of a coordinator that is here, if it is of that start."""
        agent = self._station.machine.agents.get(identity)
        return agent if agent and agent.frozen and agent.generation == generation else None

    def _drop(self, identity: str, generation: int) -> None:
        agent = self._station.machine.agents.get(identity)
        if agent and agent.generation == generation:
            agent.ended = agent.ended or "dropped"
            self._station.machine.release(agent)
        self._station.changed.set()
