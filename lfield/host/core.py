"""What one host decides: its machine, the coordinators that leave and come, and what it knows of its team.

Events in, effects out. It has no loop, socket, process, disk, clock or dice of its own: the shell (host.py)
calls a method for each event, then `run`, and carries out what `take` gives. A simulator does the same.
"""

from __future__ import annotations

import random
from collections.abc import Iterable

from lfield.bytecode.program import DeviceCall
from lfield.clock import Clock
from lfield.errors import BlockError, DeviceError
from lfield.host.directory import TeamDirectory
from lfield.host.effects import CHANGED, Call, Complain, Died, Effect, KeepStart, Nearby, Reach, Say, Write
from lfield.host.offers import Offers
from lfield.manifest import DeviceValue
from lfield.mission.mission import Mission
from lfield.mobility import effects as mobile
from lfield.mobility.core import Mobility, MobilityMessage
from lfield.mobility.departures import UNREACHABLE
from lfield.mobility.fates import Fate
from lfield.mobility.hearsay import Hearsay
from lfield.mobility.neighbours import Neighbourhood
from lfield.mobility.starts import Starts
from lfield.vm.agent import Agent, Member
from lfield.vm.contract import Reading
from lfield.vm.machine import Machine
from lfield.vm.memory import layout
from lfield.vm.offers import Found
from lfield.vm.world import PENDING, Pending
from lfield.wire.framing import Buffer
from lfield.wire.messages import Control, Ended, EndedAck, Heard, Hello, Known, Outcome, Report, Transfer


