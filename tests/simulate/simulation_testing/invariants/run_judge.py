"""Checks the invariants of a run from observations.

I1  at most one copy of a coordinator can run, at any real time
I2  no transfer is injected twice
I3  no resource starts a portal for an older copy than the newest that it has served
I4  no portal call is started twice, and none is skipped silently
I5  at every moment some disk holds a state to continue from (`durability.py`)

A copy of a recoverable coordinator may coexist with its successor if it then begins no call and commands no
device (`call_checks.py`, `device_use.py`). A terminated coordinator is not recovered (`end_checks.py`). Calls
do not outlive their block (`block_checks.py`); a reserved resource serves only its holder
(`reservation_checks.py`). Start numbers are unique, a device has one owner, no live coordinator is reported
lost, and no host fails.
"""

from __future__ import annotations

import math
from collections import defaultdict
from dataclasses import dataclass, field
from functools import partial

from lfield.journal.records import CoordinatorRecord, FenceRecord, Record
from lfield.replication.transfer.generations import is_recovery
from lfield.simulate.host_fleet import Fleet, HostRun
from lfield.text.log_messages import AGENT_LOST
from lfield.vm.agent import Agent
from lfield.wire.coordinator_messages import Transfer
from simulation_testing.invariants.agreement_checks import AgreementChecks
from simulation_testing.invariants.block_checks import BlockChecks
from simulation_testing.invariants.breaches import Breaches
from simulation_testing.invariants.call_checks import CallChecks
from simulation_testing.invariants.device_use import DeviceUse
from simulation_testing.invariants.durability import is_shadowed, last_location, unsaved_starts
from simulation_testing.invariants.end_checks import EndChecks, latest_start
from simulation_testing.invariants.host_taps import tap, tap_meter
from simulation_testing.invariants.order_checks import OrderChecks
from simulation_testing.invariants.reservation_checks import ReservationChecks
from simulation_testing.invariants.result_checks import ResultChecks

#: A coordinator and one start of it.
Start = tuple[str, int]
#: Age in seconds up to which a start may be unknown to a host that reports a loss.
MIN_KNOWN_AGE = 3.0
#: The number of calls that must end after the faults.
MIN_CALLS = 3


@dataclass(slots=True, eq=False)
class _StartRecord:
    """One start of a coordinator: its first observation, and its possible, present and former hosts.

    `copy` is the last one in a machine.
    """

    first: float
    holders: set[HostRun] = field(default_factory=set)
    running: set[HostRun] = field(default_factory=set)
    knew: set[HostRun] = field(default_factory=set)
    #: The hosts that may have the start, each with its memory; the host of its arrival, until it is durable
    #: there.
    places: dict[str, int] = field(default_factory=dict)
    unsaved: str = ""
    copy: Agent | None = None

    @property
    def was_superseded(self) -> bool:
        """Whether another start of the coordinator has continued."""
        return self.copy is not None and self.copy.ended == "dropped"


