"""Whether a run kept the promises, judged from what was seen of it (lfield/docs/decisions/0038).

I1  of one coordinator at most one copy can run, at any real time
I2  no transfer is injected twice
I3  no resource starts a portal for an older copy than the newest that it has served
I4  no portal call is started twice, and none is skipped without being told
I5  at every moment some disk holds a state to go on from (`saved.py`)

Of a coordinator that a majority may recover a copy may stand beside its successor, as long as it begins no
call and commands no device once that one goes on (`calls.py`, `devices.py`). None that is known
to have ended is recovered or runs on (`terminated.py`). Calls begun together do not outlive their block
(`blocks.py`), what is reserved is its holder's alone (`reserved.py`). Beside them: no start has an earlier
one's number, nobody is called lost who lives, no device moves for nobody or has two owners, no host fails.
"""

from __future__ import annotations

import math
from collections import defaultdict
from dataclasses import dataclass, field
from functools import partial

from lfield.journal.pages import CopyPage, Fence, Page
from lfield.mobility.generations import is_recovery
from lfield.simulate.fleet import Fleet, Life
from lfield.simulate.judging.blocks import Blocks
from lfield.simulate.judging.breaches import Breaches
from lfield.simulate.judging.calls import Calls
from lfield.simulate.judging.devices import Devices
from lfield.simulate.judging.doubts import Doubts
from lfield.simulate.judging.orders import Orders
from lfield.simulate.judging.reserved import Reserved
from lfield.simulate.judging.results import Results
from lfield.simulate.judging.saved import last_seen, nowhere, shadowed
from lfield.simulate.judging.terminated import Terminated, latest_start
from lfield.simulate.judging.witness import tap, tap_meter
from lfield.vm.agent import Agent
from lfield.wire.coordinators import Transfer

#: A coordinator and one start of it.
Start = tuple[str, int]
#: A start that is younger than so many seconds may not be known yet to whoever says lost.
YOUNG = 3.0
#: So many calls must come to an end after the weather.
ENOUGH = 3


@dataclass(slots=True, eq=False)
class _Seen:
    """One start of a coordinator: when it was first seen, who may have it, can run it, and ever had it.

    `copy` is the last one that was in a machine.
    """

    first: float
    holders: set[Life] = field(default_factory=set)
    running: set[Life] = field(default_factory=set)
    knew: set[Life] = field(default_factory=set)
    #: The hosts that may have it, each with the memory that would tell; that to which it has come, until it
    #: is seen on the disk there.
    places: dict[str, int] = field(default_factory=dict)
    unsaved: str = ""
    copy: Agent | None = None

    @property
    def gave_way(self) -> bool:
        """Whether another start of the coordinator goes on."""
        return self.copy is not None and self.copy.ended == "dropped"


