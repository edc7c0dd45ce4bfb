"""Syntax of Python, C++, Java and ROS: each snippet gets an error with a hint for L.

`cases.txt` has the snippets, `findings.txt` the report for each: place, code, sentence and hint.
`python tests/lang/test_foreign_syntax.py` rewrites `findings.txt`. `suggestions.txt` has each hint that
contains L, with its L in backticks, and snippets that apply the hint: they compile.
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
    R arm;
    init(string[] arg) {{
        arm = findR("r");
        {coordinator}
    }}
}}
"""
#: Indentation of the parts of the program.
DEPTHS = {"unit": 0, "member": 4, "statement": 8, "coordinator": 8}


def blocks(name: str) -> list[str]:
    """The blocks of a file: a line with the indented lines that follow."""
    return re.split(r"\n(?! )", (FOLDER / name).read_text(encoding="utf-8").rstrip("\n"))


def cases() -> list[str]:
    return blocks("cases.txt")


def findings(case: str) -> list[Diagnostic]:
    kind, _, text = case.partition(": ")
    text = text.replace("\n    ", "\n" + " " * DEPTHS[kind])
    parts = {"unit": "", "member": "", "statement": "n = 1;", "coordinator": ""} | {kind: text}
    return check_text(PROGRAM.format(**parts), str(FOLDER / "program.L")).diagnostics


def report_of(case: str) -> str:
    lines = [case]
    for found in findings(case):
        place = f"{found.span.line}:{found.span.column}"
        lines.append(f"        {place} {found.severity} {found.code}: {found.message} | {found.hint}")
    return "\n".join(lines)


GOLDEN = dict(zip(cases(), blocks("findings.txt"), strict=True)) if __name__ != "__main__" else {}


@pytest.mark.parametrize("case", cases())
def test_findings_equal_the_golden_file(case: str) -> None:
    assert report_of(case) == GOLDEN[case]


@pytest.mark.parametrize("case", cases())
def test_first_finding_is_an_error_with_a_hint(case: str) -> None:
    first = findings(case)[0]
    assert (first.severity, bool(first.hint)) == ("error", True)


def suggestions() -> dict[str, list[str]]:
    """The snippets that apply each hint. A hint has its L in backticks."""
    found = [block.split("\n    ") for block in blocks("suggestions.txt")]
    return {hint: snippets for hint, *snippets in found}


def pattern(code: str) -> re.Pattern[str]:
    """Matches L in the notation of a hint: placeholder names and `...` are free."""
    placeholders = r"\b(?:Name|name|object|array|x|y|T|t|seconds|reason|value|from|to)\b|\.\.\.|\?"
    free = {"...": ".*", "?": r"\S+"}
    parts, at = [], 0
    for place in re.finditer(placeholders, code):
        parts += [re.escape(code[at : place.start()]), free.get(place.group(), r"[\w. ]+")]
        at = place.end()
    return re.compile("".join([*parts, re.escape(code[at:])]))


def test_every_hint_with_l_has_a_snippet() -> None:
    hints_with_l = {
        found.hint for case in cases() for found in findings(case) if re.search(r"[][(){}=|<]|&&", found.hint)
    }
    assert sorted(hints_with_l - {hint.replace("`", "") for hint in suggestions()}) == []


def test_every_suggestion_is_a_hint_of_a_case() -> None:
    hints = {found.hint for case in cases() for found in findings(case)}
    assert sorted({hint.replace("`", "") for hint in suggestions()} - hints) == []


@pytest.mark.parametrize("hint", suggestions())
def test_suggested_l_compiles(hint: str) -> None:
    snippets = suggestions()[hint]
    text = "\n".join(snippets)
    assert [code for code in re.findall("`(.*?)`", hint) if not pattern(code).search(text)] == []
    assert [(snippet, found.message) for snippet in snippets for found in findings(snippet)] == []


if __name__ == "__main__":
    (FOLDER / "findings.txt").write_text("\n".join(map(report_of, cases())) + "\n", encoding="utf-8")


@pytest.mark.parametrize(
    "ending", ["while x", "if x and y", "for x in y", "elif x", "for (auto x :", "f((", "f ("]
)
def test_program_that_ends_in_a_statement_head_is_read_to_its_end(ending: str) -> None:
    """The text has no line break at its end."""
    assert check_text(f"coordinator A {{ init(string[] arg) {{ {ending}", "m.L").diagnostics
