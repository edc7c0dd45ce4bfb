"""Listing of a module for people: indented, with each instruction above its text.

The listing is the same module with additional spaces and comments.
"""

from __future__ import annotations

from collections.abc import Iterator

from lfield.bytecode.disassembler import instructions
from lfield.bytecode.program import Program
from lfield.vm.reference.step_compiler import prepare
from lfield.vm.wasm.lowering.module_lowering import lower_program

#: Maximum indentation: a long method has a block for each of its points.
_DEEPEST = 24
_OPENS, _CLOSES = ("block", "loop", "if"), ("end", "else")


def listing(program: Program) -> str:
    """The text, which can be assembled; it ends with a newline."""
    notes, lines_of_l = _notes(program)
    module = lower_program(prepare(program), notes)
    first, *rest = module.text.splitlines()
    unsupported = [
        f";; {method} is executed by the reference engine: {reason}"
        for method, reason in module.unsupported.items()
    ]
    lines = _once([first, *unsupported, *rest], lines_of_l)
    return "".join(f"{line}\n" for line in _set_in(lines))


def _notes(program: Program) -> tuple[dict[int, list[str]], set[str]]:
    """The comments above instructions, by number; and those comments that are lines of L."""
    notes: dict[int, list[str]] = {}
    lines_of_l: set[str] = set()
    for method in range(len(program.core.methods)):
        for pc, (line, instruction) in instructions(program, method).items():
            notes[pc] = [f";{line}", f";; {instruction}"] if line else [f";; {instruction}"]
            lines_of_l.update(notes[pc][:-1])
    return notes, lines_of_l


def _once(lines: list[str], lines_of_l: set[str]) -> Iterator[str]:
    """The lines without repeated lines of L."""
    above = ""
    for line in lines:
        if line in lines_of_l:
            if line == above:
                continue
            above = line
        yield line


def _set_in(lines: Iterator[str]) -> Iterator[str]:
    """All lines, indented by their depth of parentheses and blocks."""
    depth = 0
    for line in map(str.strip, lines):
        text = line.partition(";;")[0]
        token = text.split(maxsplit=1)[0].rstrip(")") if text.strip() else ""
        closed = len(text) - len(text.lstrip(")")) + (token in _CLOSES)
        if line:
            yield "  " * min(depth - closed, _DEEPEST) + line
        depth += text.count("(") - text.count(")") + (token in (*_OPENS, "else")) - (token in _CLOSES)
