"""For any text, the front end raises no exception, ends, and accepts no incomplete tree."""

from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from lang_expectations import GOLDEN, ROVER
from msgspec import Struct

from lfield.lang import tree
from lfield.lang.deployment import parse_deployment
from lfield.lang.frontend import CheckResult, check_file, check_text
from lfield.lang.parser import parse_file
from lfield.lang.scanner import FOREIGN_OPERATORS, KEYWORDS, TokenKind, scan
from lfield.lang.types import UNKNOWN, Type
from lfield.text.source_text import Diagnostics, Source

PROGRAM = (GOLDEN / "ok" / "everything.L").read_text(encoding="utf-8").replace('include "part.L";', "")
PIECES = sorted(
    {
        *KEYWORDS,
        *FOREIGN_OPERATORS,
        *"{}()[];.,=+-*/%<>!\"'\\#?:&|\n\0é",
        "//",
        "/*",
        "*/",
        "Arm",
        "Boss",
        "Plan",
        "Log",
    }
    | {
        "x",
        "1",
        "1.5",
        "9999999999999999999",
        '"s"',
        "null",
        "String",
        "switch",
        "static",
        "specific",
        "together",
        "within",
        "finally",
        "together {",
        "within (2) {",
        "finally {",
        "extends",
    }
)
LENIENT = settings(max_examples=30, deadline=None, suppress_health_check=[HealthCheck.too_slow])


def assert_sound(checked: CheckResult) -> None:
    """The result has a program if and only if it has no error; every type in the program is known."""
    assert (checked.program is None) == bool(checked.errors)
    for diagnostic in checked.diagnostics:
        assert diagnostic.render()
    if checked.program is not None:
        assert_types_known(checked.program)


def assert_types_known(program: tree.CheckedProgram) -> None:
    observed: set[int] = set()
    waiting: list[object] = list(program.units)
    while waiting:
        node = waiting.pop()
        assert node is not UNKNOWN
        if isinstance(node, list):
            waiting.extend(node)
        elif isinstance(node, Struct) and id(node) not in observed and not isinstance(node, Type | Source):
            observed.add(id(node))
            waiting.extend(getattr(node, name) for name in node.__struct_fields__)
        elif isinstance(node, Type):
            waiting.extend([node.element] if hasattr(node, "element") else [])


@st.composite
def mutated_programs(draw: st.DrawFn) -> str:
    """A valid program with a few cuts, repetitions and insertions at random places."""
    text = PROGRAM
    for _ in range(draw(st.integers(1, 4))):
        start = draw(st.integers(0, len(text)))
        end = min(len(text), start + draw(st.sampled_from([0, 1, 5, 40])))
        insertion = draw(st.one_of(st.sampled_from(PIECES), st.just(""), st.just(text[start:end] * 2)))
        text = text[:start] + insertion + text[end:]
    return text


@LENIENT
@given(mutated_programs())
def test_mutated_program_gives_diagnostics_or_a_sound_tree(text: str) -> None:
    assert_sound(check_text(text, devices={"Rover": ROVER}))


@LENIENT
@given(st.lists(st.sampled_from(PIECES), max_size=60).map(" ".join))
def test_words_in_any_order_give_diagnostics(text: str) -> None:
    assert_sound(check_text(text))
    assert_sound(check_text(f"resource Arm {{ init(string[] arg) {{ {text} }} }}"))


@LENIENT
@given(st.text(max_size=200))
def test_any_text_gives_diagnostics(text: str) -> None:
    assert_sound(check_text(text))


