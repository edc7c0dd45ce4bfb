"""Portals that the host itself asks, for what a resource tells of itself: they take nothing and only query.

Nobody calls them from another block: there is no caller that could be kept, told of a restart, or cancelled.
A thread that serves one may command no device (`Machine.is_left`), whatever the registry says of its portal.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cached_property

from lfield.manifest import DeviceValue
from lfield.vm import portals
from lfield.vm.agent import Agent
from lfield.vm.contract import Trap
from lfield.vm.inspect import traceback
from lfield.vm.memory.layout import W_CLASS, W_SELF
from lfield.vm.memory.threads import count
from lfield.vm.memory.values import plain
from lfield.vm.scheduler import Scheduler

#: Told once: the value and '', or nothing and why there is none.
Told = Callable[[DeviceValue, str], None]


class Questions:
    """Asks them; `Scheduler.questions` has those under way."""

    def __init__(self, scheduler: Scheduler) -> None:
        self._scheduler = scheduler

    def ask(self, resource: Agent, portal: str, told: Told) -> None:
        """Begin a portal of one that is `open`; `told` hears its end, unless the resource dies."""
        method = self._askable.get((resource.block.w[W_CLASS], portal))
        if method is None:
            told(None, f"{resource.member.type} has no portal {portal}() that takes nothing and only queries")
        else:
            self._begin(resource, method, told)

    @cached_property
    def _askable(self) -> Mapping[tuple[int, str], int]:
        """The portals that can be asked, by the class of the resource and their names."""
        scheduler = self._scheduler
        return {
            (record.owner, record.name): method
            for method, record in enumerate(scheduler.program.core.methods)
            if record.kind == "portal" and not record.parameters and method not in scheduler.acting
        }

    def _begin(self, resource: Agent, method: int, told: Told) -> None:
        scheduler = self._scheduler
        if count(resource.block) >= resource.limits.threads:
            told(None, f"{resource.id} serves its limit of {resource.limits.threads} threads")
            return
        scheduler.last_call += 1
        number = scheduler.last_call

        def work() -> int:
            return scheduler.spawn(resource, method, [resource.block.w[W_SELF]], number)

        try:
            thread = scheduler.with_room(resource, work)
        except Trap as trap:
            told(None, f"{trap.kind}: {trap.message}")
            return
        scheduler.questions[number] = lambda word, thrown: self._end(resource, method, word, thrown, told)
        portals.serve(scheduler, resource, thread, method, scheduler.turns.last)

    def _end(self, resource: Agent, method: int, word: int, thrown: int, told: Told) -> None:
        block, program = resource.block, self._scheduler.program
        record = program.core.methods[method]
        if thrown:
            name, message, _ = traceback.describe(block, program, thrown)
            told(None, f"{record.name}() throws {name}{': ' if message else ''}{message}")
        else:
            told(plain(block, program, record.result, word), "")
