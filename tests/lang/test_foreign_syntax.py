"""Syntax of Python, C++, Java and ROS: each gets an error with a hint that says what L has instead.

`cases.txt` holds the snippets, `findings.txt` what is reported for each: place, code, sentence and hint.
`python tests/lang/test_foreign_syntax.py` rewrites the latter.
"""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from lfield.lang.frontend import check_text
from lfield.text.source_text import Diagnostic

FOLDER = Path(__file__).parent / "golden" / "foreign"
PROGRAM = """{unit}
resource R {{
    int n;
    real r;
    string s;
    boolean x;
    boolean y;
    int[] a;
    {member}
    init(string[] arg) {{ a = new int[3]; }}
    private int go() {{ return 1; }}
    portal work() {{
        {statement}
    }}
}}
coordinator C {{
    init(string[] arg) {{ }}
}}
"""


def blocks(name: str) -> list[str]:
    """A line and the indented lines behind it, for each."""
    return re.split(r"\n(?! )", (FOLDER / name).read_text(encoding="utf-8").rstrip("\n"))


def cases() -> list[str]:
    return blocks("cases.txt")


def findings(case: str) -> list[Diagnostic]:
    kind, _, text = case.replace("\n    ", "\n").partition(": ")
    parts = {"unit": "", "member": "", "statement": "n = 1;"} | {kind: text}
    return check_text(PROGRAM.format(**parts)).diagnostics


def described(case: str) -> str:
    lines = [case]
    for found in findings(case):
        place = f"{found.span.line}:{found.span.column}"
        lines.append(f"        {place} {found.severity} {found.code}: {found.message} | {found.hint}")
    return "\n".join(lines)


GOLDEN = dict(zip(cases(), blocks("findings.txt"), strict=True)) if __name__ != "__main__" else {}


@pytest.mark.parametrize("case", cases())
def test_the_findings_are_those_of_the_golden_file(case: str) -> None:
    assert described(case) == GOLDEN[case]


@pytest.mark.parametrize("case", cases())
def test_the_first_finding_is_an_error_with_a_hint(case: str) -> None:
    first = findings(case)[0]
    assert (first.severity, bool(first.hint)) == ("error", True)


if __name__ == "__main__":
    (FOLDER / "findings.txt").write_text("\n".join(map(described, cases())) + "\n", encoding="utf-8")
