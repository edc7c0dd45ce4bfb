"""Properties of the engine: its transitions to the reference engine, its limits, and its failures."""

from __future__ import annotations

import random
from itertools import count
from math import factorial
from pathlib import Path

import msgspec
import pytest

from lfield.bytecode.opcodes import BY_NAME
from lfield.bytecode.program import ARRAY as TYPE_OF_ARRAYS
from lfield.bytecode.program import INT, Debug, Program, Quad, encode_quads
from lfield.clock import ManualClock
from lfield.testing.golden import GoldenWorld, compile_text, run_until_idle, team_for
from lfield.vm.agent import MachineTeam, TeamMember
from lfield.vm.engine_interface import (
    BUDGET_EXHAUSTED,
    AgentLimits,
    Engines,
    HeapExhausted,
    ThreadDone,
    UncaughtThrow,
)
from lfield.vm.machine import Machine
from lfield.vm.memory.block import Block
from lfield.vm.memory.collector import collect
from lfield.vm.memory.layout import ARRAY, FRAME_SLOTS, OBJECT, THREAD_FRAME, THREAD_ID
from lfield.vm.memory.threads import place_of, thread_template
from lfield.vm.reference import ReferenceEngine as Reference
from switching_engine import NEEDED, SwitchingEngine, switching

wasmtime = pytest.importorskip("wasmtime", reason=NEEDED)

from lfield.vm.wasm.wasm_engine import MAX_STRETCH_SECONDS  # noqa: E402
from lfield.vm.wasm.wasm_engine import EagerWasmEngine as Engine  # noqa: E402
from lfield.vm.wasm.wasm_engine import WasmEngine as Patient  # noqa: E402

EXAMPLES = Path(__file__).parents[3] / "examples"

COUNTING = compile_text(
    """
    resource Counter {
      init(string[] arg) {
        int sum = 0;
        for (int i = 0; i < 1000; i = i + 1) { if (i % 3 == 0) sum = sum + deep(i % 7); else sum = sum - 1; }
        print(sum);
      }
      private int deep(int n) { if (n == 0) return 1; return n * deep(n - 1); }
    }
    """
)


def machine_of(
    program: Program, engines: Engines, team: list[TeamMember] | None = None
) -> tuple[GoldenWorld, Machine]:
    """A machine with all agents of a program started."""
    desk, clock = GoldenWorld(), ManualClock()
    members = team or team_for(program, [])
    machine = desk.machine = Machine(
        program, MachineTeam(members, 0, 1), desk, clock, random.Random(1), engines=engines
    )
    for member in members:
        machine.start(member, AgentLimits(), 1)
    run_until_idle(machine, clock)
    return desk, machine


def thread_of(
    program: Program, engine: Engine | Reference, method: int, words: int = 4096
) -> tuple[Block, int]:
    """A block with one thread that begins a method on a new object, and the thread's place."""
    block = Block.empty(program.digest, words, engine.space)
    record = program.core.methods[method]
    own = block.allocate(OBJECT, record.owner, engine.layouts.class_words[record.owner])
    template = thread_template(method, engine.layouts.frame_words[method], record.entry + 1)
    identity = block.new_thread(template, [own, 0], 0)
    return block, place_of(block, identity)


@pytest.mark.parametrize("budget", [1, 2, 3, 5, 8, 13, 100, 1000])
def test_a_budget_ends_at_the_same_instruction(budget: int) -> None:
    images = []
    method = next(i for i, m in enumerate(COUNTING.core.methods) if m.name == "init")
    for engine in (Reference(COUNTING, float), Engine(COUNTING, float), Patient(COUNTING, float)):
        block, thread = thread_of(COUNTING, engine, method)
        observed = []
        for _ in range(20):
            leave = engine.run(block, thread, budget, AgentLimits())
            observed.append((leave, engine.unused_budget, bytes(block.image())))
            if leave != BUDGET_EXHAUSTED:
                break
        images.append(observed)
    assert images[0] == images[1] == images[2]


