"""What leases and fences mean for the coordinators of one host, and for the devices that they use. Pure.

Of the coordinators that run under leases (`Mission.fenced`) none begins a portal call while this host holds
no lease, and no device is actuated for one. When the lease ends, or a fence bars one that is here, the
devices that it has used here go into their safe states.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Iterable

from lfield.clock import Clock
from lfield.errors import DeviceError
from lfield.host.effects import Effect, MakeSafe, Say
from lfield.host.team.coordinators import Coordinators
from lfield.journal.pages import Fence, Page
from lfield.mission.mission import Mission
from lfield.mobility.copies import Copy
from lfield.mobility.departures import PERHAPS, RESTARTED
from lfield.mobility.effects import Finished, Persist, Send
from lfield.mobility.generations import next_recovery
from lfield.quorum import effects as quorum
from lfield.quorum.core import Quorum
from lfield.quorum.effects import Saved
from lfield.quorum.members import Members
from lfield.text.suggest import listed
from lfield.vm.agent import Agent
from lfield.vm.begun import Begun
from lfield.vm.machine import Machine
from lfield.vm.memory.layout import W_INTERVAL, W_SEQUENCE
from lfield.wire.coordinators import TERMINATED, Ended
from lfield.wire.fields import age
from lfield.wire.framing import Buffer
from lfield.wire.messages import Hello
from lfield.wire.quorum import Place, QuorumMessage

#: Who has called a portal: a coordinator that waits here for it, or a call that it has begun here.
Caller = Agent | Begun

#: Why a host lets no coordinator act.
ENDED = "the lease of {0} has ended: no majority of the team can be heard"
#: What a host may have promised that does not know it any more.
FORGOTTEN = (
    "no lease is given here before {0} {1} heard: the journal here is new, or has lost a promise; when a "
    "member is gone for good, start all hosts with a 'recovery: {{members: [...]}}' that leaves it out; "
    "--first-start says that this host has never run this deployment"
)
#: A host without a lease may not have heard of a termination, and what it recovers could not act.
UNHEARD = (
    "{0} runs under leases and {1} hears no majority of the members, which may know that it has ended: ask "
    "again when {1} does; when members are gone for good, start all hosts with a 'recovery: {{members: "
    "[...]}}' that leaves them out"
)
#: An older copy would do again what has been done since: that is for a person to say.
STUCK = (
    "{0} goes on nowhere by itself: the newest that is left of it is on {1}, and cannot be read; if whoever "
    "had it is gone for good, 'lfield recover {0}' goes on from an older copy, and 'lfield forget {0}' "
    "ends it"
)


class Leases:
    """The leases of one host. `pages` are those of its journal; without one there are no leases.

    What is to be done outside is added to `effects`.
    """

    def __init__(
        self,
        mission: Mission,
        own: Hello,
        team: Coordinators,
        machine: Machine,
        clock: Clock,
        effects: Callable[[Effect], None],
        pages: Iterable[Page],
        dice: random.Random,
    ) -> None:
        self._mission, self._own, self._team, self._machine = mission, own, team, machine
        self._clock, self._out = clock, effects
        #: The coordinators that run under leases.
        self.fenced = mission.fenced if own.memory else frozenset()
        self._kept = {page.agent: page.generation for page in pages if isinstance(page, Fence)}
        others = [host for host in mission.team.hosts if host != own.host]
        members = Members(mission.recovery.members, own.host, mission.recovery.lease)
        #: Whether nothing is on record here that was made in earlier lives.
        self._new = team.recovery.starts is None
        self.quorum = Quorum(
            members, others, self.fenced, own.incarnation, self, self._kept, dice, new=self._new
        )
        team.mobility.delay(lambda ended: self.quorum.is_delayed(ended, clock.monotonic()))
        self._safe = {device.name: device.safe_state for device in mission.devices_of(own.host)}
        #: The devices that were used here for coordinators that run under leases.
        self._used: dict[str, set[Caller]] = {}
        self._waiting: dict[str, Agent] = {}
        self._held = False
        #: The members of whom was said that they must be heard. All of a team may just be starting, so
        #: nothing is said before that time.
        self._missed: list[str] = []
        self._patient_until = math.inf

    # --- time -----------------------------------------------------------------------------------------

    def begin(self, *, first: bool) -> None:
        """The host is up. `first`: somebody says that it was never started before."""
        if self.fenced:
            self.quorum.begin(self._clock.monotonic(), first=first)
            if self._own.host in self._mission.recovery.members:
                self._patient_until = self._clock.monotonic() + self._mission.recovery.lease
        elif self._mission.fenced:
            self._out(Say(f"heartbeatInterval has no effect here: {self._own.host} keeps no journal"))

    def wake(self) -> None:
        """What was kept here is about to go on: not what is barred."""
        for agent, generation in self._kept.items():
            self._bar(agent, generation, "so its journal says")

    @property
    def due(self) -> float | None:
        """When `tick` has something to do next."""
        due = self.quorum.due
        return min(due, self.quorum.lease.until) if due is not None and self._held else due

    def tick(self, now: float) -> bool:
        """Time has passed, or something has come; whether the lease was gained by it."""
        if not self.fenced:
            return False
        self._carry_out(self.quorum.tick(now))
        if self._new and self.quorum.remembers:
            # In its next life it need not hear everybody again.
            self._new = False
            self._team.remember()
        if now >= self._patient_until:
            self._tell_missing()
        held, self._held = self._held, self.quorum.lease.holds(now)
        if held and not self._held:
            self._lost()
        elif self._held and not held:
            self._gained()
        return self._held and not held

    def _tell_missing(self) -> None:
        """Who must be heard before this host counts, whenever that has changed."""
        missing = self.quorum.unheard
        if missing and missing != self._missed:
            self._out(Say(FORGOTTEN.format(listed(missing), "was" if len(missing) == 1 else "were")))
        self._missed = missing

    def _gained(self) -> None:
        """Those that stand at a portal call may begin it; not who was told to go on and wants away by now."""
        waiting, self._waiting = self._waiting, {}
        for name, agent in sorted(waiting.items()):
            if self._machine.agents.get(name) is agent and not self._team.is_leaving(agent):
                self._machine.go(agent)

    def _lost(self) -> None:
        """Calls that run under the lease fail, and what they have used goes safe."""
        reason = ENDED.format(self._own.host)
        here = {caller for caller in self._callers() if caller.id in self.fenced}
        used = {device: users & here for device, users in self._used.items()}
        if here:
            self._out(Say(reason))
        for name in sorted({caller.id for caller in here}):
            abandon(self._machine, name, f"{reason}; {PERHAPS}")
        for device, users in used.items():
            if users:
                names = tuple(sorted({caller.id for caller in users}))
                why = f"{reason}; it was used for {', '.join(names)}"
                self._out(MakeSafe(device, self._safe[device], why, names))
        self._used.clear()

    def _callers(self) -> list[Caller]:
        """The agents that are here, and the calls that run here for those that may be elsewhere."""
        running = (begun for begun in self._machine.begun_calls() if begun.state == "running")
        return [*self._machine.agents.values(), *running]

    @property
    def wanted(self) -> set[str]:
        """The hosts that links are needed with."""
        return self.quorum.wanted if self.fenced else set()

    # --- what coordinators may do ---------------------------------------------------------------------

    @property
    def waits(self) -> bool:
        """Whether coordinators of this host are not begun before it has a lease."""
        return bool(self.fenced) and not self.quorum.lease.holds(self._clock.monotonic())

    def want(self) -> None:
        """A coordinator of this host waits to begin until there is a lease."""
        self.quorum.hurry(self._clock.monotonic())

    @property
    def left(self) -> float | None:
        """For how many seconds yet the lease holds, None where nothing needs one."""
        if not self.fenced:
            return None
        return age(self.quorum.lease.until - self._clock.monotonic())

    def is_waiting(self, agent: Agent) -> bool:
        """Whether a coordinator stands at a portal call until there is a lease."""
        return self._waiting.get(agent.id) is agent

    def may_begin(self, agent: Agent) -> bool:
        """Whether a coordinator may begin a portal call now; else it is told when it may, or has stopped."""
        if agent.id not in self.fenced:
            return True
        now = self._clock.monotonic()
        if self.quorum.may_act(agent.id, agent.generation, now):
            return True
        if self.quorum.barred(agent.id, agent.generation):
            self._bar(agent.id, self.quorum.fences.of(agent.id), "it came back after that")
        else:
            self._waiting[agent.id] = agent
            self.quorum.hurry(now)
        return False

    def give_up(self, agent: Agent) -> bool:
        """Nobody wants to wait any longer for the lease that a coordinator needs; whether it did wait."""
        if waits := self.is_waiting(agent):
            del self._waiting[agent.id]
        return waits

    def barred(self, agent: str, generation: int) -> bool:
        """Whether a start of a coordinator is taken in no more."""
        return self.quorum.barred(agent, generation)

    def over(self, agent: str, generation: int) -> str:
        """Why a start acts nowhere any more, as far as is known here; '' when it may."""
        if self.barred(agent, generation):
            return f"no start of {agent} as early as this one may run any more"
        return self._team.mobility.over(agent, generation)

    def why_not_recovered(self, agent: str, generation: int) -> str:
        """Why an operator may not recover a coordinator here from its start `generation`; '' if they may."""
        ended = self._team.mobility.termination(agent)
        if agent in self.fenced and (known := self.quorum.terminations.covers(agent, generation)):
            return f"{agent} has ended on {known.host} ({known.outcome}): there is nothing to go on with"
        if ended is not None:
            return f"{agent} has ended on {ended.ended_on} ({ended.outcome}): there is nothing to go on with"
        if agent in self.fenced and self.waits:
            return UNHEARD.format(agent, self._own.host)
        return ""

    def until(self, caller: Caller, device: str) -> float:
        """Until when a device may be actuated for a coordinator, in seconds of this host's clock.

        Raises DeviceError when the time is over.
        """
        if caller.id not in self.fenced:
            return math.inf
        now = self._clock.monotonic()
        if caller.ended or not self.quorum.may_act(caller.id, caller.generation, now):
            raise DeviceError(device.rpartition(".")[2], ENDED.format(self._own.host))
        self._used.setdefault(device, set()).add(caller)
        return self.quorum.lease.until

    # --- messages -------------------------------------------------------------------------------------

    def received(self, host: str, message: QuorumMessage) -> None:
        """A host asks, answers or tells that it lives."""
        self._carry_out(self.quorum.receive(host, message, self._clock.monotonic()))

    def _carry_out(self, effects: Iterable[quorum.Effect]) -> None:
        for effect in effects:
            match effect:
                case quorum.Tell():
                    self._team.carry_out([Send(effect.host, effect.message)])
                case quorum.Bar():
                    self._bar(effect.agent, effect.generation, effect.reason)
                    page = Fence(effect.agent, effect.generation)
                    self._team.carry_out([Persist(effect.agent, page)])
                case quorum.TakeOver() if self._team.mobility.recoverable(effect.agent):
                    self._out(Say(effect.reason))
                    if not self._team.recover(effect.agent, effect.generation):
                        self._out(Say(STUCK.format(effect.agent, self._own.host)))
                case quorum.Terminate():
                    self._terminated(effect.ended)
                case quorum.Explain():
                    self._out(Say(effect.text))

    def _terminated(self, ended: Ended) -> None:
        """Another host says that a coordinator has terminated."""
        effects = self._team.mobility.terminated(ended)
        if any(isinstance(effect, Finished) for effect in effects):
            self._out(Say(f"{ended.agent} has ended on {ended.host} ({ended.outcome})"))
        self._team.carry_out(effects)

    def _bar(self, name: str, generation: int, reason: str) -> None:
        """No start before this may run: what is here stops, and its devices go safe."""
        barred = {c for c in self._callers() if c.id == name and c.generation < generation}
        self._team.carry_out(self._team.mobility.bar(name, generation, reason))
        if any(self._waiting.get(name) is caller for caller in barred):
            del self._waiting[name]
        for device, users in self._used.items():
            if users & barred:
                users -= barred
                why = f"{name}, which has used it, is barred: {reason}"
                self._out(MakeSafe(device, self._safe[device], why, (name,)))

    # --- Copies of the quorum -------------------------------------------------------------------------

    def saved(self, agent: str) -> Saved | None:
        """The newest that is here of a coordinator, or its termination."""
        copy = self._team.mobility.newest(agent)
        if copy is None:
            return self._saved_end(agent)
        if copy.is_here:
            return Saved(Place(copy.generation, copy.sequence, left=False), alive=True, interval=0.0)
        block, left = copy.block, copy.state != "RUN"
        if copy.unreadable:
            # Nobody goes on with it, nor with what is older.
            return Saved(Place(copy.generation, copy.sequence, left), alive=False, interval=0.0)
        sequence = _word(block, W_SEQUENCE) if block is not None else 0
        interval = _word(block, W_INTERVAL) / 1000.0 if block is not None else 0.0
        return Saved(Place(copy.generation, sequence, left), alive=False, interval=interval)

    def _saved_end(self, agent: str) -> Saved | None:
        """The termination of a coordinator of which nothing else is here. It is final once a majority of the
        members has it on disk, as they confirm to the host where it ended. Until it is on disk there, the
        coordinator counts as one that runs.
        """
        copy = self._team.mobility.termination(agent)
        if copy is None or not copy.outcome:
            return None
        if not self._is_on_disk(copy):
            return Saved(Place(copy.generation, copy.sequence, left=False), alive=True, interval=0.0)
        ended = Ended(agent, copy.generation, copy.outcome, copy.detail, copy.ended_on)
        final = copy.ended_on != self._own.host or copy.outcome == "lost" or self._is_final(copy)
        return Saved(Place(copy.generation, copy.sequence, left=False), False, 0.0, ended, final)

    def _is_on_disk(self, ended: Copy) -> bool:
        [told] = self._team.keeping.on_record([ended.known()], self._own.host)
        return told.state == "EXITED"

    def _is_final(self, ended: Copy) -> bool:
        """Whether a majority of the members has on disk that a coordinator has terminated here."""
        waiting = self._team.mobility.unconfirmed_by(ended.agent, ended.generation)
        members = self.quorum.members
        return self._is_on_disk(ended) and members.is_majority(members.names.difference(waiting))

    @property
    def unsettled(self) -> list[str]:
        """The coordinators that have terminated here, not finally yet, and are not barred."""
        found = (self._team.mobility.termination(agent) for agent in sorted(self.fenced))
        return [
            copy.agent
            for copy in found
            if copy is not None
            and copy.ended_on == self._own.host
            and copy.outcome in TERMINATED
            and not self.barred(copy.agent, copy.generation)
            and not self._is_final(copy)
        ]

    def mint(self, agent: str, above: int) -> int:
        """A generation that no other host makes, greater than all that are known."""
        known = (k.generation for k in self._team.mobility.knowledge() if k.agent == agent)
        return next_recovery(max([above, *known]), self._mission.team.number(self._own.host))


def abandon(machine: Machine, coordinator: str, reason: str) -> None:
    """What a coordinator has called on this host, and has begun here, has ended for it: it may have begun."""
    if agent := machine.agents.get(coordinator):
        machine.abandon(agent, RESTARTED, reason)
    machine.end_begun(coordinator, RESTARTED, reason)


def _word(block: Buffer, index: int) -> int:
    """A word of a block's header."""
    return int.from_bytes(bytes(block[8 * index : 8 * index + 8]), "little")
