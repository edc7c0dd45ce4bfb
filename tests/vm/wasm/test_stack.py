"""The stack of WebAssembly holds every chain of calls of a program, for all contents of its methods.

The stack use of a function is not known in advance: `lfield.vm.wasm.stack_depth` has to know the largest.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator

import pytest

from lfield.clock import ManualClock
from lfield.testing.golden import GoldenWorld, compile_text, run_until_idle, team_for
from lfield.vm.agent import MachineTeam
from lfield.vm.engine_interface import AgentLimits, Engines
from lfield.vm.machine import Machine
from lfield.vm.reference import ReferenceEngine as Reference
from switching_engine import NEEDED

wasmtime = pytest.importorskip("wasmtime", reason=NEEDED)

from lfield.vm.wasm import machine_code, wasm_compiler  # noqa: E402
from lfield.vm.wasm.stack_depth import OTHERS, STACK, deepest  # noqa: E402
from lfield.vm.wasm.wasm_engine import EagerWasmEngine as Engine  # noqa: E402


def _each(line: str, count: int, times: int = 2) -> str:
    """The line with the numbers from 1 for `#`, repeated: its results are needed again."""
    return "\n".join(line.replace("#", str(i)) for i in range(1, count + 1)) * times


#: The code of a method at every depth, besides the recursive call.
SHAPES = {
    "products": _each("s = s + n * #;", 90),
    "products again, from the last": _each("s = s + n * #;", 90, 1)
    + "\n".join(f"s = s - n * {i};" for i in range(90, 0, -1)),
    "quotients": _each("s = s + v / (n + #);", 60),
    "reals": _each("r = r + q * #.5;", 90),
    "roots": _each("r = r + sqrt(q * #.25);", 60),
    "powers": _each("r = r + pow(q * #.25, 0.5);", 20),
    "rounding": _each("s = s + f2i(round(q * #.25));", 40),
    "least": _each("s = s + min(n * #, v * #);", 40),
    "comparisons": _each("t = ((n * # < v * #) == (q * #.5 < r)) == t;", 22),
    "comparison of texts": _each("t = (u < i2s(n * #)) == t;", 42),
    "texts": _each('u = "t#" + i2s(n + #);', 40),
    "elements": _each("s = s + a[(n + #) % 100] + b[#][(n + #) % 100];", 20),
    "elements of reals": _each("r = r + x[(v + #) % 100];", 40),
    "fields": _each("s = s + o.left * # + o.next.right;", 30),
    "new objects": _each("o = new Box(); o.left = n * #; o.right = v * #; o.next = o;", 20),
    "many arguments": _each(f"s = s + last({', '.join(f'n * {i}' for i in range(90))});", 1),
    "few arguments, often": _each("s = s + last" + f"({', '.join(['n * #'] * 90)});", 12, 1),
    "branches": _each("if (n * # > s) { s = s + n * #; } else { s = s - n * #; }", 22),
    "swaps": _each("if (n > #) { int z = s; s = v; v = w; w = z; }", 28),
    "loops": _each("for (int i = 0; i < 2; i = i + 1) { s = s + n * # % 7; }", 22),
    "exceptions": _each("try { s = s + v / (n - #); } catch (ArithmeticException e) { s = s - 1; }", 28),
    "finally": _each("try { s = s + n * #; } finally { s = s - v * #; }", 20),
    "long": _each("s = s + n * # % 9; t = (n * # < s) == t;", 120),
}  # fmt: skip


def _program(body: str, depth: int, again: str) -> str:
    return f"""
        class Box {{ public int left; public int right; public Box next; }}
        resource R {{
          Box box; int[] ints; int[][] rows; real[] reals; string text;
          init(string[] arg) {{
            box = new Box(); box.next = box; text = "text";
            ints = new int[100]; rows = new int[50][100]; reals = new real[100];
            for (int i = 0; i < 50; i = i + 1) rows[i] = ints;
            print(down({depth}, 3.5));
            try {{ fall({depth}, 3.5); }} catch (ArithmeticException e) {{ print(e.message()); }}
          }}
          private int last({", ".join(f"int p{i}" for i in range(90))}) {{ return p89 % 7; }}
          private int fall(int n, real q) {{ if (n == 0) return 1 / n; return 1 + fall(n - 1, q); }}
          private int down(int n, real q) {{
            if (n == 0) return 0;
            int s = 0; int v = n + 1; int w = 2; real r = 0.0; boolean t = true; string u = text;
            Box o = box; int[] a = ints; real[] x = reals; int[][] b = rows;
            {again} {{
              {body}
              if (t) s = s + 1;
              s = s % 1000003 + f2i(r) + down(n - 1, q);
            }}
            return s;
          }}
        }}
    """


#: Once, and in a loop, where constant values are kept during the calls.
AGAIN = {"once": "if (n > 0)", "loop": "for (int k = n; k == n; k = k + 1)"}


def _run(text: str, engines: Engines, limits: AgentLimits) -> tuple[list[str], list[str]]:
    """The output, and the reports of agents that died."""
    program, desk, clock = compile_text(text), GoldenWorld(), ManualClock()
    members = team_for(program, [])
    machine = desk.machine = Machine(
        program, MachineTeam(members, 0, 1), desk, clock, random.Random(1), engines=engines
    )
    for member in members:
        machine.start(member, limits, 1)
    run_until_idle(machine, clock)
    return desk.output, [agent.report for agent in desk.endings if agent.ended == "died"]


@pytest.fixture
def with_half() -> Iterator[Callable[[], None]]:
    """From the call on, programs are compiled for the whole stack and run on one of half the size."""
    with pytest.MonkeyPatch.context() as patch:

        def halve() -> None:
            patch.setattr(wasm_compiler, "STACK", STACK // 2)
            _forget()

        yield halve
    _forget()


def _forget() -> None:
    wasm_compiler.compiler.cache_clear()
    machine_code._recent.clear()


@pytest.mark.few(2)
@pytest.mark.parametrize("body", SHAPES.values(), ids=SHAPES)
def test_the_deepest_recursion_has_the_same_effect(body: str) -> None:
    text = _program(body, AgentLimits().call_depth - 2, AGAIN["loop"])
    expected = _run(text, Reference, AgentLimits())
    assert (len(expected[0]), expected[1]) == (2, [])
    assert _run(text, Engine, AgentLimits()) == expected


def test_a_method_of_few_slots_and_many_products_has_the_same_effect() -> None:
    text = f"""
        resource R {{
          init(string[] arg) {{ print(down(990)); }}
          private int down(int n) {{
            if (n == 0) return 0;
            int s = 0;
            {_each("s = s + n * #;", 140)}
            return down(n - 1) + s;
          }}
        }}
    """
    assert _run(text, Engine, AgentLimits()) == _run(text, Reference, AgentLimits())


@pytest.mark.few(6)
@pytest.mark.parametrize("again", AGAIN.values(), ids=AGAIN)
@pytest.mark.parametrize("body", SHAPES.values(), ids=SHAPES)
def test_half_of_the_stack_is_in_reserve(body: str, again: str, with_half: Callable[[], None]) -> None:
    """Other processors and versions of the compiler need more stack."""
    with_half()
    output, reports = _run(_program(body, 2500, again), Engine, AgentLimits(heap=64 << 20, call_depth=3000))
    assert (len(output), reports) == (2, [])


def test_small_methods_reach_the_default_call_depth() -> None:
    """A stack that ends costs a return to Python, and a write of all its frames."""
    assert deepest({0: 700}, {0: [0]}) > AgentLimits().call_depth


ROOM = STACK - OTHERS


@pytest.mark.parametrize(
    ("sizes", "calls", "expected"),
    [
        ({}, {}, 0),
        # Without recursion: the whole chain fits, or so many of the largest functions.
        ({0: ROOM // 2, 1: ROOM // 4}, {0: [1], 1: []}, ROOM // 4 - 1),
        ({0: ROOM // 2, 1: ROOM // 2, 2: ROOM // 2}, {0: [1], 1: [2], 2: []}, 1),
        # A recursive function has the rest: without those before it and behind it.
        ({0: 1000}, {0: [0]}, ROOM // 1000 - 1),
        ({0: ROOM // 2, 1: 1000}, {0: [1], 1: [1]}, ROOM // 2 // 1000 - 1),
        ({0: ROOM // 2, 1: 1000, 2: ROOM // 4}, {0: [1], 1: [1, 2], 2: []}, ROOM // 4 // 1000 - 1),
        # One of two functions before a cycle is in a chain; one between two cycles counts like them.
        ({0: ROOM // 2, 1: ROOM // 2, 2: 1000}, {0: [2], 1: [2], 2: [2]}, ROOM // 2 // 1000 - 1),
        ({0: 10, 1: 1000, 2: 10}, {0: [0, 1], 1: [2], 2: [2]}, ROOM // 1000 - 1),
        ({0: 10, 1: 1000}, {0: [1], 1: [0]}, ROOM // 1000 - 1),
        # Methods without a function are not called.
        ({0: 1000}, {0: [0, 7]}, ROOM // 1000 - 1),
    ],
)  # fmt: skip
def test_the_number_of_calls_that_fit_the_stack(
    sizes: dict[int, int], calls: dict[int, list[int]], expected: int
) -> None:
    assert abs(deepest(sizes, calls) - expected) <= 1
