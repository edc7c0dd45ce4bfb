"""The harness of the figures: failures of one figure, counted values, and saved values."""

from __future__ import annotations

import io
import json
import os
import subprocess
import sys
import time
from pathlib import Path
from types import ModuleType

import pytest
from harness.bench import main
from harness.checkout import Checkout, CheckoutError
from harness.figure import Figure, Row, rows_between, rows_of
from harness.number_text import BYTES, COUNT, TIMES, number_text
from harness.paced import Paced, read_round
from harness.processes import ChildError, Processes
from harness.samples import in_turns, median, pair_ratios, percentile, timed
from rich.console import Console
from run import FIGURES

HERE = Checkout(Path("/here"), sys.executable)
THERE = Checkout(Path("/there"), sys.executable)


def silent(text: str) -> None:
    """Ignore the progress."""


def giving(*seconds):
    """An opener of a contender with the same samples in each round."""
    return lambda checkout, processes: lambda: {"case": seconds}


def failing(checkout, processes):
    raise OSError("no such\n   thing")


@pytest.fixture
def bench(monkeypatch):
    """Runs the command on figures; returns its status and what it printed."""

    def run(figures, *arguments):
        modules = {}
        for name, figure in figures.items():
            module = modules[name] = f"figure_of_{name}"
            if figure is not None:
                made = ModuleType(module)
                made.FIGURE = figure
                monkeypatch.setitem(sys.modules, module, made)
        out = Console(file=io.StringIO(), width=160)
        return main(modules, arguments, out), out.file.getvalue()

    return run


A = Figure("The first; ratio to b", {"a": giving(0.002, 0.004), "b": giving(0.001)}, base=("b",), rounds=3)
B = Figure("The second", {"b": giving(5.0)})


def test_quantiles():
    samples = [5.0, 1.0, 4.0, 2.0, 3.0]
    assert (median(samples), percentile(samples, 0), percentile(samples, 99)) == (3.0, 1.0, 5.0)
    with pytest.raises(ValueError, match="no samples"):
        median([])


def test_row_has_minimum_median_and_maximum():
    assert Row("", "", samples=[3.0, 1.0, 2.0]).numbers() == {
        "min": 1.0,
        "median": 2.0,
        "p90": 3.0,
        "p99": 3.0,
        "max": 3.0,
    }
    assert Row("", "", error="gone").numbers() == {}


def test_ratio_is_of_rounds_that_were_measured_together():
    # The second round was under load for both.
    assert pair_ratios([[1.1], [11.0]], [[1.0], [10.0]]) == pytest.approx([1.1, 1.1])


def test_short_work_is_repeated_to_a_reliable_duration():
    calls = []
    assert timed(lambda: calls.append(1), at_least=0.002) * len(calls) >= 0.002
    assert len(calls) > 10


def test_contenders_take_turns_in_changing_order():
    order = []
    openers = {name: lambda n=name: lambda: order.append(n) or {"": [1.0]} for name in "ab"}
    samples, errors = in_turns(openers, 3, silent)
    assert ("".join(order), errors) == ("abbaab", {})
    assert samples == {"a": {"": [[1.0]] * 3}, "b": {"": [[1.0]] * 3}}


def test_growth_is_computed_from_all_sizes_of_each_round():
    def squares(checkout, processes):
        return lambda: {f"{n} cats": [1e-3 * n * n] for n in (1, 10, 100)}

    def halves(checkout, processes):
        return lambda: {f"{n} cats": [5.0 / n] for n in (1, 10, 100)}

    sizes = {f"{n} cats": n for n in (1, 10, 100)}
    figure = Figure(
        "", {"a": squares, "b": halves}, rounds=2, sizes=sizes, targets={"a: ten times the size": "10x"}
    )
    *rows, a, b = rows_of(figure, HERE, silent)
    assert [row.size for row in rows] == [1, 1, 10, 10, 100, 100]
    assert (a.case, a.measured, a.unit, a.target) == ("ten times the size", "a", TIMES, "10x")
    assert list(a.samples) == pytest.approx([100.0] * 2)
    assert (b.case, b.measured, list(b.samples)) == ("", "b", pytest.approx([0.1] * 2))


def test_sizes_may_be_contenders_or_parts_of_a_case():
    figure = Figure("", {"few": giving(1.0), "many": giving(2.0)}, rounds=1, sizes={"few": 1, "many": 10})
    *_, row = rows_of(figure, HERE, silent)
    assert (row.case, row.measured, row.samples) == ("ten times the size: case", "", [2.0])
    opener = lambda checkout, processes: lambda: {f"{n} hosts: {w}": [n] for n in (1, 10) for w in "ab"}  # noqa: E731
    sizes = {"1 hosts": 1, "10 hosts": 10}
    *_, a, b = rows_of(Figure("", {"c": opener}, rounds=1, sizes=sizes), HERE, silent)
    assert (a.case, b.case) == ("ten times the size: a", "ten times the size: b")


