"""Rendering of findings."""

from lfield.lang.frontend import check_text
from lfield.text.message_tables import MAX_RENDERED, render_findings
from lfield.text.source_text import MAX_SHOWN

PROGRAM = """\
resource Arm {
\tinit(string[] arg) {
\t\tint count = 3;
\t\twrite(cuont + 1);
\t}
}
"""


def test_finding_has_place_sentence_line_caret_and_hint() -> None:
    (found,) = check_text(PROGRAM, "arm.L").diagnostics
    assert found.render().split("\n") == [
        "arm.L:4:9: error[L301]: there is no variable 'cuont' here",
        "    \t\twrite(cuont + 1);",
        "    \t\t      ^~~~~",
        "    hint: did you mean 'count'?",
    ]


def test_missing_semicolon_is_marked_behind_the_statement() -> None:
    (found,) = check_text(PROGRAM.replace("int count = 3;", "int cuont = 3"), "arm.L").diagnostics
    assert found.render().split("\n")[1:3] == ["    \t\tint cuont = 3", "    \t\t             ^"]


def test_warnings_do_not_prevent_a_program() -> None:
    text = "resource Arm { init(string[] arg) { return; yield(); } }"
    checked = check_text(text)
    assert [d.severity for d in checked.diagnostics] == ["warning"]
    assert checked.program is not None
    assert "warning[L902]" in checked.diagnostics[0].render()


def test_errors_of_a_file_are_in_source_order() -> None:
    text = "resource Arm {\n  Boks b;\n  init(string[] arg) {\n    x = 1;\n    int y = ;\n    z();\n  }\n}\n"
    found = check_text(text).diagnostics
    assert [(d.code, d.span.line) for d in found] == [("L302", 2), ("L301", 4), ("L205", 5), ("L303", 6)]


def test_long_line_is_shown_around_the_error_only() -> None:
    text = f"class C {{ {'int a; ' * 2_000} intt b; {'int c; ' * 2_000}}}"
    found = next(d for d in check_text(text).diagnostics if d.code == "L302")
    _, line, caret, *_ = found.render().split("\n")
    assert len(line) <= 4 + MAX_SHOWN
    assert line[caret.index("^") : caret.rindex("~") + 1] == "intt"


def test_text_of_three_thousand_errors_is_bounded() -> None:
    unknown = "".join(f"int x{number} = y{number};\n" for number in range(3000))
    found = check_text(f"resource Arm {{ init(string[] arg) {{\n{unknown}}} }}").diagnostics
    lines = render_findings(found).split("\n")
    assert (len(found), len(lines)) == (3000, 4 * MAX_RENDERED + 1)
    assert lines[-1].startswith("... and 2950 more;")