@pytest.mark.parametrize(
    "body",
    [
        "try { try { i = none[i]; } finally { i = i + 1; } } catch (NullException e) { i = i + 1; }",
        "try { throw new Exception(f2s(1.5)); } catch (Exception e) { i = i + 1; }",
        "text = f2s(1.5);",
        "i = long.length();",
        "if (long == other) i = i + 1;",
        "if (long < other) i = i + 1;",
        "text = long.substring(3, 4);",
        'text = long + "x";',
        'i = long.indexOf("aab");',
        "some = new int[10000];",
    ],
)
def test_long_operations_reduce_the_number_of_instructions(body: str) -> None:
    """The guards treat a silent host as dead: no run may take too long."""
    program = compile_text(
        f"""
        resource R {{
          string long; string other; int[] some;
          init(string[] arg) {{ }}
          private void run() {{
            int i = 0; string text; int[] none;
            long = "a"; while (long.length() < 2000) long = long + long;
            other = "" + long;
            while (true) {{ {body} }}
          }}
        }}
        """
    )
    method = next(i for i, m in enumerate(program.core.methods) if m.name == "run")
    polls = count()
    engine = Engine(program, lambda: next(polls) / 1000.0)
    block, thread = thread_of(program, engine, method, 1 << 17)
    identity = block.w[thread + THREAD_ID]
    for _ in range(40):
        engine.run(block, place_of(block, identity), 100, AgentLimits())
        collect(block, engine.layouts, 1 << 16)
    thread = place_of(block, identity)
    before = next(polls)
    assert engine.run(block, thread, 100_000, AgentLimits()) is BUDGET_EXHAUSTED
    assert engine.unused_budget > 90_000
    assert next(polls) - before <= 1000 * MAX_STRETCH_SECONDS + 3


@pytest.mark.parametrize(
    "body",
    [
        "return new Node();",
        "int[] found = new int[3]; return null;",
        """string found = "found"; return null;""",
        "return deep(n);",
        "int found = n / (n - n); return null;",
        "int found = numbers[n + 7]; return null;",
    ],
)
@pytest.mark.parametrize("above", [0, 1, 40])
def test_nothing_is_made_where_the_heap_ends_below_its_top(body: str, above: int) -> None:
    """The exception may lie above the limit (`Block.use_reserve`), and the code that catches it continues."""
    program = compile_text(
        f"""
        class Node {{ private int n; private Node next; }}
        resource R {{
          int[] numbers;
          init(string[] arg) {{ numbers = new int[1]; }}
          private Node run() {{ int n = 1; {body} }}
          private Node deep(int n) {{ return null; }}
        }}
        """
    )
    method = next(i for i, m in enumerate(program.core.methods) if m.name == "run")
    types = program.core.types
    index = next(i for i, t in enumerate(types) if t.kind == TYPE_OF_ARRAYS and types[t.of].kind == INT)
    observed = []
    for engine in (Reference(program, float), Engine(program, float)):
        block, thread = thread_of(program, engine, method)
        own = block.w[block.w[thread + THREAD_FRAME] + FRAME_SLOTS]
        block.w[own + 1] = block.allocate(ARRAY, index, 2)
        block.end = block.top - above
        observed.append((engine.run(block, thread, 100, AgentLimits()), bytes(block.image())))
    assert observed[0] == observed[1]
    assert isinstance(observed[0][0], UncaughtThrow if "n +" in body or "n -" in body else HeapExhausted)