#: Runs in its own process: modules of the benchmarks have the same names as modules of other tests.
_SIZES = """
from importlib import import_module
from run import FIGURES
for name, module in FIGURES.items():
    figure = import_module(module).FIGURE
    print(name, bool(figure.sizes) + bool(figure.one_size), len(set(figure.sizes.values())))
"""


@pytest.mark.few(0)
def test_every_figure_has_sizes_or_a_reason_for_none():
    command = [sys.executable, "-c", _SIZES]
    output = subprocess.run(
        command, cwd=Path(__file__).parent, check=True, capture_output=True, text=True
    ).stdout
    has_size = {name: tuple(map(int, rest)) for name, *rest in map(str.split, output.splitlines())}
    assert has_size.keys() == FIGURES.keys()
    assert {name: one for name, one in has_size.items() if one[0] != 1 or one[1] == 1} == {}


def test_custom_rows_of_a_figure_have_growths():
    def own(checkout, rounds, tick):
        for count in (1, 10):
            yield Row(f"{count} cats: fed", "a", samples=[1.0 * count])
            yield Row("", "b", samples=[5.0 / count])
        yield Row("10 cats: sold", "a", error="no buyer")

    figure = Figure("", {}, own_rows=own, sizes={"1 cats": 1, "10 cats": 10})
    *rows, lost, a, b = rows_of(figure, HERE, silent)
    assert [row.size for row in rows] == [1, 1, 10, 10]
    assert (lost.error, a.case, b.case) == ("no buyer", "ten times the size: fed", "")
    assert [*a.samples, *b.samples] == pytest.approx([10.0, 0.1])


def test_zero_cost_or_a_single_size_has_no_growth():
    figure = Figure("", {"few": giving(0.0), "many": giving(2.0)}, rounds=1, sizes={"few": 1, "many": 10})
    assert [row.measured for row in rows_of(figure, HERE, silent)] == ["few", "many"]
    figure = Figure("", {"few": giving(1.0)}, rounds=1, sizes={"few": 1})
    assert [row.measured for row in rows_of(figure, HERE, silent)] == ["few"]


def test_target_may_be_of_one_contender_in_one_case():
    figure = Figure("", {}, targets={"a: case": "1x", "case": "2x", "b": "3x"})
    assert [figure.target(*key) for key in (("case", "a"), ("case", "b"), ("other", "b"))] == [
        "1x",
        "2x",
        "3x",
    ]


def test_failing_contender_leaves_the_others():
    figure = Figure("", {"a": failing, "b": giving(1.0)}, rounds=2)
    good, bad = rows_of(figure, HERE, silent)
    assert (good.measured, list(good.samples)) == ("b", [1.0, 1.0])
    assert (bad.measured, bad.error) == ("a", "OSError: no such thing")


def test_ratio_to_a_rival_has_its_smallest_and_largest_round():
    durations = iter([1.0, 2.0, 6.0])
    rising = {"a": lambda checkout, processes: lambda: {"case": [next(durations)]}, "b": giving(2.0)}
    figure = Figure("", rising, rounds=3, ratios=(("a", "b", "0.60x"), ("a", "gone", "1.00x")))
    *_, ratio = rows_of(figure, HERE, silent)
    assert (ratio.measured, ratio.unit, ratio.target) == ("a / b", TIMES, "0.60x")
    assert ratio.numbers() == {"min": 0.5, "median": 1.0, "p90": 3.0, "p99": 3.0, "max": 3.0}


def test_contender_failing_in_a_later_round_leaves_the_others():
    left = [1.0]
    openers = {"a": lambda: lambda: {"": [left.pop()]}, "b": lambda: lambda: {"": [2.0]}}
    samples, errors = in_turns(openers, 2, silent)
    assert samples == {"b": {"": [[2.0], [2.0]]}}
    assert errors == {"a": "IndexError: pop from empty list"}


def test_failing_figure_leaves_the_others(bench):
    status, output = bench({"lost": None, "second": B})
    assert status == 1
    assert "lost: ModuleNotFoundError: No module named 'figure_of_lost'" in output
    assert "5.00 s" in output


def test_only_named_figures_are_run(bench):
    status, output = bench({"first": A, "second": B}, "--only", "second")
    assert status == 0
    assert "The second" in output
    assert "The first" not in output


def test_unknown_figure_is_an_error(bench, capsys):
    assert bench({"first": A, "second": B}, "--only", "third")[0] == 64
    assert capsys.readouterr().err == "there is no figure 'third'; there are first, second\n"


