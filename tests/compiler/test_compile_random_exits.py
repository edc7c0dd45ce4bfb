"""Random nested try, catch, finally, together, within, reserve, and loops end as in a small Python model.

Every third call of `tick()` returns true, so the program executes some exits, also in later rounds of a loop.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from hypothesis import given, settings
from hypothesis import strategies as st

from lfield.testing.golden import run_text

#: The end of a statement: "on" (normal), "break", "continue", "return 3", or "throw" and a class.
Exit = str


@dataclass
class Execution:
    """The output of a run, and the number of calls of `tick()`."""

    trace: list[str]
    ticks: int = 0

    def tick(self) -> bool:
        """Return true at every third call."""
        self.ticks += 1
        return self.ticks % 3 == 0


@dataclass(frozen=True)
class Step:
    """A statement as L text and as a Python function."""

    text: str
    run: Callable[[Execution], Exit]


def _exit_step(text: str, ending: Exit) -> Step:
    return Step(text, lambda execution: ending)


def _say(number: int) -> Step:
    def run(execution: Execution) -> Exit:
        execution.trace.append(str(number))
        return "on"

    return Step(f"say({number});", run)


def _block(steps: list[Step]) -> Step:
    def run(execution: Execution) -> Exit:
        for step in steps:
            if (ending := step.run(execution)) != "on":
                return ending
        return "on"

    return Step(" ".join(step.text for step in steps), run)


def _maybe(body: Step) -> Step:
    return Step(
        f"if (tick()) {{ {body.text} }}", lambda execution: body.run(execution) if execution.tick() else "on"
    )


def _loop(name: str, body: Step) -> Step:
    def run(execution: Execution) -> Exit:
        for _ in range(3):
            ending = body.run(execution)
            if ending == "break":
                break
            if ending not in ("on", "continue"):
                return ending
        return "on"

    return Step(f"for (int {name} = 0; {name} < 3; {name} = {name} + 1) {{ {body.text} }}", run)


def _try(name: str, body: Step, caught: str, catch: Step | None, last: Step | None) -> Step:
    def run(execution: Execution) -> Exit:
        ending = body.run(execution)
        if (
            catch is not None
            and ending.startswith("throw")
            and (caught == "Exception" or ending.endswith(caught))
        ):
            ending = catch.run(execution)
        end = last.run(execution) if last is not None else "on"
        return ending if end == "on" else end

    text = f"try {{ {body.text} }}"
    if catch is not None:
        text += f" catch ({caught} {name}) {{ {catch.text} }}"
    if last is not None:
        text += f" finally {{ {last.text} }}"
    return Step(text, run)


def _parallel(level: int, body: Step) -> Step:
    """A call that starts in parallel to the body. The call has ended after each kind of exit of the body."""

    def run(execution: Execution) -> Exit:
        ending = body.run(execution)
        execution.trace.append("0")
        return ending

    return Step(
        f"try together {{ arm.work({level}); {body.text} }} finally {{ printWorking({level}); }}", run
    )


def _reserved(body: Step) -> Callable[[Execution], Exit]:
    """The body of a reserve. The program first prints that no call is running."""

    def run(execution: Execution) -> Exit:
        execution.trace.append("0")
        return body.run(execution)

    return run


_CLASSES = ("NullException", "IndexException")


@st.composite
def steps(
    draw: st.DrawFn, depth: int, loops: int = 0, last: int | None = None, parallel: bool = False
) -> Step:
    """A statement of at most `depth` levels, in `loops` loops, `last` of them around the innermost finally.

    `parallel`: the statement is in a together.
    """
    kinds = ["say", "throw", "own", *(["return"] if last is None else [])]
    kinds += ["break", "continue"] if loops > (last or 0) else []
    deep = ["try", "try", "try", "loop", "maybe", "block", "within", "together"] if depth else []
    deep += ["reserve"] if depth and not parallel else []
    kind = draw(st.sampled_from(deep or kinds) if draw(st.booleans()) else st.sampled_from(kinds))
    if kind == "say":
        return _say(draw(st.integers(0, 99)))
    if kind == "throw":
        name = draw(st.sampled_from(_CLASSES))
        return _maybe(_exit_step(f'throw new {name}("x");', f"throw {name}"))
    if kind == "own":
        return _maybe(_exit_step("fail();", "throw IndexException"))
    if kind == "return":
        number = draw(st.integers(0, 9))
        return _maybe(_exit_step(f"return {number};", f"return {number}"))
    if kind in ("break", "continue"):
        return _maybe(_exit_step(f"{kind};", kind))
    if kind == "loop":
        return _loop("ijklmn"[loops], draw(steps(depth - 1, loops + 1, last, parallel)))
    parallel = parallel or kind == "together"
    inner = [draw(steps(depth - 1, loops, last, parallel)) for _ in range(draw(st.integers(1, 3)))]
    if kind == "maybe":
        return _maybe(_block(inner))
    if kind == "block":
        return _block(inner)
    if kind == "within":
        return Step(f"within (9999) {{ {_block(inner).text} }}", _block(inner).run)
    if kind == "reserve":
        return Step(f"reserve (arm) {{ printWorking(0); {_block(inner).text} }}", _reserved(_block(inner)))
    if kind == "together":
        return _parallel(depth, _block(inner))
    which = draw(st.sampled_from(["catch", "finally", "both"]))
    catch = draw(steps(depth - 1, loops, last, parallel)) if which != "finally" else None
    end = draw(steps(depth - 1, loops, loops, parallel)) if which != "catch" else None
    return _try(f"e{depth}", _block(inner), draw(st.sampled_from(("Exception", *_CLASSES))), catch, end)


_PROGRAM = """
resource Arm {{
    int[] now = new int[9];
    init(string[] arg) {{ while (true) yield(); }}
    portal work(int n) {{ try {{ now[n] = now[n] + 1; sleep(0.1); }} finally {{ now[n] = now[n] - 1; }} }}
    portal working(int n) emit int {{ return now[n]; }}
}}
coordinator R {{
    int ticks = 0; Arm arm;
    init(string[] arg) {{
        arm = findArm("arm");
        for (int round = 0; round < 4; round = round + 1) {{
            try {{ print("return " + i2s(work(7))); }}
            catch (Exception e) {{ print("throw " + e.type()); }}
        }}
    }}
    private int work(int given) {{ {body} return -1; }}
    private void say(int n) {{ print(n); }}
    private void printWorking(int n) {{ print(arm.working(n)); }}
    private void fail() {{ int[] a = new int[1]; a[2] = 0; }}
    private boolean tick() {{ ticks = ticks + 1; return ticks % 3 == 0; }}
}}
"""


@given(steps(5))
@settings(deadline=None, max_examples=60)
def test_random_nested_statements_end_as_in_the_model(step: Step) -> None:
    execution = Execution([])
    for _ in range(4):
        ending = step.run(execution)
        execution.trace.append("return -1" if ending == "on" else ending)
    world, _ = run_text(_PROGRAM.format(body=step.text))
    assert world.output == execution.trace
    assert [holder for _, holder in world.reserved.values()] in ([], [""])
