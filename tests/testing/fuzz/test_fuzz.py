"""The fuzzer finds what is planted, says nothing of engines that are alike, and shrinks what it finds."""

from __future__ import annotations

import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lfield.testing.engines import NEEDED

pytest.importorskip("wasmtime", reason=NEEDED)

from planted_engines import PLANTED, WrongOpcode

from lfield.testing.fuzz.__main__ import Fuzz, main
from lfield.testing.fuzz.mutations import edited, random_edits
from lfield.testing.fuzz.programs import random_program
from lfield.testing.fuzz.trial import tried
from lfield.testing.golden import compile_text
from lfield.vm.reference import Engine
from lfield.vm.wasm.engine import Eager as Wasm

#: Programs in which a planted fault must be found.
_SOON = 400


@pytest.mark.parametrize("planted", PLANTED)
def test_a_planted_fault_is_found(planted: type[Engine]) -> None:
    seeds = iter(range(_SOON))
    while True:
        piece = random_program(random.Random(seed := next(seeds)))
        outcome = tried(compile_text(piece.text()), piece.text(), seed, planted)
        if outcome.differences:
            return


def test_an_engine_does_what_it_does_itself() -> None:
    fuzz = Fuzz(Engine, mutants=3)
    assert [report for seed in range(10) for report in fuzz.seed(seed)] == []
    assert fuzz.tally.programs == 40
    assert fuzz.tally.slices > 200


def test_the_engine_in_webassembly_does_the_same() -> None:
    """`python -m lfield.testing.fuzz` tries as many as there is time for."""
    fuzz = Fuzz(Wasm, mutants=3)
    assert [report for seed in range(8) for report in fuzz.seed(seed)] == []


@given(st.randoms(use_true_random=False), st.integers(0, 1000))
@settings(deadline=None, max_examples=20)
def test_the_engines_do_the_same_whatever_hypothesis_thinks_of(dice: random.Random, seed: int) -> None:
    text = random_program(dice).text()
    assert tried(compile_text(text), text, seed, Wasm).differences == ()


def test_a_difference_is_shrunk(capsys: pytest.CaptureFixture[str]) -> None:
    engine = f"{WrongOpcode.__module__}:{WrongOpcode.__name__}"
    assert main(["--count", "50", "--seed", "3", "--mutants", "0", "--most", "1", "--engine", engine]) == 1
    report = capsys.readouterr().out
    program = report[report.index("// deploy") : report.index("\n\n")]
    whole = random_program(random.Random(int(report.split()[1].rstrip(":")))).text()
    assert len(program) < len(whole) / 2
    assert "1 differences" in report


def test_mutants_are_programs() -> None:
    """The verifier accepts them, and they are other programs."""
    program = compile_text(random_program(random.Random(5)).text())
    mutant, edits = random_edits(program, random.Random(6), 8)
    assert len(edits) >= 4
    assert mutant.digest != program.digest
    again = edited(program, edits)
    assert again is not None
    assert again.digest == mutant.digest
