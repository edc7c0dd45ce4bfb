"""Every production of appendix A: a program that uses it compiles, or it has the listed error.

Misprints are read as the programs of appendices C to E require: `;` after `return` and `throw`, a comma
between parameters and between arguments, any number of variables, names and texts as expressions.
"""

from __future__ import annotations

import pytest

from lfield.lang.frontend import check_text
from lfield.lang.scanner import KEYWORDS

COORDINATOR = "coordinator C { init(string[] arg) { } }"
RESOURCE = "resource R { init(string[] arg) { } }"
CLASS = "class K { }"


def coordinator(members: str = "", body: str = "") -> str:
    """A coordinator with these fields and statements of its init, beside a resource with a portal."""
    portal = "portal get(int i, int j) emit int { return i + j; }"
    return (
        f"resource R {{ init(string[] arg) {{ }} {portal} }} "
        f"coordinator C {{ {members} init(string[] arg) {{ {body} }} }}"
    )


def resource(members: str = "", fields: str = "") -> str:
    """A resource with these portals and methods, and fields before its init."""
    return f"resource R {{ {fields} init(string[] arg) {{ }} {members} }} class K {{ public int n; }}"


def class_of(members: str, usage: str = "") -> str:
    """A class with these members."""
    return f"{RESOURCE} class K {usage} {{ {members} }}"


def statements(body: str) -> str:
    """A method with these statements."""
    node = "class Node { public int n; public int[] a; public Node next; public Node(int i) { n = i; } "
    node += "public Node get(int i) { return next; } public int sum(int i, int j) { return i + j; } }"
    return (
        f"{node} resource R {{ int n; boolean b; Node k; int[] a; init(string[] arg) {{ }} "
        f"private int f() {{ return 1; }} private int g(int i, int j) {{ return i; }} "
        f"private void h() {{ {body} }} }}"
    )


