"""The instructions of one method as in the listing of a program; the `frame` of the method has number 0."""

from __future__ import annotations

import re

from lfield.bytecode.disassembler import disassemble
from lfield.bytecode.program import MethodRecord, Program
from lfield.compiler.program_builder import compile_program
from lfield.lang.frontend import check_text

#: A class that every test can use.
_PRELUDE = """
class Pair {
    public int a; public Pair next; public string name;
    public Pair() { } public Pair(int x) { a = x; } public int get() { return a; }
}
"""


def compiled(text: str, name: str = "test.L") -> Program:
    """A program compiled from L text. Raises ProgramError."""
    return compile_program(check_text(text, name).or_raise())


def compiled_body(body: str, members: str = "") -> Program:
    """A program whose resource R has these statements in its init."""
    return compiled(f"{_PRELUDE} resource R {{ init(string[] arg) {{ {body} }} {members} }}")


def method(program: Program, name: str) -> MethodRecord:
    """The record of `Owner.name`."""
    names = [program.method_name(i) for i in range(len(program.core.methods))]
    return program.core.methods[names.index(name)]


def instructions(program: Program, name: str = "R.init") -> list[str]:
    """The instructions of `Owner.name` after its frame; the first has number 1."""
    record = method(program, name)
    numbered = re.findall(r"^(?=.{6}  ) *L?(\d+)  (\w.*)$", disassemble(program), re.MULTILINE)
    own = [text for number, text in numbered if record.entry < int(number) < record.end]
    return [re.sub(r"\bL(\d+)", lambda m: f"L{int(m[1]) - record.entry}", text) for text in own]


def code(body: str, members: str = "") -> list[str]:
    """The instructions of an init with these statements, without the closing `rtn`."""
    lines = instructions(compiled_body(body, members))
    assert lines[-1] == "rtn"
    return lines[:-1]
