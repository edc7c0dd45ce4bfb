"""The fuzzer finds planted faults, reports no difference between equal engines, and reduces findings."""

from __future__ import annotations

import random
from collections.abc import Callable

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from switching_engine import NEEDED

pytest.importorskip("wasmtime", reason=NEEDED)

from engine_fuzzer.command_line import EngineFuzzer, main
from engine_fuzzer.engine_trial import compiled, run_trial
from engine_fuzzer.mutations import edited, random_edits
from engine_fuzzer.program_generator import random_program
from engine_fuzzer.program_tree import ProgramPiece
from lfield.bytecode.opcodes import BY_CODE, TABLE
from lfield.bytecode.verifier import verify
from lfield.vm.reference import ReferenceEngine
from lfield.vm.wasm.wasm_engine import EagerWasmEngine as Wasm
from planted_engines import PLANTED, WrongOpcode
from planted_texts import FAULTS, Fault, finder

#: The number of programs within which a planted fault must be found.
_SOON = 400
#: Exceptions of hypothesis, which also reduces failures.
DICE = st.randoms(use_true_random=False)
#: Device instructions and offers within a together, which only golden programs use.
_BEYOND = {"device", "settle"}


@pytest.mark.few(2)
@pytest.mark.parametrize("planted", PLANTED)
def test_a_planted_fault_is_found(planted: type[ReferenceEngine]) -> None:
    fuzz = EngineFuzzer(planted, mutants=0)
    assert any(True for seed in range(_SOON) for _ in fuzz.seed(seed))


@pytest.mark.few(0)
@pytest.mark.parametrize("fault", FAULTS, ids=str)
def test_planted_fault_in_the_engine_text_is_found(fault: Fault) -> None:
    assert finder(fault, _SOON) is not None


@pytest.mark.few(0)
def test_programs_contain_every_instruction() -> None:
    missing = {row.name for row in TABLE} - _BEYOND
    for seed in range(_SOON):
        program = compiled(random_program(random.Random(seed)).text())
        missing -= {BY_CODE[quad.op].name for quad in program.quads}
        if not missing:
            return
    pytest.fail(f"no program has {sorted(missing)}")


@pytest.mark.few(0)
def test_engine_compared_with_itself_shows_no_difference() -> None:
    fuzz = EngineFuzzer(ReferenceEngine, mutants=3)
    assert [report for seed in range(10) for report in fuzz.seed(seed)] == []
    assert fuzz.tally.programs == 40
    assert fuzz.tally.slices > 200


def test_webassembly_engine_shows_no_difference() -> None:
    """`python tests/fuzz/fuzz.py` runs more programs."""
    fuzz = EngineFuzzer(Wasm, mutants=3)
    assert [report for seed in range(4) for report in fuzz.seed(seed)] == []


def test_a_trial_ends_before_its_clock_exceeds_64_bits() -> None:
    text = """
resource Sleeper { init(string[] arg) { } loop beat at 1.0 { sleep(1.0e10); } }
// deploy: Sleeper:s
"""
    outcome = run_trial(compiled(text), text, 1, Wasm)
    assert (outcome.differences, outcome.instructions > 20) == ((), True)


# 2,000 examples take three minutes on an idle computer, and hypothesis shrinks for up to five minutes.
@pytest.mark.few(0)
@pytest.mark.timeout(1200)
def test_engines_agree_on_programs_of_hypothesis(pytestconfig: pytest.Config) -> None:
    @given(DICE, st.integers(0, 1000))
    @settings(max_examples=2000 if pytestconfig.option.every_case else 8)
    def same(dice: random.Random, seed: int) -> None:
        text = random_program(dice).text()
        assert run_trial(compiled(text), text, seed, Wasm).differences == ()

    same()


@pytest.mark.few(0)
def test_difference_is_reduced(capsys: pytest.CaptureFixture[str]) -> None:
    engine = f"{WrongOpcode.__module__}:{WrongOpcode.__name__}"
    assert main(["--count", "400", "--mutants", "0", "--most", "1", "--engine", engine]) == 1
    report = capsys.readouterr().out
    program = report[report.index("// deploy") : report.index("\n\n")]
    full_text = random_program(random.Random(int(report.split()[1].rstrip(":")))).text()
    assert len(program) < len(full_text) / 2
    assert "1 differences" in report


def test_difference_is_reported_before_its_reduction() -> None:
    """The first report has the unreduced program and the command that reproduces the difference."""
    fuzz = EngineFuzzer(WrongOpcode, mutants=0)
    seed, report = next((seed, report) for seed in range(_SOON) for report in fuzz.seed(seed))
    again = f"--count 1 --seed {seed} --mutants 0 --engine {WrongOpcode.__module__}:WrongOpcode"
    assert report.startswith(f"seed {seed}: run of ")
    assert report.endswith(f"python tests/fuzz/fuzz.py {again}")


def test_ctrl_c_prints_the_findings(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The findings are the smallest program so far, and the counts."""

    def interrupted(piece: ProgramPiece, shows: Callable[[], bool]) -> None:
        assert shows()
        raise KeyboardInterrupt

    monkeypatch.setattr("engine_fuzzer.command_line.shrink", interrupted)
    engine = f"{WrongOpcode.__module__}:{WrongOpcode.__name__}"
    assert main(["--count", "400", "--mutants", "0", "--engine", engine]) == 1
    first, _, rest = capsys.readouterr().out.partition("\n  again: ")
    assert f"{first.partition(':')[0]}, smaller: {first.partition(': ')[2]}\n// deploy" in rest
    assert rest.endswith("1 differences\n")


def test_mutants_are_accepted_and_different() -> None:
    """The verifier accepts mutants, and mutants differ from their program."""
    program = compiled(random_program(random.Random(5)).text())
    mutant, edits = random_edits(program, random.Random(6), 8)
    assert len(edits) >= 4
    assert mutant.digest != program.digest
    verify(mutant)
    again = edited(program, edits)
    assert again is not None
    assert again.digest == mutant.digest