def test_rows_are_saved(bench, tmp_path):
    file = tmp_path / "rows.json"
    assert bench({"first": A, "lost": None}, "--save", str(file), "--rounds", "2")[0] == 1
    saved = json.loads(file.read_text(encoding="utf-8"))
    a, b, lost = saved["rows"]
    assert saved["format"] == 1
    assert (a["figure"], a["case"], a["measured"], a["count"]) == ("first", "case", "a", 4)
    assert (a["min"], a["median"], a["max"], a["ratio"]) == (0.002, 0.004, 0.004, 4.0)
    assert (b["case"], b["ratio"]) == ("case", 1.0)
    assert lost["error"].startswith("ModuleNotFoundError")


def test_interrupted_run_is_printed_and_saved(bench, tmp_path, capsys):
    def interrupted(checkout, processes):
        raise KeyboardInterrupt

    file = tmp_path / "rows.json"
    figures = {"first": A, "second": Figure("", {"c": interrupted})}
    status, output = bench(figures, "--save", str(file))
    assert (status, "4.00x" in output) == (130, True)
    assert len(json.loads(file.read_text(encoding="utf-8"))["rows"]) == 2
    assert "interrupted" in capsys.readouterr().err


def test_two_checkouts_are_compared_round_by_round():
    def opener(checkout, processes):
        return lambda: {"case": [3.0 if checkout is HERE else 2.0]}

    figure = Figure("", {"a": opener, "alone": giving(9.0)}, rounds=4, between=("a",))
    this, other, ratio = rows_between(figure, HERE, THERE, 2, silent)
    assert (list(this.samples), list(other.samples)) == ([3.0] * 4, [2.0] * 4)
    assert (list(ratio.samples), ratio.unit, ratio.ratio) == ([1.5] * 4, TIMES, 1.5)


def test_case_of_only_one_checkout_is_reported():
    def opener(checkout, processes):
        if checkout is THERE:
            raise OSError("unknown figure")
        return lambda: {"case": [1.0]}

    this, lost = rows_between(Figure("", {"a": opener}, rounds=1, between=("a",)), HERE, THERE, 1, silent)
    assert this.measured == "this"
    assert (lost.measured, lost.error) == ("other", "OSError: unknown figure")


def test_checkout_without_an_environment_is_an_error(bench, tmp_path, capsys):
    with pytest.raises(CheckoutError):
        Checkout.at(tmp_path)
    assert bench({"first": A}, "--against", str(tmp_path))[0] == 66
    assert capsys.readouterr().err == f"{tmp_path} has no .venv/bin/python: run 'make test' there first\n"


@pytest.mark.parametrize(
    ("number", "unit", "shown"),
    [
        (1.5e-7, "s", "0.150 µs"), (2.5e-5, "s", "25.0 µs"), (2.5e-3, "s", "2.50 ms"), (12.0, "s", "12.0 s"),
        (-0.5, "s", "-500 ms"), (37.5e6, BYTES, "37.5 MB"), (128, COUNT, "128"), (0.05, TIMES, "0.05x"),
        (42.0, TIMES, "42x"), (0.5, "%", "0.50 %"),
    ],
)  # fmt: skip
def test_number_is_shown_with_its_unit(number, unit, shown):
    assert number_text(number, unit) == shown


def state_of(pid: int) -> str:
    return Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()[0]


@pytest.mark.process
def test_self_measuring_process_is_stopped_between_its_rounds():
    printing = "print(f'a = {n}\\nb =\\na = 0.5\\nend', flush=True)"
    loop = f"import time\nfor n in range(9999): {printing}; time.sleep(0.1)"
    with Processes() as processes:
        child = processes.start(sys.executable, "-c", loop)
        paced = Paced([child])
        # A signal takes effect when its process is scheduled.
        end = time.monotonic() + 60.0
        while state_of(child.pid) != "T":
            assert time.monotonic() < end
            time.sleep(0.01)
        # The first round was the warm-up.
        assert paced() == {"a": [1.0, 0.5]}
        assert paced() == {"a": [2.0, 0.5]}
    with pytest.raises(ProcessLookupError):
        os.kill(child.pid, 0)


@pytest.mark.process
def test_failed_measuring_process_states_its_reason():
    with Processes() as processes:
        wrong = processes.start(sys.executable, "-c", "print('error: fib gave 3 instead of 5')")
        with pytest.raises(ChildError, match=r"^fib gave 3 instead of 5$"):
            read_round(wrong)
        gone = processes.start(sys.executable, "-c", "raise OSError('no bus')")
        with pytest.raises(ChildError, match=r"ended: OSError: no bus$"):
            read_round(gone)
