"""The layout rules of `lfield fmt`: a source text and its formatted text for each rule."""

from __future__ import annotations

import pytest

from lfield.editor.layout.formatter import format_deployment, format_program
from lfield.errors import ProgramError
from lfield.text.source_text import Source

#: By rule: statements of a method before and after formatting.
STATEMENTS = {
    "spaces around operators, not inside brackets": (
        "x=( a+b )*c [ i ] ; f ( a,b ) ;",
        "x = (a + b) * c[i];\nf(a, b);",
    ),
    "a minus sign and its number": (
        "x = - 1 ; y = a - - b ; z = ! done && - - a < 0;",
        "x = -1;\ny = a - -b;\nz = !done && - -a < 0;",
    ),
    "statement keywords have a space before the bracket, calls have none": (
        "if(a) return ; within(3){ f (1); } while( b ) sleep(1);",
        "if (a) return;\nwithin (3) { f(1); }\nwhile (b) sleep(1);",
    ),
    "a one-line block stays on one line": ("together{ a.b() ;c.d(); }", "together { a.b(); c.d(); }"),
    "a block with a line break has a line for each statement": (
        "together { a.b();\nc.d(); }",
        "together {\n    a.b();\n    c.d();\n}",
    ),
    "clauses follow the brace": (
        "try {\na();\n}\ncatch (E e) { b(); }\nfinally\n{\nc();\n}",
        "try {\n    a();\n} catch (E e) { b(); }\nfinally {\n    c();\n}",
    ),
    "clauses after a one-line block stay on their lines": (
        "try { a(); }\ncatch (E e) { b(); }",
        "try { a(); }\ncatch (E e) { b(); }",
    ),
    "else if is one clause": (
        "if (a) { b();\n} else\nif (c) { d(); } else e();",
        "if (a) {\n    b();\n} else if (c) { d(); } else e();",
    ),
    "a body without braces is indented": (
        "for (int i = 0;i<3;i+=1)\nif (a)\nb();\nelse\nc();\nd();",
        "for (int i = 0; i < 3; i += 1)\n    if (a)\n        b();\n    else\n        c();\nd();",
    ),
    "an else after a body on its own line starts a line": (
        "if (a)\nb(); else c();",
        "if (a)\n    b();\nelse c();",
    ),
    "array elements have no spaces at the braces": (
        'string[ ] s = { "a" , "b" } ; f(new int [ ] { 1 });',
        's = {"a", "b"};\nf(new int[] {1});'.replace("s =", "string[] s =", 1),
    ),
    "for without conditions": ("for(;;){ a(); }", "for (;;) { a(); }"),
    "for each": ("for(T x:xs) a(x);", "for (T x : xs) a(x);"),
    "line breaks in brackets stay, with an indentation": (
        "f(a,\n             b\n  + c);\nreturn a\n&& b;",
        "f(a,\n    b\n    + c);\nreturn a\n    && b;",
    ),
    "brackets with a line break at their start": (
        "f(\na,\ng(\nb\n)\n);",
        "f(\n    a,\n    g(\n        b\n    )\n);",
    ),
    "blank lines: at most one, none at the edges of a block": (
        "\n\na();\n\n\n\nif (b) {\n\nc();\n\n}\nd();\n\n",
        "a();\n\nif (b) {\n    c();\n}\nd();",
    ),
    "comments stay on their lines": (
        "a(); // one\n  // two\n/* three */ b(/* four */ c);\nif (d) { // five\ne();\n// six\n}",
        "a(); // one\n// two\n/* three */ b(/* four */ c);\nif (d) { // five\n    e();\n    // six\n}",
    ),
    "aligned comments stay aligned": (
        "a();    // one\nbbb();  // two\n        // three\nc(); // four",
        "a();   // one\nbbb(); // two\n       // three\nc(); // four".replace("   //", "    //").replace(
            "bbb(); ", "bbb();  "
        ),
    ),
    "a comment of several lines is indented as a whole": (
        "if (a) {\n  /* one\n     two\n\n   three */\n  b();\n}",
        "if (a) {\n    /* one\n       two\n\n     three */\n    b();\n}",
    ),
    "types have spaces only after commas": (
        "map < string,map<Phase , int[ ]>> [ ] m = new map< Phase,real > ();\nfuture <void> f=async a.b();",
        "map<string, map<Phase, int[]>>[] m = new map<Phase, real>();\nfuture<void> f = async a.b();",
    ),
    "a comment in a type does not end a statement": (
        "map</* name */ string, int> m = null;",
        "map < /* name */ string, int > m = null;",
    ),
    "tabs and carriage returns": ("\tif (a) {\r\n\t\tb();\t// c\r\n\t}", "if (a) {\n    b();    // c\n}"),
}
#: A name that makes lines longer than the limit.
LONG = "a" * 40


