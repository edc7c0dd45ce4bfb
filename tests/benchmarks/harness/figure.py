"""A figure: who is measured, and how the samples become rows. Nothing here asserts a time."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

from harness.checkout import Checkout
from harness.number_text import SECONDS, TIMES
from harness.processes import Processes
from harness.samples import Contender, Samples, Tick, flat, in_turns, median, pair_ratios, percentile
from harness.tenfold import series, tenfold

#: Makes a contender of a checkout ready; what it starts ends with `Processes`.
Opener = Callable[[Checkout, Processes], Contender]
#: Measures a checkout in so many rounds.
OwnRows = Callable[[Checkout, int, Tick], Iterator["Row"]]
#: What a later version may cost against an earlier one.
ALLOWED = "1.10x"
#: The case of the rows that say how a cost grows.
GROWTH = "ten times the size"


@dataclass(frozen=True, slots=True)
class Row:
    """A line: a case, what was measured, its samples in `unit`; or, with `error`, why there are none.

    `size` is how much of something it was measured with, 0 where that is no question.
    """

    case: str
    measured: str
    unit: str = SECONDS
    samples: Sequence[float] = ()
    ratio: float | None = None
    target: str = ""
    error: str = ""
    size: float = 0

    def numbers(self) -> dict[str, float]:
        """Minimum, median, 90th and 99th percentile, and maximum."""
        if not self.samples:
            return {}
        low, high = min(self.samples), max(self.samples)
        percentiles = {f"p{percent}": percentile(self.samples, percent) for percent in (90, 99)}
        return {"min": low, "median": median(self.samples), **percentiles, "max": high}


@dataclass(frozen=True)
class Figure:
    """The contents of `make bench` under one name.

    `base` names the contenders whose fastest is ratio 1. `units` and `targets` are by case or by contender, a
    target by both, `contender: case`, too. `sizes` are those of cases, up to a colon, or of contenders; where
    there are none, `one_size` says why there is nothing that grows.
    `between` names the contenders by which two checkouts can be compared: those that use commands only.
    `own_rows` makes the rows instead of contenders, where what fails is a part of the figure.
    `ratios` are who, to whom, and what to reach: a line for each, with the least and the greatest round.
    """

    title: str
    contenders: Mapping[str, Opener]
    base: Sequence[str] = ()
    rounds: int = 10
    units: Mapping[str, str] = field(default_factory=dict)
    targets: Mapping[str, str] = field(default_factory=dict)
    sizes: Mapping[str, float] = field(default_factory=dict)
    one_size: str = ""
    notes: Sequence[str] = ()
    between: Sequence[str] = ()
    own_rows: OwnRows | None = None
    ratios: Sequence[tuple[str, str, str]] = ()

    def unit(self, case: str, name: str) -> str:
        """Of the samples of a contender in a case."""
        return self.units.get(case) or self.units.get(name) or SECONDS

    def target(self, case: str, name: str) -> str:
        """The target of a contender in a case; '' if there is none."""
        found = (self.targets.get(key) for key in (f"{name}: {case}", case, name))
        return next(filter(None, found), "")

    def size(self, case: str, name: str) -> float:
        """Of what a contender was measured with in a case; 0 where there are no sizes."""
        return self.sizes.get(case.partition(": ")[0]) or self.sizes.get(name) or 0


def rows_of(figure: Figure, checkout: Checkout, tick: Tick) -> Iterator[Row]:
    """Measure all contenders."""
    if figure.own_rows is not None:
        yield from _with_growths(figure, figure.own_rows(checkout, figure.rounds, tick))
        return
    with Processes() as processes:
        openers = {name: partial(opener, checkout, processes) for name, opener in figure.contenders.items()}
        samples, errors = in_turns(openers, figure.rounds, tick)
    for case in _cases(samples):
        shown = case
        for name, of_case in samples.items():
            if case in of_case:
                ratio = _ratio_to_fastest(samples, figure.base, name, case)
                unit, target = figure.unit(case, name), figure.target(case, name)
                size = figure.size(case, name)
                yield Row(shown, name, unit, flat(of_case[case]), ratio, target, size=size)
                shown = ""
    yield from _growths(figure, samples)
    yield from (Row("", name, error=error) for name, error in errors.items())
    yield from _ratios(figure, samples)


def _with_growths(figure: Figure, rows: Iterator[Row]) -> Iterator[Row]:
    """A figure's own rows, and how their costs grow: all samples of one are a single round."""
    samples: Samples = {}
    case = ""
    for row in rows:
        case = row.case or case
        if row.samples:
            samples.setdefault(row.measured, {})[case] = [list(row.samples)]
        yield replace(row, size=figure.size(case, row.measured))
    yield from _growths(figure, samples)


def _ratios(figure: Figure, samples: Samples) -> Iterator[Row]:
    """Rows with the ratios of two contenders: of their medians in each round."""
    for case in _cases(samples):
        shown = f"{case}: medians of each round"
        for who, whom, target in figure.ratios:
            if case in samples.get(who, {}) and case in samples.get(whom, {}):
                found = pair_ratios(samples[who][case], samples[whom][case])
                yield Row(shown, f"{who} / {whom}", TIMES, found, target=target)
                shown = ""


def _growths(figure: Figure, samples: Samples) -> Iterator[Row]:
    """How the cost of each contender grows, where it was measured at several sizes."""
    shown = ""
    for one in sorted(series(samples, figure.sizes), key=lambda one: one.case):
        if grown := tenfold(one.points):
            case = f"{GROWTH}: {one.case}" if one.case else GROWTH
            target = figure.targets.get(f"{one.name}: {case}") or figure.targets.get(case, "")
            yield Row(case if case != shown else "", one.name, TIMES, grown, target=target)
            shown = case


def rows_between(figure: Figure, own: Checkout, other: Checkout, sessions: int, tick: Tick) -> Iterator[Row]:
    """Measure what two checkouts can be compared by: the samples of each, and the ratio round by round.

    Every session starts all processes anew, as some are lucky with their place in memory and some are not.
    """
    for name in figure.between:
        samples: Samples = {"this": {}, "other": {}}
        errors: dict[str, str] = {}
        for _ in range(sessions):
            with Processes() as processes:
                opener = figure.contenders[name]
                openers = {
                    "this": partial(opener, own, processes),
                    "other": partial(opener, other, processes),
                }
                found, wrong = in_turns(openers, -(-figure.rounds // sessions), tick)
            errors |= wrong
            for side, of_side in found.items():
                for case, rounds in of_side.items():
                    samples[side].setdefault(case, []).extend(rounds)
        for case in _cases(samples):
            shown = f"{name}: {case}"
            for side, of_side in samples.items():
                if case in of_side:
                    yield Row(shown, side, figure.unit(case, name), flat(of_side[case]))
                    shown = ""
            if all(case in of_side for of_side in samples.values()):
                ratios = pair_ratios(samples["this"][case], samples["other"][case])
                yield Row("", "this / other", TIMES, ratios, median(ratios) if ratios else None, ALLOWED)
        yield from (Row(name, side, error=error) for side, error in errors.items())


def _cases(samples: Samples) -> list[str]:
    return list(dict.fromkeys(case for of_contender in samples.values() for case in of_contender))


def _ratio_to_fastest(samples: Samples, base: Sequence[str], name: str, case: str) -> float | None:
    """Against that base which is the fastest in this case."""
    there = [samples[b][case] for b in base if case in samples.get(b, {})]
    if not there:
        return None
    ratios = pair_ratios(samples[name][case], min(there, key=lambda rounds: median(flat(rounds))))
    return median(ratios) if ratios else None
