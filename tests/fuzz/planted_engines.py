"""Engines with one plausible fault each: the fuzzer must find every one."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from msgspec import structs

from lfield.bytecode.opcodes import BY_NAME
from lfield.bytecode.program import Core, Program, encode_quads
from lfield.vm.engine_interface import (
    AgentLimits,
    BudgetExhausted,
    EngineExit,
    HeapExhausted,
    HostCall,
    MonitorBlocked,
    Reading,
)
from lfield.vm.memory import layout
from lfield.vm.memory.block import Block
from lfield.vm.memory.layout import FRAME_CALLER, FRAME_RETURN, THREAD_FRAME
from lfield.vm.memory.word_codec import NAN_WORD
from lfield.vm.reference import ReferenceEngine


class WrongOpcode(ReferenceEngine):
    """Executes a subtraction as an addition."""

    def __init__(self, program: Program, now: Callable[[], float]) -> None:
        plus, minus = BY_NAME["addf"].code, BY_NAME["subf"].code
        quads = [quad._replace(op=minus) if quad.op == plus else quad for quad in program.quads]
        fields = [getattr(program.core, name) for name in Core.__struct_fields__[:-1]]
        super().__init__(Program(Core(*fields, encode_quads(quads)), program.debug, program.digest), now)


class _Changed(ReferenceEngine):
    """Changes the result at the end of each run."""

    def run(
        self,
        block: Block,
        thread: int,
        budget: int,
        limits: AgentLimits,
        readings: Sequence[Reading | None] = (),
        stops: object = None,
    ) -> EngineExit:
        leave = super().run(block, thread, budget, self.limits(limits), readings)
        return self.changed(leave, block, thread)

    def limits(self, limits: AgentLimits) -> AgentLimits:
        return limits

    def changed(self, leave: EngineExit, block: Block, thread: int) -> EngineExit:
        return leave


class WrongBudget(_Changed):
    """Does not charge for an instruction that fails for lack of memory."""

    def changed(self, leave: EngineExit, block: Block, thread: int) -> EngineExit:
        self.unused_budget += isinstance(leave, HeapExhausted)
        return leave


class WrongDepth(_Changed):
    """Permits one more nested call."""

    def limits(self, limits: AgentLimits) -> AgentLimits:
        return replace(limits, call_depth=limits.call_depth + 1)


class WrongFrame(_Changed):
    """Does not store the return address when a slice ends in a call."""

    def changed(self, leave: EngineExit, block: Block, thread: int) -> EngineExit:
        frame = block.w[thread + THREAD_FRAME]
        if isinstance(leave, BudgetExhausted) and block.w[frame + FRAME_CALLER]:
            block.w[frame + FRAME_RETURN] = 0
        return leave


class WrongNan(_Changed):
    """Uses a different NaN from the reference engine."""

    def changed(self, leave: EngineExit, block: Block, thread: int) -> EngineExit:
        for place in range(layout.HEADER_WORDS, block.top):
            if block.w[place] == NAN_WORD:
                block.w[place] |= -(1 << 63)
        return leave


class WrongMonitor(_Changed):
    """Counts a monitor that it did not enter."""

    def changed(self, leave: EngineExit, block: Block, thread: int) -> EngineExit:
        if isinstance(leave, MonitorBlocked):
            block.w[layout.W_ENTRIES] += 1
        return leave


class WrongTop(_Changed):
    """Leaves a word on the heap at a request to the machine."""

    def changed(self, leave: EngineExit, block: Block, thread: int) -> EngineExit:
        if isinstance(leave, HostCall) and len(leave.words) == 3:
            block.top += 1
        return leave


class Crashing(_Changed):
    """Crashes when the heap is full."""

    def changed(self, leave: EngineExit, block: Block, thread: int) -> EngineExit:
        if isinstance(leave, HeapExhausted):
            raise MemoryError("out of bounds memory access")
        return leave


class _WrongHead(_Changed):
    """Passes a wrong last argument in one kind of request to the machine."""

    head: str

    def changed(self, leave: EngineExit, block: Block, thread: int) -> EngineExit:
        if isinstance(leave, HostCall) and leave.op == BY_NAME[self.head].code:
            return structs.replace(leave, words=[*leave.words[:-1], leave.words[-1] + 1])
        return leave


class WrongCall(_WrongHead):
    """Passes a wrong argument at the start of a call in a `together`."""

    head = "begin"


class WrongStart(_WrongHead):
    """Passes a wrong argument when a `together` starts its calls."""

    head = "start"


class WrongFuture(_WrongHead):
    """Passes a wrong argument when the call of a future starts."""

    head = "launch"


class WrongWait(_WrongHead):
    """Passes a wrong argument when a thread reenters the monitor."""

    head = "wait_enter"


class WrongReservation(_WrongHead):
    """Passes a wrong argument at a reservation."""

    head = "take"


class WrongLimit(_WrongHead):
    """Passes a wrong argument at the start of a `within`."""

    head = "limit"


PLANTED = (
    WrongOpcode,
    WrongBudget,
    WrongDepth,
    WrongFrame,
    WrongNan,
    WrongMonitor,
    WrongTop,
    Crashing,
    WrongCall,
    WrongStart,
    WrongFuture,
    WrongWait,
    WrongReservation,
    WrongLimit,
)
