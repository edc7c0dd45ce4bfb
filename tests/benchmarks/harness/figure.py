"""A figure: who is measured, and how the samples become rows.

Machines are shared and noisy, so contenders are measured in turns (A B, B A, A B ...), and a ratio is the
median of the ratios of the rounds: both sides of each have seen the same weather. Nothing here asserts a time.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

from harness.checkout import Checkout
from harness.processes import Processes
from harness.statistics import median, percentile
from harness.words import SECONDS, TIMES

#: One round: samples by case.
Contender = Callable[[], Mapping[str, Iterable[float]]]
#: Makes a contender of a checkout ready; what it starts ends with `Processes`.
Opener = Callable[[Checkout, Processes], Contender]
#: Samples of each round, by contender and case.
Samples = dict[str, dict[str, list[list[float]]]]


@dataclass(frozen=True, slots=True)
class Row:
    """One line: a case, what was measured, its samples in `unit`; or, with `error`, why there are none."""

    case: str
    measured: str
    unit: str = SECONDS
    samples: Sequence[float] = ()
    ratio: float | None = None
    target: str = ""
    error: str = ""

    def numbers(self) -> dict[str, float]:
        """Minimum, median, 99th percentile and maximum."""
        if not self.samples:
            return {}
        return {
            "min": min(self.samples),
            "median": median(self.samples),
            "p99": percentile(self.samples, 99),
            "max": max(self.samples),
        }


@dataclass(frozen=True)
class Figure:
    """What `make bench` shows under one name.

    `base` names the contenders whose fastest is ratio 1. `units` and `targets` are by case or by contender.
    `between` names the contenders that two checkouts are compared by; they use commands only.
    """

    title: str
    contenders: Mapping[str, Opener]
    base: Sequence[str] = ()
    rounds: int = 10
    units: Mapping[str, str] = field(default_factory=dict)
    targets: Mapping[str, str] = field(default_factory=dict)
    notes: Sequence[str] = ()
    between: Sequence[str] = ()


def rows_of(figure: Figure, checkout: Checkout, tick: Callable[[str], None]) -> Iterator[Row]:
    """Measure a figure; `tick` is told what goes on."""
    with Processes() as processes:
        openers = {name: lambda n=name: figure.contenders[n](checkout, processes) for name in figure.contenders}
        samples, errors = in_turns(openers, figure.rounds, tick)
    for case in _cases(samples):
        shown = ""
        for name, of_case in samples.items():
            if case in of_case:
                row = Row(
                    case if not shown else "", name, _told(figure.units, case, name) or SECONDS,
                    [sample for found in of_case[case] for sample in found],
                    _ratio_to_fastest(samples, figure.base, name, case), _told(figure.targets, case, name),
                )  # fmt: skip
                shown = name
                yield row
    yield from (Row("", name, error=error) for name, error in errors.items())


def rows_between(
    figure: Figure, own: Checkout, other: Checkout, sessions: int, tick: Callable[[str], None]
) -> Iterator[Row]:
    """Measure what is compared between two checkouts: the samples of each, and the ratio round by round.

    Every session starts all processes anew, as some are lucky with their memory and some are not.
    """
    for name in figure.between:
        both: Samples = {"this": {}, "other": {}}
        errors: dict[str, str] = {}
        for _ in range(sessions):
            with Processes() as processes:
                openers = {
                    "this": lambda p=processes: figure.contenders[name](own, p),
                    "other": lambda p=processes: figure.contenders[name](other, p),
                }
                found, wrong = in_turns(openers, -(-figure.rounds // sessions), tick)
            errors |= wrong
            for side, of_side in found.items():
                for case, rounds in of_side.items():
                    both[side].setdefault(case, []).extend(rounds)
        for case in _cases(both):
            unit = _told(figure.units, case, name) or SECONDS
            for side, of_side in both.items():
                flat = [sample for found in of_side.get(case, ()) for sample in found]
                yield Row(f"{name}, {case}" if side == "this" else "", side, unit, flat)
            if all(case in of_side for of_side in both.values()):
                ratios = pair_ratios(both["this"][case], both["other"][case])
                yield Row("", "this / other", TIMES, ratios, median(ratios), "1.10x")
        yield from (Row(name, side, error=error) for side, error in errors.items())


def in_turns(
    openers: Mapping[str, Callable[[], Contender]], rounds: int, tick: Callable[[str], None] = lambda text: None
) -> tuple[Samples, dict[str, str]]:
    """Samples of every contender, measured one after the other in each round, and what failed.

    The order is reversed in every other round, so that nobody is always first. A contender that fails loses
    its place and its samples; the others go on.
    """
    contenders: dict[str, Contender] = {}
    samples: Samples = {}
    errors: dict[str, str] = {}

    def attempt(name: str, work: Callable[[], None]) -> None:
        tick(name)
        try:
            work()
        except Exception as error:
            errors[name] = sentence(error)
            contenders.pop(name, None)
            samples.pop(name, None)

    def measure(name: str) -> None:
        for case, found in contenders[name]().items():
            samples.setdefault(name, {}).setdefault(case, []).append(list(found))

    for name, opener in openers.items():
        attempt(name, lambda n=name, o=opener: contenders.update({n: o()}))
    order = list(contenders)
    for number in range(rounds):
        for name in order:
            if name in contenders:
                attempt(name, lambda n=name: measure(n))
        order.reverse()
        tick(f"round {number + 1} of {rounds}")
    # In the order they were named, not the order they were last measured in.
    return {name: samples[name] for name in openers if name in samples}, errors


def sentence(error: BaseException) -> str:
    """An exception on one line."""
    told = " ".join(str(error).split())
    return told if type(error).__name__ == "ChildError" else f"{type(error).__name__}: {told}"


def pair_ratios(own: Sequence[Sequence[float]], base: Sequence[Sequence[float]]) -> list[float]:
    """The ratio of the medians of each round that both have."""
    return [median(a) / median(b) for a, b in zip(own, base, strict=False) if a and b and median(b)]


def timed(work: Callable[[], object], at_least: float = 0.0) -> float:
    """Seconds that one call takes; it is called again and again until `at_least` has passed."""
    calls, start = 0, time.perf_counter()
    while True:
        work()
        calls += 1
        took = time.perf_counter() - start
        if took >= at_least:
            return took / calls


def _cases(samples: Samples) -> list[str]:
    return list(dict.fromkeys(case for of_contender in samples.values() for case in of_contender))


def _told(words: Mapping[str, str], case: str, name: str) -> str:
    return words.get(case) or words.get(name, "")


def _ratio_to_fastest(samples: Samples, base: Sequence[str], name: str, case: str) -> float | None:
    """Against that base which is the fastest in this case."""
    there = [samples[b][case] for b in base if case in samples.get(b, {})]
    if not there:
        return None
    fastest = min(there, key=lambda rounds: median(sample for found in rounds for sample in found))
    ratios = pair_ratios(samples[name][case], fastest)
    return median(ratios) if ratios else None
