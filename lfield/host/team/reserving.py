"""Reservations of one host, between its machine, its journal and the other hosts (`reservations` decides).

What its own coordinators have is read off the blocks that they stand in (`Machine.held`), and renewed here
or by a message, as long as they are here or wait to leave. Pure.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Sequence

from lfield.capability.directory.news import Reserved
from lfield.clock import Clock
from lfield.host.effects import Effect
from lfield.host.team.coordinators import Coordinators
from lfield.host.team.leases import Leases
from lfield.host.team.reservations import (
    RESERVED,
    Held,
    Let,
    Refuse,
    Refused,
    Reservations,
    Start,
    Write,
)
from lfield.journal.pages import Page, ReservationPage
from lfield.mission.mission import Mission
from lfield.mobility.departures import LIMIT
from lfield.mobility.effects import Send
from lfield.vm.agent import Agent, Member
from lfield.vm.contract import Trap
from lfield.vm.machine import Machine
from lfield.wire.fields import clip
from lfield.wire.messages import Hello
from lfield.wire.reservations import Release, Renew, ReservationMessage


class Reserving:
    """The reservations of one host's resources, and what its coordinators have of those of others.

    `own` is its greeting, `pages` are those of its journal, `linked` says whether a host can be talked to.
    What is to be done outside is added to `effects`.
    """

    def __init__(
        self,
        mission: Mission,
        own: Hello,
        team: Coordinators,
        leases: Leases,
        machine: Machine,
        clock: Clock,
        effects: Callable[[Effect], None],
        linked: Callable[[str], bool],
        pages: Iterable[Page],
    ) -> None:
        self._own, self._hosts, self._keeps = own, mission.team.hosts, bool(own.memory)
        self._team, self._leases, self._machine = team, leases, machine
        self._clock, self._out, self._linked = clock, effects, linked
        self._here = mission.team.number(own.host)
        self._coordinators = [member.id for member in mission.team.coordinators]
        self._resources = {m.id for m in mission.team.on(self._here) if m.kind == "resource"}
        bindings = mission.bindings
        self._lease = bindings.reservations.lease
        first = own.incarnation % (1 << 30) << 20
        self._core = Reservations(first, self._lease, bindings.reserved_wait, self._busy)
        self._pages = [page for page in pages if isinstance(page, ReservationPage)]
        #: The coordinators that are frozen here for a resource.
        self._waiting: dict[Start, Agent] = {}
        #: The reservations whose pages are on their way to the disk, with the number of the batch.
        self._unwritten: deque[tuple[int, str, int]] = deque()
        #: When what each coordinator here has was renewed last.
        self._renewed: dict[str, tuple[Agent, float]] = {}
        #: Whether somebody was let go since the last look.
        self._moved = False
        self._used = machine.program.has_reserves

    def restore(self) -> None:
        """The resources are started: who had one when this host stopped has it for a lease yet."""
        now = self._clock.monotonic()
        for page in self._pages:
            holder = (page.agent, page.generation) if page.agent else None
            self._core.restore(page.resource, page.number, holder, now)
        self._carry_out()

    # --- the machine asks -----------------------------------------------------------------------------

    def take(self, agent: Agent, resource: Member, *, nested: bool) -> int:
        """See `World.take`."""
        found = self._machine.agents.get(resource.id)
        if found is None or found.ended:
            why = f"it died of {found.report.splitlines()[0]}" if found else "its host does not run it"
            raise Trap("UnreachableResourceException", f"{resource.id} is gone: {why}", resource.id)
        if self._team.trouble:
            reason = f"{self._own.host} can keep nothing: {self._team.trouble}"
            raise Trap(LIMIT, reason, resource.id)
        if not self._leases.may_begin(agent):
            # It waits for that first, or was barred and has stopped: it has no place in a queue.
            return 0
        start = agent.id, agent.generation
        self._waiting[start] = agent
        try:
            number = self._core.take(start, resource.id, self._clock.monotonic(), nested=nested)
        except Refused as refused:
            del self._waiting[start]
            raise Trap(refused.kind, str(refused), resource.id) from None
        finally:
            self._carry_out()
        if number:
            self._waiting.pop(start, None)
        return number

    def drop(self, agent: Agent, held: Sequence[tuple[Member, int]]) -> None:
        """See `World.drop`."""
        for resource, number in held:
            host = self._hosts[resource.host]
            if resource.host == self._here:
                self._core.release(resource.id, number, self._clock.monotonic())
            elif self._linked(host):
                self._out(Send(host, Release(resource.id, number)))
        self._carry_out()

    def serves(self, agent: Agent, resource: Member, number: int) -> bool:
        """See `World.serves`."""
        if not self._leases.may_begin(agent):
            return False
        start = agent.id, agent.generation
        nested = not number and bool(self._machine.held(agent))
        try:
            serves = self._core.serves(start, resource.id, number, self._clock.monotonic(), nested=nested)
        except Refused as refused:
            raise Trap(refused.kind, str(refused), resource.id) from None
        finally:
            self._carry_out()
        if not serves:
            self._waiting[start] = agent
        return serves

    def give_up(self, agent: Agent) -> bool:
        """Nobody wants to wait any longer for what a coordinator waits for; whether it did wait."""
        start = agent.id, agent.generation
        self._waiting.pop(start, None)
        waited = self._core.give_up(start, self._clock.monotonic())
        self._carry_out()
        return waited

    def waits(self, agent: Agent) -> str:
        """What a frozen coordinator waits for, in a few words; '' when it is for no resource."""
        start = agent.id, agent.generation
        resource = self._core.waits_for(start) if self._waiting.get(start) is agent else ""
        if not resource:
            return ""
        held = self._core.of(resource)
        return f"waits for {resource}" + (f", which {held.holder[0]} has reserved" if held else "")

    def _busy(self, resource: str, agent: str) -> bool:
        found = self._machine.agents.get(resource)
        return found is not None and self._machine.calls_of_others(found, agent)

    # --- events ---------------------------------------------------------------------------------------

    def received(self, message: ReservationMessage) -> None:
        """A host tells of the holder of a resource of this one."""
        now = self._clock.monotonic()
        if self._team.paused:
            # Whose renewals came late, as its host could not tell whether it has left, loses nothing.
            self._core.postpone(now)
        match message:
            case Renew() if message.resource in self._resources:
                start = message.agent, message.generation
                self._core.renew(start, message.resource, message.number, now)
            case Release() if message.resource in self._resources:
                self._core.release(message.resource, message.number, now)
        self._carry_out()

    def linked(self) -> None:
        """A host can be talked to: it may not have heard of holders for a while."""
        self._renewed.clear()

    @property
    def wanted(self) -> set[str]:
        """The hosts that must hear of holders here."""
        if not self._used:
            return set()
        held = (entry for agent in self._here_now() for entry in self._machine.held(agent))
        return {self._hosts[resource.host] for resource, _ in held}

    def kept(self, number: int) -> None:
        """All pages up to those of that batch are on the disk."""
        while self._unwritten and self._unwritten[0][0] <= number:
            _, resource, given = self._unwritten.popleft()
            self._core.written(resource, given, self._clock.monotonic())
        self._carry_out()

    def not_kept(self, why: str) -> None:
        """The disk takes nothing: who waits for its page is told that it has not got the resource."""
        for resource, start in self._core.unwritten:
            agent = self._waiting.get(start)
            self._core.give_up(start, self._clock.monotonic())
            if agent is not None and self._is_frozen(agent):
                reason = f"{self._own.host} can keep nothing: {why}"
                self._machine.resume(agent, LIMIT, reason, resource)
        self._carry_out()

    def postpone(self) -> None:
        """Time stood still here: whoever waits has all its time again."""
        self._core.postpone(self._clock.monotonic())

    # --- time -----------------------------------------------------------------------------------------

    @property
    def due(self) -> float | None:
        """When `look` has something to do next, None for never."""
        if not self._used or self._team.halted:
            return None
        dues = [when + self._lease / 3 for _, when in self._renewed.values()]
        due = None if self._team.paused else self._core.due
        return min([*dues, *([] if due is None else [due])], default=None)

    def look(self) -> bool:
        """Time has passed, or something has come: to be called in every turn. Whether anybody was let go."""
        if not self._used or self._team.halted:
            return False
        now = self._clock.monotonic()
        agents = self._machine.agents
        self._waiting = {start: one for start, one in self._waiting.items() if agents.get(one.id) is one}
        self._renew(now)
        for start in sorted(self._core.concerned):
            if why := self._leases.over(*start):
                self._core.over(start, why, now)
        if not self._team.paused:
            self._core.tick(now)
        self._carry_out()
        moved, self._moved = self._moved, False
        return moved

    def _here_now(self) -> list[Agent]:
        """The coordinators that are here as far as anybody knows; one in doubt may have gone on from here."""
        found = (self._machine.agents.get(name) for name in self._coordinators)
        return [agent for agent in found if agent is not None and not agent.ended and self._has(agent)]

    def _has(self, agent: Agent) -> bool:
        return not (agent.frozen and self._team.mobility.in_doubt(agent.id, agent.generation))

    def _renew(self, now: float) -> None:
        before, self._renewed = self._renewed, {}
        for agent in self._here_now():
            last, when = before.get(agent.id, (None, 0.0))
            if last is agent and now < when + self._lease / 3:
                self._renewed[agent.id] = agent, when
                continue
            self._renewed[agent.id] = agent, now
            for resource, number in self._machine.held(agent):
                self._renew_one(agent, resource, number, now)

    def _renew_one(self, agent: Agent, resource: Member, number: int, now: float) -> None:
        host = self._hosts[resource.host]
        if resource.host == self._here:
            self._core.renew((agent.id, agent.generation), resource.id, number, now)
        elif self._linked(host):
            self._out(Send(host, Renew(resource.id, number, agent.id, agent.generation)))

    # --- what others want to know ---------------------------------------------------------------------

    @property
    def held(self) -> list[Held]:
        """Who has which resource of this host."""
        return list(self._core.held.values())

    def by(self, resource: str) -> Reserved | None:
        """Who has a resource of this host, for the directory."""
        held = self._core.of(resource)
        return None if held is None else Reserved(held.holder[0], held.since)

    # --- inside ---------------------------------------------------------------------------------------

    def _carry_out(self) -> None:
        while effects := self._core.take_effects():
            for effect in effects:
                match effect:
                    case Write():
                        self._write(effect)
                    case Let():
                        self._let(effect.start)
                    case Refuse():
                        self._refuse(effect)
        for resource in self._core.known:
            if (found := self._machine.agents.get(resource)) is not None:
                found.reserved = self._core.concerns(resource)

    def _write(self, effect: Write) -> None:
        if self._keeps:
            agent, generation = effect.holder or ("", 0)
            page = ReservationPage(effect.resource, effect.number, agent, generation)
            batch = self._team.keeping.page(page, self._clock.monotonic(), soon=effect.soon)
            if effect.holder is not None:
                self._unwritten.append((batch, effect.resource, effect.number))
        elif effect.holder is not None:
            self._core.written(effect.resource, effect.number, self._clock.monotonic())

    def _let(self, start: Start) -> None:
        agent = self._waiting.pop(start, None)
        if agent is not None and self._is_frozen(agent):
            self._machine.go(agent)
            self._moved = True

    def _refuse(self, effect: Refuse) -> None:
        agent = self._waiting.pop(effect.start, None)
        if agent is not None and self._is_frozen(agent):
            self._machine.resume(agent, RESERVED, clip(effect.message), effect.resource)
            self._moved = True

    def _is_frozen(self, agent: Agent) -> bool:
        """Whether a coordinator still waits here; not who was told to go on, and wants away by now."""
        held = self._machine.agents.get(agent.id) is agent and agent.frozen and not agent.ended
        return held and not self._team.is_leaving(agent)