def method(statements: str) -> str:
    """A program with these statements in a method."""
    lines = "\n".join(f"        {line}" if line else "" for line in statements.split("\n"))
    return f"class C {{\n    public void f() {{\n{lines}\n    }}\n}}\n"


def formatted(text: str) -> str:
    """The formatted program. Fails if formatting it again changes it."""
    once = format_program(Source("p.L", text))
    assert format_program(Source("p.L", once)) == once
    return once


@pytest.mark.parametrize("rule", STATEMENTS)
def test_statements_follow_the_layout_rule(rule: str) -> None:
    written, expected = STATEMENTS[rule]
    assert formatted("class C{public void f(){\n" + written + "\n}}") == method(expected)


def test_members_and_units_start_on_new_lines() -> None:
    text = 'include  < mavlink/copter.L > ; include "a.L";resource  R{int x; init ( string[]arg ){} '
    text += "portal p()emit int[]{return x;}}"
    assert formatted(text) == (
        'include <mavlink/copter.L>;\ninclude "a.L";\n'
        "resource R { int x; init(string[] arg) { } portal p() emit int[] { return x; } }\n"
    )
    assert formatted("class A { public int x; public A()\n{ x = 1; } }\n\n\n\nclass B {\n}") == (
        "class A {\n    public int x;\n    public A() { x = 1; }\n}\n\nclass B {\n}\n"
    )


@pytest.mark.parametrize(
    ("written", "expected"),
    [
        # After the last possible comma of the outermost brackets.
        (f"f({LONG}, g({LONG}, 1), {LONG}, b);", f"f({LONG}, g({LONG}, 1),\n    {LONG}, b);"),
        # Before the operator with the lowest precedence.
        (f"x = {LONG} * {LONG} || {LONG} && b;", f"x = {LONG} * {LONG}\n    || {LONG} && b;"),
        # A block or a body is broken into lines before its statements are broken.
        (f"if ({LONG}) {{ {LONG}(); {LONG}(); }}", f"if ({LONG}) {{\n    {LONG}();\n    {LONG}();\n}}"),
        (f"if ({LONG}) if ({LONG}) f({LONG});", f"if ({LONG})\n    if ({LONG}) f({LONG});"),
        # The length of a comment at the end is ignored, and a string is not broken.
        (f"f({LONG}); // {LONG} {LONG}", f"f({LONG}); // {LONG} {LONG}"),
        (f'f("{LONG} {LONG} {LONG}");', f'f("{LONG} {LONG} {LONG}");'),
    ],
)
def test_long_lines_are_broken(written: str, expected: str) -> None:
    assert formatted(method(written)) == method(expected)


def test_soft_keywords_are_ordinary_names() -> None:
    text = method("int within = 1;\nwithin = finally(reserve (2));\ntogether.within();")
    assert formatted(text) == text.replace("reserve (2)", "reserve(2)")


@pytest.mark.parametrize("text", ["", "\n\n", "// only a comment\n", "/* one */\n"])
def test_program_without_units_is_formatted(text: str) -> None:
    assert formatted(text) == text.strip("\n") + ("\n" if text.strip() else "")


@pytest.mark.parametrize(
    "text", ["class A {", "class A { int x }", 'resource R { init(string[] arg) { "a } }']
)
def test_program_with_syntax_errors_is_not_formatted(text: str) -> None:
    with pytest.raises(ProgramError) as refused:
        format_program(Source("p.L", text))
    assert refused.value.diagnostics[0].span.source.name == "p.L"


def test_formatting_changes_only_white_space_of_a_deployment() -> None:
    text = "\n\n  //A:a@h?x&y   # why\t\n\n\n# all\nB:b@h:8181\r\n//@w\n\n"
    assert format_deployment(Source("m.dL", text)) == "//A:a@h?x&y   # why\n\n# all\nB:b@h:8181\n//@w\n"
    with pytest.raises(ProgramError):
        format_deployment(Source("m.dL", "//A:a h\n"))
