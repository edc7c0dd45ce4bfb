"""The instructions of one method: labels, reachability, and the lines they come from."""

from __future__ import annotations

from dataclasses import dataclass, field

from lfield.bytecode.opcodes import BY_NAME
from lfield.bytecode.program import Quad

_TERMINALS = frozenset({"jmp", "return", "rtn", "throw", "noreturn"})


@dataclass(slots=True, eq=False)
class Label:
    """A place in the code, known once it is placed; `jumps` are the quads that wait for it."""

    position: int | None = None
    jumps: list[int] = field(default_factory=list)


class Code:
    """Quads in the making. Positions are those of the whole program: `base` is the method's entry."""

    def __init__(self, base: int) -> None:
        self.quads: list[Quad] = []
        self.lines: list[tuple[int, int]] = []
        #: The source line that instructions come from.
        self.line = 0
        #: Whether control can come here. Where it cannot, instructions are dropped.
        self.reachable = True
        self._base = base

    @property
    def position(self) -> int:
        """Where the next instruction will be."""
        return self._base + len(self.quads)

    def emit(self, name: str, a: int = 0, b: int = 0, c: int = 0) -> None:
        """Append an instruction."""
        if not self.reachable:
            return
        if not self.lines or self.lines[-1][1] != self.line:
            self.lines.append((self.position, self.line))
        self.quads.append(Quad(BY_NAME[name].code, a, b, c))
        self.reachable = name not in _TERMINALS

    def jump(self, name: str, label: Label, condition: int = 0) -> None:
        """Append `jmp`, `bnz` or `bz` to a label that may be placed later."""
        if self.reachable and label.position is None:
            label.jumps.append(len(self.quads))
        self.emit(name, label.position or 0, condition)

    def place(self, label: Label, *, entered: bool = False) -> None:
        """Put a label here. `entered`: control comes by a way not made yet, a jump back or a handler."""
        label.position = self.position
        for index in label.jumps:
            self.quads[index] = self.quads[index]._replace(a=label.position)
        self.reachable = self.reachable or entered or bool(label.jumps)
