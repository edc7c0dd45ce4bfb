"""Run random programs on two engines: python tests/fuzz/fuzz.py --count 1000 --seed 1

Each L program is run unchanged, then with a growing number of changes (`--mutants`). A difference is printed
with the command that reproduces it, and again after the reduction, which may take minutes: Ctrl-C prints the
current reduction.
"""

from __future__ import annotations

import argparse
import gc
import importlib
import random
import re
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass

from engine_fuzzer.engine_trial import TrialOutcome, compiled, run_trial
from engine_fuzzer.mutations import Edit, changed_methods, edited, random_edits
from engine_fuzzer.program_generator import random_program
from engine_fuzzer.program_shrinker import shrink, shrunk_edits
from engine_fuzzer.program_tree import ProgramPiece
from lfield.bytecode.disassembler import disassemble
from lfield.bytecode.program import Program
from lfield.errors import ProgramError
from lfield.exit_status import INTERRUPTED
from lfield.vm.engine_interface import Engines
from quick_code import partly_compiled, quick_code

#: Seconds between two lines of progress.
_EVERY = 20.0
#: One of this many seeds is compiled with the settings of the product.
_OPTIMISED_EVERY = 20


@dataclass
class FuzzTally:
    """Counts of trials."""

    programs: int = 0
    instructions: int = 0
    slices: int = 0
    found: int = 0

    def add(self, outcome: TrialOutcome) -> None:
        """Count a trial."""
        self.programs += 1
        self.instructions += outcome.instructions
        self.slices += outcome.slices

    def line(self, seconds: float) -> str:
        """The progress line."""
        return (
            f"{self.programs} programs, {self.instructions} instructions, {self.slices} slices, "
            f"{self.programs / max(seconds, 0.001):.1f} programs/s, {self.found} differences"
        )


class EngineFuzzer:
    """Runs the programs of seeds on one engine."""

    def __init__(self, engines: Engines, mutants: int) -> None:
        self._engines, self._mutants = engines, mutants
        self.tally = FuzzTally()

    def seed(self, seed: int) -> Iterator[str]:
        """Run one program and its mutants; report a difference immediately, and again when it is reduced.

        A KeyboardInterrupt during the reduction is raised after the second report, with the current
        reduction.
        """
        with nullcontext() if seed % _OPTIMISED_EVERY == 0 else quick_code():
            yield from self._trials(seed)

    def _trials(self, seed: int) -> Iterator[str]:
        piece = random_program(random.Random(seed))
        text = piece.text()
        program = compiled(text)
        outcome = run_trial(program, text, seed, self._engines)
        self.tally.add(outcome)
        if outcome.differences:
            yield self._found(f"seed {seed}", seed, outcome)
            yield from self._shrunk(piece, seed)
            return
        mutant, edits = program, list[Edit]()
        for number in range(self._mutants):
            rng = random.Random(f"{seed} {number}")
            mutant, edits = random_edits(program, rng, rng.choice((1, 1, 2, 4)), mutant, edits)
            with partly_compiled(changed_methods(mutant, edits)):
                outcome = run_trial(mutant, text, seed + number, self._engines)
            self.tally.add(outcome)
            if outcome.differences:
                yield self._found(f"seed {seed}, mutant {number}", seed, outcome)
                yield from self._shrunk_mutant(program, text, edits, seed, number)
                return

    def _found(self, what: str, seed: int, outcome: TrialOutcome) -> str:
        self.tally.found += 1
        engine = f"{self._engines.__module__}:{getattr(self._engines, '__qualname__', '')}"
        again = f"--count 1 --seed {seed} --mutants {self._mutants} --engine {engine}"
        return f"{what}: {outcome.differences[0]}\n  again: python tests/fuzz/fuzz.py {again}"

    def _shrunk(self, piece: ProgramPiece, seed: int) -> Iterator[str]:
        smallest = SmallestFailure(self._engines, f"seed {seed}", seed)

        def shows() -> bool:
            text = piece.text()
            try:
                return smallest.shows(compiled(text), text, text)
            except (ProgramError, StopIteration):
                return False

        return smallest.after(lambda: shrink(piece, shows))

    def _shrunk_mutant(
        self, program: Program, text: str, edits: list[Edit], seed: int, number: int
    ) -> Iterator[str]:
        smallest = SmallestFailure(self._engines, f"seed {seed}, mutant {number}", seed + number)

        def shows(kept: list[Edit]) -> bool:
            mutant = edited(program, kept)
            if mutant is None:
                return False
            with partly_compiled(changed_methods(mutant, kept)):
                return smallest.shows(mutant, text, "\n".join(map(str, kept)))

        return smallest.after(lambda: shrunk_edits(edits, shows))