#: Programs with each right-hand side, in the order of the appendix.
PRODUCTIONS: dict[str, list[str]] = {
    "COMPILATION_UNIT": [COORDINATOR, RESOURCE, CLASS],
    "COMPILATION_UNIT_Z": [f"{RESOURCE} {COORDINATOR} {CLASS}", RESOURCE],
    "COORDINATOR_DECLARATION": [coordinator("R r;")],
    "RESOURCE_DECLARATION": [resource("portal p() { } private void f() { }", "int i;")],
    "CLASS_DECLARATION": [class_of("public int i;")],
    "USAGE": [class_of("", "resource specific"), class_of("", "coordinator specific"), class_of("")],
    "INITIALIZATION": [coordinator(body="int i = 0; while (i < 3) i = i + 1;")],
    "RC_VARIABLE_DECLARATION_Z": [resource(fields="int i; string s;"), resource()],
    "CLASS_VARIABLE_DECLARATION_Z": [class_of("public int i; private int j;"), class_of("")],
    "FIELD_DECLARATION_Z": [
        class_of("public K() { } public int f() { return i; } private int i; ;"),
        class_of(""),
    ],
    "SYNC_X": [
        resource("portal synchronized p() { } private synchronized void f() { }"),
        resource("portal p() { } private void f() { }"),
    ],
    "RC_VARIABLE_DECLARATION": [resource(fields="real r;")],
    "METHOD_DECLARATION_Z": [resource("private void f() { } public void g() { }"), resource()],
    "METHOD_DECLARATION": [resource("private synchronized int f(int i) { int j = i; return j; }")],
    "CONSTRUCTOR_DECLARATION": [class_of("private int n; public K(int i) { int j = i; n = j; }")],
    "CLASS_VARIABLE_DECLARATION": [class_of("public boolean b;")],
    "LOCAL_VARIABLE_DECLARATION_Z": [statements("int i; int j; i = 1; j = i;"), statements("")],
    "MODIFIER": [class_of("public int i;"), class_of("private int i;")],
    "LOCAL_VARIABLE_DECLARATION": [statements("int i = 1;")],
    "VARIABLE_DECLARATION": [statements("boolean x; int i; real r; string s; int[] y; Node q;")],
    "VARIABLE_DECLARATION_X_INIT": [
        statements("Node q = new Node(1);"),
        statements("int i = 2;"),
        statements("int i;"),
    ],
    "PARAMETER_LIST_X": [resource("portal p(int i) { }"), resource("portal p() { }")],
    "PARAMETER_Z": [resource("portal p(int i, real r, string s) { }"), resource("portal p(int i) { }")],
    "PARAM": [resource("portal p(boolean[] b) { }")],
    "EMIT_X": [resource("portal p() emit K { return null; }"), resource("portal p() { }")],
    "PORTAL_Z": [resource("portal p(int i) emit int { int j = i; return j; } portal q() { }"), resource()],
    "EXPRESSION": [
        statements(f"{kind} x = {value};")
        for kind, value in (
            ("int", "(1)"),
            ("boolean", "true"),
            ("boolean", "false"),
            ("Node", "null"),
            ("int", "12"),
            ("real", "1.5"),
            ("string", '"text"'),
            ("int", "k.next.n"),
        )
    ],
    "EXPRESSION_Z": [
        *(statements(f"boolean x = n {op} 1;") for op in ("==", "<=", ">=", "!=", "<", ">")),
        *(statements(f"boolean x = b {op} true;") for op in ("&&", "||")),
        *(statements(f"int x = n {op} 2;") for op in "+-*/%"),
        statements("k = new Node(1);"),
        statements("n = 1;"),
        statements("n = n;"),
    ],
    "NEW_EXPRESSION": [statements("k = new Node(1);")],
    "NEW_EXPRESSION_KIND": [statements("k = new Node(1);"), statements("a = new int[3];")],
    "MEMBER": [statements("n = f();"), statements("n = a[0];"), statements("n = n;")],
    "EXPRESSION_FX_ID": [statements("n = g(1, 2);"), statements("n = a[n + 1];")],
    "MEMBER_REF_Z": [statements("n = k.get(1).next.a[2];"), statements("n = n;")],
    "EXPRESSION_ARRAY": [statements("a = new int[n * 2];")],
    "ARG_LIST_X": [statements("k.get(1);"), statements("f();")],
    "ARG_LIST_Z": [statements("g(1, n);"), statements("k.get(1);")],
    "STATEMENT": [
        statements("{ n = 1; n = 2; }"),
        statements("if (b) n = 1; else n = 2;"),
        statements("while (b) n = 1;"),
        statements("try n = 1; catch (Exception e) n = 2;"),
        statements("throw new Node(1);"),
        statements("return;"),
        statements(";"),
        statements("f();"),
    ],
    "STATEMENT_Z": [statements("n = 1; n = 2;"), statements("")],
    "STATEMENT_X_ELSE": [
        statements("if (b) n = 1; else if (b) n = 2; else n = 3;"),
        statements("if (b) n = 1;"),
    ],
    "STATEMENT_X_EXPRESSION": [
        class_of("public int f() { return 1; }"),
        class_of("public void f() { return; }"),
    ],
    "STATEMENT_X_CATCH_LIST": [statements("try { } catch (Node x) { } catch (Exception e) { }")],
    "STATEMENT_CATCH": [statements("try { f(); } catch (Node x) { n = x.n; }")],
}
#: Features that L lacks, like the other object-based languages of chapter III; the error is L217.
ABSENT = {
    "inheritance": "class K extends M { } class M { }",
    "interfaces": "interface K { }",
    "packages": f"package p; {RESOURCE}",
}
#: Constructs that the printed grammar permits and L refuses, with the code of the error.
REFUSED: dict[str, tuple[str, str]] = {
    "an assignment as a condition": (statements("if (b = true) n = 1;"), "L412"),
    "an assignment as an operand": (statements("n = 1 + (n = 2);"), "L412"),
    "statements in brackets": (statements("[ n = 1; ]"), "L205"),
    "a try without catch": (statements("try n = 1;"), "L214"),
    "a thrown number": (statements("throw 1;"), "L418"),
    "a catch of a number": (statements("try n = 1; catch (int i) n = i;"), "L419"),
    "a statement without effect": (statements("n + 1;"), "L413"),
}
#: The reserved words of the appendix, and those that L adds.
RESERVED_WORDS = (
    *(
        "boolean",
        "catch",
        "class",
        "coordinator",
        "else",
        "emit",
        "false",
        "if",
        "init",
        "int",
        "new",
        "null",
    ),
    *("portal", "private", "public", "real", "resource", "return", "string", "throw", "true", "try", "while"),
)
RESERVED_BY_L = ("break", "continue", "for", "include", "synchronized", "this", "void")


def errors(text: str) -> list[str]:
    """The codes of the errors of a program."""
    return [
        finding.code for finding in check_text(text, "grammar.L").diagnostics if finding.severity == "error"
    ]


@pytest.mark.parametrize("production", PRODUCTIONS)
def test_production_compiles(production: str) -> None:
    for text in PRODUCTIONS[production]:
        assert errors(text) == [], text


@pytest.mark.parametrize("construct", REFUSED)
def test_refused_construct_has_its_error(construct: str) -> None:
    text, code = REFUSED[construct]
    assert errors(text)[0] == code


def test_program_without_units_is_permitted() -> None:
    assert errors("// nothing yet\n") == []


@pytest.mark.parametrize("feature", ABSENT)
def test_absent_feature_is_an_error(feature: str) -> None:
    assert errors(ABSENT[feature])[0] == "L217"


@pytest.mark.parametrize("word", [*RESERVED_WORDS, *RESERVED_BY_L])
def test_reserved_word_is_no_name(word: str) -> None:
    assert errors(class_of(f"public int {word};")) == ["L204"]


def test_no_other_word_is_reserved() -> None:
    assert {*RESERVED_WORDS, *RESERVED_BY_L} == set(KEYWORDS)