def test_a_few_instructions_do_not_enter_webassembly(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    program = compile_text(
        """
        resource Store { init(string[] arg) { } portal ask(int n) emit int { return n; } }
        coordinator Clerk {
          init(string[] arg) {
            Store store = findStore("store");
            int sum = 0;
            for (int i = 0; i < 100; i = i + 1) sum = sum + store.ask(i);
            print(i2s(sum));
          }
        }
        """
    )
    entered = []
    of_engine = Patient._continue
    monkeypatch.setattr(Patient, "_continue", lambda *given: entered.append(given) or of_engine(*given))
    desk, _ = machine_of(program, Patient)
    assert (desk.output, entered) == (["4950"], [])


def test_most_of_the_work_is_done_in_webassembly(monkeypatch: pytest.MonkeyPatch) -> None:
    granted: list[int] = []
    of_reference = Reference.run

    def counted(self: Reference, *args: object, **options: object) -> object:
        leave = of_reference(self, *args, **options)  # type: ignore[arg-type]  # as it was called
        granted.append(args[2] - self.unused_budget)  # type: ignore[operator]  # the budget
        return leave

    monkeypatch.setattr(Reference, "run", counted)
    desk, _ = machine_of(COUNTING, Engine)
    expected = sum(factorial(i % 7) if i % 3 == 0 else -1 for i in range(1000))
    assert desk.output == [str(expected)]
    assert sum(granted) < 100


def test_a_block_outside_the_arena_is_run_by_the_reference_engine() -> None:
    engine = Engine(COUNTING, float)
    method = next(i for i, m in enumerate(COUNTING.core.methods) if m.name == "init")
    inside, thread = thread_of(COUNTING, engine, method)
    outside = Block(bytearray(inside.data), inside.top, inside.limit)
    for block in (inside, outside):
        assert engine.run(block, thread, 700, AgentLimits()) == BUDGET_EXHAUSTED
    assert bytes(inside.image()) == bytes(outside.image())


DEEP = """
resource R {
  init(string[] arg) {
    print(down(%d));
    try { print(down(%d)); } catch (LimitException e) { print(e.message()); }
  }
  private int down(int n) { if (n == 0) return 0; return 1 + down(n - 1); }
}
"""


def test_calls_may_be_deeper_than_the_stack_of_webassembly() -> None:
    program = compile_text(DEEP % (40_000, 60_000))
    desk, clock = GoldenWorld(), ManualClock()
    member = team_for(program, [])[0]
    machine = desk.machine = Machine(
        program, MachineTeam([member], 0, 1), desk, clock, random.Random(1), engines=Engine
    )
    machine.start(member, AgentLimits(heap=16 << 20, call_depth=50_000), 1)
    for _ in range(50):
        machine.run()
    assert desk.output == ["40000", "calls are nested deeper than 50000"]


def test_a_trap_of_webassembly_is_a_bug_that_ends_only_the_agent(monkeypatch: pytest.MonkeyPatch) -> None:
    program = compile_text(
        """
        resource Bad { init(string[] arg) { int i = 1; while (i > 0) i = i + 1; } }
        resource Good { init(string[] arg) { sleep(1.0); print("still here"); } }
        """
    )
    desk, clock = GoldenWorld(), ManualClock()
    members = team_for(program, [])
    machine = desk.machine = Machine(
        program, MachineTeam(members, 0, 1), desk, clock, random.Random(1), engines=Engine
    )
    for member in members:
        machine.start(member, AgentLimits(), 1)
    assert isinstance(machine.engine, Engine)
    enter = machine.engine._enter
    calls = iter([True])

    def broken() -> int:
        if next(calls, False):
            raise wasmtime.Trap("out of bounds memory access")
        return enter()

    monkeypatch.setattr(machine.engine, "_enter", broken)
    run_until_idle(machine, clock)
    assert desk.output == ["still here"]
    assert [agent.id for agent in desk.endings if agent.ended == "died"] == ["bad"]
    assert desk.endings[0].report.startswith("bug in lfield: Trap: out of bounds memory access")


def test_a_loop_with_two_entries_is_left_to_the_reference_engine() -> None:
    """The verifier accepts such a program, although the compiler does not generate it."""
    core = COUNTING.core
    method = next(m for m in core.methods if m.name == "init")
    quads = list(COUNTING.quads)
    jump, move, branch = (BY_NAME[name].code for name in ("jmp", "move", "bz"))
    start = method.entry + 1
    integer = next(i for i, t in enumerate(method.slots) if core.types[t].kind == 2)
    truth = next(i for i, t in enumerate(method.slots) if core.types[t].kind == 1)
    constant = next(-1 - i for i, c in enumerate(core.constants) if type(c) is int)
    code = [
        Quad(branch, start + 3, truth, 0),
        Quad(move, integer, constant, 0),  # one way into the loop
        Quad(jump, start + 4, 0, 0),
        Quad(move, integer, constant, 0),  # the other
        Quad(branch, start + 3, truth, 0),
        Quad(BY_NAME["rtn"].code, 0, 0, 0),
    ]
    assert len(code) <= method.end - start
    quads[start : start + len(code)] = code
    changed = msgspec.structs.replace(core, code=encode_quads(quads))
    program = Program(changed, Debug((), ()), b"\1" * 32)
    engine = Engine(program, float)
    index = core.methods.index(method)
    assert start not in engine.points
    images = []
    for one in (Reference(program, float), engine):
        block, thread = thread_of(program, one, index)
        images.append((one.run(block, thread, 50, AgentLimits()), one.unused_budget, bytes(block.image())))
    assert images[0] == images[1]


@pytest.mark.parametrize("name", ["10-client-server", "11-multiple-tiers", "12-peer-to-peer"])
@pytest.mark.parametrize("seed", [1, 2])
def test_the_programs_of_the_thesis_may_change_engines_anywhere(name: str, seed: int) -> None:
    program = compile_text((EXAMPLES / name / "mission.L").read_text())
    deployed = [
        line[2:] for line in (EXAMPLES / name / "mission.dL").read_text().splitlines() if line[:2] == "//"
    ]
    team = []
    for line in deployed:
        kind, _, rest = line.partition(":")
        identity, _, more = rest.partition("@")
        team.append((kind, identity, more.partition("?")[2]))
    members = team_for(program, team)
    outputs = []
    engines: list[SwitchingEngine] = []
    for make in (Reference, switching(Engine, seed)):
        desk, machine = machine_of(program, make, members)
        outputs.append(desk.output)
        if isinstance(machine.engine, SwitchingEngine):
            engines.append(machine.engine)
    assert outputs[0] == outputs[1]
    assert outputs[0]
    assert min(engines[0].given) > 10


def test_the_result_of_a_thread_is_its_word() -> None:
    program = compile_text(
        "resource R { init(string[] arg) { } private real half(int n) { return n / 2.0; } }"
    )
    method = next(i for i, m in enumerate(program.core.methods) if m.name == "half")
    words = []
    for engine in (Reference(program, float), Engine(program, float)):
        block, thread = thread_of(program, engine, method)
        leave = engine.run(block, thread, 100, AgentLimits())
        assert isinstance(leave, ThreadDone)
        words.append((leave.word, bytes(block.image())))
    assert words[0] == words[1]


def test_no_code_is_made_for_methods_of_classes_that_no_method_calls() -> None:
    """Most missions use few methods of a map; all of resources and coordinators are compiled."""
    program = compile_text(
        """
        resource R {
          init(string[] arg) { map<string, int> m = new map<string, int>(); m["a"] = 3; print(m["a"]); }
          private void alone() { }
        }
        """
    )
    engine = Engine(program, ManualClock().now)
    methods = {m.name: range(m.entry, m.end) for m in program.core.methods}
    compiled = {name for name, code in methods.items() if any(pc in engine.points for pc in code)}
    assert {"init", "alone", "get", "set", "move"} <= compiled
    assert methods.keys() - compiled == {"remove", "keys", "values", "contains", "length"}
    desk, _ = machine_of(program, Engine)
    assert desk.output == ["3"]