class SmallestFailure:
    """The smallest program with a difference so far, and its report."""

    def __init__(self, engines: Engines, what: str, seed: int) -> None:
        self._engines, self._what, self._seed = engines, what, seed
        self._report = f"{what}: nothing can be left out"

    def shows(self, program: Program, text: str, written: str) -> bool:
        """Return true if the program shows a difference, which is then reported with the text `written`."""
        differences = run_trial(program, text, self._seed, self._engines).differences
        if differences:
            self._report = (
                f"{self._what}, smaller: "
                f"{differences[0]}\n{written}\n{listing_around(program, differences[0])}"
            )
        return differences != ()

    def after(self, work: Callable[[], object]) -> Iterator[str]:
        """The report after the reduction, or after a KeyboardInterrupt during the reduction."""
        try:
            work()
        except KeyboardInterrupt:
            yield self._report
            raise
        yield self._report


def listing_around(program: Program, difference: str) -> str:
    """The listing of the method that a difference names."""
    text = disassemble(program)
    named = re.search(r"from instruction (\d+)", difference)
    if named is None:
        return text
    pc = int(named[1])
    parts = text.split("\n\n")
    return next((part for part in parts if re.search(rf"^ *L?{pc}  ", part, re.MULTILINE)), text)


def engine_named(name: str) -> Engines:
    """The engine of a `module:class`."""
    module, _, attribute = name.partition(":")
    engines: Engines = getattr(importlib.import_module(module), attribute)
    return engines


def main(argv: list[str]) -> int:
    """Run the command; returns 1 when engines differ, INTERRUPTED after Ctrl-C, otherwise 0."""
    parser = argparse.ArgumentParser(prog="python tests/fuzz/fuzz.py", description=__doc__)
    parser.add_argument("--count", type=int, default=1000, help="programs, mutants included")
    parser.add_argument("--seed", type=int, default=1, help="the first one; the next programs have the next")
    parser.add_argument("--mutants", type=int, default=4, help="of each program")
    parser.add_argument("--seconds", type=float, default=1e9, help="stop after so many")
    parser.add_argument(
        "--engine", default="lfield.vm.wasm.wasm_engine:EagerWasmEngine", help="what is compared"
    )
    parser.add_argument("--most", type=int, default=5, help="stop after so many differences")
    args = parser.parse_args(argv)
    fuzz = EngineFuzzer(engine_named(args.engine), args.mutants)
    started, status = time.monotonic(), 0
    gc.freeze()
    try:
        _try(fuzz, args, started)
    except KeyboardInterrupt:
        status = INTERRUPTED
    finally:
        gc.unfreeze()
    print(fuzz.tally.line(time.monotonic() - started))
    return 1 if fuzz.tally.found else status


@contextmanager
def _collected_after() -> Iterator[None]:
    """Defer Python's garbage collection, a fifth of the run time, to the end of the context."""
    gc.disable()
    try:
        yield
    finally:
        gc.enable()
        gc.collect()


def _try(fuzz: EngineFuzzer, args: argparse.Namespace, started: float) -> None:
    """Run seeds in sequence until the count or time is reached."""
    seed, last_report = args.seed, started
    while fuzz.tally.programs < args.count and fuzz.tally.found < args.most:
        with _collected_after():
            for report in fuzz.seed(seed):
                print(report, flush=True)
        seed += 1
        now = time.monotonic()
        if now - last_report >= _EVERY:
            print(f"seed {seed}: {fuzz.tally.line(now - started)}", flush=True)
            last_report = now
        if now - started >= args.seconds:
            break