class HostCore:
    """One host of a mission, without the world. Implements the machine's `World`.

    `incarnation` tells this life from the next; `unreachable_after` is in seconds.
    """

    def __init__(
        self,
        mission: Mission,
        name: str,
        incarnation: int,
        clock: Clock,
        nearby: Nearby,
        dice: random.Random,
        unreachable_after: float,
        neighbours: Neighbourhood,
    ) -> None:
        self.mission, self.team, self.name, self.incarnation = mission, mission.team, name, incarnation
        self.here = self.team.number(name)
        self._clock, self._nearby = clock, nearby
        self.machine = Machine(mission.program, self.team.members, self.here, self, clock, dice)
        self.mobility = Mobility(
            self._own_hello([]),
            peers=self.team.hosts,
            agents=[member.id for member in self.team.coordinators],
            inject=self._inject,
            unreachable_after=unreachable_after,
        )
        self.directory = TeamDirectory(mission, name, incarnation, self.machine.agents, nearby, clock)
        self._offers = Offers(self.directory, mission)
        self._coordinators = {member.id: member for member in self.team.coordinators}
        self._effects: list[Effect] = []
        #: Answers to arrivals, until those that arrived have run: the agent, who waits, and what it gets.
        self._answers: list[tuple[str, str, mobile.Send]] = []
        #: Coordinators that came before the resources here were started; None once they are.
        self._early: dict[str, tuple[str, Transfer, memoryview]] | None = {}
        #: Where each coordinator was last sent, and the resource that it last wanted to get to.
        self._sent_to: dict[str, str] = {}
        self._wanted: dict[str, str] = {}
        #: When mobility may have something to give up. A new deadline is later than those before, so one that
        #: is set stays until it has come.
        self._due: float | None = None
        self.hearsay = Hearsay(self.team.hosts, self.here, incarnation, clock.monotonic(), neighbours)
        self._own = [member for member in self.team.on(self.here) if member.kind == "coordinator"]
        others = [host for host in self.team.hosts if host != name]
        self._starts = Starts([member.id for member in self._own], others)
        self._halted = False

    # --- out ------------------------------------------------------------------------------------------

    def take(self) -> list[Effect]:
        """What is to be done, in this order; each effect is given once."""
        effects, self._effects = self._effects, []
        return effects

    def hello(self) -> Hello:
        """What this host says of itself now."""
        return self._own_hello(self.mobility.knowledge())

    def _own_hello(self, coordinators: list[Known]) -> Hello:
        return Hello(
            "host",
            self.name,
            self.incarnation,
            self.mission.program.digest,
            self.team.deployment,
            self.mission.max_block,
            coordinators,
            self.mission.registry.digest if self.mission.registry is not None else b"",
            self.mission.world,
        )

    # --- time -----------------------------------------------------------------------------------------

    def run(self) -> float | None:
        """Do what is due and let the machine run; to be called after every event, and when its time is up.

        Returns the seconds until it is to be called again (0: at once), None when only an event can change
        anything.
        """
        now = self._clock.monotonic()
        if self._due is not None and now >= self._due:
            self._carry_out(self.mobility.tick(now))
            self._due = self.mobility.next_deadline()
        if self.directory.due is not None and now >= self.directory.due:
            self._effects += self.directory.tick(now)
        if self.hearsay.due is not None and now >= self.hearsay.due:
            self._effects += [mobile.Send(host, news) for host, news in self.hearsay.tell(now)]
        pause = None if self._halted else self.machine.run()
        if self._answers:
            self._answer()
        for due in (self._due, self.directory.due, self.hearsay.due):
            if due is not None:
                left = max(0.0, due - now)
                pause = left if pause is None else min(pause, left)
        return pause

    # --- life -----------------------------------------------------------------------------------------

    def start_resources(self) -> None:
        """The devices are open: start the resources, and take in the coordinators that came meanwhile."""
        for member in self.team.on(self.here):
            if member.kind == "resource":
                self.machine.start(member, self.mission.bindings.limits(member.id), 0)
        self.directory.open()
        early, self._early = self._early or {}, None
        for host, header, block in early.values():
            self.arrived(host, header, block)

    def start_coordinators(self, record: int | None, *, first: bool = False) -> None:
        """The other hosts had time to say what they know: start the coordinators that are not alive there.

        `record` is the last start that this host has on record, None if there is no record; `first` that
        somebody says there was no earlier start. Without either, all hosts must be heard first.
        """
        self._starts.begin(record, first=first)
        self._start_when_heard()

    def halt(self) -> None:
        """The host is stopping: no agent runs any more, and no coordinator is taken in.

        What is under way between hosts goes on, and so does what this host tells of itself.
        """
        self._halted = True

    def kept(self, generation: int) -> None:
        """The start is on record: begin, unless a greeting has told of a later one meanwhile."""
        known = self.mobility.knowledge()
        self._starts.learn(known)
        if self._starts.next > generation:
            self._effects.append(KeepStart(self._starts.next))
            return
        for member in self._own:
            if self._starts.alive(member.id, known):
                self._say(f"{member.id} is alive on another host: not started again")
            else:
                self.mobility.start(member.id, generation)
                self.machine.start(member, self.mission.bindings.limits(member.id), generation)

    def not_kept(self, reason: str) -> None:
        """The record could not be written: a later start could then count as an earlier one."""
        agents = " and ".join(member.id for member in self._own)
        self._say(f"not started: {agents}; its start cannot be put on record: {reason}")

    def _start_when_heard(self) -> None:
        if why := self._starts.why():
            self._say(why)
        if not self._halted and self._starts.due:
            self._starts.learn(self.mobility.knowledge())
            self._effects.append(KeepStart(self._starts.next))

    def reaped(self, host: str) -> None:
        """A host of this team has ended for good: whoever started it says so."""
        if host in self.team.hosts and host != self.name:
            self.hearsay.gone.add(host)
            self._starts.heard(host)
            self._start_when_heard()
            self._effects.append(CHANGED)

    def wanted(self) -> set[str]:
        """The hosts to have links with now: the neighbours, and whoever is waited for."""
        near = self.hearsay.wanted(self._clock.monotonic())
        return {*near, *self._starts.wanted, *self.mobility.wanted()} - {self.name}

    def told(self, host: str, records: list[Known]) -> None:
        """A host that was asked says what it knows of coordinators."""
        self._carry_out(self.mobility.told(host, records))

    def pass_on(self, found: Iterable[Fate]) -> None:
        """This host is about to go: whoever can be reached is told of all endings, and of what it found."""
        self._carry_out(self.mobility.pass_on(found))

    # --- events of links ------------------------------------------------------------------------------

    def linked(self, hello: Hello) -> None:
        """A host can be talked to."""
        restarted = self.hearsay.linked(hello.host, hello.incarnation)
        if restarted or hello.host in self.hearsay.near:
            self._say(f"linked with {hello.host}{', which was restarted' if restarted else ''}")
        self._starts.heard(hello.host, hello.coordinators)
        self._effects += self.directory.linked(hello)
        self._carry_out(self.mobility.linked(hello))
        self._start_when_heard()
        self._effects.append(CHANGED)

    def unlinked(self, host: str, *, quietly: bool = False) -> None:
        """A host cannot be talked to any more; `quietly`: this one had no use for the link."""
        if not quietly:
            self._say(f"lost the link with {host}")
        self.mobility.unlinked(host)
        self.directory.unlinked(host)
        self.hearsay.unlinked(host, self._clock.monotonic())
        self._starts.unlinked(host)
        self._effects.append(CHANGED)

    def arrived(self, host: str, header: Transfer, block: memoryview) -> None:
        """A coordinator came: it runs before its sender gets an answer."""
        if self._early is not None:
            if header.agent in self._coordinators:
                self._early[header.agent] = host, header, block
            return
        self._sent_to.pop(header.agent, None)
        for effect in self.mobility.arrive(host, header, block):
            if isinstance(effect, mobile.Send):
                self._answers.append((header.agent, host, effect))
            else:
                self._carry_out([effect])

    def _answer(self) -> None:
        answers, self._answers = self._answers, []
        for agent, host, answer in answers:
            # It is for the sender's books only, and a coordinator that is back there has brought it.
            if self._sent_to.get(agent) != host:
                self._effects.append(answer)

    def too_large(self, host: str, header: Transfer, size: int) -> None:
        """A coordinator came whose block was not even read."""
        self._carry_out(self.mobility.oversize(host, header, size))

    def received(self, host: str, message: Control) -> None:
        """A host has answered, asks, tells of an ending or of its agents."""
        if isinstance(message, Report):
            if complaint := self.directory.received(host, message):
                self._effects.append(Complain(complaint))
        elif isinstance(message, Heard):
            self.hearsay.told(host, message, self._clock.monotonic())
        elif isinstance(message, MobilityMessage):
            self._carry_out(self.mobility.receive(host, message, self._clock.monotonic()))
            if isinstance(message, Ended | EndedAck):
                self._effects.append(CHANGED)

    # --- events of devices ----------------------------------------------------------------------------

    def answered(self, asked: Call, value: DeviceValue | DeviceError) -> None:
        """What became of a call of a device."""
        if isinstance(value, DeviceError):
            self.machine.refuse(asked.agent, asked.thread, value.kind, str(value), value.device)
        else:
            self.machine.answer(asked.agent, asked.thread, value, asked.call.result, asked.call.field)

    # --- what mobility decides ------------------------------------------------------------------------

    def _carry_out(self, effects: Iterable[mobile.Effect]) -> None:
        for effect in effects:
            self._effect(effect)

    def _effect(self, effect: mobile.Effect) -> None:
        match effect:
            case mobile.SendTransfer():
                self._sent_to[effect.header.agent] = effect.host
                self._effects.append(effect)
            case mobile.Send():
                self._effects.append(effect)
            case mobile.Departed():
                if agent := self._held(effect.agent, effect.generation):
                    self.machine.release(agent)
            case mobile.Resume():
                if agent := self._held(effect.agent, effect.generation):
                    agent.block.w[layout.W_SEQUENCE] = effect.sequence
                    self.machine.resume(agent, effect.kind, effect.reason, self._wanted[effect.agent])
            case mobile.InDoubt():
                self._say(f"{effect.agent} is in doubt: {effect.reason}")
                self._effects.append(CHANGED)
            case mobile.Supersede():
                self._say(f"{effect.agent} stopped: {effect.reason}")
                self._drop(effect.agent, effect.generation)
            case mobile.Finished():
                self._drop(effect.agent, effect.generation)
            case mobile.Note():
                self._say(effect.reason)

    def _inject(self, header: Transfer, block: Buffer) -> mobile.Refusal | None:
        if self._halted:
            return mobile.Refusal(UNREACHABLE, f"{self.name} is stopping")
        member = self._coordinators.get(header.agent)
        if member is None:
            return mobile.Refusal(UNREACHABLE, f"{self.name} knows no coordinator {header.agent}")
        try:
            self.machine.admit(member, memoryview(block), self.mission.bindings.limits(member.id))
        except BlockError as error:
            self._say(f"refused {header.agent}: {error}")
            return mobile.Refusal(UNREACHABLE, f"{self.name} refused the coordinator: {error}")
        return None

    def _held(self, identity: str, generation: int) -> Agent | None:
        """The frozen copy of a coordinator that is here, if it is of that start."""
        agent = self.machine.agents.get(identity)
        return agent if agent and agent.frozen and agent.generation == generation else None

    def _drop(self, identity: str, generation: int) -> None:
        agent = self.machine.agents.get(identity)
        if agent and agent.generation == generation:
            agent.ended = agent.ended or "dropped"
            self.machine.release(agent)
        self._effects.append(CHANGED)

    def _say(self, text: str) -> None:
        self._effects.append(Say(text))

    # --- World of the machine -------------------------------------------------------------------------

    def write(self, agent: Agent, text: str) -> None:
        """Program output."""
        self._effects.append(Write(text))

    def log(self, agent: Agent, text: str) -> None:
        """A line of `print`."""
        self._say(f"{agent.id}: {text}")

    def depart(self, agent: Agent, resource: Member) -> None:
        """A frozen coordinator wants to the host of a resource."""
        self._wanted[agent.id] = resource.id
        image = self.machine.pack(agent)

        def seal(sequence: int) -> Buffer:
            agent.block.w[layout.W_SEQUENCE] = sequence
            return image

        target = self.team.hosts[resource.host]
        if not self.hearsay.is_linked(target):
            self._effects.append(Reach(target))
        self._carry_out(self.mobility.depart(agent.id, target, seal, self._clock.monotonic()))
        if self._due is None:
            self._due = self.mobility.next_deadline()

    def device(
        self, agent: Agent, thread: int, call: DeviceCall, values: list[DeviceValue]
    ) -> DeviceValue | Pending:
        """A device instruction: telemetry is known here, anything else is the guard's."""
        value = self._nearby.query(agent.id, call)
        if isinstance(value, Pending):
            self._effects.append(Call(agent, thread, call, values))
            return PENDING
        return value

    def reading(self, agent: Agent, call: DeviceCall) -> Reading | None:
        """What the engine may read by itself from now on."""
        return self._nearby.reading(agent.id, call)

    def offers(self, agent: Agent, capability: str, constraint: str | None) -> list[Found]:
        """Who offers a capability now, best first."""
        return self._offers.offers(capability, constraint)

    def explain(self, agent: Agent, capability: str, constraint: str | None) -> str:
        """Why everybody else does not."""
        return self._offers.explain(capability, constraint)

    def ended(self, agent: Agent) -> None:
        """A coordinator is done, or an agent has died."""
        if agent.ended == "died":
            self._report_death(agent)
        if agent.member.kind == "coordinator":
            outcome: Outcome = "done" if agent.ended == "done" else "died"
            self._carry_out(self.mobility.ended(agent.id, agent.generation, outcome, agent.report))
        self._effects.append(CHANGED)

    def _report_death(self, agent: Agent) -> None:
        visited = " → ".join(self.team.hosts[n] for n in agent.block.trail() if n < len(self.team.hosts))
        where = f"\n    hosts visited: {visited}" if agent.member.kind == "coordinator" else ""
        self._say(f"{agent.id} died of an uncaught {agent.report}{where}")
        self._effects.append(Died(agent))
