"""The page about the thesis names existing tests, all productions of the grammar, and all opcodes."""

from __future__ import annotations

import ast
import importlib
import re
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import pytest

from lfield.bytecode.opcodes import BY_NAME

ROOT = Path(__file__).resolve().parents[3]
PAGE = ROOT / "lfield" / "docs" / "thesis.md"

#: The instructions of tables J.1 to J.10, by table.
INSTRUCTIONS = {
    "J.1": "bnz jmp",
    "J.2": "move",
    "J.3": "call pcall frame return rtn",
    "J.4": "new newarray",
    "J.5": "push pop",
    "J.6": "and or",
    "J.7": "addi addf subi subf muli mulf divi divf mod",
    "J.8": "eqi eqf eqs eqc eqnull slei slef sles slec sgei sgef sges sgec snei snef snes snec "
    "slti sltf slts sltc sgti sgtf sgts sgtc",
    "J.9": "write_int write_float write_str array_len str_concat i2f f2i yield s2i s2f",
    "J.10": "find findall",
}
#: Instructions for characters: L has no character type.
OF_CHARACTERS = {"eqc", "slec", "sgec", "snec", "sltc", "sgtc"}
#: The possible states of a row; True if a row in this state needs a test.
STATES = {
    "implemented": True,
    "implemented differently": True,
    "differs": True,
    "not implemented": False,
}


@dataclass(frozen=True)
class Row:
    """One row of a table with a state."""

    line: int
    cells: dict[str, str]

    @property
    def state(self) -> str:
        """The state without its reason or remark."""
        return re.split(r"[:;]| as ", self.cells["state"])[0]

    @property
    def tests(self) -> list[str]:
        """The names of the tests of the row."""
        return re.findall(r"`([^`]+)`", self.cells["test"])


def rows(text: str) -> list[Row]:
    """The rows of all tables whose columns include `state` and `test`."""
    found: list[Row] = []
    head: list[str] = []
    for number, line in enumerate(text.splitlines(), 1):
        if not line.startswith("|"):
            head = []
            continue
        cells = [cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]]
        if not head:
            head = cells
        elif "test" in head and not set(line) <= set("|-"):
            found.append(Row(number, dict(zip(head, cells, strict=True))))
    return found


@cache
def functions(path: Path) -> frozenset[str]:
    """The names of the functions of a file."""
    nodes = ast.walk(ast.parse(path.read_text(encoding="utf-8")))
    return frozenset(node.name for node in nodes if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef))


def cases(path: Path, function: str) -> set[str]:
    """The identifiers of the cases of a test with one list of parameters."""
    found: set[str] = set()
    for mark in getattr(importlib.import_module(path.stem), function).pytestmark:
        if mark.name == "parametrize":
            ids = mark.kwargs.get("ids") or str
            found.update(map(ids, mark.args[1]) if callable(ids) else ids)
    return found


def missing(name: str, monkeypatch: pytest.MonkeyPatch) -> str:
    """The part of `file::function[case]` that does not exist, or ''."""
    file, _, rest = name.partition("::")
    function, _, case = rest.partition("[")
    path = ROOT / file
    if not path.is_file():
        return file
    if function and function not in functions(path):
        return function
    if case:
        monkeypatch.syspath_prepend(str(path.parent))
        if case.removesuffix("]") not in cases(path, function):
            return case
    return ""


@pytest.fixture(scope="module")
def table() -> list[Row]:
    return rows(PAGE.read_text(encoding="utf-8"))


def test_each_row_has_a_state_with_its_reason_and_its_tests(table: list[Row]) -> None:
    assert len(table) > 250
    assert {row.state for row in table} == STATES.keys()
    for row in table:
        assert row.tests or not STATES[row.state], row
        if row.state == "implemented differently":
            assert "](" in row.cells["state"], row
        if row.state in ("differs", "not implemented"):
            assert re.search(r": \S", row.cells["state"]), row


def test_each_test_exists(table: list[Row], monkeypatch: pytest.MonkeyPatch) -> None:
    assert [(row.line, name) for row in table for name in row.tests if missing(name, monkeypatch)] == []


def test_each_production_of_the_grammar_has_a_row(table: list[Row], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(ROOT / "tests/lang"))
    productions = cases(ROOT / "tests/lang/test_thesis_grammar.py", "test_production_compiles")
    assert len(productions) == 42
    assert productions <= {row.cells.get("item", "").strip("`") for row in table}


def test_opcodes_equal_those_of_the_machine(table: list[Row]) -> None:
    printed = {(number, name) for number, names in INSTRUCTIONS.items() for name in names.split()}
    excerpts = {
        (row.cells["table"], row.cells["instruction"].strip("`")): row
        for row in table
        if "instruction" in row.cells
    }
    assert excerpts.keys() == printed
    for (_, name), row in excerpts.items():
        assert (name in BY_NAME) == (row.state != "not implemented") == (name not in OF_CHARACTERS)
        assert row.cells["number"] == (str(BY_NAME[name].code) if name in BY_NAME else "")
        if name in BY_NAME:
            assert f"tests/golden/test_thesis_instructions.py::test_instruction[{name}]" in row.tests


@pytest.mark.parametrize(
    ("name", "part"),
    [
        ("tests/golden/programs/arrays.L", ""),
        ("tests/golden/programs/nothing.L", "tests/golden/programs/nothing.L"),
        ("tests/lang/test_thesis_grammar.py::test_production_compiles", ""),
        ("tests/lang/test_thesis_grammar.py::test_nothing", "test_nothing"),
        ("tests/lang/test_thesis_grammar.py::test_production_compiles[PARAM]", ""),
        ("tests/lang/test_thesis_grammar.py::test_production_compiles[NOTHING]", "NOTHING]"),
    ],
)
def test_missing_file_function_or_case_is_found(
    name: str, part: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert missing(name, monkeypatch) == part
