"""`hold`, `take` and `drop`: a coordinator visits the hosts of its resources, which grant reservations.

`take` restarts on each host: all acquired numbers are in the array. The global order of acquisition prevents
deadlock between coordinators.
"""

from __future__ import annotations

from collections.abc import Callable

from lfield.bytecode.program import ARRAY, INT, TypeRecord
from lfield.vm import portal_calls
from lfield.vm.agent import Agent, TeamMember
from lfield.vm.deadlines import Deadlines
from lfield.vm.engine_interface import Trap
from lfield.vm.memory import layout
from lfield.vm.memory.layout import CALLING, PROXY_MEMBER
from lfield.vm.reservations.held_reservations import HeldReservations, ReservationEntry
from lfield.vm.scheduler import Scheduler

Handler = Callable[[Agent, int, int, list[int]], None]


class ReserveHandlers:
    """The instructions of `reserve`, for the coordinators of one host (`own_host`, a number)."""

    def __init__(
        self, scheduler: Scheduler, held: HeldReservations, own_host: int, limits: Deadlines
    ) -> None:
        self._scheduler, self._held_reservations = scheduler, held
        self._own_host, self._deadlines = own_host, limits
        kinds = scheduler.program.core.types
        classes = scheduler.program.core.classes
        self._offers = frozenset(i for i, record in enumerate(classes) if record.capability)
        self._array = kinds.index(TypeRecord(ARRAY, INT)) if TypeRecord(ARRAY, INT) in kinds else 0

    def handlers(self) -> dict[str, Handler]:
        """The handlers, by name."""
        return {"hold": self._on_hold, "take": self._on_acquire, "drop": self._on_drop}

    # --- hold -----------------------------------------------------------------------------------------

    def _on_hold(self, agent: Agent, thread: int, operand: int, words: list[int]) -> None:
        """The resources to acquire, without duplicates when several offers share one."""
        try:
            resources = self._resources(agent, words[0])
        except Trap as trap:
            self._scheduler.throw_builtin(agent, thread, trap.kind, trap.message)
            return

        def work() -> int:
            block = agent.block
            array = block.allocate(layout.ARRAY, self._array, 1 + 2 * len(resources))
            for place, resource in zip(range(array + 1, block.top, 2), resources, strict=True):
                block.w[place], block.w[place + 1] = resource.number, 0
            return array

        self._scheduler.complete(agent, thread, work)

    def _resources(self, agent: Agent, place: int) -> list[TeamMember]:
        """The resources of a proxy, an offer or an array, host by host. Raises Trap for a null."""
        w = agent.block.w
        waiting, visited, found = [place], {place}, set()
        while waiting:
            place = waiting.pop()
            if w[place] & 0xFF == layout.PROXY:
                found.add(w[place + PROXY_MEMBER])
            inner = self._parts(w, place)
            waiting += [part for part in dict.fromkeys(inner) if part not in visited]
            visited.update(inner)
        return self._held_reservations.in_order(found)

    def _parts(self, w: memoryview[int], place: int) -> list[int]:
        """The elements of an array, none of them null; for an offer, its realisations."""
        if w[place] & 0xFF in layout.ARRAYS_ON_HEAP:
            first, end = layout.elements(w, place)
            inner = list(w[first:end])
            if 0 in inner:
                raise Trap("NullException", f"'reserve' of null (element {inner.index(0)})")
            return inner
        inner = [w[place + offset] for offset in self._scheduler.layouts.references(w[place])]
        if w[place] & 0xFF != layout.OBJECT:
            return inner
        # The first field is the description. An object that is no offer was made from components, which are
        # fields too.
        offer = w[place] >> 8 & 0xFFFFFF in self._offers
        return [part for part in inner[1:] if part] if offer else []

    # --- take -----------------------------------------------------------------------------------------

    def _on_acquire(self, agent: Agent, thread: int, operand: int, words: list[int]) -> None:
        self._scheduler.set_state(agent, thread, CALLING)
        while (entry := self._held_reservations.next_ungranted(agent)) is not None:
            if entry.resource.host != self._own_host:
                agent.freeze()
                self._deadlines.depart(agent, entry.resource)
                return
            try:
                number = self._acquire(agent, entry)
            except Trap as trap:
                agent.resume()
                self._scheduler.throw_builtin(agent, thread, trap.kind, trap.message, entry.resource.id)
                return
            if not number:
                return
            agent.resume()
            self._store_number(agent, number)
        # The coordinator's state on disk is outdated from here on.
        agent.invalidate_image()
        self._scheduler.complete_at_once(agent, thread)

    def _acquire(self, agent: Agent, entry: ReservationEntry) -> int:
        """The number granted by this host; 0 if it is not granted yet, with the coordinator suspended. Raises
        Trap.
        """
        portal_calls.live_resource(self._scheduler, entry.resource)
        if reason := self._barred_reason(agent, entry.resource):
            raise Trap("AccessException", reason)
        agent.freeze()
        return self._scheduler.world.acquire_reservation(
            agent, entry.resource, nested=self._held_reservations.is_nested(agent)
        )

    def _barred_reason(self, agent: Agent, resource: TeamMember) -> str:
        """The reason why a coordinator that may call no portal of a resource may not reserve it; '' if it
        may.
        """
        rules, methods = self._scheduler.hooks.rules, self._scheduler.program.core.methods
        if rules is None:
            return ""
        owner = self._scheduler.program.class_index[resource.type]
        portals = (n for n, method in enumerate(methods) if method.owner == owner and method.kind == "portal")
        refused = [rules(agent.id, resource.id, portal) for portal in portals]
        if not (refused and all(refused)):
            return ""
        return f"{resource.id} cannot be reserved by a coordinator that may not call it: {refused[0]}"

    def _store_number(self, agent: Agent, number: int) -> None:
        """Store a number in the array, which a collection may have moved."""
        entry = self._held_reservations.next_ungranted(agent)
        assert entry is not None, "it was just acquired"
        agent.block.w[entry.word] = number

    # --- drop -----------------------------------------------------------------------------------------

    def _on_drop(self, agent: Agent, thread: int, operand: int, words: list[int]) -> None:
        """Release every granted resource."""
        entries = [entry for entry in self._held_reservations.entries(agent, words[0]) if entry.number]
        for entry in entries:
            agent.block.w[entry.word] = 0
        if entries:
            self._scheduler.world.release_reservations(
                agent, [(entry.resource, entry.number) for entry in entries]
            )
        self._scheduler.complete_at_once(agent, thread)