@settings(max_examples=50, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.binary(max_size=200))
def test_any_bytes_give_diagnostics(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "any.L"
    path.write_bytes(data)
    assert_sound(check_file(path))


@LENIENT
@given(mutated_programs())
def test_text_skipped_by_the_parser_is_always_reported(text: str) -> None:
    found = Diagnostics()
    file = parse_file(Source("any.L", text), found)
    broken = file.broken or any(u.broken or any(m.broken for m in u.methods) for u in file.units)
    assert not broken or found.errors


@LENIENT
@given(st.one_of(mutated_programs(), st.text(max_size=200)))
def test_tokens_cover_the_text(text: str) -> None:
    found = Diagnostics()
    scanned = scan(Source("any.L", text), found)
    assert scanned.tokens[-1].kind is TokenKind.END
    at = 0
    for token in scanned.tokens:
        assert at <= token.span.start <= token.span.end <= len(text)
        assert token.text == token.span.text
        gap = text[at : token.span.start].strip(" \t\r\n\f")
        assert found.found or not gap or gap.startswith(("//", "/*"))
        at = token.span.end


def test_deep_nesting_is_an_error() -> None:
    depth = 5_000
    bodies = ["x = " + "(" * depth, "{" * depth, "if (true) " * depth, "x = " + "-" * 3 + "!" * depth + "x;"]
    bodies += [
        "x = " + "1 + (" * depth + "1;",
        "x" + ".y(x" * depth + ";",
        "x = " * depth + "1;",
        "f(" * depth,
    ]
    bodies += ["x" + "[0" * depth, "if (x) y(); else { " * depth, "new A(" * depth]
    bodies += [
        "int" + "[]" * depth + " x;",
        "x = new int" + "[1]" * depth + ";",
        "try " * depth,
        "x ? " * depth,
    ]
    bodies += ["together { " * depth, "within (1) { " * depth, "try { } finally { " * depth]
    for text in bodies:
        checked = check_text(f"resource Arm {{ init(string[] arg) {{ {text} }} }}")
        assert "L211" in {d.code for d in checked.diagnostics}, text[:40]


@pytest.mark.few(0)
def test_long_chain_with_errors_is_no_deep_nesting() -> None:
    length = 5_000
    bodies = ["x = " + "1 + " * length + "1;", "x" + ".y" * length + ";", "x" + "[0]" * length + ";"]
    bodies += ["if (x) y(); " + "else if (x) y(); " * length, "x" + ".y()" * length + ";"]
    for text in bodies:
        checked = check_text(f"resource Arm {{ init(string[] arg) {{ {text} }} }}")
        assert "L211" not in {d.code for d in checked.diagnostics}, text[:40]
        assert "L301" in {d.code for d in checked.diagnostics}, text[:40]


def test_deepest_allowed_program_checks() -> None:
    for text in [
        "print(" + "(" * 90 + "1" + ")" * 90 + ");",
        "print(" + "1 + (" * 48 + "1" + ")" * 48 + ");",
        "if (true) " * 90 + ";",
        "try { } finally { " * 49 + "int x; " + "}" * 49,
    ]:
        assert check_text(f"resource Arm {{ init(string[] arg) {{ {text} }} }}").program is not None


@pytest.mark.few(0)
def test_together_calls_in_long_chains_are_no_deep_nesting() -> None:
    length = 3_000
    ladder = "if (x > 1) arm.go(); " + "else if (x > 2) arm.go(); " * length
    limit = "within (" + "1 + " * length + "1) { arm.go(); }"
    unclosed = "within (arm.go(;\n" * length
    for text, code in ((f"together {{ {ladder} }}", None), (limit, None), (unclosed, "L205")):
        arm = "resource Arm { init(string[] arg) { } portal go() { } }"
        init = f'init(string[] arg) {{ Arm arm = findArm("a"); int x; {text} }}'
        checked = check_text(f"{arm} coordinator Boss {{ {init} }}")
        assert {d.code for d in checked.diagnostics} >= ({code} if code else set())
        assert (checked.program is None) == (code is not None)


def test_long_chain_of_classes_is_checked() -> None:
    classes = "".join(f"class C{i} {{ public C{i + 1} next; }}\n" for i in range(3000))
    classes += "class C3000 { public Exception e; }\n"
    text = classes + "resource A { init(string[] a) { } portal p(C0 c) { } }"
    assert [d.code for d in check_text(text).diagnostics] == ["L511"]


@LENIENT
@given(
    st.one_of(st.text(max_size=80), st.lists(st.sampled_from([*"/:@?&%# \n0a", "Arm", "%41"])).map("".join))
)
def test_any_deployment_text_gives_a_deployment_or_diagnostics(text: str) -> None:
    deployment, found = parse_deployment(text, "any.dL", {"Arm": "resource"})
    assert (deployment is None) == bool(found)
    for diagnostic in found:
        assert diagnostic.render()
