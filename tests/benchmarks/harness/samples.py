"""Samples: measurement in turns, quantiles, and ratios of rounds.

Computers are shared and noisy, so contenders are measured in turns (A B, B A, A B ...) and compared within
each round, in which both had the same load.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterable, Mapping, Sequence

from harness.processes import ChildError

#: One round: samples by case.
Contender = Callable[[], Mapping[str, Iterable[float]]]
#: Samples of each round, by contender and case.
Samples = dict[str, dict[str, list[list[float]]]]
#: Receives the progress of a measurement, as text.
Tick = Callable[[str], None]


def percentile(samples: Iterable[float], percent: float) -> float:
    """The smallest sample that `percent` percent of all do not exceed. Raises ValueError without samples."""
    ordered = sorted(samples)
    if not ordered:
        raise ValueError("there are no samples")
    return ordered[min(len(ordered) - 1, int(len(ordered) * percent / 100))]


def median(samples: Iterable[float]) -> float:
    """The 50th percentile."""
    return percentile(samples, 50)


def flat(rounds: Iterable[Sequence[float]]) -> list[float]:
    """The samples of all rounds."""
    return [sample for found in rounds for sample in found]


def pair_ratios(own: Sequence[Sequence[float]], base: Sequence[Sequence[float]]) -> list[float]:
    """The ratio of the medians of each common round."""
    return [median(a) / median(b) for a, b in zip(own, base, strict=False) if a and b and median(b)]


def timed(work: Callable[[], object], at_least: float = 0.0) -> float:
    """Seconds of one call; calls are repeated until `at_least` seconds have passed."""
    calls, start = 0, time.perf_counter()
    while True:
        work()
        calls += 1
        elapsed = time.perf_counter() - start
        if elapsed >= at_least:
            return elapsed / calls


def in_turns(
    openers: Mapping[str, Callable[[], Contender]], rounds: int, tick: Tick
) -> tuple[Samples, dict[str, str]]:
    """Samples of every contender, measured in sequence in each round, and the errors of failed contenders.

    The order is reversed in every other round, so that no contender is always first. A failed contender and
    its samples are removed; the others continue.
    """
    contenders: dict[str, Contender] = {}
    samples: Samples = {name: {} for name in openers}
    errors: dict[str, str] = {}

    def attempt(name: str, work: Callable[[str], None], where: str) -> None:
        tick(f"{name}, {where}")
        try:
            work(name)
        except Exception as error:
            errors[name] = sentence(error)
            contenders.pop(name, None)
            del samples[name]

    def ready(name: str) -> None:
        contenders[name] = openers[name]()

    def measure(name: str) -> None:
        for case, found in contenders[name]().items():
            samples[name].setdefault(case, []).append(list(found))

    for name in openers:
        attempt(name, ready, "made ready")
    order = list(contenders)
    for number in range(rounds):
        for name in [name for name in order if name in contenders]:
            attempt(name, measure, f"round {number + 1} of {rounds}")
        order.reverse()
    return samples, errors


def chosen(variable: str, names: tuple[str, ...]) -> list[str]:
    """The names that an environment variable lists; all names when it is not set."""
    value = os.environ.get(variable)
    return [name for name in names if value is None or name in map(str.strip, value.split(","))]


def sentence(error: BaseException) -> str:
    """An exception as one line."""
    text = " ".join(str(error).split())
    return text if isinstance(error, ChildError) else f"{type(error).__name__}: {text}"
