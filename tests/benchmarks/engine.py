"""The engine's speed: run time of the same algorithms in L and in CPython, and instructions per second.

An instruction is one step of the engine; a group of quads that the engine does at once (a call with its
arguments) counts as one. They are counted in a run of their own, which is not timed.
"""

from __future__ import annotations

from functools import partial

from algorithms import ALGORITHMS, Algorithm
from harness import Figure, Row, in_turns, median, milliseconds, percentile, play, stage, timed, times

from lfield.bytecode.program import Program
from lfield.testing.golden import compile_text
from lfield.vm.reference.registers import Registers, Step

ROUNDS = 9


def figure() -> Figure:
    """All algorithms."""
    rows = [row for algorithm in ALGORITHMS for row in _rows(algorithm)]
    return Figure("The same algorithm in L and in CPython; ratio to CPython", rows, (f"{ROUNDS} rounds",))


def _rows(algorithm: Algorithm) -> tuple[Row, ...]:
    program = compile_text(algorithm.source)
    instructions = count_instructions(program)
    samples = in_turns(
        {"L": partial(_run, program, algorithm), "CPython": lambda: [timed(algorithm.python)]}, ROUNDS
    )
    own, python = samples["L"], samples["CPython"]
    ratio = times(median(own) / median(python))
    speed = f"{instructions / median(own) / 1e6:.2f} M/s"
    return (
        Row(algorithm.name, "lfield: run time", *_seconds(own), ratio),
        Row("", "CPython: run time", *_seconds(python), times(1.0)),
        Row("", f"lfield: instructions per second (of {instructions})", speed),
    )


def _seconds(samples: list[float]) -> tuple[str, str]:
    return milliseconds(median(samples)), milliseconds(percentile(samples, 99))


def _run(program: Program, algorithm: Algorithm) -> list[float]:
    """Seconds one run takes by L's own clock."""
    result, seconds = play(*stage(program))
    if int(result) != algorithm.python():
        raise RuntimeError(f"{algorithm.name} gave {result} in L and {algorithm.python()} in CPython")
    return [float(seconds)]


def count_instructions(program: Program) -> int:
    """How many steps a whole run takes."""
    machine, desk = stage(program)
    count = 0

    def counted(step: Step) -> Step:
        def run(m: Registers) -> int:
            nonlocal count
            count += 1
            return step(m)

        return run

    steps = machine.engine.prepared.steps
    steps[:] = [counted(step) for step in steps]
    play(machine, desk)
    return count
