"""The tables of lfield/docs/bytecode.md, generated from the table of instructions.

`python tests/docs/reference/bytecode_reference.py` prints them; `--write` writes them to the page.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from lfield.bytecode.opcodes import TABLE, Opcode

PAGE = Path(__file__).parents[3] / "lfield" / "docs" / "bytecode.md"
START_MARKER = "<!-- table: begin; written by python tests/docs/reference/bytecode_reference.py --write -->"
END_MARKER = "<!-- table: end -->"

#: Headings by the first opcode of the section.
_SECTIONS = {
    10: "Jumps (J.1)",
    100: "Moves, fields, elements (J.2, J.11)",
    200: "Subroutines (J.3)",
    300: "Memory (J.4)",
    400: "Parameter stack (J.5)",
    500: "Arithmetic (J.7)",
    600: "Logic (J.6)",
    700: "Comparisons (J.8)",
    800: "Library: output",
    820: "Library: arrays and strings",
    830: "Library: conversions",
    840: "Library: time and threads",
    850: "Library: maths",
    870: "Library: exceptions",
    1300: "Finding resources (J.10)",
    1302: "Asking for capabilities",
    1400: "Exceptions",
    1500: "Devices",
    1600: "Parallel work and time limits",
    1700: "Reservations",
    1870: "Loops of resources",
}


def reference() -> str:
    """The tables in Markdown, one section after another."""
    lines: list[str] = []
    for row in TABLE:
        if row.code in _SECTIONS:
            lines += ["", f"### {_SECTIONS[row.code]}", ""]
            lines += ["| code | instruction | operands | stack | what it does |", "|---:|---|---|---|---|"]
        lines.append(_line(row))
    return "\n".join(lines).strip()


def page_with_table(page: str) -> str:
    """A page with the current table. Raises ValueError if the page has no markers."""
    before, begin, rest = page.partition(START_MARKER)
    _, end, after = rest.partition(END_MARKER)
    if not (begin and end):
        raise ValueError("the page has no place for the table")
    return f"{before}{START_MARKER}\n\n{reference()}\n\n{END_MARKER}{after}"


def _line(row: Opcode) -> str:
    operands = ", ".join(f"{o.role}:{o.kind}" if o.kind else o.role for o in row.operands)
    leaves = " *" if row.leaves_engine else ""
    return f"| {row.code} | `{row.name}` | {operands} | {_stack(row)} | {row.description}{leaves} |"


def _stack(row: Opcode) -> str:
    """The arguments that an instruction takes from the parameter stack, and its result."""
    if row.argument_kinds is None:
        return ""
    if row.name in ("call", "pcall", "device"):
        return "as declared"
    return " ".join([*row.argument_kinds, *(["→", row.result_kind] if row.result_kind else [])]) or "nothing"


def main() -> None:
    """Print the table, or write it into the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true", help=f"write the tables to {PAGE.name}")
    if parser.parse_args().write:
        PAGE.write_text(page_with_table(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
    else:
        print(reference())


if __name__ == "__main__":
    main()
