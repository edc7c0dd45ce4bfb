"""A figure: its contenders, and the conversion of samples to rows. No time is asserted."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

from harness.checkout import Checkout
from harness.number_text import SECONDS, TIMES
from harness.processes import Processes
from harness.samples import Contender, Samples, Tick, flat, in_turns, median, pair_ratios, percentile
from harness.tenfold import series, tenfold

#: Opens a contender of a checkout; its processes end with `Processes`.
Opener = Callable[[Checkout, Processes], Contender]
#: Measures a checkout in the given number of rounds.
OwnRows = Callable[[Checkout, int, Tick], Iterator["Row"]]
#: The highest permitted cost of a later version relative to an earlier one.
ALLOWED = "1.10x"
#: The case of the rows with the growth of a cost.
GROWTH = "ten times the size"


@dataclass(frozen=True, slots=True)
class Row:
    """A line: a case, the measured contender, its samples in `unit`; or an `error` instead of samples.

    `size` is the size of the case, or 0 for a figure without sizes.
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

    `base` names reference contenders; the fastest of them has ratio 1. Keys of `units` and `targets` are
    cases or contenders; targets can also have the key `contender: case`. Keys of `sizes` are cases, up to a
    colon, or contenders; without sizes, `one_size` gives the reason. `between` names the contenders for the
    comparison of two checkouts: those that use commands only. `own_rows` replaces the contenders for a figure
    in which failures are results. `ratios` has pairs of contenders and their target: a line for each, with
    the lowest and highest round.
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
        """The unit of the samples of a contender in a case."""
        return self.units.get(case) or self.units.get(name) or SECONDS

    def target(self, case: str, name: str) -> str:
        """The target of a contender in a case; '' if bases is none."""
        found = (self.targets.get(key) for key in (f"{name}: {case}", case, name))
        return next(filter(None, found), "")

    def size(self, case: str, name: str) -> float:
        """The size of a case or contender; 0 without sizes."""
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
        label = case
        for name, of_case in samples.items():
            if case in of_case:
                ratio = _ratio_to_fastest(samples, figure.base, name, case)
                unit, target = figure.unit(case, name), figure.target(case, name)
                size = figure.size(case, name)
                yield Row(label, name, unit, flat(of_case[case]), ratio, target, size=size)
                label = ""
    yield from _growths(figure, samples)
    yield from (Row("", name, error=error) for name, error in errors.items())
    yield from _ratios(figure, samples)


def _with_growths(figure: Figure, rows: Iterator[Row]) -> Iterator[Row]:
    """A figure's own rows, then the growth of their costs: all samples of a row are one round."""
    samples: Samples = {}
    case = ""
    for row in rows:
        case = row.case or case
        if row.samples:
            samples.setdefault(row.measured, {})[case] = [list(row.samples)]
        yield replace(row, size=figure.size(case, row.measured))
    yield from _growths(figure, samples)


def _ratios(figure: Figure, samples: Samples) -> Iterator[Row]:
    """Rows with the ratios of the medians of two contenders in each round."""
    for case in _cases(samples):
        label = f"{case}: medians of each round"
        for contender, reference, target in figure.ratios:
            if case in samples.get(contender, {}) and case in samples.get(reference, {}):
                found = pair_ratios(samples[contender][case], samples[reference][case])
                yield Row(label, f"{contender} / {reference}", TIMES, found, target=target)
                label = ""


def _growths(figure: Figure, samples: Samples) -> Iterator[Row]:
    """The growth of the cost of each contender that was measured at several sizes."""
    label = ""
    for one in sorted(series(samples, figure.sizes), key=lambda one: one.case):
        if grown := tenfold(one.points):
            case = f"{GROWTH}: {one.case}" if one.case else GROWTH
            target = figure.targets.get(f"{one.name}: {case}") or figure.targets.get(case, "")
            yield Row(case if case != label else "", one.name, TIMES, grown, target=target)
            label = case


def rows_between(figure: Figure, own: Checkout, other: Checkout, sessions: int, tick: Tick) -> Iterator[Row]:
    """Compare two checkouts: the samples of each, and the ratio of each round.

    Every session restarts all processes, because their speed depends on their memory layout.
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
            label = f"{name}: {case}"
            for side, of_side in samples.items():
                if case in of_side:
                    yield Row(label, side, figure.unit(case, name), flat(of_side[case]))
                    label = ""
            if all(case in of_side for of_side in samples.values()):
                ratios = pair_ratios(samples["this"][case], samples["other"][case])
                yield Row("", "this / other", TIMES, ratios, median(ratios) if ratios else None, ALLOWED)
        yield from (Row(name, side, error=error) for side, error in errors.items())


def _cases(samples: Samples) -> list[str]:
    return list(dict.fromkeys(case for of_contender in samples.values() for case in of_contender))


def _ratio_to_fastest(samples: Samples, base: Sequence[str], name: str, case: str) -> float | None:
    """The ratio to the fastest base contender in this case."""
    bases = [samples[b][case] for b in base if case in samples.get(b, {})]
    if not bases:
        return None
    ratios = pair_ratios(samples[name][case], min(bases, key=lambda rounds: median(flat(rounds))))
    return median(ratios) if ratios else None
