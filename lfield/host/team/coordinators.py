"""The coordinators of one host: what mobility decides about them is carried out in the machine.

What has to be on disk first waits for it: `keeping` holds back what comes after. On a host without a journal
nothing waits. Pure, as the core that it is a part of.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from functools import partial

from lfield.clock import Clock
from lfield.errors import BlockError
from lfield.host.effects import CHANGED, Complain, Effect, Keep, Say
from lfield.host.sight.hops import Hops
from lfield.host.team.absent import Absent
from lfield.host.team.keeping import Keeping, Recovery, asleep, explanation
from lfield.host.telling.answers import Answers
from lfield.journal.pages import BundlePage, Key, Page, Run, Starts
from lfield.mission.mission import Mission
from lfield.mobility import effects as mobile
from lfield.mobility.copies import Copy
from lfield.mobility.core import Mobility
from lfield.mobility.departures import LIMIT, PAUSED, PERHAPS, RESTARTED, UNREACHABLE
from lfield.vm.agent import Agent, Member
from lfield.vm.machine import Machine
from lfield.vm.memory import layout
from lfield.wire.coordinators import Accepted, Known, Outcome, Transfer
from lfield.wire.fields import clip
from lfield.wire.framing import Buffer
from lfield.wire.messages import Hello, Room


class Coordinators:
    """Those that are on a host, come or leave. `own` is its greeting, `pages` what its journal has kept.

    `times` says when each was, in Unix time. What is to be done outside is added to `effects`;
    `unreachable_after` is in seconds.
    """

    def __init__(
        self,
        mission: Mission,
        own: Hello,
        machine: Machine,
        clock: Clock,
        effects: Callable[[Effect], None],
        unreachable_after: float,
        pages: Iterable[Page],
        times: Mapping[Key, float],
        hops: Hops,
    ) -> None:
        self._mission, self._own, self._machine, self._clock, self._hops = mission, own, machine, clock, hops
        self._out, self._since = effects, partial(asleep, times, clock)
        self._members = {member.id: member for member in mission.team.coordinators}
        hosts, agents = mission.team.hosts, list(self._members)
        self.mobility = Mobility(
            own, peers=hosts, agents=agents, inject=self._inject, unreachable_after=unreachable_after
        )
        self.recovery = Recovery(pages, own.mission, mission.release.digest)
        self.keeping = Keeping([] if self.recovery.explained else [explanation(mission, own.mission)])
        self.mobility.restore(self.recovery.copies, self.recovery.parked)
        #: Somebody has paused the mission: time stands still for what waits here.
        self.paused = self.recovery.paused
        #: Why an emergency stop bars the devices here, '' when none does.
        self.stopped = self.recovery.stopped
        #: Why the disk should take nothing more in, '' when it may.
        self.full = ""
        #: Whether the number of a start is on record here.
        self._counted = self.recovery.starts is not None
        #: Why nothing can be kept now, '' while all is well.
        self.trouble = ""
        #: Those that wait at a portal call here until they are kept.
        self._saving: set[str] = set()
        #: Whether a start of a coordinator must not run any more.
        self.barred: Callable[[str, int], bool] = lambda agent, generation: False
        #: The starts that were told that what they stood at may have begun in an earlier life of this host.
        self.told: set[tuple[str, int]] = set()
        #: No coordinator is taken in any more.
        self.halted = False
        self._answers = Answers(effects, clock.monotonic)
        #: Coordinators that came before the resources here were started; None once they are.
        self._early: dict[tuple[str, int], tuple[str, Transfer, memoryview, float]] | None = {}
        #: For how many seconds the one that is taken in now was on its way, or waited here for that.
        self._transit = 0.0
        #: The block that was packed just now, to leave at once if there is a link.
        self._packed: memoryview | None = None
        #: When mobility may have something to give up. New deadlines are later, so one that is set stays.
        self._due: float | None = None

    # --- time -----------------------------------------------------------------------------------------

    @property
    def due(self) -> float | None:
        """When `tick` or `batch` has something to do next, None for never."""
        due = None if self.paused else self._due
        for other in (self._answers.due, self.keeping.due):
            due = other if due is None or (other is not None and other < due) else due
        return due

    def tick(self, now: float) -> None:
        """Time has passed."""
        self._answers.tick(now)
        if self._due is not None and now >= self._due and not self.paused:
            self.carry_out(self.mobility.tick(now))
            self._due = self.mobility.next_deadline()

    @property
    def room(self) -> Room:
        """Whether a coordinator may come here, as other hosts are told."""
        return Room(clip(PAUSED if self.paused else self.full))

    def batch(self) -> list[Keep]:
        """What is to be kept now."""
        found = self.keeping.take(self._clock.monotonic()) if self._own.memory else None
        return [Keep(*found)] if found else []

    def not_kept(self, why: str) -> None:
        """The disk takes nothing now: coordinators stay where they are, and begin no call that acts."""
        if not self.trouble:
            self.say(f"coordinators wait, since nothing can be kept: {why}")
        self.trouble = why
        for identity in sorted(self._saving & self._machine.agents.keys()):
            self._stays(self._machine.agents[identity])
        self._saving.clear()

    def kept(self, number: int) -> None:
        """All pages up to those of that batch are on the disk."""
        if self.trouble:
            self.say("what happens can be kept again")
        for effect in self.keeping.kept(number):
            self._effect(effect)
        # Only now: what has waited since must not be taken for what is on the disk.
        self.trouble = ""

    # --- coming and going -----------------------------------------------------------------------------

    def open(self) -> None:
        """The resources here are started: take in the coordinators that came meanwhile."""
        if self._mission.release.by:
            self.keep(BundlePage(self._mission.release.digest))
        early, self._early = self._early or {}, None
        for host, header, block, left in early.values():
            self.arrived(host, header, block, self._clock.monotonic() - left)

    def wake(self) -> None:
        """Go on with the coordinators that the journal has."""
        if self.paused:
            self.say("the mission is still paused: no agent runs here until 'lfield resume'")
        now = self._clock.monotonic()
        self.carry_out(self.mobility.wake(self._put, now))
        self._due = self.mobility.next_deadline()

    def count(self, generation: int) -> int:
        """Keep that a start has this number, in a run that goes on from here; the number of the batch."""
        now = self._clock.monotonic()
        self.keeping.page(Run(open=True), now)
        self._counted = True
        return self.keeping.page(Starts(generation), now)

    def remember(self) -> None:
        """Keep that there is a record here now, though no start may have been made."""
        if not self._counted:
            self.keep(Starts(0))

    def keep(self, page: Page) -> None:
        """Have a page on the disk as soon as can be; a host without a journal keeps none."""
        if self._own.memory:
            self.keeping.page(page, self._clock.monotonic())

    def park(self) -> None:
        """The host stops in order. Unless a coordinator of its own may go on, the next start is a new run.

        Not when it has opened no device: what tries again by itself must not begin a mission anew.
        """
        self.halted = True
        self._answers.flush()
        if not self._own.memory or self._early is not None:
            return
        here, known = self._mission.team.number(self._own.host), self.mobility.knowledge()
        own = {member.id for member in self._members.values() if member.host == here}
        going = any(row.agent in own and row.state != "EXITED" for row in known)
        self.keeping.page(Run(open=going), self._clock.monotonic())
        if self._mission.release.by and self.recovery.over(self._members, known):
            self.keep(BundlePage(b""))

    def arrived(self, host: str, header: Transfer, block: memoryview, transit: float = 0.0) -> None:
        """A coordinator came, after so many seconds: it runs before its sender gets an answer."""
        if self._early is not None:
            if header.agent in self._members:
                left = self._clock.monotonic() - transit
                self._early[header.agent, header.generation] = host, header, block, left
            return
        self._transit = transit
        self.carry_out(self.mobility.arrive(host, header, block))

    def greeting(self) -> list[Known]:
        """What others are told of all coordinators when they are greeted."""
        waiting = (header for _, header, *_ in (self._early or {}).values())
        return self.keeping.on_record(self.mobility.greeting(waiting), self._own.host)

    def recover(self, agent: str, generation: int) -> bool:
        """The holder of a coordinator is gone for good: it goes on here, as start `generation`, once that is
        on the disk. False: what is left of it here cannot be read, and nothing was done.
        """
        effects = self.mobility.recover(agent, generation, partial(self._put, runs=False))
        if effects:
            self.say(f"{agent} is recovered here, as start {generation}")
        self.carry_out(effects)
        return bool(effects)

    def depart(self, agent: Agent, resource: Member, absent: Absent | None) -> None:
        """A frozen coordinator wants to the host of a resource: linked, unless it may be `absent`. It waits
        for nobody who is lost, but for what it has begun there as long as ever: that may be there yet.
        """
        if self.trouble and self._stays(agent):
            return
        target, since = self._mission.team.hosts[resource.host], self._clock.monotonic()
        if absent is not None and not self._machine.fetches(agent):
            if why := absent.lost(target):
                self._resume(agent, UNREACHABLE, why)
                return
            since -= absent.away(target)
        self.carry_out(self.mobility.depart(agent.id, target, self._sealer(agent), since))
        self._packed = None
        if self._due is None:
            self._due = self.mobility.next_deadline()

    def save(self, agent: Agent) -> bool:
        """A coordinator calls a further portal here: whether it may go on at once, else when it is kept."""
        if not self._own.memory:
            return True
        if self._stays(agent):
            return False
        self._saving.add(agent.id)
        self.carry_out(self.mobility.save(agent.id, self._machine.pack(agent)))
        return False

    def is_leaving(self, agent: Agent) -> bool:
        """Whether a frozen coordinator wants to another host, or may be there."""
        return self.mobility.leaves(agent.id, agent.generation)

    def _stays(self, agent: Agent) -> bool:
        """Whether a call must not begin, since where it stands cannot be kept; its caller is told."""
        if self.trouble:
            self._resume(agent, LIMIT, f"{self._own.host} can keep nothing: {self.trouble}")
        return bool(self.trouble)

    def ended(self, agent: Agent) -> None:
        """A coordinator is done, or died."""
        outcome: Outcome = "done" if agent.ended == "done" else "died"
        self.carry_out(self.mobility.ended(agent.id, agent.generation, outcome, agent.report))

    def _sealer(self, agent: Agent) -> Callable[[int], Buffer]:
        image = self._packed = self._machine.pack(agent)

        def seal(sequence: int) -> Buffer:
            agent.block.w[layout.W_SEQUENCE] = sequence
            if self._packed is not image:  # It has waited since then, and its time limits go on.
                self._machine.note_clock(agent)
            return image

        return seal

    def _inject(self, header: Transfer, block: Buffer) -> mobile.Refusal | None:
        if self.halted:
            return mobile.Refusal(UNREACHABLE, f"{self._own.host} is stopping")
        if self.barred(header.agent, header.generation):
            why = f"on {self._own.host} no start of {header.agent} as early as this one may run any more"
            return mobile.Refusal(UNREACHABLE, why)
        member = self._members.get(header.agent)
        if member is None:
            return mobile.Refusal(UNREACHABLE, f"{self._own.host} knows no coordinator {header.agent}")
        try:
            limits = self._mission.bindings.limits(member.id)
            self._machine.admit(member, memoryview(block), limits, self._transit)
        except BlockError as error:
            self._out(Complain(f"refused {header.agent}: {error}"))
            return mobile.Refusal(UNREACHABLE, f"{self._own.host} refused the coordinator: {error}")
        return None

    def _put(self, copy: Copy, *, runs: bool) -> Callable[[int], Buffer] | None:
        """Have a coordinator that was kept in the machine again."""
        if copy.block is None:
            # It never came to a portal call that acts: nothing that it did was seen from outside.
            self._start(copy.agent, copy.generation)
            self.say(f"{copy.agent} begins again: {self._own.host} stopped before its first call that acts")
            # It is not asked for its block before it has come to a portal call.
            return lambda _: b""
        member = self._members[copy.agent]
        try:
            limits = self._mission.bindings.limits(member.id)
            agent = self._machine.restore(member, memoryview(copy.block), limits, self._since(copy))
        except BlockError as error:
            self.say(f"{copy.agent} cannot go on: what was kept of it cannot be read: {error}")
            return None
        # It may have been kept as it came, before its arrival was counted; or as it was recovered.
        recovered = agent.block.w[layout.W_GENERATION] != copy.generation
        agent.block.w[layout.W_HOPS], agent.block.w[layout.W_GENERATION] = copy.hops, copy.generation
        seal = self._sealer(agent)
        self._packed = None
        if runs:
            self.say(f"{copy.agent} goes on where it was kept")
        if runs and not recovered and self._machine.goes_on(agent):
            self._machine.go(agent)
        elif runs:
            self.told.add((agent.id, agent.generation))
            reason = f"{self._own.host} was started again; {PERHAPS}"
            self._resume(agent, RESTARTED, reason, recovered=recovered)
        return seal

    def _start(self, agent: str, generation: int) -> None:
        self._machine.start(self._members[agent], self._mission.bindings.limits(agent), generation)

    def carry_out(self, effects: Iterable[mobile.Effect]) -> None:
        """Do what need not wait, and keep the rest."""
        for effect in self.keeping.put(effects, self._clock.monotonic()) if self._own.memory else effects:
            self._effect(effect)

    def _effect(self, effect: mobile.Effect) -> None:
        match effect:
            # Those of every hop come first.
            case mobile.SendTransfer():
                self._answers.leaves(effect.host, effect.header)
                self._hops.left(effect.host, effect.header)
                self._out(effect)
            case mobile.Go():
                self._hops.goes(effect.agent, effect.generation)
                self._saving.discard(effect.agent)
                if agent := self._held(effect.agent, effect.generation):
                    agent.kept = True
                    self._machine.go(agent)
            case mobile.Send():
                if isinstance(effect.message, Accepted):
                    self._answers.put(effect, effect.message)
                else:
                    self._answers.flush(effect.host)
                    self._out(effect)
            case mobile.Departed():
                self._hops.departed(effect)
                if agent := self._held(effect.agent, effect.generation):
                    self._machine.release(agent)
            case mobile.Began():
                self._hops.tell(effect)
                self._start(effect.agent, effect.generation)
            case mobile.Resume():
                if agent := self._held(effect.agent, effect.generation):
                    agent.block.w[layout.W_SEQUENCE] = effect.sequence
                    self._resume(agent, effect.kind, effect.reason, recovered=effect.recovered)
            case mobile.InDoubt():
                self._hops.tell(effect)
                self.say(f"{effect.agent} is in doubt: {effect.reason}")
                self._out(CHANGED)
            case mobile.Supersede():
                self.say(f"{effect.agent} stopped: {effect.reason}")
                self._drop(effect)
            case mobile.Finished():
                self._drop(effect)
            case mobile.Note():
                self._out(Complain(effect.reason))

    def _resume(self, agent: Agent, kind: str, reason: str, *, recovered: bool = False) -> None:
        """Let a frozen coordinator go on with an exception, which names the resource that it has called."""
        self._hops.stays(agent, kind, reason, recovered=recovered)
        called = self._machine.calling(agent)
        if called and kind == RESTARTED:
            # Who has forgotten what it was about needs the portal too; there is none where it reserves.
            reason = f"{reason} ({'.'.join(filter(None, (called[0].id, called[1])))})"
        self._machine.resume(agent, kind, reason, called[0].id if called else "", recovered=recovered)

    def _held(self, identity: str, generation: int) -> Agent | None:
        """The frozen copy of a coordinator that is here, if it is of that start."""
        agent = self._machine.agents.get(identity)
        return agent if agent and agent.frozen and agent.generation == generation else None

    def _drop(self, effect: mobile.Supersede | mobile.Finished) -> None:
        self._hops.tell(effect)
        self._saving.discard(effect.agent)
        agent = self._machine.agents.get(effect.agent)
        if agent and agent.generation == effect.generation:
            agent.ended = agent.ended or "dropped"
            self._machine.release(agent)
        self._out(CHANGED)

    def say(self, text: str) -> None:
        """A line for the log."""
        self._out(Say(text))
