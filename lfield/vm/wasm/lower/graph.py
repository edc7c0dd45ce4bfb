"""The control flow of a method: runs of instructions that are done one after another, and how one ends.

A run also ends behind each call and where an instruction leaves the engine: what is behind is a *point*
where the method can be resumed, with its slots from the block.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from lfield.bytecode.opcodes import BY_CODE, Opcode
from lfield.bytecode.program import CATCH, FINALLY, MethodRecord, Quad
from lfield.vm.reference.prepare import Prepared
from lfield.vm.wasm.lower.table import CONTROL
from lfield.vm.wasm.stack import STRETCH

#: A method is long whose instructions times slots, with some of our own, are more.
LONG = 10_000


@dataclass(frozen=True, slots=True)
class Instruction:
    """What costs one of the budget: a quad, or a whole group with the operands it pushes.

    `into` is the slot its result is popped to, -1 for none.
    """

    pc: int
    after: int
    row: Opcode
    quad: Quad
    arguments: tuple[int, ...] = ()
    into: int = -1


@dataclass(frozen=True, slots=True)
class Jump:
    """Goes on there."""

    to: int


@dataclass(frozen=True, slots=True)
class Branch:
    """Goes on at `yes` when the boolean in a slot is true, else at `no`."""

    slot: int
    yes: int
    no: int


@dataclass(frozen=True, slots=True)
class Call:
    """Calls a method, then goes on."""

    what: Instruction
    to: int


@dataclass(frozen=True, slots=True)
class Return:
    """Leaves the method."""

    what: Instruction


@dataclass(frozen=True, slots=True)
class Throw:
    """Throws the object in a slot."""

    what: Instruction


@dataclass(frozen=True, slots=True)
class Leave:
    """Leaves the engine, which does not know the instruction; goes on there some time."""

    what: Instruction
    to: int | None


End = Jump | Branch | Call | Return | Throw | Leave


@dataclass(slots=True)
class Run:
    """Instructions from `pc` on, one after another, and how they end."""

    pc: int
    work: list[Instruction] = field(default_factory=list)
    end: End | None = None

    @property
    def cost(self) -> int:
        """What it takes from the budget; an instruction that leaves is paid for by who does it."""
        return len(self.work) + (isinstance(self.end, (Branch, Call, Return, Throw)) or self._jumps)

    @property
    def last(self) -> tuple[int, int]:
        """The instruction that ends it, and what is behind: the same where it only goes on."""
        if isinstance(self.end, (Call, Return, Throw, Leave)):
            return self.end.what.pc, self.end.what.after
        pc = self.work[-1].after if self.work else self.pc
        return pc, pc + (not self.falls)

    @property
    def _jumps(self) -> bool:
        return isinstance(self.end, Jump) and not self.falls

    #: Whether it only goes on with the next instruction, which costs nothing.
    falls: bool = False


class Graph:
    """The runs of one method by the instruction they begin at, and its points.

    `lowered` says of an instruction whether the engine does it itself.
    """

    def __init__(
        self, prepared: Prepared, method: MethodRecord, lowered: Callable[[Instruction], bool]
    ) -> None:
        self.method = method
        self._prepared, self._lowered = prepared, lowered
        self._quads = prepared.program.quads
        self.entry = method.entry if method.synchronized else method.entry + 1
        self.instructions = {i.pc: i for i in self._decoded()}
        self.long = len(self.instructions) * (8 + len(method.slots)) > LONG
        self.points = {self.entry}
        self.points.update(h.target for h in method.handlers if h.kind in (CATCH, FINALLY))
        #: Where what an instruction throws may be caught.
        self._caught: dict[int, list[int]] = {}
        for handler in method.handlers:
            if handler.kind in (CATCH, FINALLY):
                for pc in range(handler.start, handler.end):
                    self._caught.setdefault(pc, []).append(handler.target)
        heads = self._heads()
        self.runs: dict[int, Run] = {}
        for pc in sorted(heads):
            self.runs[pc] = self._run(pc, heads)

    def _decoded(self) -> list[Instruction]:
        found = []
        pc = self.method.entry
        while pc < self.method.end:
            group = self._prepared.groups.get(pc)
            quad = self._quads[pc]
            if group is None:
                found.append(Instruction(pc, pc + 1, BY_CODE[quad.op], quad))
            else:
                row = BY_CODE[group.head.op]
                back = group.after - (group.destination >= 0)
                pushed = tuple(push.a for push in self._quads[pc : back - 1])
                found.append(Instruction(pc, group.after, row, group.head, pushed, group.destination))
            pc = found[-1].after
        return found

    def _heads(self) -> set[int]:
        """Where runs begin; notes the points behind calls and behind what leaves."""
        heads = set(self.points)
        for i in self.instructions.values():
            ends = CONTROL.get(i.row.name)
            if ends in ("Jump", "Branch"):
                heads.update((i.quad.a, i.after))
                if i.quad.a <= i.pc:
                    self.points.add(i.quad.a)
            elif ends == "Call" or not (ends or self._lowered(i)):
                heads.add(i.after)
                self.points.add(i.after)
        heads |= self._stretched()
        return {pc for pc in heads if pc in self.instructions}

    def _stretched(self) -> set[int]:
        """More points: they cut long chains of values, which cost the compiler and its stack too much."""
        since: dict[int, int] = {}
        for pc, i in self.instructions.items():
            if since.get(pc, 0) >= STRETCH:
                self.points.add(pc)
            passed = 1 if pc in self.points else since.get(pc, 0) + 1
            ends = CONTROL.get(i.row.name)
            ways = [i.quad.a] if ends in ("Jump", "Branch") else []
            for to in ways if ends == "Jump" else [*ways, i.after]:
                since[to] = max(since.get(to, 0), passed)
        return self.points

    def _run(self, pc: int, heads: set[int]) -> Run:
        run = Run(pc)
        while run.end is None:
            i = self.instructions[pc]
            run.end = self._end(i)
            if run.end is None:
                run.work.append(i)
                pc = i.after
                if pc in heads:
                    run.end, run.falls = Jump(pc), True
        return run

    def _end(self, i: Instruction) -> End | None:
        """How an instruction ends the run that it is in; None: it does not."""
        match CONTROL.get(i.row.name):
            case "Jump":
                return Jump(i.quad.a)
            case "Branch":
                ways = (i.quad.a, i.after) if i.row.name == "bnz" else (i.after, i.quad.a)
                return Branch(i.quad.b, *ways)
            case "Call":
                return Call(i, i.after)
            case "Return":
                return Return(i)
            case "Throw":
                return Throw(i)
        if self._lowered(i):
            return None
        return Leave(i, i.after if i.after in self.instructions else None)

    def leads_to(self, pc: int) -> list[int]:
        """Where control may go from a run: by itself, by what is thrown in it, and when it is resumed."""
        run = self.runs[pc]
        ways: list[int] = []
        match run.end:
            case Jump(to) | Call(_, to):
                ways.append(to)
            case Branch(_, yes, no):
                ways += [yes, no]
            case Leave(_, to) if to is not None:
                ways.append(to)
        inside = [*run.work, *([run.end.what] if isinstance(run.end, (Call, Throw, Leave)) else [])]
        targets = dict.fromkeys(target for i in inside for target in self._caught.get(i.pc, ()))
        return [*ways, *targets]
