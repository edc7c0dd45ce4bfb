"""The table part of docs/bytecode.md, made from the table of instructions.

`python -m lfield.bytecode.reference` prints it; with `--write` it is put into the page.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from lfield.bytecode.opcodes import TABLE, Opcode

PAGE = Path(__file__).parents[1] / "docs" / "bytecode.md"
BEGIN = "<!-- table: begin; written by python -m lfield.bytecode.reference --write -->"
END = "<!-- table: end -->"

#: Headings by the first opcode they stand above.
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
    """A page with its table replaced; ValueError when it has no markers."""
    before, begin, rest = page.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not (begin and end):
        raise ValueError("the page has no place for the table")
    return f"{before}{BEGIN}\n\n{reference()}\n\n{END}{after}"


def _line(row: Opcode) -> str:
    operands = ", ".join(f"{o.role}:{o.kind}" if o.kind else o.role for o in row.operands)
    leaves = " Leaves the engine." if row.exits else ""
    return f"| {row.code} | `{row.name}` | {operands} | {_stack(row)} | {row.sentence}{leaves} |"


def _stack(row: Opcode) -> str:
    """What a head takes from the parameter stack and gives back."""
    if row.takes is None:
        return ""
    if row.name in ("call", "pcall", "device"):
        return "as declared"
    return " ".join([*row.takes, *(["→", row.gives] if row.gives else [])]) or "nothing"


def main() -> None:
    """Print the table, or write it into the page."""
    parser = argparse.ArgumentParser(prog="python -m lfield.bytecode.reference", description=__doc__)
    parser.add_argument("--write", action="store_true", help=f"put the table into {PAGE.name}")
    if parser.parse_args().write:
        PAGE.write_text(page_with_table(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
    else:
        print(reference())


if __name__ == "__main__":
    main()
