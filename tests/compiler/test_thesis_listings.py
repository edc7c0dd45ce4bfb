"""The seven constructs of appendix B: the instructions that lfield compiles, and the printed opcode numbers.

The reasons of the differences are in lfield/docs/bytecode.md ("Differences to appendices B and J").
"""

from __future__ import annotations

import pytest
from listing import compiled, instructions

from lfield.bytecode.opcodes import BY_NAME

PROGRAM = """
resource Writer {{ init(string[] arg) {{ }} portal f(int k) emit int {{ return k; }} }}
resource R {{
    init(string[] arg) {{ int i = 0; {resource} }}
    private int f(int j) {{ return j + 5; }}
}}
coordinator C {{
    Writer w;
    init(string[] arg) {{ int j = 0; int k = 1; {coordinator} }}
}}
"""

#: By construct: the statement, the instructions in the thesis, the method, and its instructions in lfield.
LISTINGS: dict[str, tuple[str, str, str, list[str]]] = {
    "assignment": ("i = i + 1;", "addi move", "R.init", ["addi, ^2, ^2, 1"]),
    "if": (
        "if (i >= 12) { i = i + 10; }",
        "sgei bnz addi move",
        "R.init",
        ["sgei, ^3, ^2, 12", "bz, L5, ^3", "addi, ^2, ^2, 10"],
    ),
    "while": (
        "while (i < 70) { i = i + 10; }",
        "slti bnz addi move jmp",
        "R.init",
        ["jmp, L4", "addi, ^2, ^2, 10", "slti, ^3, ^2, 70", "bnz, L3, ^3"],
    ),
    "function declaration": ("", "frame pop pop addi return", "R.f", ["addi, ^2, ^1, 5", "return, ^2"]),
    "function call": (
        "i = f(i);",
        "push push call pop move",
        "R.init",
        ["push, ^0", "push, ^2", "call, R.f(int)", "pop, ^2"],
    ),
    "finding a resource": (
        'Writer x = findWriter("test");',
        "push push find pop move",
        "C.init",
        ['lds, ^5, "test"', "push, ^5", "find, Writer", "pop, ^4"],
    ),
    "portal call": (
        "j = w.f(k);",
        "push push pcall pop move",
        "C.init",
        ["getf, ^4, ^0, .w", "push, ^4", "push, ^3", "pcall, Writer.f(int)", "pop, ^2"],
    ),
}

#: The numbers in the column "Java Encoding" of appendix B.
NUMBERS = {
    "bnz": 10,
    "jmp": 11,
    "move": 100,
    "call": 200,
    "pcall": 202,
    "frame": 210,
    "return": 220,
    "push": 400,
    "pop": 401,
    "addi": 500,
    "sgei": 702,
    "slti": 704,
    "find": 1300,
}

#: Instructions of the thesis that lfield does not compile, each with the instruction that replaces it.
REPLACED = {
    "assignment": {"move": "addi"},
    "if": {"bnz": "bz", "move": "addi"},
    "while": {"move": "addi"},
    "function declaration": {"frame": "frame", "pop": "frame"},
    "function call": {"move": "pop"},
    "finding a resource": {"move": "pop"},
    "portal call": {"move": "pop"},
}


def listing(construct: str) -> list[str]:
    """The instructions of the construct, without those of the declarations before it."""
    statement, _, method, _ = LISTINGS[construct]
    resource, coordinator = ("", statement) if method == "C.init" else (statement, "")
    program = compiled(PROGRAM.format(resource=resource, coordinator=coordinator))
    declared = {"R.init": 1, "C.init": 2, "R.f": 0}[method]
    made = instructions(program, method)
    return made[declared:-1] if made[-1] == "rtn" else made


@pytest.mark.parametrize("construct", LISTINGS)
def test_a_construct_compiles_to_these_instructions(construct: str) -> None:
    assert listing(construct) == LISTINGS[construct][3]


@pytest.mark.parametrize("construct", LISTINGS)
def test_each_printed_instruction_occurs_or_has_a_replacement(construct: str) -> None:
    printed = set(LISTINGS[construct][1].split())
    compiled_names = {line.partition(",")[0] for line in listing(construct)}
    assert printed - compiled_names == REPLACED[construct].keys()


def test_opcodes_have_the_printed_numbers() -> None:
    assert {name: BY_NAME[name].code for name in NUMBERS} == NUMBERS
    assert {name for _, printed, _, _ in LISTINGS.values() for name in printed.split()} <= NUMBERS.keys()