class Judge:
    """Watches one team: `fleet` must be set before anything happens. `breaches` has what was found.

    Where hosts have journals no coordinator may be lost, whoever dies.
    """

    def __init__(self) -> None:
        self.fleet: Fleet
        self.breaches = Breaches(lambda: self.fleet.now)
        self._breach = self.breaches.add
        self._starts: dict[Start, _Seen] = {}
        self._calls = Calls(self.breaches, lambda agent: self._newest_at(agent, math.inf))
        self._blocks = Blocks(self.breaches, lambda: self.fleet.now, self._newest_at, self._on_disk)
        self._results = Results(self.breaches, self._home)
        times = lambda: self.fleet.now, lambda: self.fleet.mission.bindings.reservations.lease
        self.reserved = Reserved(self.breaches, *times, self._newest_at, self._on_disk)
        self.orders = Orders(self.breaches, lambda: self.fleet.now, lambda: self.fleet.keeps)
        self.told = self._blocks.told
        self._devices = Devices(self.breaches, self._made_for, self._newest_at, self.reserved.commanded)
        self._terminated = Terminated(self.breaches, lambda: self.fleet, partial(latest_start, self._starts))
        self._doubts = Doubts(self.breaches, lambda: self.fleet)
        self.given, self.dropped = self.reserved.given, self.reserved.dropped
        self.asked, self.renewed = self.reserved.asked, self.reserved.renewed
        #: How much was seen: a judge who sees nothing finds nothing.
        self.seen = dict.fromkeys(("injections", "starts", "recoveries"), 0)
        #: When which recovery of each agent was the first to go on.
        self._gone_on: defaultdict[str, dict[int, float]] = defaultdict(dict)
        self._newest: dict[str, int] = {}
        #: The starts whose number was given twice, by a host that had lost its disk.
        self._void: set[Start] = set()
        self._injected: set[tuple[str, int, int]] = set()
        #: The starts that a life has found on its disk, and that have not gone on from there.
        self._kept: set[tuple[Life, Start]] = set()
        self._agents: defaultdict[Life, list[Agent]] = defaultdict(list)
        self._lives: dict[int, Life] = {}
        #: The disk that each life has begun with, should somebody take the life for what remembers.
        self._memories: dict[int, int] = {}
        self._disks_of: dict[str, int] = {}
        self._told = 0

    def born(self, name: str, life: Life) -> None:
        """A host's process begins."""
        memory = life.host.scribe.memory
        self._lives[life.core.incarnation], self._memories[life.core.incarnation] = life, memory
        if self._disks_of.setdefault(name, memory) != memory:
            self._disks_of[name] = memory
            self.reserved.lost_disk(member.id for member in life.core.team.on(life.core.here))
            self.orders.lost_disk(name)
        self.orders.born(name)
        tap(life, self)
        tap_meter(life, self.orders.computed)
        self._terminated.born(life)

    @property
    def calls(self) -> int:
        """How many calls began."""
        return self._calls.begun + self._blocks.begun + self.reserved.begun.total()

    @property
    def restarts(self) -> int:
        """How many exceptions told a walker that it goes on elsewhere, or again."""
        return self._calls.restarts + self._blocks.restarts + self.reserved.rounds["restarted"]

    def _newest_at(self, agent: str, when: float) -> int:
        """The last recovery of an agent that had gone on at that time, 0 for none."""
        return max((start for start, at in self._gone_on[agent].items() if at < when), default=0)

    # --- what is seen: copies ---------------------------------------------------------------------------

    def started(self, life: Life, agent: Agent) -> None:
        """A coordinator was begun: as which start?"""
        self.seen["starts"] += 1
        newest = self._newest.get(agent.id, 0)
        if agent.generation <= newest:
            self._again(life, agent, newest)
        self._newest[agent.id] = max(newest, agent.generation)
        self._held(life, agent)

    def _again(self, life: Life, agent: Agent, newest: int) -> None:
        """A number that is not new: of who had called nothing yet, or it tells nothing any more."""
        before = self._starts.get(start := (agent.id, agent.generation))
        begun = any(of(*start) for of in (self._calls.any_of, self._blocks.any_of, self.reserved.any_of))
        moved = before and any(other.core.name != life.core.name for other in before.knew)
        if before and self.fleet.keeps and not moved and not begun:
            return
        if self._remembers(life.core.name) or self._known(agent, life.core.name):
            found = f"{agent.id} was started as {agent.generation}, which is not above {newest}"
            self._breach("start", (life.core.name,), found)
        self._void.add(start)

    def _known(self, agent: Agent, home: str) -> bool:
        """Whether another host that lives has had this start, or one with a higher number."""
        own = (s for (who, start), s in self._starts.items() if who == agent.id and start >= agent.generation)
        knew = {life for seen in own for life in seen.knew}
        return any(not life.process.loop.dead and life.core.name != home for life in knew)

    def came(self, life: Life, header: Transfer) -> None:
        """A coordinator has come to a host, which knows of that start from now on."""
        seen = self._starts.get((header.agent, header.generation))
        if seen is not None and header.receiver_memory == life.core.hello().remembers:
            seen.knew.add(life)

    def admitted(self, life: Life, agent: Agent, *, came: bool) -> None:
        """A coordinator was put into a machine."""
        transfer = agent.id, agent.generation, agent.sequence
        if came:
            self.seen["injections"] += 1
            if transfer in self._injected and transfer[:2] not in self._void:
                self._breach("I2", (life.core.name,), f"transfer {transfer} was injected twice")
            self._injected.add(transfer)
        before = dict(self._starts[transfer[:2]].places) if transfer[:2] in self._starts else {}
        self._held(life, agent)
        seen = self._starts[transfer[:2]]
        seen.places, seen.unsaved = before | seen.places, life.core.name

    def restored(self, life: Life, agent: Agent) -> None:
        """A host has found a coordinator on its own disk."""
        self._kept.add((life, (agent.id, agent.generation)))

    def _goes_on_from_disk(self, life: Life, start: Start) -> None:
        """It may not know any more of which calls it was told that they failed."""
        if (life, start) not in self._kept:
            return
        self._kept.discard((life, start))
        self._calls.goes_back(start[0])

    def may_run(self, life: Life, agent: Agent, kind: str) -> None:
        """A frozen coordinator may run again, with this exception: whoever it was sent to has it not."""
        self._goes_on_from_disk(life, (agent.id, agent.generation))
        self._held(life, agent)

    def _held(self, life: Life, agent: Agent) -> None:
        seen = self._starts.setdefault((agent.id, agent.generation), _Seen(self.fleet.now))
        self._goes_on(agent)
        seen.holders, seen.copy = {life}, agent
        seen.knew.add(life)
        seen.places, seen.unsaved = {life.core.name: life.host.scribe.memory}, ""
        if all(agent is not other for other in self._agents[life]):
            self._agents[life].append(agent)
        self._look(life)

    def _goes_on(self, agent: Agent) -> None:
        if is_recovery(agent.generation) and not agent.frozen:
            gone_on = self._gone_on[agent.id]
            self.seen["recoveries"] += agent.generation not in gone_on
            gone_on.setdefault(agent.generation, self.fleet.now)

    def sent(self, life: Life, header: Transfer, target: str, incarnation: int) -> None:
        """A coordinator was sent: whoever gets it may have it now."""
        receiver, seen = self._lives.get(incarnation), self._starts.get((header.agent, header.generation))
        self._goes_on_from_disk(life, (header.agent, header.generation))
        if seen is not None:
            seen.places[target] = header.receiver_memory
        if seen is not None and receiver is not None:
            seen.holders.add(receiver)

    def _remembers(self, name: str) -> bool:
        """Whether a host has always had one memory."""
        return self.fleet.keeps and name not in self.fleet.replaced

    def turned(self, life: Life) -> None:
        """The host stands still: who can run on it?"""
        if life in self._agents:
            self._look(life)

    def _look(self, life: Life) -> None:
        held = life.core.machine.agents
        here = [a for a in self._agents[life] if not a.ended and (not a.frozen or held.get(a.id) is a)]
        run = [agent for agent in here if not agent.frozen]
        if len({agent.id for agent in run}) < len(run):
            names = ", ".join(f"{agent.id} {agent.generation}" for agent in run)
            self._breach("I1", (life.core.name,), f"one host can run several starts: {names}")
        for agent in self._agents[life]:
            self._starts[agent.id, agent.generation].running.discard(life)
        for agent in run:
            self.orders.runs(life, agent)
            self._runs(life, (agent.id, agent.generation))
        self._agents[life] = here

    def _runs(self, life: Life, start: Start) -> None:
        running = self._starts[start].running
        running.add(life)
        if len(running) > 1:
            running -= {other for other in running if other.process.loop.dead}
        if len(running) > 1 and start not in self._void:
            hosts = tuple(sorted(other.core.name for other in running))
            self._breach("I1", hosts, f"{start[0]} of start {start[1]} can run on {len(hosts)} hosts")

    def said(self, life: Life, agent: Agent, text: str) -> None:
        """A program has written something."""
        for line in text.splitlines():
            if self._blocks.said(life, agent, line.split()) or " has thrown too: " in line:
                continue
            if self.reserved.said(life, agent, line.split()):
                continue
            self._calls.said(life, agent, line)

    def _home(self, member: int) -> str:
        team = self.fleet.mission.team
        return team.hosts[team.members[member].host]

    def _made_for(self, arguments: tuple[object, ...]) -> Start:
        agent, generation = self._calls.made_for(arguments)
        return (agent, generation) if agent else self.reserved.made_for(arguments)

    def _on_disk(self, name: str) -> list[Page] | None:
        return self.fleet.disks[name].pages() if self.fleet.keeps else None

    # --- what is seen: devices and logs -----------------------------------------------------------------

    def look(self) -> None:
        """Look at devices and logs; several times a second."""
        for name, hardware in self.fleet.hardware.items():
            self._devices.look(name, hardware, self.fleet.now)
            self.orders.look(self.fleet.mission, name, hardware)
        for at, host, text in self.fleet.log[self._told :]:
            self._line(at, host, text)
        self._told = len(self.fleet.log)
        self._doubts.look()
        if self.fleet.keeps:
            self._disks()
            self._terminated.look()

    def _disks(self) -> None:
        latest = [(agent, self._latest(agent)) for agent in self._newest if agent not in self._calls.over]
        going = [(agent, start) for agent, start in latest if not self.orders.is_given_up(agent, start)]
        kept = [(name, page) for name, disk in self.fleet.disks.items() for page in disk.pages()]
        for name, page in kept:
            self._is_saved(name, page)
        self._blocks.look(kept)
        barred = {(page.agent, page.generation) for _, page in kept if isinstance(page, Fence)}
        safe = [(a, s) for a, s in going if s and not any(a == b and s < g for b, g in barred)]
        identities = {name: disk.identity for name, disk in self.fleet.disks.items()}
        self._results.look(kept, identities, [start for start in safe if not self._doubtful(start)])
        pages = (page for _, page in kept)
        for agent, start in nowhere(pages, [(agent, start) for agent, start in going if start]):
            if not self._doubtful((agent, start)):
                self._breach("I5", (), f"no disk holds {agent} of start {start}, and it has not ended")

    def _is_saved(self, name: str, page: Page) -> None:
        """Whoever sent it need keep nothing any more, once it is on the disk where it has come to."""
        seen = self._starts.get((page.agent, page.generation)) if isinstance(page, CopyPage) else None
        if seen and seen.unsaved == name and isinstance(page, CopyPage) and page.state == "RUN":
            seen.places, seen.unsaved = {name: seen.places[name]}, ""

    def _latest(self, agent: str) -> int:
        """The latest start that has not given way to another, 0 if all have."""
        starts = (s for s, seen in self._starts.items() if s[0] == agent and not seen.gave_way)
        return max((generation for _, generation in starts), default=0)

    def _doubtful(self, start: Start) -> bool:
        """Whether a host that may have had it has lost its disk since: then nobody can know."""
        places = self._starts[start].places
        if any(self._is_gone(name, memory) for name, memory in places.items()):
            return True
        last = last_seen(start, (page for disk in self.fleet.disks.values() for page in disk.pages()))
        # Whether it was sent cannot be known.
        return last is not None and last.state == "PREPARED" and self._is_gone(last.target, last.memory)

    def _is_gone(self, name: str, memory: int) -> bool:
        wrecked = name in self.fleet.gone and not self.fleet.mission.fenced
        return wrecked or self.fleet.disks[name].identity != self._memories.get(memory, memory)

    def _line(self, at: float, host: str, text: str) -> None:
        if "bug in lfield" in text:
            self._breach("bug", (host,), text.strip())
        agent, lost, _ = text.partition(" is lost: ")
        if lost:
            old = [s for s, seen in self._starts.items() if s[0] == agent and at - seen.first > YOUNG]
            for start in old:
                running = {life for life in self._starts[start].running if not life.process.loop.dead}
                if running:
                    hosts = (host, *sorted(life.core.name for life in running))
                    self._breach("lost", hosts, f"{text.strip()}, while start {start[1]} lives")

    # --- after the weather ------------------------------------------------------------------------------

    def settled(self) -> None:
        """All has been well for so long that every host must be reached."""
        self._calls.settled = not self.fleet.gone

    def healed(self) -> None:
        """The weather is over: from now on everybody must get on."""
        self._calls.ended.clear()
        self._blocks.healed()
        self.reserved.healed()

    def waits_for(self) -> list[str]:
        """The coordinators that may go on, and have not done so enough."""
        return [agent for agent in self._homes if self._owed(agent)]

    @property
    def _homes(self) -> dict[str, str]:
        team = self.fleet.mission.team
        return {member.id: team.hosts[member.host] for member in team.coordinators}

    def _owed(self, agent: str) -> bool:
        ended = self._calls.ended[agent] + self._blocks.closed[agent] + self.reserved.closed[agent]
        given_up = self.orders.is_given_up(agent, self._newest.get(agent, 0))
        if agent in self._calls.over or ended >= ENOUGH or given_up:
            return False
        if agent in self.fleet.mission.fenced:
            return shadowed(agent, self.fleet.pages_left)
        if generation := self._latest(agent):
            start = agent, generation
            if self.fleet.gone and self._doubtful(start):
                return self.orders.acted and shadowed(agent, self.fleet.pages_left)
            if self.fleet.keeps:
                return not self._doubtful(start)
            return not any(life.process.loop.dead for life in self._starts[start].holders)
        name = self._homes[agent]
        # A new start waits for all others but those that a person says are gone.
        return name in self.fleet.lives and (self._remembers(name) or not self.fleet.left)

    def end(self) -> None:
        """Time is up: whoever has not got on is stuck."""
        for agent in self.waits_for():
            holders = [seen.holders for start, seen in self._starts.items() if start[0] == agent]
            hosts = {life.core.name for some in holders for life in some}
            lines = (text.strip() for _, _, text in self.fleet.log if agent in text)
            told = [
                f"; last was said: {text.splitlines()[0]}" for text in lines if "." not in text.split()[0]
            ]
            last = told[-1] if told else ""
            self._breach("stuck", tuple(sorted(hosts)), f"{agent} does not go on after the weather{last}")
        for name in sorted(self.fleet.failed):
            self._breach("host", (name,), "it has failed")