class RunJudge:
    """Observes one team: `fleet` must be set before any event. `breaches` has the findings.

    With journals no coordinator may be lost after any crashes.
    """

    def __init__(self) -> None:
        self.fleet: Fleet
        self.breaches = Breaches(lambda: self.fleet.now)
        self._breach = self.breaches.add
        self._starts: dict[Start, _StartRecord] = {}
        self._calls = CallChecks(self.breaches, lambda agent: self._newest_at(agent, math.inf))
        self._blocks = BlockChecks(self.breaches, lambda: self.fleet.now, self._newest_at, self._on_disk)
        self._results = ResultChecks(self.breaches, self._home)
        times = lambda: self.fleet.now, lambda: self.fleet.mission.bindings.reservations.lease
        self.reserved = ReservationChecks(self.breaches, *times, self._newest_at, self._on_disk)
        self.orders = OrderChecks(self.breaches, lambda: self.fleet.now, lambda: self.fleet.options.keeps)
        self.on_result_durable = self._blocks.on_result_durable
        self._devices = DeviceUse(self.breaches, self._caller, self._newest_at, self.reserved.commanded)
        self._terminated = EndChecks(self.breaches, lambda: self.fleet, partial(latest_start, self._starts))
        self._doubts = AgreementChecks(self.breaches, lambda: self.fleet)
        self.on_granted, self.on_dropped = self.reserved.on_granted, self.reserved.on_dropped
        self.on_reserved_call, self.on_renewed = self.reserved.on_reserved_call, self.reserved.on_renewed
        #: The number of observations, to detect a judge without observations.
        self.counts = dict.fromkeys(("injections", "starts", "recoveries"), 0)
        #: The time at which each recovery of each agent was the first to continue.
        self._gone_on: defaultdict[str, dict[int, float]] = defaultdict(dict)
        self._newest: dict[str, int] = {}
        #: The starts whose number was used twice, by a host that had lost its disk.
        self._void: set[Start] = set()
        self._injected: set[tuple[str, int, int]] = set()
        #: The starts that a life has found on its disk and that have not left since.
        self._kept: set[tuple[HostRun, Start]] = set()
        self._agents: defaultdict[HostRun, list[Agent]] = defaultdict(list)
        self._lives: dict[int, HostRun] = {}
        #: The disk with which each life has begun, for peers that identify the memory by the life.
        self._memories: dict[int, int] = {}
        self._disks_of: dict[str, int] = {}
        self._log_position = 0

    def on_host_start(self, name: str, life: HostRun) -> None:
        """A host's process begins."""
        memory = life.host.journal_writer.journal_id
        self._lives[life.core.incarnation], self._memories[life.core.incarnation] = life, memory
        if self._disks_of.setdefault(name, memory) != memory:
            self._disks_of[name] = memory
            self.reserved.on_disk_lost(m.id for m in life.core.team.members_on(life.core.own_number))
            self.orders.on_disk_lost(name)
        self.orders.on_host_start(name)
        tap(life, self)
        tap_meter(life, self.orders.on_computed)
        self._terminated.on_host_start(life)

    @property
    def calls(self) -> int:
        """The number of calls that began."""
        return self._calls.started + self._blocks.started + self.reserved.started.total()

    @property
    def restarts(self) -> int:
        """The number of exceptions that informed a walker of a recovery or restart."""
        return self._calls.restarts + self._blocks.restarts + self.reserved.rounds["restarted"]

    def _newest_at(self, agent: str, when: float) -> int:
        """The last recovery of an agent that had continued at that time, 0 for none."""
        return max((start for start, at in self._gone_on[agent].items() if at < when), default=0)

    # --- observations: copies ---------------------------------------------------------------------------

    def on_started(self, life: HostRun, agent: Agent) -> None:
        """A coordinator was started: check its number."""
        self.counts["starts"] += 1
        newest = self._newest.get(agent.id, 0)
        if agent.generation <= newest:
            self._again(life, agent, newest)
        self._newest[agent.id] = max(newest, agent.generation)
        self._held(life, agent)

    def _again(self, life: HostRun, agent: Agent, newest: int) -> None:
        """Check a repeated number: it is permitted if the start had made no call, or is inactive."""
        before = self._starts.get(start := (agent.id, agent.generation))
        busy = any(of(*start) for of in (self._calls.has_any, self._blocks.has_any, self.reserved.has_any))
        moved = before and any(other.core.name != life.core.name for other in before.knew)
        if before and self.fleet.options.keeps and not moved and not busy:
            return
        if self._keeps_memory(life.core.name) or self._known(agent, life.core.name):
            found = f"{agent.id} was started as {agent.generation}, which is not above {newest}"
            self._breach("start", (life.core.name,), found)
        self._void.add(start)

    def _known(self, agent: Agent, home: str) -> bool:
        """Whether another running host has had this start, or one with a higher number."""
        own = (s for (who, start), s in self._starts.items() if who == agent.id and start >= agent.generation)
        knew = {life for row in own for life in row.knew}
        return any(not life.process.loop.dead and life.core.name != home for life in knew)

    def on_transfer(self, life: HostRun, header: Transfer) -> None:
        """A coordinator has arrived at a host, which knows that start from now on."""
        row = self._starts.get((header.agent, header.generation))
        if row is not None and header.receiver_memory == life.core.hello().state_id:
            row.knew.add(life)

    def on_admitted(self, life: HostRun, agent: Agent, *, came: bool) -> None:
        """A coordinator was put into a machine."""
        transfer = agent.id, agent.generation, agent.sequence
        if came:
            self.counts["injections"] += 1
            if transfer in self._injected and transfer[:2] not in self._void:
                self._breach("I2", (life.core.name,), f"transfer {transfer} was injected twice")
            self._injected.add(transfer)
        before = dict(self._starts[transfer[:2]].places) if transfer[:2] in self._starts else {}
        self._held(life, agent)
        row = self._starts[transfer[:2]]
        row.places, row.unsaved = before | row.places, life.core.name

    def on_restored(self, life: HostRun, agent: Agent) -> None:
        """A host has found a coordinator on its own disk."""
        self._kept.add((life, (agent.id, agent.generation)))

    def _continues_from_disk(self, life: HostRun, start: Start) -> None:
        """A restored start continues: the failures of calls that were reported to it may be lost."""
        if (life, start) not in self._kept:
            return
        self._kept.discard((life, start))
        self._calls.on_resumed_from_disk(start[0])

    def on_resumed(self, life: HostRun, agent: Agent, kind: str) -> None:
        """A frozen coordinator may run again, with this exception: the receiver does not have it."""
        self._continues_from_disk(life, (agent.id, agent.generation))
        self._held(life, agent)

    def _held(self, life: HostRun, agent: Agent) -> None:
        row = self._starts.setdefault((agent.id, agent.generation), _StartRecord(self.fleet.now))
        self._observe_recovery(agent)
        row.holders, row.copy = {life}, agent
        row.knew.add(life)
        row.places, row.unsaved = {life.core.name: life.host.journal_writer.journal_id}, ""
        if all(agent is not other for other in self._agents[life]):
            self._agents[life].append(agent)
        self._check_host(life)

    def _observe_recovery(self, agent: Agent) -> None:
        if is_recovery(agent.generation) and not agent.frozen:
            gone_on = self._gone_on[agent.id]
            self.counts["recoveries"] += agent.generation not in gone_on
            gone_on.setdefault(agent.generation, self.fleet.now)

    def on_sent(self, life: HostRun, header: Transfer, target: str, incarnation: int) -> None:
        """A coordinator was sent: the receiver may have it now."""
        receiver, row = self._lives.get(incarnation), self._starts.get((header.agent, header.generation))
        self._continues_from_disk(life, (header.agent, header.generation))
        if row is not None:
            row.places[target] = header.receiver_memory
        if row is not None and receiver is not None:
            row.holders.add(receiver)

    def _keeps_memory(self, name: str) -> bool:
        """Whether a host has always had one memory."""
        return self.fleet.options.keeps and name not in self.fleet.replaced

    def on_step(self, life: HostRun) -> None:
        """Observe the coordinators that can run on an idle host."""
        if life in self._agents:
            self._check_host(life)

    def _check_host(self, life: HostRun) -> None:
        held = life.core.machine.agents
        here = [a for a in self._agents[life] if not a.ended and (not a.frozen or held.get(a.id) is a)]
        run = [agent for agent in here if not agent.frozen]
        if len({agent.id for agent in run}) < len(run):
            names = ", ".join(f"{agent.id} {agent.generation}" for agent in run)
            self._breach("I1", (life.core.name,), f"one host can run several starts: {names}")
        for agent in self._agents[life]:
            self._starts[agent.id, agent.generation].running.discard(life)
        for agent in run:
            self.orders.on_running(life, agent)
            self._runs(life, (agent.id, agent.generation))
        self._agents[life] = here

    def _runs(self, life: HostRun, start: Start) -> None:
        running = self._starts[start].running
        running.add(life)
        if len(running) > 1:
            running -= {other for other in running if other.process.loop.dead}
        if len(running) > 1 and start not in self._void:
            hosts = tuple(sorted(other.core.name for other in running))
            self._breach("I1", hosts, f"{start[0]} of start {start[1]} can run on {len(hosts)} hosts")

    def on_output(self, life: HostRun, agent: Agent, text: str) -> None:
        """A program has written text."""
        for line in text.splitlines():
            if self._blocks.on_output(life, agent, line.split()) or " also failed: " in line:
                continue
            if self.reserved.on_output(life, agent, line.split()):
                continue
            self._calls.on_output(life, agent, line)

    def _home(self, member: int) -> str:
        team = self.fleet.mission.team
        return team.hosts[team.members[member].host]

    def _caller(self, arguments: tuple[object, ...]) -> Start:
        agent, generation = self._calls.caller_of(arguments)
        return (agent, generation) if agent else self.reserved.caller_of(arguments)

    def _on_disk(self, name: str) -> list[Record] | None:
        return self.fleet.disks[name].records() if self.fleet.options.keeps else None

    # --- observations: devices and logs -----------------------------------------------------------------

    def check(self) -> None:
        """Check devices and logs; called several times a second."""
        for name, hardware in self.fleet.hardware.items():
            self._devices.check(name, hardware, self.fleet.now)
            self.orders.check(self.fleet.mission, name, hardware)
        for at, host, text in self.fleet.log[self._log_position :]:
            self._line(at, host, text)
        self._log_position = len(self.fleet.log)
        self._doubts.check()
        if self.fleet.options.keeps:
            self._disks()
            self._terminated.check()

    def _disks(self) -> None:
        latest = [(agent, self._latest(agent)) for agent in self._newest if agent not in self._calls.over]
        going = [(agent, start) for agent, start in latest if not self.orders.is_given_up(agent, start)]
        records = [(name, page) for name, disk in self.fleet.disks.items() for page in disk.records()]
        for name, page in records:
            self._is_saved(name, page)
        self._blocks.check_disks(records)
        barred = {(page.agent, page.generation) for _, page in records if isinstance(page, FenceRecord)}
        safe = [(a, s) for a, s in going if s and not any(a == b and s < g for b, g in barred)]
        identities = {name: disk.identity for name, disk in self.fleet.disks.items()}
        self._results.check(records, identities, [start for start in safe if not self._in_doubt(start)])
        pages = (page for _, page in records)
        for agent, start in unsaved_starts(pages, [(agent, start) for agent, start in going if start]):
            if not self._in_doubt((agent, start)):
                self._breach("I5", (), f"no disk holds {agent} of start {start}, and it has not ended")

    def _is_saved(self, name: str, page: Record) -> None:
        """True if any disk has the start; the sender may delete it once it is durable at the receiver."""
        row = self._starts.get((page.agent, page.generation)) if isinstance(page, CoordinatorRecord) else None
        if row and row.unsaved == name and isinstance(page, CoordinatorRecord) and page.state == "RUN":
            row.places, row.unsaved = {name: row.places[name]}, ""

    def _latest(self, agent: str) -> int:
        """The latest start that is not superseded, 0 if all are."""
        starts = (s for s, row in self._starts.items() if s[0] == agent and not row.was_superseded)
        return max((generation for _, generation in starts), default=0)

    def _in_doubt(self, start: Start) -> bool:
        """True if a possible holder has lost its disk since: then the true state is unknown."""
        places = self._starts[start].places
        if any(self._lost(name, memory) for name, memory in places.items()):
            return True
        last = last_location(start, (page for disk in self.fleet.disks.values() for page in disk.records()))
        # It is unknown whether the transfer was sent.
        return last is not None and last.state == "PREPARED" and self._lost(last.target, last.receiver_memory)

    def _lost(self, name: str, memory: int) -> bool:
        wrecked = name in self.fleet.lost_hosts and not self.fleet.mission.fenced
        return wrecked or self.fleet.disks[name].identity != self._memories.get(memory, memory)

    def _line(self, at: float, host: str, text: str) -> None:
        if "bug in lfield" in text:
            self._breach("bug", (host,), text.strip())
        agent, lost, _ = text.partition(AGENT_LOST.line(agent="", reason=""))
        if lost:
            old = [s for s, row in self._starts.items() if s[0] == agent and at - row.first > MIN_KNOWN_AGE]
            for start in old:
                running = {life for life in self._starts[start].running if not life.process.loop.dead}
                if running:
                    hosts = (host, *sorted(life.core.name for life in running))
                    self._breach("lost", hosts, f"{text.strip()}, while start {start[1]} lives")

    # --- after the faults -------------------------------------------------------------------------------

    def on_settled(self) -> None:
        """The faults have been over for so long that every host must be reached."""
        self._calls.settled = not self.fleet.lost_hosts

    def on_healed(self) -> None:
        """The faults are over: from now on all coordinators must make progress."""
        self._calls.ended.clear()
        self._blocks.on_healed()
        self.reserved.on_healed()

    def waits_for(self) -> list[str]:
        """The coordinators that may continue, and have not made enough progress."""
        return [agent for agent in self._homes if self._must_run(agent)]

    @property
    def _homes(self) -> dict[str, str]:
        team = self.fleet.mission.team
        return {member.id: team.hosts[member.host] for member in team.coordinators}

    def _must_run(self, agent: str) -> bool:
        ended = self._calls.ended[agent] + self._blocks.closed[agent] + self.reserved.closed[agent]
        given_up = self.orders.is_given_up(agent, self._newest.get(agent, 0))
        if agent in self._calls.over or ended >= MIN_CALLS or given_up:
            return False
        if agent in self.fleet.mission.fenced:
            return is_shadowed(agent, self.fleet.pages_left)
        if generation := self._latest(agent):
            start = agent, generation
            if self.fleet.lost_hosts and self._in_doubt(start):
                return self.orders.acted and is_shadowed(agent, self.fleet.pages_left)
            if self.fleet.options.keeps:
                return not self._in_doubt(start)
            return not any(life.process.loop.dead for life in self._starts[start].holders)
        name = self._homes[agent]
        # A new start waits for all others except those that an operator has declared lost.
        return name in self.fleet.runs and (self._keeps_memory(name) or not self.fleet.left)

    def end(self) -> None:
        """The end of the run: a coordinator without progress is stuck."""
        for agent in self.waits_for():
            holders = [row.holders for start, row in self._starts.items() if start[0] == agent]
            hosts = {life.core.name for some in holders for life in some}
            lines = (text.strip() for _, _, text in self.fleet.log if agent in text)
            last_said = [
                f"; last was said: {text.splitlines()[0]}" for text in lines if "." not in text.split()[0]
            ]
            last = last_said[-1] if last_said else ""
            self._breach("stuck", tuple(sorted(hosts)), f"{agent} does not go on after the weather{last}")
        for name in sorted(self.fleet.failed):
            self._breach("host", (name,), "it has failed")
