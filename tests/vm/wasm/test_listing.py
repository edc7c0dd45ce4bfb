"""`lfield disasm --wasm`: the executed module, with the instructions and the lines of L."""

from __future__ import annotations

from pathlib import Path

import pytest

from lfield.bytecode.disassembler import disassemble
from lfield.mission.loader import load_program
from lfield.testing.golden import compile_text
from lfield.vm.reference.step_compiler import prepare
from lfield.vm.wasm.lowering import module_lowering as lowering
from lfield.vm.wasm.wasm_listing import listing
from switching_engine import NEEDED

wasmtime = pytest.importorskip("wasmtime", reason=NEEDED)

EXAMPLES = Path(__file__).parents[3] / "examples"
PROGRAM = compile_text(
    """
    resource R {
      init(string[] arg) {
        int sum = 0;
        for (int i = 0; i < 3; i = i + 1) {
          sum = sum + twice(i);
        }
        print(";; (" + i2s(sum)); // \x1b[31m \u202e ;; end
      }
      private int twice(int n) { return 2 * n; }
    }
    """
)


@pytest.mark.few(1)
@pytest.mark.parametrize("name", ["02-equivalent-lift", "05-two-carry-one", "15-tuple-space"])
def test_the_listing_is_the_executed_module(name: str) -> None:
    (path,) = (EXAMPLES / name).glob("*.dL")
    program = load_program(path)
    assert wasmtime.wat2wasm(listing(program)) == wasmtime.wat2wasm(
        lowering.lower_program(prepare(program)).text
    )


def test_every_compiled_instruction_is_above_its_text() -> None:
    wasm = [line.strip() for line in listing(PROGRAM).splitlines()]
    expected = [line.strip() for line in disassemble(PROGRAM).splitlines() if " ^" in line and ", " in line]
    assert len(expected) > 10
    assert [line for line in expected if not any(w.endswith(line) for w in wasm if w.startswith(";;"))] == []
    at = next(i for i, line in enumerate(wasm) if line.endswith("sum = sum + twice(i);"))
    assert wasm[at].startswith(";; golden.L:6  ")
    assert "push" in wasm[at + 1]
    assert ";; R.init" in wasm
    assert wasmtime.wat2wasm(listing(PROGRAM)) == wasmtime.wat2wasm(
        lowering.lower_program(prepare(PROGRAM)).text
    )


def test_the_listing_has_no_control_characters() -> None:
    assert all(line.isprintable() for line in listing(PROGRAM).splitlines())


def test_nested_lines_are_indented() -> None:
    lines = listing(PROGRAM).splitlines()
    at = next(i for i, line in enumerate(lines) if line.strip().startswith("loop $l-"))
    depth = len(lines[at]) - len(lines[at].lstrip())
    inside = next(i for i in range(at, len(lines)) if lines[i] == f"{' ' * depth}end")
    assert inside > at + 5
    assert all(line.startswith(" " * depth + "  ") for line in lines[at + 1 : inside])
    assert (lines[0], lines[-1]) == ("(module $program", ")")


def test_methods_left_out_are_listed_with_the_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lowering, "MAX_FUNCTION_TEXT", 2500)
    output = listing(PROGRAM)
    reason = "its code is too long for WebAssembly"
    assert f"  ;; R.init is executed by the reference engine: {reason}\n" in output
    assert ";; R.twice is left" not in output
    wasmtime.wat2wasm(output)


def test_the_executed_module_has_no_comments() -> None:
    assert ";; golden.L" not in lowering.lower_program(prepare(PROGRAM)).text
