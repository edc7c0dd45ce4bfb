"""Attribute queries of the host to its own resources: portals without parameters or side effects.

They have no caller in another block that would need persistence, restart notices or cancellation. Their
threads may command no device (`ServedCalls.of_thread` has no caller for them), even if the registry says so.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cached_property, partial

from lfield.manifest import DeviceValue
from lfield.vm import portal_calls
from lfield.vm.agent import Agent
from lfield.vm.engine_interface import Trap
from lfield.vm.inspection import traceback
from lfield.vm.memory.layout import W_CLASS, W_SELF
from lfield.vm.memory.threads import count
from lfield.vm.memory.word_codec import decode_value
from lfield.vm.scheduler import Scheduler

#: Called once with the value and '', or with None and the reason.
OnAnswer = Callable[[DeviceValue, str], None]


class ResourceQueries:
    """Runs the queries; pending ones are in `Scheduler.resource_queries`."""

    def __init__(self, scheduler: Scheduler) -> None:
        self._scheduler = scheduler

    def call_portal(self, resource: Agent, portal: str, on_answer: OnAnswer) -> None:
        """Start a portal of an `open` resource; `on_answer` gets its result, unless the resource dies."""
        method = self._query_portals.get((resource.block.w[W_CLASS], portal))
        if method is None:
            on_answer(
                None, f"{resource.member.type} has no portal {portal}() without parameters and side effects"
            )
        else:
            self._start(resource, method, on_answer)

    @cached_property
    def _query_portals(self) -> Mapping[tuple[int, str], int]:
        """The portals that can be queried, by class of the resource and name."""
        scheduler = self._scheduler
        return {
            (record.owner, record.name): method
            for method, record in enumerate(scheduler.program.core.methods)
            if record.kind == "portal" and not record.parameters and method not in scheduler.effectful_methods
        }

    def _start(self, resource: Agent, method: int, on_answer: OnAnswer) -> None:
        scheduler = self._scheduler
        if count(resource.block) >= resource.limits.threads:
            on_answer(None, f"{resource.id} already serves its limit of {resource.limits.threads} threads")
            return
        number = next(scheduler.call_numbers)

        def work() -> int:
            return scheduler.spawn(resource, method, [resource.block.w[W_SELF]], number)

        try:
            thread = scheduler.run_with_collection(resource, work)
        except Trap as trap:
            on_answer(None, f"{trap.kind}: {trap.message}")
            return
        scheduler.resource_queries[number] = partial(self._finish, resource, method, on_answer)
        portal_calls.serve(scheduler, resource, thread, method, scheduler.run_queue.push_back)

    def _finish(self, resource: Agent, method: int, on_answer: OnAnswer, word: int, thrown: int) -> None:
        block, program = resource.block, self._scheduler.program
        record = program.core.methods[method]
        if thrown:
            name, message, _ = traceback.describe(block, program, thrown)
            on_answer(None, f"{record.name}() throws {name}{': ' if message else ''}{message}")
        else:
            on_answer(decode_value(block, program, record.result, word), "")
