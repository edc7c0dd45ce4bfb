"""Whether a run kept the promises, judged from what was seen of it (lfield/docs/decisions/0038).

I1  of one coordinator at most one copy can run, at any real time
I2  no transfer is injected twice
I3  no resource starts a portal for an older copy than the newest that it has served
I4  no portal call is started twice, and none is skipped without being told
I5  at every moment some disk holds a state to go on from (`saved.py`)

Beside them: no start has the number of an earlier one, nobody is called lost who lives, no device moves for
nobody or has two owners, no host fails, and whoever may go on after the weather does.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, field

from lfield.journal.pages import CopyPage
from lfield.mobility.departures import RESTARTED
from lfield.simulate.fleet import Fleet, Life
from lfield.simulate.saved import nowhere
from lfield.simulate.witness import tap
from lfield.vm.agent import Agent
from lfield.wire.messages import Transfer

#: A coordinator and one start of it.
Start = tuple[str, int]

#: A start that is younger than so many seconds may not be known yet to whoever says lost.
YOUNG = 3.0
#: So many seconds a device may move after its last command: an act, or a silence and the way to rest.
MOVES = 6.0
#: So many calls must come to an end after the weather.
ENOUGH = 3


@dataclass(frozen=True, slots=True)
class Breach:
    """A promise that was broken: its name, when in true time, on which hosts, and a sentence."""

    name: str
    at: float
    hosts: tuple[str, ...]
    sentence: str

    def __str__(self) -> str:
        return f"{self.name} at {self.at:.3f} s on {', '.join(self.hosts) or 'no host'}: {self.sentence}"


@dataclass(slots=True, eq=False)
class _Call:
    """What is known of one call: how often it began, and what its caller said of it."""

    begun: int = 0
    told: str = ""


@dataclass(slots=True, eq=False)
class _Seen:
    """One start of a coordinator: when it was first seen, who may have it, and who can run it."""

    first: float
    holders: set[Life] = field(default_factory=set)
    running: set[Life] = field(default_factory=set)
    #: The hosts that may have it, each with the memory that would tell; and the lives that it has drawn.
    places: dict[str, int] = field(default_factory=dict)
    lives: set[str] = field(default_factory=set)
    #: Its last copy that was in a machine.
    copy: Agent | None = None

    @property
    def gave_way(self) -> bool:
        """Whether another start of the coordinator goes on."""
        return self.copy is not None and self.copy.ended == "dropped"


class Judge:
    """Watches one team. `breaches` has what was found, each kind once.

    Where hosts have journals no coordinator may be lost, whoever dies.
    """

    def __init__(self) -> None:
        self.breaches: list[Breach] = []
        self.fleet: Fleet
        #: How much was seen: a judge who sees nothing finds nothing.
        self.seen = dict.fromkeys(("injections", "calls", "starts", "restarts"), 0)
        self._starts: dict[Start, _Seen] = {}
        self._newest: dict[str, int] = {}
        #: The starts whose number was given twice, by a host that had lost its disk.
        self._void: set[Start] = set()
        self._injected: set[tuple[str, int, int]] = set()
        self._agents: defaultdict[Life, list[Agent]] = defaultdict(list)
        self._lives: dict[int, Life] = {}
        self._calls: dict[str, dict[int, _Call]] = defaultdict(dict)
        self._served: dict[tuple[str, str], int] = {}
        self._ended: defaultdict[str, int] = defaultdict(int)
        self._over: set[str] = set()
        self._told = 0
        self._commands: dict[str, int] = {}
        self._actuated: set[tuple[object, ...]] = set()
        self._moves_since: dict[str, float] = {}

    def born(self, name: str, life: Life) -> None:
        """A host's process begins."""
        self._lives[life.core.incarnation] = life
        tap(life, self)

    def _breach(self, name: str, hosts: tuple[str, ...], sentence: str) -> None:
        if all(name != breach.name for breach in self.breaches):
            self.breaches.append(Breach(name, self.fleet.now, hosts, sentence))

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
        before = self._starts.get((agent.id, agent.generation))
        calls = [call for who in before.lives for call in self._calls[who].values()] if before else []
        if before and self.fleet.keeps and not any(call.begun for call in calls):
            return
        if self._remembers(life.core.name):
            found = f"{agent.id} was started as {agent.generation}, which is not above {newest}"
            self._breach("start", (life.core.name,), found)
        self._void.add((agent.id, agent.generation))

    def admitted(self, life: Life, agent: Agent, *, came: bool) -> None:
        """A coordinator was put into a machine."""
        transfer = agent.id, agent.generation, agent.sequence
        if came:
            self.seen["injections"] += 1
            if transfer in self._injected and transfer[:2] not in self._void:
                self._breach("I2", (life.core.name,), f"transfer {transfer} was injected twice")
            self._injected.add(transfer)
        self._held(life, agent)

    def _went_back(self, agent: Agent) -> None:
        """It goes on from a disk, and may not know any more of which calls it was told that they failed."""
        seen = self._starts.get((agent.id, agent.generation))
        for who in seen.lives if seen else ():
            for call in self._calls[who].values():
                if call.told == "failed":
                    call.told = "forgotten"

    def may_run(self, life: Life, agent: Agent, kind: str) -> None:
        """A frozen coordinator may run again, with this exception: whoever it was sent to has it not."""
        if kind == RESTARTED:
            self._went_back(agent)
        self._held(life, agent)

    def _held(self, life: Life, agent: Agent) -> None:
        seen = self._starts.setdefault((agent.id, agent.generation), _Seen(self.fleet.now))
        seen.holders, seen.copy = {life}, agent
        seen.places = {life.core.name: life.host.scribe.memory}
        if all(agent is not other for other in self._agents[life]):
            self._agents[life].append(agent)
        self._look(life)

    def sent(self, life: Life, header: Transfer, target: str, incarnation: int) -> None:
        """A coordinator was sent: whoever gets it may have it now."""
        receiver, seen = self._lives.get(incarnation), self._starts.get((header.agent, header.generation))
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

    # --- what is seen: calls ----------------------------------------------------------------------------

    def said(self, life: Life, agent: Agent, text: str) -> None:
        """A program has written something: a word, a life of a coordinator, the number of a call."""
        for line in text.splitlines():
            word, who, *more = line.split()
            if word == "over":
                self._over.add(who.partition(".")[0])
            elif word == "born":
                self._starts[agent.id, agent.generation].lives.add(who)
            elif word == "restarted":
                self._restarted(life.core.name, who, int(more[0]), " ".join(more))
            elif more:
                self._call(life.core.name, agent.id, word, who, int(more[0]))

    def _restarted(self, host: str, who: str, number: int, text: str) -> None:
        """A call that may have begun, or has not; what came after it had not begun, and is forgotten."""
        self.seen["restarts"] += 1
        calls = self._calls[who]
        later = sorted(n for n in calls if n > number)
        for begun in (n for n in later if calls[n].begun):
            found = f"{who} went back to call {number}, and call {begun} had begun"
            self._breach("I4", (host,), found)
        for n in later:
            del calls[n]
        self._call(host, "", "failed" if "has not begun" in text else "threw", who, number)

    def _call(self, host: str, by: str, word: str, who: str, number: int) -> None:
        call = self._calls[who].setdefault(number, _Call())
        if word == "begin":
            self._begin(host, by, who, number, call)
        elif word in ("done", "failed", "threw"):
            self._ended[who.partition(".")[0]] += 1
            call.told = word
            if word == "done" and call.begun != 1:
                self._breach(
                    "I4", (host,), f"call {number} of {who} is done, and it began {call.begun} times"
                )
            if word == "failed" and call.begun:
                self._breach("I4", (host,), f"call {number} of {who} could not be made, and it has begun")

    def _begin(self, host: str, resource: str, who: str, number: int, call: _Call) -> None:
        self.seen["calls"] += 1
        call.begun += 1
        if call.begun > 1:
            self._breach("I4", (host,), f"call {number} of {who} began again, on {resource}")
        if call.told == "failed":
            self._breach("I4", (host,), f"call {number} of {who} began after it could not be made")
        before = self._calls[who].get(number - 1)
        if number > 1 and (before is None or not before.told):
            self._breach("I4", (host,), f"call {number} of {who} began, and call {number - 1} has no end")
        newest = self._served.get((resource, who), 0)
        if number < newest:
            self._breach("I3", (host,), f"{resource} served call {number} of {who} after call {newest}")
        self._served[resource, who] = max(newest, number)

    # --- what is seen: devices and logs -----------------------------------------------------------------

    def look(self) -> None:
        """Look at devices and logs; several times a second."""
        for name in self.fleet.hardware:
            self._device(name)
        for at, host, text in self.fleet.log[self._told :]:
            self._line(at, host, text)
        self._told = len(self.fleet.log)
        if self.fleet.keeps:
            self._disks()

    def _disks(self) -> None:
        going = [(agent, self._goes_on(agent)) for agent in self._newest if agent not in self._over]
        pages = (page for disk in self.fleet.disks.values() for page in disk.pages())
        for agent, start in nowhere(pages, [(agent, start) for agent, start in going if start]):
            if not self._doubtful((agent, start)):
                self._breach("I5", (), f"no disk holds {agent} of start {start}, and it has not ended")

    def _goes_on(self, agent: str) -> int:
        """The latest start that has not given way to another, 0 if all have."""
        starts = (s for s, seen in self._starts.items() if s[0] == agent and not seen.gave_way)
        return max((generation for _, generation in starts), default=0)

    def _doubtful(self, start: Start) -> bool:
        """Whether a host that may have had it has lost its disk since: then nobody can know."""
        places = self._starts[start].places
        return any(self._is_gone(name, memory) for name, memory in places.items()) or self._waits(start)

    def _waits(self, start: Start) -> bool:
        """Whether a disk says that it went to a memory that is gone: whether it was sent cannot be known."""
        disks = self.fleet.disks.values()
        pages = [page for disk in disks for page in disk.pages() if isinstance(page, CopyPage)]
        here = [page for page in pages if (page.agent, page.generation) == start]
        sent = [page for page in here if page.state == "PREPARED"]
        runs = any(page.state == "RUN" for page in here)
        return not runs and any(self._is_gone(page.target, page.memory) for page in sent)

    def _is_gone(self, name: str, memory: int) -> bool:
        return self.fleet.disks[name].identity != memory

    def _device(self, name: str) -> None:
        hardware, now = self.fleet.hardware[name], self.fleet.now
        if len(hardware.owners) > 1:
            self._breach("device", (), f"{name} has {len(hardware.owners)} owners")
        for told in hardware.record[self._commands.get(name, 0) :]:
            self._moves_since[name] = told.at
            if told.what == "setVelocity" and told.arguments in self._actuated:
                self._breach("I4", (), f"{name} was commanded twice for call {told.arguments[:2]}")
            if told.what == "setVelocity":
                self._actuated.add(told.arguments)
        self._commands[name] = len(hardware.record)
        if not hardware.moving:
            self._moves_since[name] = now
        elif now - self._moves_since.get(name, now) > MOVES:
            self._breach("device", (), f"{name} moves, and nobody has commanded it for {MOVES:g} s")

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

    def healed(self) -> None:
        """The weather is over: from now on everybody must get on."""
        self._ended.clear()

    def waits_for(self) -> list[str]:
        """The coordinators that may go on, and have not done so enough."""
        return [agent for agent in self._homes if self._owed(agent)]

    @property
    def _homes(self) -> dict[str, str]:
        team = self.fleet.mission.team
        return {member.id: team.hosts[member.host] for member in team.coordinators}

    def _owed(self, agent: str) -> bool:
        if agent in self._over or self._ended[agent] >= ENOUGH:
            return False
        if generation := self._goes_on(agent):
            start = agent, generation
            if self.fleet.keeps:
                return not self._doubtful(start)
            return not any(life.process.loop.dead for life in self._starts[start].holders)
        name = self._homes[agent]
        # A home that has forgotten waits for all others, and one that has gone is not started again.
        waits = not self._remembers(name) and bool(self.fleet.left)
        return name in self.fleet.lives and not waits

    def end(self) -> None:
        """Time is up: whoever has not got on is stuck."""
        for agent in self.waits_for():
            hosts = {
                life.core.name for s, seen in self._starts.items() if s[0] == agent for life in seen.holders
            }
            told = [
                text.strip() for _, _, text in self.fleet.log if agent in text and "." not in text.split()[0]
            ]
            last = f"; last was said: {told[-1].splitlines()[0]}" if told else ""
            self._breach("stuck", tuple(sorted(hosts)), f"{agent} does not go on after the weather{last}")
        for name in sorted(self.fleet.failed):
            self._breach("host", (name,), "it has failed")
