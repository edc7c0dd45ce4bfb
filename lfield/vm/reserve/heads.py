"""`hold`, `take` and `drop`: a coordinator goes to what it reserves, and its host gives it the number there.

`take` is run again from its beginning wherever the coordinator comes to: all that it has is in the array. All
coordinators take in one order, so of two that want the same several none has what the other waits for.
"""

from __future__ import annotations

from collections.abc import Callable

from lfield.bytecode.program import ARRAY, INT, TypeRecord
from lfield.vm import portals
from lfield.vm.agent import Agent, Member
from lfield.vm.contract import Trap
from lfield.vm.limits import TimeLimits
from lfield.vm.memory import layout
from lfield.vm.memory.layout import CALLING, PROXY_MEMBER
from lfield.vm.reserve.held import Entry, Held
from lfield.vm.scheduler import Scheduler

Handler = Callable[[Agent, int, int, list[int]], None]


class Reserving:
    """The heads of `reserve`, for the coordinators of one host (`here`, a number)."""

    def __init__(self, scheduler: Scheduler, held: Held, here: int, limits: TimeLimits) -> None:
        self._scheduler, self._held, self._here, self._limits = scheduler, held, here, limits
        kinds = scheduler.program.core.types
        classes = scheduler.program.core.classes
        self._offers = frozenset(i for i, record in enumerate(classes) if record.capability)
        self._array = kinds.index(TypeRecord(ARRAY, INT)) if TypeRecord(ARRAY, INT) in kinds else 0

    def heads(self) -> dict[str, Handler]:
        """By name, what carries them out."""
        return {"hold": self._hold, "take": self._take, "drop": self._drop}

    # --- hold -----------------------------------------------------------------------------------------

    def _hold(self, agent: Agent, thread: int, operand: int, words: list[int]) -> None:
        """What there is to take: each resource once, however many offers lead to it."""
        try:
            resources = self._resources(agent, words[0])
        except Trap as trap:
            self._scheduler.refuse(agent, thread, trap.kind, trap.message)
            return

        def work() -> int:
            block = agent.block
            array = block.allocate(layout.ARRAY, self._array, 1 + 2 * len(resources))
            for place, resource in zip(range(array + 1, block.top, 2), resources, strict=True):
                block.w[place], block.w[place + 1] = resource.number, 0
            return array

        self._scheduler.complete(agent, thread, work)

    def _resources(self, agent: Agent, place: int) -> list[Member]:
        """The resources that a proxy, an offer or an array leads to, host by host; raises Trap for a null."""
        w = agent.block.w
        waiting, seen, found = [place], {place}, set()
        while waiting:
            place = waiting.pop()
            if w[place] & 0xFF == layout.PROXY:
                found.add(w[place + PROXY_MEMBER])
            inner = self._parts(w, place)
            waiting += [part for part in dict.fromkeys(inner) if part not in seen]
            seen.update(inner)
        return self._held.in_order(found)

    def _parts(self, w: memoryview[int], place: int) -> list[int]:
        """The elements of an array, none of them null; of an offer the ways by which it was found."""
        inner = [w[place + offset] for offset in self._scheduler.layouts.references(w[place])]
        if w[place] & 0xFF == layout.ARRAY and 0 in inner:
            raise Trap("NullException", f"'reserve' of null (element {inner.index(0)})")
        if w[place] & 0xFF != layout.OBJECT:
            return inner
        # What it says of itself comes first. What is no offer was made from its parts, which are here too.
        offer = w[place] >> 8 & 0xFFFFFF in self._offers
        return [part for part in inner[1:] if part] if offer else []

    # --- take -----------------------------------------------------------------------------------------

    def _take(self, agent: Agent, thread: int, operand: int, words: list[int]) -> None:
        self._scheduler.set_state(agent, thread, CALLING)
        while (wanted := self._held.wanted(agent)) is not None:
            if wanted.resource.host != self._here:
                agent.frozen = True
                self._limits.depart(agent, wanted.resource)
                return
            try:
                number = self._asked(agent, wanted)
            except Trap as trap:
                agent.frozen = False
                self._scheduler.refuse(agent, thread, trap.kind, trap.message, wanted.resource.id)
                return
            if not number:
                return
            agent.frozen = False
            self._note(agent, number)
        # What is on the disk of it stands before what it does from here on.
        agent.kept = False
        self._scheduler.go_on(agent, thread)

    def _asked(self, agent: Agent, wanted: Entry) -> int:
        """The number that this host gives, 0 for not yet: then it is frozen. Raises Trap."""
        portals.living(self._scheduler, wanted.resource)
        if why := self._barred(agent, wanted.resource):
            raise Trap("AccessException", why)
        agent.frozen = True
        return self._scheduler.world.take(agent, wanted.resource, nested=self._held.nested(agent))

    def _barred(self, agent: Agent, resource: Member) -> str:
        """Why a coordinator must not keep a resource from others: it may call nothing of it; '' if it may."""
        rules, methods = self._scheduler.attached.rules, self._scheduler.program.core.methods
        if rules is None:
            return ""
        owner = self._scheduler.program.class_index[resource.type]
        own = (n for n, method in enumerate(methods) if method.owner == owner and method.kind == "portal")
        refused = [rules(agent.id, resource.id, portal) for portal in own]
        if not (refused and all(refused)):
            return ""
        return f"{resource.id} is not reserved for whom it does not serve: {refused[0]}"

    def _note(self, agent: Agent, number: int) -> None:
        """Into the array, wherever it is now: the block may have been packed meanwhile."""
        entry = self._held.wanted(agent)
        assert entry is not None, "it was asked for"
        agent.block.w[entry.word] = number

    # --- drop -----------------------------------------------------------------------------------------

    def _drop(self, agent: Agent, thread: int, operand: int, words: list[int]) -> None:
        """Whatever has a number is given back."""
        entries = [entry for entry in self._held.entries(agent, words[0]) if entry.number]
        for entry in entries:
            agent.block.w[entry.word] = 0
        if entries:
            self._scheduler.world.drop(agent, [(entry.resource, entry.number) for entry in entries])
        self._scheduler.go_on(agent, thread)
