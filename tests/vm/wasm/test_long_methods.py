"""Long methods: the work of compilation is linear, and only a method that WebAssembly refuses is left out."""

from __future__ import annotations

import random
from collections.abc import Callable

import pytest

from lfield.clock import ManualClock
from lfield.testing.golden import GoldenWorld, compile_text, run_until_idle, team_for
from lfield.vm.agent import MachineTeam
from lfield.vm.engine_interface import AgentLimits, Engines
from lfield.vm.machine import Machine
from lfield.vm.reference import ReferenceEngine as Reference
from lfield.vm.reference.step_compiler import PreparedProgram
from switching_engine import NEEDED

wasmtime = pytest.importorskip("wasmtime", reason=NEEDED)

from lfield.vm.wasm.lowering import control_flow_graph  # noqa: E402
from lfield.vm.wasm.lowering import module_lowering as lowering  # noqa: E402
from lfield.vm.wasm.lowering.slot_storage import PARAMETERS  # noqa: E402
from lfield.vm.wasm.wasm_engine import EagerWasmEngine as Engine  # noqa: E402

#: Bodies of a method of a given length.
SHAPES: dict[str, Callable[[int], str]] = {
    "sums": lambda n: "".join(f"k = k * 3 % 1000 + {i};" for i in range(n)),
    "calls": lambda n: "k = h(k);" * n,
    "else if": lambda n: " else ".join(f"if (k == {i}) k = {i + 1};" for i in range(n)),
    "and": lambda n: f"if ({' && '.join(f'k != {i + 5}' for i in range(n))}) return 2;",
    "strings": lambda n: 'string s = "";' + "".join(f's = "{"x" * 120}{i}";' for i in range(n)),
    "loops": lambda n: "".join(f"while (k < {i}) k = h(k) + 1;" for i in range(n)),
    "tries": lambda n: "try { k = h(k); } catch (IndexException e) { k = 2; }" * n,
    "quotients": lambda n: "".join(
        f"try {{ k = k + 5 / {i}; }} catch (ArithmeticException e) {{ k = {i}; }}" for i in range(n)
    ),
    "breaks": lambda n: "".join(
        f"while (k > {i}) {{ if (k % {i + 2} == 0) break; k = k - 1; if (k == {i}) continue; }}"
        for i in range(n)
    ),
    "finallies": lambda n: "try { k = h(k); } finally { k = k + 2; }" * n,
    "slots": lambda n: (
        "".join(f"int a{i} = h(k);" for i in range(n)) + "".join(f"k = k + a{i};" for i in range(n))
    ),
    "arrays": lambda n: "int[] b = null;" + "b = new int[2]; b[0] = k; k = b[1];" * n,
    "returns": lambda n: "".join(f"if (k == {i + 9}) return {i};" for i in range(n)),
}  # fmt: skip


def _program(body: str, more: str = "") -> str:
    return f"""
        resource R {{
          init(string[] arg) {{ print(f(3)); }}
          private int f(int k) {{ {body} return k; }}
          private int h(int k) {{ return k; }}
          {more}
        }}
    """


def _prepared(text: str) -> PreparedProgram:
    return Reference(compile_text(text), float).prepared


def _run(text: str, engines: Engines) -> tuple[list[str], list[bytes]]:
    """The output, and the blocks at the end."""
    program, desk, clock = compile_text(text), GoldenWorld(), ManualClock()
    members = team_for(program, [])
    machine = desk.machine = Machine(
        program, MachineTeam(members, 0, 1), desk, clock, random.Random(1), engines=engines
    )
    for member in members:
        machine.start(member, AgentLimits(), 1)
    run_until_idle(machine, clock)
    assert [agent.report for agent in desk.endings if agent.ended == "died"] == []
    return desk.output, [bytes(agent.block.image()) for agent in machine.agents.values()]


def _joined(text: str) -> int:
    """Quadratic work of the compiler: locals for slots, times places where a function is left and entered."""
    functions = text.split("\n(func ")
    return max(
        f.count("(local $s") * (f.count("br $exit") + f.count("(local.set $resume")) for f in functions
    )


