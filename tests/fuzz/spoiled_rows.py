"""Changes the table of the WebAssembly engine, row by row, and reports faults that random programs miss.

    python tests/fuzz/spoiled_rows.py [PROGRAMS]

One word of a row is replaced, or an exit line is omitted. An undetected fault is not reached by the fuzzer,
or has no effect.
"""

from __future__ import annotations

import random
import sys
from collections.abc import Iterator

from engine_fuzzer.engine_trial import compiled, run_trial
from engine_fuzzer.program_generator import random_program
from lfield.bytecode.opcodes import BY_CODE
from lfield.bytecode.program import Program
from lfield.vm.wasm import machine_code
from lfield.vm.wasm.lowering.instruction_table import ROWS
from lfield.vm.wasm.wasm_engine import WasmEngine

#: Words and their replacements.
_WORDS = {
    **{f"{kind}.add": f"{kind}.sub" for kind in ("i64", "f64")},
    **{f"{kind}.sub": f"{kind}.add" for kind in ("i64", "f64")},
    **{"f64.mul": "f64.div", "f64.div": "f64.mul", "f64.neg": "f64.abs", "mul_wide_s": "mul_wide_u"},
    **{"i64.eq ": "i64.ne ", "i64.ne ": "i64.eq ", "f64.eq ": "f64.ne ", "f64.ne ": "f64.eq "},
    **{f"{k}.{a}": f"{k}.{b}" for k in ("i64", "f64") for a, b in (("lt", "le"), ("le", "lt"), ("gt", "ge"))},
    **{
        "f64.ge": "f64.gt",
        "i64.ge": "i64.gt",
        "i64.and": "i64.or",
        "i64.or": "i64.and",
    },
    **{
        "offset=8": "offset=16",
        "i64.div_s": "i64.div_u",
        "i64.rem_s": "i64.rem_u",
        "(i64.const 1)": "(i64.const 2)",
    },
}


def spoiled(row: str) -> Iterator[tuple[str, str]]:
    """The row with one fault, and its description."""
    for word, other in _WORDS.items():
        if word in row:
            yield row.replace(word, other, 1), f"{word} for {other}"
    lines = row.splitlines()
    for at, line in enumerate(lines):
        if line.strip().startswith(("leave", "null")):
            yield "\n".join([*lines[:at], *lines[at + 1 :]]), f"without '{line.strip()[:60]}'"


def noticed(programs: list[tuple[Program, str]], opcode: str) -> int:
    """The number of the first program that shows the fault, or -1."""
    for seed, (program, text) in enumerate(programs):
        if any(BY_CODE[quad.op].name == opcode for quad in program.quads):
            machine_code._recent.clear()
            if run_trial(program, text, seed, WasmEngine).differences:
                return seed
    return -1


def main(count: int) -> None:
    """Try every fault of every row."""
    texts = [random_program(random.Random(seed)).text() for seed in range(count)]
    programs = [(compiled(text), text) for text in texts]
    made_count = missed = 0
    for opcode, row in list(ROWS.items()):
        for wrong, how in spoiled(row):
            ROWS[opcode] = wrong
            made_count += 1
            if noticed(programs, opcode) < 0:
                missed += 1
                print(f"{opcode}: {how}: not noticed", flush=True)
        ROWS[opcode] = row
    print(f"{made_count} mistakes, {missed} not noticed by {count} programs")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 60)
