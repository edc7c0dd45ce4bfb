"""Control-flow graph of a method: basic blocks and their ends.

A block also ends after each call and each engine exit: the next instruction is a *point* where the method
can be resumed, with its slots from the block.
"""

from __future__ import annotations

from collections.abc import Callable

from msgspec import Struct, field

from lfield.bytecode.opcodes import BY_CODE, Opcode
from lfield.bytecode.program import CATCH, FINALLY, MethodRecord, Quad
from lfield.vm.reference.step_compiler import PreparedProgram
from lfield.vm.wasm.lowering.instruction_table import CONTROL
from lfield.vm.wasm.stack_depth import STRETCH

#: A method is long if its instructions times slots (with those of the engine) exceed this.
LONG_METHOD = 10_000


class LoweredInstruction(Struct, frozen=True):
    """An instruction that counts as one in the budget: a quad, or a group with its operands.

    `into` is the slot of its result, -1 for none.
    """

    pc: int
    after: int
    row: Opcode
    quad: Quad
    arguments: tuple[int, ...] = ()
    into: int = -1


class JumpExit(Struct, frozen=True):
    """Continues at the block `target`."""

    target: int


class BranchExit(Struct, frozen=True):
    """Continues at `yes` if the boolean in a slot is true, else at `no`."""

    slot: int
    yes: int
    no: int


class CallExit(Struct, frozen=True):
    """Calls a method, then continues."""

    instruction: LoweredInstruction
    target: int


class ReturnExit(Struct, frozen=True):
    """Leaves the method."""

    instruction: LoweredInstruction


class ThrowExit(Struct, frozen=True):
    """Throws the object in a slot."""

    instruction: LoweredInstruction


class EngineCallExit(Struct, frozen=True):
    """Exits the engine for an instruction that it does not support; continues at `target` later."""

    instruction: LoweredInstruction
    target: int | None


BlockExit = JumpExit | BranchExit | CallExit | ReturnExit | ThrowExit | EngineCallExit


class BasicBlock(Struct):
    """Consecutive instructions from `pc` on, and their end."""

    pc: int
    work: list[LoweredInstruction] = field(default_factory=list)
    end: BlockExit | None = None

    @property
    def cost(self) -> int:
        """The number of instructions charged; an instruction that exits is charged by the engine that
        executes it.
        """
        return len(self.work) + (
            isinstance(self.end, (BranchExit, CallExit, ReturnExit, ThrowExit)) or self._jumps
        )

    @property
    def last(self) -> tuple[int, int]:
        """The instruction that ends the block, and the next one; they are equal if the block only falls
        through.
        """
        if isinstance(self.end, (CallExit, ReturnExit, ThrowExit, EngineCallExit)):
            return self.end.instruction.pc, self.end.instruction.after
        pc = self.work[-1].after if self.work else self.pc
        return pc, pc + (not self.falls)

    @property
    def _jumps(self) -> bool:
        return isinstance(self.end, JumpExit) and not self.falls

    #: Whether the block only falls through, without a charged instruction.
    falls: bool = False