def _ways_out(text: str) -> int:
    """Quadratic work of the compiler as well: the places from which a function without locals goes to its
    end."""
    functions = [f for f in text.split("\n(func ") if "(local $to_i64 " in f]
    return max((f.count("br $exit") + f.count("$spill") for f in functions), default=0)


@pytest.mark.few(2)
@pytest.mark.parametrize("shape", SHAPES)
def test_the_work_is_linear_in_the_length_of_the_code(shape, steps):
    short, long = (_prepared(_program(SHAPES[shape](n))) for n in (60, 600))
    texts = []
    few, many = (steps(lambda p=p: texts.append(lowering.lower_program(p).text)) for p in (short, long))
    assert many < 12 * few
    assert len(texts[1]) < 15 * len(texts[0])
    assert _joined(texts[1]) < 20_000
    assert _ways_out(texts[1]) < 5


@pytest.mark.few(6)
@pytest.mark.parametrize("shape", SHAPES)
def test_a_long_method_has_the_same_effect(shape, monkeypatch):
    text = _program(SHAPES[shape](40))
    expected = _run(text, Reference)
    assert _run(text, Engine) == expected
    monkeypatch.setattr(control_flow_graph, "LONG_METHOD", 0)
    monkeypatch.setattr(control_flow_graph, "STRETCH", 5)
    from lfield.vm.wasm import machine_code

    machine_code._recent.clear()
    assert _run(text, Engine) == expected
    machine_code._recent.clear()


def test_every_path_through_a_long_method_has_points() -> None:
    """An `else if` chain is a single path through all tests, and each body leaves it."""
    prepared = _prepared(_program(SHAPES["else if"](600)))
    method = next(m for m in prepared.program.core.methods if m.name == "f")
    points = control_flow_graph.ControlFlowGraph(prepared, method, lambda i: True).points
    assert len(points) > 2 * 600 // control_flow_graph.STRETCH


@pytest.mark.few(1)
@pytest.mark.parametrize("count", [PARAMETERS - 1, PARAMETERS, PARAMETERS + 200])
def test_parameters_beyond_the_limit_of_webassembly_are_in_the_frame(count: int) -> None:
    takes = ", ".join(f"int p{i}" for i in range(count))
    more = f"private int g({takes}) {{ return p0 + p{count - 1}; }}"
    text = _program(f"k = g({', '.join(['k'] * count)});", more)
    assert _run(text, Engine) == _run(text, Reference)


def test_a_method_too_long_for_webassembly_is_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    from lfield.vm.wasm import machine_code

    text = _program("k = g(k);", f"private int g(int k) {{ {SHAPES['sums'](400)} return k; }}")
    expected = _run(text, Reference)
    machine_code._recent.clear()
    monkeypatch.setattr(lowering, "MAX_FUNCTION_TEXT", 200_000)
    notes: list[str] = []
    assert _run(text, lambda program, now: Engine(program, now, note=notes.append)) == expected
    assert notes == [
        "method R.g not compiled: its code is too long for WebAssembly; the reference engine runs it"
    ]
    machine_code._recent.clear()


@pytest.mark.few(0)
def test_many_slots_are_no_locals() -> None:
    text = _program("".join(f"int a{i} = k;" for i in range(3000)) + "k = a2999;")
    assert "(local $s2000 " not in lowering.lower_program(_prepared(text)).text
    assert _run(text, Engine) == _run(text, Reference)


def test_an_agent_outside_the_arena_is_logged_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lfield.vm.wasm.heap_arena.HeapArena.base", lambda self, data: -1)
    notes: list[str] = []
    text = _program("for (int i = 0; i < 50000; i = i + 1) k = h(i);")
    assert _run(text, lambda program, now: Engine(program, now, note=notes.append)) == _run(text, Reference)
    assert len(notes) == 1
    assert notes[0].startswith("r running slowly: its block of 0.0 MiB does not fit")
