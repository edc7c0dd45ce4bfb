"""Try random programs on two engines: python -m lfield.testing.fuzz --count 1000 --seed 1

Each program of L is tried as it is, and changed a little more each time (`--mutants`). A difference is shrunk
and printed; the same seed finds it again.
"""

from __future__ import annotations

import argparse
import importlib
import random
import re
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass

from lfield.bytecode.disassemble import disassemble
from lfield.bytecode.program import Program
from lfield.errors import ProgramError
from lfield.testing.fuzz.mutations import Edit, edited, random_edits
from lfield.testing.fuzz.programs import random_program
from lfield.testing.fuzz.shrinking import shrink, shrunk_edits
from lfield.testing.fuzz.trial import Outcome, deployed, tried
from lfield.testing.golden import compile_text
from lfield.vm.contract import Engines

#: Seconds between two lines of progress.
_EVERY = 20.0


@dataclass
class Tally:
    """What was done."""

    programs: int = 0
    instructions: int = 0
    slices: int = 0
    found: int = 0

    def add(self, outcome: Outcome) -> None:
        """Count a trial."""
        self.programs += 1
        self.instructions += outcome.instructions
        self.slices += outcome.slices

    def line(self, seconds: float) -> str:
        """Progress, as it is printed."""
        return (
            f"{self.programs} programs, {self.instructions} instructions, {self.slices} slices, "
            f"{self.programs / max(seconds, 0.001):.1f} programs/s, {self.found} differences"
        )


class Fuzz:
    """Tries the programs of seeds on one engine."""

    def __init__(self, engines: Engines, mutants: int) -> None:
        self._engines, self._mutants = engines, mutants
        self.tally = Tally()

    def seed(self, seed: int) -> Iterator[str]:
        """Try one program and its mutants; a report for each difference."""
        piece = random_program(random.Random(seed))
        program, team = compile_text(piece.text()), deployed(piece.text())
        outcome = tried(program, team, seed, self._engines)
        self.tally.add(outcome)
        if outcome.differences:
            self.tally.found += 1
            yield self._shrunk(seed)
            return
        mutant, edits = program, list[Edit]()
        for number in range(self._mutants):
            dice = random.Random(f"{seed} {number}")
            mutant, edits = random_edits(program, dice, dice.choice((1, 1, 2, 4)), mutant, edits)
            outcome = tried(mutant, team, seed + number, self._engines)
            self.tally.add(outcome)
            if outcome.differences:
                self.tally.found += 1
                yield self._shrunk_mutant(program, team, edits, seed, number)
                return

    def _shrunk(self, seed: int) -> str:
        piece = random_program(random.Random(seed))

        def outcome() -> Outcome | None:
            try:
                program = compile_text(piece.text())
                return tried(program, deployed(piece.text()), seed, self._engines)
            except (ProgramError, StopIteration):
                return None

        shrink(piece, lambda: (found := outcome()) is not None and found.differences != ())
        found = outcome()
        assert found is not None
        first = found.differences[0]
        return f"seed {seed}: {first}\n{piece.text()}\n{around(compile_text(piece.text()), first)}"

    def _shrunk_mutant(
        self, program: Program, team: list[tuple[str, str, str]], edits: list[Edit], seed: int, number: int
    ) -> str:
        def outcome(kept: list[Edit]) -> Outcome | None:
            mutant = edited(program, kept)
            return None if mutant is None else tried(mutant, team, seed + number, self._engines)

        kept = shrunk_edits(edits, lambda e: (found := outcome(e)) is not None and found.differences != ())
        found, mutant = outcome(kept), edited(program, kept)
        assert found is not None
        assert mutant is not None
        changes = "\n".join(str(edit) for edit in kept)
        first = found.differences[0]
        return f"seed {seed}, mutant {number}: {first}\n{changes}\n{around(mutant, first)}"


def around(program: Program, difference: str) -> str:
    """The listing of the method that a difference speaks of."""
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


def main(words: list[str]) -> int:
    """The command; 1 when engines differ."""
    parser = argparse.ArgumentParser(prog="python -m lfield.testing.fuzz", description=__doc__)
    parser.add_argument("--count", type=int, default=1000, help="programs, mutants included")
    parser.add_argument("--seed", type=int, default=1, help="the first one; the next programs have the next")
    parser.add_argument("--mutants", type=int, default=4, help="of each program")
    parser.add_argument("--seconds", type=float, default=1e9, help="stop after so many")
    parser.add_argument("--engine", default="lfield.vm.wasm.engine:Eager", help="what is compared")
    parser.add_argument("--most", type=int, default=5, help="stop after so many differences")
    args = parser.parse_args(words)
    fuzz = Fuzz(engine_named(args.engine), args.mutants)
    began = said = time.monotonic()
    seed = args.seed
    while fuzz.tally.programs < args.count and fuzz.tally.found < args.most:
        for report in fuzz.seed(seed):
            print(report, flush=True)
        seed += 1
        now = time.monotonic()
        if now - said >= _EVERY:
            print(f"seed {seed}: {fuzz.tally.line(now - began)}", flush=True)
            said = now
        if now - began >= args.seconds:
            break
    print(fuzz.tally.line(time.monotonic() - began))
    return 1 if fuzz.tally.found else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
