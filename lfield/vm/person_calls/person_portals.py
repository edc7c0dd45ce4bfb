"""Portal calls of persons in the resources of one host: arguments from values, results as values.

A call is a `PendingCall` whose caller is not an agent: cancellation, the end of its resource, events and
reservations treat it as a call of a `together`. Its end is reported by `HostInterface.on_call_completed`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property

from lfield.bytecode.program import REAL
from lfield.vm import portal_calls
from lfield.vm.agent import Agent
from lfield.vm.cancellation import Cancellation
from lfield.vm.engine_interface import Trap
from lfield.vm.memory.block import Block
from lfield.vm.memory.layout import W_CLASS, W_SELF
from lfield.vm.memory.serialised_results import WORD_SIZE
from lfield.vm.memory.threads import count
from lfield.vm.pending_call import PendingCall
from lfield.vm.person_calls.value_conversion import EncodedValue, Mismatch, thrown_parts, values_of
from lfield.vm.scheduler import Scheduler


class PortalMismatch(Exception):
    """No portal has this name, or no portal of this name accepts these arguments; `has_portal` distinguishes
    the two.
    """

    def __init__(self, message: str, *, has_portal: bool) -> None:
        super().__init__(message)
        self.has_portal = has_portal


class PersonPortals:
    """The running calls, in the order of their start."""

    def __init__(self, scheduler: Scheduler, cancelling: Cancellation) -> None:
        self._scheduler, self._cancellation = scheduler, cancelling
        self._running: dict[int, PendingCall] = {}

    @property
    def running(self) -> list[PendingCall]:
        """The calls that have started and not ended."""
        return list(self._running.values())

    def find(
        self, resource: Agent, portal: str, arguments: Sequence[object]
    ) -> tuple[int, Sequence[EncodedValue]]:
        """The portal (by index) for these arguments, and the arguments. Raises PortalMismatch.

        Of several matching portals, the one with the fewest integers for reals is selected.
        """
        named = self._portals.get((resource.block.w[W_CLASS], portal), ())
        fitting: list[tuple[int, int, list[EncodedValue]]] = []
        mistakes: list[str] = []
        for method in named:
            kinds = self._parameter_types(method)
            if len(kinds) != len(arguments):
                mistakes.append(f"its number of parameters is {len(kinds)}, not {len(arguments)}")
                continue
            try:
                encoded = [
                    EncodedValue(self._scheduler.program, kind, value)
                    for kind, value in zip(kinds, arguments, strict=True)
                ]
            except Mismatch as error:
                mistakes.append(str(error))
                continue
            types = self._scheduler.program.core.types
            widened = sum(
                types[kind].kind == REAL and type(value) is int
                for kind, value in zip(kinds, arguments, strict=True)
            )
            fitting.append((widened, method, encoded))
        if not named:
            raise PortalMismatch(f"{resource.member.type} has no portal {portal}()", has_portal=False)
        if not fitting:
            raise PortalMismatch("; ".join(mistakes), has_portal=True)
        _, method, words = min(fitting, key=lambda found: found[:2])
        return method, words

    def _parameter_types(self, method: int) -> tuple[int, ...]:
        record = self._scheduler.program.core.methods[method]
        return tuple(record.slots[1 : 1 + record.parameters])

    @cached_property
    def _portals(self) -> Mapping[tuple[int, str], list[int]]:
        """The portals by class of the resource and name."""
        found: dict[tuple[int, str], list[int]] = {}
        for method, record in enumerate(self._scheduler.program.core.methods):
            if record.kind == "portal":
                found.setdefault((record.owner, record.name), []).append(method)
        return found

    def start(
        self, call: PendingCall, resource: Agent, method: int, arguments: Sequence[EncodedValue]
    ) -> None:
        """Start a portal for a call; the portal runs at the next `run`. Raises Trap at a limit."""
        scheduler, limit = self._scheduler, resource.limits.threads
        if count(resource.block) >= limit:
            raise Trap("LimitException", f"{resource.id} already serves its limit of {limit} threads")
        number = next(scheduler.call_numbers)

        def thread() -> int:
            words = [argument.put(resource.block) for argument in arguments]
            return scheduler.spawn(resource, method, [resource.block.w[W_SELF], *words], number)

        served = scheduler.run_with_collection(resource, thread)
        call.call, call.method = number, method
        scheduler.calls[number] = self._running[number] = call
        if scheduler.hooks.observer is not None:
            scheduler.hooks.observer.on_call_started(resource, served, number, method, call.agent)
        if resource.open:
            portal_calls.serve(scheduler, resource, served, method, scheduler.run_queue.push_back)
        else:
            resource.waiting.append((resource, served))

    def on_completed(self, call: PendingCall) -> None:
        """The host has processed the end of a call."""
        self._running.pop(call.call, None)

    def cancel(self, call: PendingCall, reason: str) -> None:
        """Cancel a running call: its portal gets a CancelledException with this reason."""
        resource = self._scheduler.agents.get(call.resource)
        if call.state == "running" and resource is not None:
            self._cancellation.cancel_call(resource, call.call, reason)

    def fail_running(self, caller: str, kind: str, reason: str) -> None:
        """End the running calls of a caller at once with an exception, as `PendingCalls.fail_running`."""
        for call in self.running:
            if call.agent == caller:
                self._scheduler.calls.pop(call.call, None)
                message = f"{reason} ({call.resource}.{call.portal})"
                self._scheduler.fail_pending(call, kind, message, call.resource)

    def result(self, call: PendingCall) -> object:
        """The value that a call has returned."""
        program = self._scheduler.program
        kind = program.core.methods[call.method].result
        if len(call.result) == WORD_SIZE:
            word = int.from_bytes(call.result, "little", signed=True)
            return values_of(_EMPTY, program, [kind], [word])[0]
        block = _block(call.result)
        return values_of(block, program, [kind], [block.w[W_SELF]])[0]

    def exception(self, call: PendingCall) -> tuple[str, str]:
        """The class and the message of the exception that a call has thrown."""
        block = _block(call.result)
        return thrown_parts(block, self._scheduler.program, block.w[W_SELF])


def _block(image: bytes) -> Block:
    words = len(image) // 8
    return Block(bytearray(image), words, words)


#: The encoding of values of one word.
_EMPTY = Block(bytearray(8), 1, 1)
