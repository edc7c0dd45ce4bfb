"""The compiler and the verifier accept each program that the checker accepts: random nested blocks."""

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from lfield.bytecode.verifier import verify
from lfield.compiler.program_builder import compile_program
from lfield.lang.frontend import check_text

UNITS = """
resource Arm {
    init(string[] arg) { }
    portal go() { }
    portal lift(real metres) emit real { return metres; }
}
coordinator Boss {
    init(string[] arg) {
        Arm arm = findArm("arm");
        real x;
        real[] a = new real[3];
        int i;
        BODY
    }
    private int count(Arm arm, int i) {
        real x;
        real[] a = new real[3];
        COUNTED
    }
}
"""
STEPS = [
    *("arm.go();", "x = arm.lift(1);", "a[i] = arm.lift(x);", "a[0] = arm.lift(2);", "a[1] = 3;"),
    *("print(x);", "sleep(1);", "i += 1;", "break;", "continue;", "return;", "throw new Exception();"),
]


def blocks(step: st.SearchStrategy[str]) -> st.SearchStrategy[str]:
    """A statement with bodies of these steps."""
    body = st.lists(step, max_size=4).map(" ".join)
    heads = ["together", "within (i + 1)", "reserve (arm)", "while (i < 3)", "while (true)", "if (i < 3)"]
    one = st.tuples(st.sampled_from(heads), body).map(lambda parts: f"{parts[0]} {{ {parts[1]} }}")
    handled = st.sampled_from(["", "NullException", "TimeLimitException", "Exception"])
    attempt = st.tuples(body, handled, body, st.none() | body).map(lambda parts: try_statement(*parts))
    return one | attempt


def try_statement(body: str, handled: str, handler: str, last: str | None) -> str:
    """A try with a catch, a finally, or both. No other catch is in it, since all of them use the name `e`.

    A jump in the finally does not leave the finally.
    """
    catch = f"catch ({handled} e) {{ {handler} }}" if handled and "catch (" not in body + handler else ""
    if last is None and catch:
        return f"try {{ {body} }} {catch}"
    inner = (last or "").replace("return;", "")
    if "break;" in inner or "continue;" in inner:
        inner = f"while (i < 3) {{ {inner} }}"
    return f"try {{ {body} }} {catch} finally {{ {inner} }}"


def whole(body: str) -> str:
    """A program with the body in a method without a result, and in a method with a result."""
    return UNITS.replace("BODY", body).replace("COUNTED", body.replace("return;", "return i;"))


BODIES = st.lists(st.recursive(st.sampled_from(STEPS), blocks, max_leaves=10), max_size=4).map(" ".join)


@settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))
@given(BODIES)
def test_a_program_that_passes_the_checker_compiles_and_verifies(body: str) -> None:
    checked = check_text(whole(body))
    if checked.program is not None:
        verify(compile_program(checked.program))


def test_bodies_of_every_kind_pass_the_checker() -> None:
    """The test above checks only the programs that the checker accepts."""
    for body in (
        "together { arm.go(); x = arm.lift(1); a[i] = arm.lift(2); }",
        "while (true) { together { arm.go(); try { break; } finally { sleep(1); } } }",
        try_statement("arm.go();", "Exception", "return;", "if (i < 3) { break; } continue; return;"),
        "reserve (arm) { while (true) { together { arm.go(); if (i < 3) break; } } }",
        "within (i + 1) { try { arm.go(); } catch (NullException e) { } finally { together { arm.go(); } } }",
    ):
        checked = check_text(whole(body))
        assert checked.errors == []
