"""One host of a team: the machine, its links to the others, its devices, and its life from start to stop.

Everything happens on one asyncio loop. The machine and mobility are pure; this module carries their
effects out, and gives the machine its turns: `_pump` runs it until nothing can run, then waits for a timer,
a message, or a device.
"""

from __future__ import annotations

import asyncio
import os
import secrets
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from lfield.bytecode.program import DeviceCall
from lfield.clock import Clock, SystemClock
from lfield.errors import BlockError, DeviceError
from lfield.fleet.deploy import Mission
from lfield.fleet.guards import Guards
from lfield.fleet.logbook import Logbook
from lfield.fleet.mobility import Mobility, MobilityMessage
from lfield.fleet.mobility_effects import (
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
from lfield.fleet.peers import Peers
from lfield.fleet.status import coordinators_of, status_of
from lfield.framing import Buffer
from lfield.manifest import DeviceValue
from lfield.net.transport import Link, Transport
from lfield.vm import dump, layout
from lfield.vm.agent import Agent, Member
from lfield.vm.machine import Machine
from lfield.vm.world import Pending
from lfield.wire.messages import (
    Accepted,
    Control,
    Ended,
    EndedAck,
    Hello,
    Known,
    Outcome,
    Status,
    StatusRequest,
    Transfer,
)

#: How long a starting host waits for the others' first answers before it starts its coordinators: one that
#: is alive elsewhere must not be started twice. Longer than a host waits before it calls again.
CENSUS = 1.5


@dataclass(slots=True)
class Options:
    """How a host is run. `listen` is the address to listen on; times are in seconds."""

    listen: str
    dump: Path | None = None
    unreachable_after: float = 10.0
    clock: Clock = field(default_factory=SystemClock)


class Host:
    """A host; `name` is its name in the deployment."""

    def __init__(
        self, mission: Mission, name: str, transport: Transport, logbook: Logbook, options: Options
    ) -> None:
        self.mission, self.name, self.options = mission, name, options
        self.team = mission.team
        self.here = self.team.number(name)
        self.logbook = logbook
        self.clock = options.clock
        self.started = self.clock.monotonic()
        self.incarnation = secrets.randbits(62) + 1
        self.machine = Machine(mission.program, self.team.members, self.here, self, self.clock)
        self.max_block = max(
            (mission.bindings.limits(m.id).heap for m in self.team.coordinators), default=1 << 20
        )
        self.mobility = Mobility(
            self._own_hello([]),
            peers=self.team.hosts,
            agents=[m.id for m in self.team.coordinators],
            inject=self._inject,
            unreachable_after=options.unreachable_after,
        )
        self.peers = Peers(self, transport, self.clock, self.team.hosts, self.team.addresses, self.here)
        self.guards = Guards(mission.plugins, self.clock, self.note)
        self.changed = asyncio.Event()
        self.address = ""
        self.failed: list[Agent] = []
        #: Coordinators that came before the resources here were started; None once they are.
        self._early: list[tuple[str, Transfer, memoryview]] | None = []
        self._hellos: dict[str, Hello] = {}
        self._statuses: dict[str, dict[str, Any]] = {}
        #: Where each coordinator was last sent.
        self._sent_to: dict[str, str] = {}
        #: Every other host's incarnation as last seen, and the hosts that were restarted meanwhile.
        self._seen: dict[str, int] = {}
        self.restarted: set[str] = set()
        self._loop = asyncio.get_running_loop()
        self._timer: asyncio.TimerHandle | asyncio.Handle | None = None
        self._deadline: asyncio.TimerHandle | None = None
        self._stopped = False

    # --- life -----------------------------------------------------------------------------------------

    async def start(self) -> None:
        """Listen, open the devices, start the resources, ask what the others know, start the coordinators.

        Raises AddressError and DevicesError: then nothing has moved.
        """
        self.address = await self.peers.open(self.options.listen)
        members = self.team.on(self.here)
        await self.guards.open(self.mission.bindings.of([m.id for m in members]))
        self.note(f"{self.name} is up on {self.address}")
        generation = int(self.clock.time() * 1e9)
        for member in members:
            if member.kind == "resource":
                self.machine.start(member, self.mission.bindings.limits(member.id), generation)
        self._let_in()
        coordinators = [m for m in members if m.kind == "coordinator"]
        if coordinators:
            await self.peers.first_round(CENSUS)
        for member in coordinators:
            if self._may_start(member, generation):
                self.machine.start(member, self.mission.bindings.limits(member.id), generation)
        self._pump()

    def _let_in(self) -> None:
        """Take the coordinators that came while the devices were opened: what they call is here now."""
        early, self._early = self._early or [], None
        for host, header, block in early:
            self._carry_out(self.mobility.arrive(host, header, block))
        self._pump()

    def _may_start(self, member: Member, generation: int) -> bool:
        known = [k for k in self.mobility.knowledge() if k.agent == member.id]
        alive = next((k for k in known if k.state in ("RUN", "FROZEN", "PREPARED", "IN DOUBT")), None)
        if alive is not None or self._runs_elsewhere(member.id):
            self.note(f"{member.id} is alive on another host: not started again")
            return False
        self.mobility.start(member.id, generation)
        return True

    def _runs_elsewhere(self, identity: str) -> bool:
        return any(
            known.agent == identity and known.state in ("RUN", "FROZEN", "PREPARED")
            for hello in self._hellos.values()
            for known in hello.coordinators
        )

    async def stop(self) -> None:
        """Make the devices safe, then close everything. Coordinators that are here end with the host."""
        if self._stopped:
            return
        self._stopped = True
        for handle in (self._timer, self._deadline):
            if handle:
                handle.cancel()
        await self.guards.close()
        self.peers.close()
        self.logbook.flush()

    # --- the machine's turns --------------------------------------------------------------------------

    def _pump(self) -> None:
        """Let the machine run, and come back when it can run again."""
        if self._timer:
            self._timer.cancel()
            self._timer = None
        if self._stopped:
            return
        pause = self.machine.run()
        self.logbook.flush()
        if pause == 0.0:
            self._timer = self._loop.call_soon(self._pump)
        elif pause is not None:
            self._timer = self._loop.call_later(pause, self._pump)

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
            wait = max(0.0, due - self.clock.monotonic())
            self._deadline = self._loop.call_later(wait, self._tick)

    def _tick(self) -> None:
        self._deadline = None
        self._carry_out(self.mobility.tick(self.clock.monotonic()))
        self._pump()

    # --- mobility's effects ---------------------------------------------------------------------------

    def _effect(self, effect: Effect) -> None:
        match effect:
            case SendTransfer():
                self._sent_to[effect.header.agent] = effect.host
                self.peers.send_transfer(effect.host, effect.header, effect.block)
            case Send():
                self.peers.send(effect.host, effect.message)
            case Departed():
                if agent := self._held(effect.agent, effect.generation):
                    self.machine.release(agent)
            case Resume():
                if agent := self._held(effect.agent, effect.generation):
                    agent.block.w[layout.W_SEQUENCE] = effect.sequence
                    self.machine.resume(agent, effect.kind, effect.reason)
            case InDoubt():
                self.note(f"{effect.agent} is in doubt: {effect.reason}")
                self.changed.set()
            case Supersede():
                self.note(f"{effect.agent} stopped: {effect.reason}")
                self._drop(effect.agent, effect.generation)
            case Finished():
                self._drop(effect.agent, effect.generation)
            case Note():
                self.note(effect.reason)

    def _held(self, identity: str, generation: int) -> Agent | None:
        """The frozen copy of a coordinator that is here, if it is of that start."""
        agent = self.machine.agents.get(identity)
        return agent if agent and agent.frozen and agent.generation == generation else None

    def _drop(self, identity: str, generation: int) -> None:
        agent = self.machine.agents.get(identity)
        if agent and agent.generation == generation:
            agent.ended = agent.ended or "dropped"
            self.machine.release(agent)
        self.changed.set()

    def _inject(self, header: Transfer, block: Buffer) -> Refusal | None:
        member = self.team.member(header.agent)
        if member is None:
            return Refusal("UnreachableResourceException", f"{self.name} knows no coordinator {header.agent}")
        try:
            self.machine.admit(member, memoryview(block), self.mission.bindings.limits(member.id))
        except BlockError as error:
            self.note(f"refused {header.agent}: {error}")
            return Refusal("UnreachableResourceException", f"{self.name} refused the coordinator: {error}")
        return None

    # --- Owner of the links ---------------------------------------------------------------------------

    def _own_hello(self, coordinators: list[Known]) -> Hello:
        return Hello(
            "host",
            self.name,
            self.incarnation,
            self.mission.program.digest,
            self.team.deployment,
            self.max_block,
            coordinators,
        )

    def hello(self) -> Hello:
        """What this host says of itself now."""
        return self._own_hello(self.mobility.knowledge())

    def linked(self, hello: Hello) -> None:
        """A host can be talked to."""
        if self._seen.get(hello.host, hello.incarnation) != hello.incarnation:
            self.note(f"linked with {hello.host}, which was restarted")
            self.restarted.add(hello.host)
        else:
            self.note(f"linked with {hello.host}")
        self._seen[hello.host] = hello.incarnation
        self._hellos[hello.host] = hello
        self._carry_out(self.mobility.linked(hello))
        self.changed.set()
        self._pump()

    def unlinked(self, host: str) -> None:
        """A host cannot be talked to any more."""
        if not self._stopped:
            self.note(f"lost the link with {host}")
        self.mobility.unlinked(host)
        self._hellos.pop(host, None)
        self.changed.set()

    def arrived(self, host: str, header: Transfer, block: memoryview) -> None:
        """A coordinator came: it runs before anything else does."""
        if self._early is not None:
            self._early.append((host, header, block))
            return
        effects = self.mobility.arrive(host, header, block)
        answers = [effect for effect in effects if isinstance(effect, Send)]
        if len(answers) < len(effects):
            self._carry_out(effect for effect in effects if not isinstance(effect, Send))
        self._sent_to.pop(header.agent, None)
        self._pump()
        # An answer is for the sender's books only, and a coordinator that is back there has brought it.
        if self._sent_to.get(header.agent) != host:
            self._carry_out(answers)

    def too_large(self, host: str, header: Transfer, size: int) -> None:
        """A coordinator came whose block was not even read."""
        self._carry_out(self.mobility.oversize(host, header, size))

    def received(self, host: str, message: Control, link: Link) -> None:
        """A message came; `host` is '' when an observer sent it."""
        if isinstance(message, StatusRequest):
            link.send(Status(self.status()))
        elif isinstance(message, Status):
            self._statuses[host] = message.data
            self.changed.set()
        elif host and isinstance(message, MobilityMessage):
            self._carry_out(self.mobility.receive(host, message, self.clock.monotonic()))
            if isinstance(message, Ended | EndedAck):
                self.changed.set()
            if not isinstance(message, Accepted):
                self._pump()

    def note(self, text: str) -> None:
        """A line for the log."""
        self.logbook.note(text)

    def status(self) -> dict[str, Any]:
        """What `lfield ps` shows of this host."""
        return status_of(self)

    async def ask_others(self, bound: float = 1.0) -> dict[str, list[dict[str, Any]]]:
        """The coordinators that this host and every host it can reach know of, by host, asked now."""
        self._statuses.clear()
        asked = set(self.peers.incarnations)
        for host in asked:
            self.peers.send(host, StatusRequest())
        end = self.clock.monotonic() + bound
        while asked - self._statuses.keys() and self.clock.monotonic() < end:
            self.changed.clear()
            with suppress(TimeoutError):
                async with asyncio.timeout(bound):
                    await self.changed.wait()
        answers = {host: data["coordinators"] for host, data in self._statuses.items()}
        return answers | {self.name: coordinators_of(self)}

    # --- World of the machine -------------------------------------------------------------------------

    def write(self, agent: Agent, text: str) -> None:
        """Program output."""
        self.logbook.write(text)

    def log(self, agent: Agent, text: str) -> None:
        """A line of `print`."""
        self.logbook.note(f"{agent.id}: {text}")

    def depart(self, agent: Agent, resource: Member) -> None:
        """A frozen coordinator wants to the host of a resource."""
        image = self.machine.pack(agent)

        def seal(sequence: int) -> Buffer:
            agent.block.w[layout.W_SEQUENCE] = sequence
            return image

        target = self.team.hosts[resource.host]
        self._carry_out(self.mobility.depart(agent.id, target, seal, self.clock.monotonic()))

    def device(
        self, agent: Agent, thread: int, call: DeviceCall, values: list[DeviceValue]
    ) -> DeviceValue | Pending:
        """A device instruction."""

        def answered(value: DeviceValue | DeviceError) -> None:
            if isinstance(value, DeviceError):
                self.machine.refuse(agent, thread, value.kind, str(value), value.device)
            else:
                self.machine.answer(agent, thread, value, call.result, call.field)
            self._pump()

        return self.guards.call(agent.id, call.field, call.instruction, values, answered)

    def ended(self, agent: Agent) -> None:
        """A coordinator is done, or an agent has died."""
        if agent.ended == "died":
            self._report_death(agent)
        if agent.member.kind == "coordinator":
            outcome: Outcome = "done" if agent.ended == "done" else "died"
            self._carry_out(self.mobility.ended(agent.id, agent.generation, outcome, agent.report))
        self.changed.set()

    def _report_death(self, agent: Agent) -> None:
        visited = " → ".join(self.team.hosts[n] for n in agent.block.trail() if n < len(self.team.hosts))
        where = f"\n    hosts visited: {visited}" if agent.member.kind == "coordinator" else ""
        self.note(f"{agent.id} died of an uncaught {agent.report}{where}")
        self.failed.append(agent)
        if self.options.dump:
            self._dump(agent, self.options.dump)

    def _dump(self, agent: Agent, folder: Path) -> None:
        data = dump.encode(
            self.name,
            agent.report,
            agent.limits.heap,
            self.team.members,
            self.team.hosts,
            self.mission.program,
            agent.block,
        )
        path = folder / f"{agent.id}.block"
        try:
            folder.mkdir(parents=True, exist_ok=True)
            path.write_bytes(data)
            self.note(f"dumped {agent.id}: lfield inspect {path}")
        except OSError as error:
            self.note(f"cannot dump {agent.id} to {path}: {os.strerror(error.errno or 0)}")
