"""One host of a team: the machine, its links to the others, its devices, and its life from start to stop.

Everything happens on one asyncio loop. The machine is pure; this module is its world and gives it its turns:
`pump` runs it until nothing can run, then waits for a timer, a message, or a device.
"""

from __future__ import annotations

import asyncio
import os
import random
import secrets
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from lfield.bytecode.program import DeviceCall
from lfield.clock import Clock, SystemClock
from lfield.devices.guards import Guards
from lfield.errors import DeviceError
from lfield.host.logbook import Logbook
from lfield.host.offers import Offers
from lfield.host.reporting import Reporting
from lfield.host.status import coordinators_of, status_of
from lfield.host.travel import Travel
from lfield.manifest import DeviceValue
from lfield.mission.mission import Mission
from lfield.mobility.core import MobilityMessage
from lfield.net.peers import Peers
from lfield.net.transport import Link, Transport
from lfield.vm.agent import Agent, Member
from lfield.vm.inspect import dump
from lfield.vm.machine import Machine
from lfield.vm.offers import Found
from lfield.vm.readings import Reading
from lfield.vm.world import Pending
from lfield.wire.messages import (
    Control,
    EmergencyStop,
    EmergencyStopped,
    Hello,
    Known,
    Report,
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
        self.machine = Machine(
            mission.program, self.team.members, self.here, self, self.clock, random.Random()
        )
        self.peers = Peers(self, transport, self.clock, self.team.hosts, self.team.addresses, self.here)
        self.guards = Guards(mission.drivers, self.clock, self.note, silence=mission.bindings.silence)
        self.changed = asyncio.Event()
        self.address = ""
        self.travel = Travel(
            self, self.team, self._own_hello([]), mission.bindings.limits, options.unreachable_after
        )
        self.mobility = self.travel.mobility
        self.reporting = Reporting(self, mission)
        self._capabilities = Offers(self.reporting, mission)
        self._hellos: dict[str, Hello] = {}
        self._statuses: dict[str, dict[str, Any]] = {}
        #: Every other host's incarnation as last seen, and the hosts that were restarted meanwhile.
        self._seen: dict[str, int] = {}
        self.restarted: set[str] = set()
        self._loop = asyncio.get_running_loop()
        self._timer: asyncio.TimerHandle | asyncio.Handle | None = None
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
        self.travel.open()
        self.reporting.open()
        coordinators = [m for m in members if m.kind == "coordinator"]
        if coordinators:
            await self.peers.first_round(CENSUS)
        for member in coordinators:
            if self._may_start(member, generation):
                self.machine.start(member, self.mission.bindings.limits(member.id), generation)
        self.pump()

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
        if self._timer:
            self._timer.cancel()
        self.travel.stop()
        self.reporting.stop()
        await self.guards.close()
        self.peers.close()
        self.logbook.flush()

    # --- the machine's turns --------------------------------------------------------------------------

    def pump(self) -> None:
        """Let the machine run, and come back when it can run again."""
        if self._timer:
            self._timer.cancel()
            self._timer = None
        if self._stopped:
            return
        pause = self.machine.run()
        self.logbook.flush()
        if pause == 0.0:
            self._timer = self._loop.call_soon(self.pump)
        elif pause is not None:
            self._timer = self._loop.call_later(pause, self.pump)

    # --- Owner of the links ---------------------------------------------------------------------------

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
        self.reporting.linked(hello)
        self.travel.linked(hello)
        self.changed.set()
        self.pump()

    def unlinked(self, host: str) -> None:
        """A host cannot be talked to any more."""
        if not self._stopped:
            self.note(f"lost the link with {host}")
        self.mobility.unlinked(host)
        self.reporting.unlinked(host)
        self._hellos.pop(host, None)
        self.changed.set()

    def arrived(self, host: str, header: Transfer, block: memoryview) -> None:
        """A coordinator came."""
        self.travel.arrived(host, header, block)

    def too_large(self, host: str, header: Transfer, size: int) -> None:
        """A coordinator came whose block was not even read."""
        self.travel.too_large(host, header, size)

    def received(self, host: str, message: Control, link: Link) -> None:
        """A message came; `host` is '' when an observer sent it."""
        if isinstance(message, StatusRequest):
            link.send(Status(self.status()))
        elif isinstance(message, Status):
            self._statuses[host] = message.data
            self.changed.set()
        elif isinstance(message, EmergencyStop) and not host:
            self._stopping_devices = self._loop.create_task(self._emergency_stop(message, link))
        elif host and isinstance(message, Report):
            self.reporting.received(host, message)
        elif host and isinstance(message, MobilityMessage):
            self.travel.received(host, message)

    async def _emergency_stop(self, message: EmergencyStop, link: Link) -> None:
        if message.lift:
            self.note("the emergency stop is lifted; programs may release their devices")
            devices = self.guards.lift_stop()
        else:
            self.note(f"EMERGENCY STOP: {message.reason}")
            devices = await self.guards.emergency_stop(message.reason)
        link.send(EmergencyStopped(devices))

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
        self.travel.depart(agent, resource)

    def device(
        self, agent: Agent, thread: int, call: DeviceCall, values: list[DeviceValue]
    ) -> DeviceValue | Pending:
        """A device instruction."""

        def answered(value: DeviceValue | DeviceError) -> None:
            if isinstance(value, DeviceError):
                self.machine.refuse(agent, thread, value.kind, str(value), value.device)
            else:
                self.machine.answer(agent, thread, value, call.result, call.field)
            self.pump()

        return self.guards.call(agent.id, call.field, call.instruction, values, answered)

    def reading(self, agent: Agent, call: DeviceCall) -> Reading | None:
        """What the engine may read by itself from now on."""
        return self.guards.reading(agent.id, call.field, call.instruction)

    def offers(self, agent: Agent, capability: str, constraint: str | None) -> list[Found]:
        """Who offers a capability now, best first."""
        return self._capabilities.offers(capability, constraint)

    def explain(self, agent: Agent, capability: str, constraint: str | None) -> str:
        """Why everybody else does not."""
        return self._capabilities.explain(capability, constraint)

    def ended(self, agent: Agent) -> None:
        """A coordinator is done, or an agent has died."""
        if agent.ended == "died":
            self._report_death(agent)
        if agent.member.kind == "coordinator":
            self.travel.ended(agent)
        self.changed.set()

    def _report_death(self, agent: Agent) -> None:
        visited = " → ".join(self.team.hosts[n] for n in agent.block.trail() if n < len(self.team.hosts))
        where = f"\n    hosts visited: {visited}" if agent.member.kind == "coordinator" else ""
        self.note(f"{agent.id} died of an uncaught {agent.report}{where}")
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