class ControlFlowGraph:
    """The blocks of one method by their first instruction, and its points.

    `lowered` says whether the engine executes an instruction itself.
    """

    def __init__(
        self, prepared: PreparedProgram, method: MethodRecord, lowered: Callable[[LoweredInstruction], bool]
    ) -> None:
        self.method = method
        self._prepared, self._lowered = prepared, lowered
        self._quads = prepared.program.quads
        self.entry = method.entry if method.synchronized else method.entry + 1
        self.instructions = {i.pc: i for i in self._decoded()}
        self.long = len(self.instructions) * (8 + len(method.slots)) > LONG_METHOD
        self.points = {self.entry}
        self.points.update(h.target for h in method.handlers if h.kind in (CATCH, FINALLY))
        #: Targets of the handlers around an instruction.
        self._handler_targets: dict[int, list[int]] = {}
        for handler in method.handlers:
            if handler.kind in (CATCH, FINALLY):
                for pc in range(handler.start, handler.end):
                    self._handler_targets.setdefault(pc, []).append(handler.target)
        heads = self._heads()
        self.blocks: dict[int, BasicBlock] = {}
        for pc in sorted(heads):
            self.blocks[pc] = self._block(pc, heads)

    def _decoded(self) -> list[LoweredInstruction]:
        instructions = []
        pc = self.method.entry
        while pc < self.method.end:
            group = self._prepared.groups.get(pc)
            quad = self._quads[pc]
            if group is None:
                instructions.append(LoweredInstruction(pc, pc + 1, BY_CODE[quad.op], quad))
            else:
                row = BY_CODE[group.head.op]
                result_fetch = group.after - (group.destination >= 0)
                pushed = tuple(push.a for push in self._quads[pc : result_fetch - 1])
                instructions.append(
                    LoweredInstruction(pc, group.after, row, group.head, pushed, group.destination)
                )
            pc = instructions[-1].after
        return instructions

    def _heads(self) -> set[int]:
        """Starts of blocks; records the points after calls and exits."""
        heads = set(self.points)
        for i in self.instructions.values():
            ends = CONTROL.get(i.row.name)
            if ends in ("JumpExit", "BranchExit"):
                heads.update((i.quad.a, i.after))
                if i.quad.a <= i.pc:
                    self.points.add(i.quad.a)
            elif ends == "CallExit" or not (ends or self._lowered(i)):
                heads.add(i.after)
                self.points.add(i.after)
        heads |= self._stretched()
        return {pc for pc in heads if pc in self.instructions}

    def _stretched(self) -> set[int]:
        """Additional points, which cut long chains of values: these would need too much time and stack in the
        compiler.
        """
        since: dict[int, int] = {}
        for pc, i in self.instructions.items():
            if since.get(pc, 0) >= STRETCH:
                self.points.add(pc)
            passed = 1 if pc in self.points else since.get(pc, 0) + 1
            ends = CONTROL.get(i.row.name)
            targets = [i.quad.a] if ends in ("JumpExit", "BranchExit") else []
            for target in targets if ends == "JumpExit" else [*targets, i.after]:
                since[target] = max(since.get(target, 0), passed)
        return self.points

    def _block(self, pc: int, heads: set[int]) -> BasicBlock:
        run = BasicBlock(pc)
        while run.end is None:
            i = self.instructions[pc]
            run.end = self._end(i)
            if run.end is None:
                run.work.append(i)
                pc = i.after
                if pc in heads:
                    run.end, run.falls = JumpExit(pc), True
        return run

    def _end(self, i: LoweredInstruction) -> BlockExit | None:
        """The end of a block by an instruction; None if the instruction does not end its block."""
        match CONTROL.get(i.row.name):
            case "JumpExit":
                return JumpExit(i.quad.a)
            case "BranchExit":
                targets = (i.quad.a, i.after) if i.row.name == "bnz" else (i.after, i.quad.a)
                return BranchExit(i.quad.b, *targets)
            case "CallExit":
                return CallExit(i, i.after)
            case "ReturnExit":
                return ReturnExit(i)
            case "ThrowExit":
                return ThrowExit(i)
        if self._lowered(i):
            return None
        return EngineCallExit(i, i.after if i.after in self.instructions else None)

    def leads_to(self, pc: int) -> list[int]:
        """Successors of a block: normal, by exceptions, and when resumed."""
        run = self.blocks[pc]
        successors: list[int] = []
        match run.end:
            case JumpExit(successor) | CallExit(_, successor):
                successors.append(successor)
            case BranchExit(_, yes, no):
                successors += [yes, no]
            case EngineCallExit(_, successor) if successor is not None:
                successors.append(successor)
        inside = [
            *run.work,
            *([run.end.instruction] if isinstance(run.end, (CallExit, ThrowExit, EngineCallExit)) else []),
        ]
        handlers = dict.fromkeys(target for i in inside for target in self._handler_targets.get(i.pc, ()))
        return [*successors, *handlers]
