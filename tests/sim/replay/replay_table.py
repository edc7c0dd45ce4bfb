"""Differences with their figures, and the table of known differences: pure, without a flight.

An entry of the table is the key of a difference, with figures if there are any, the recording first:
`51.6 top speed (8.1 / 6.9 m/s)`. The figures are its bound: the fake may be between the two, or beyond them
by at most the slack of its kind. An entry with `*` matches several differences and has no bound.
"""

from __future__ import annotations

import fnmatch
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

#: Trace or pattern -> reason -> entries.
Table = dict[str, dict[str, list[str]]]

#: The reason of a difference that is not yet fixed or explained.
TO_BE_MENDED = "to be mended"
FIGURES = re.compile(r"^(.*) \((?:-?[\d.]+ / )?(-?[\d.]+)(?: [^\d()]+)?\)$", re.DOTALL)


@dataclass(frozen=True, slots=True)
class Figures:
    """The values of the recording and of the fake, in a unit.

    real    None for the duration of a difference between two states
    slack   how much further from the recording than listed the fake may be, or on its other side
    """

    real: float | None
    fake: float
    slack: float
    unit: str = "s"

    def __str__(self) -> str:
        fake = f"{_round(self.fake):g} {self.unit}"
        return fake if self.real is None else f"{_round(self.real):g} / {fake}"

    def is_beyond(self, listed: float) -> bool:
        """Whether the fake is further from the recording than listed, or on its other side."""
        low, high = sorted((self.real or 0.0, listed))
        return not low - self.slack <= _round(self.fake) <= high + self.slack


@dataclass(frozen=True, slots=True)
class Difference:
    """One difference between the fake and the recording, with a readable detail."""

    key: str
    detail: str = ""
    figures: Figures | None = None

    @property
    def entry(self) -> str:
        """The entry of the difference in the table."""
        key = self.key.replace("*", "?")
        return f"{key} ({self.figures})" if self.figures else key


@dataclass(frozen=True, slots=True)
class Verdict:
    """Differences of one recording: all, not listed, worse than listed, and listed without occurring."""

    found: list[Difference]
    unlisted: list[Difference]
    worse: list[str]
    stale: list[str]


def once(found: Iterable[Difference]) -> list[Difference]:
    """Each key once; durations are added up."""
    rows_by_key: dict[str, Difference] = {}
    for each in found:
        before = rows_by_key.get(each.key)
        rows_by_key[each.key] = _sum(before, each) if before else each
    return list(rows_by_key.values())


def _sum(one: Difference, other: Difference) -> Difference:
    if one.figures is None or other.figures is None or other.figures.real is not None:
        return other
    figures = replace(one.figures, fake=one.figures.fake + other.figures.fake)
    return Difference(one.key, f"{one.detail}, {other.detail}", figures)


def judge(name: str, found: list[Difference], table: Table) -> Verdict:
    """Compares the differences of one recording with the table."""
    own = [entry for listed in (table.get(name) or {}).values() for entry in listed]
    common = [entry for listed in _common(name, table) for entry in listed]
    unlisted = [each for each in found if not any(matches(each, entry) for entry in [*own, *common])]
    worse = [
        text for each in found for entry in own if matches(each, entry) and (text := _worse(each, entry))
    ]
    stale = [entry for entry in own if not any(matches(each, entry) for each in found)]
    return Verdict(found, unlisted, worse, stale)


def matches(difference: Difference, entry: str) -> bool:
    """Whether an entry matches this difference, with any figures."""
    pattern = _parse(entry)[0] if difference.figures else entry
    # `[` is no pattern character.
    return fnmatch.fnmatchcase(difference.key, pattern.replace("[", "[[]"))


def reason(name: str, difference: Difference, table: Table) -> str:
    """The reason of a known difference, "" if it is not listed."""
    for trace, reasons in table.items():
        if trace == name or _is_pattern_of(trace, name):
            for why, listed in reasons.items():
                if any(matches(difference, entry) for entry in listed):
                    return why
    return ""


def renew(table: Table, name: str, verdict: Verdict) -> None:
    """Adds new differences, removes those that no longer occur, and writes the current figures."""
    rows_by_key = {
        why: [_renewed(entry, verdict.found) for entry in listed if entry not in verdict.stale]
        for why, listed in (table.get(name) or {}).items()
    }
    rows_by_key.setdefault(TO_BE_MENDED, []).extend(each.entry for each in verdict.unlisted)
    rows_by_key = {why: listed for why, listed in rows_by_key.items() if listed}
    table.pop(name, None)
    if rows_by_key:
        table[name] = rows_by_key


def unbounded(table: Table) -> list[str]:
    """Entries for several differences other than texts and messages: they would have no bound."""
    return [
        entry
        for trace, reasons in table.items()
        for listed in reasons.values()
        for entry in listed
        if ("*" in trace or "*" in entry) and not entry.startswith(("text ", "message "))
    ]


def _common(name: str, table: Table) -> Iterator[list[str]]:
    for trace, reasons in table.items():
        if _is_pattern_of(trace, name):
            yield from reasons.values()


def _is_pattern_of(trace: str, name: str) -> bool:
    return "*" in trace and fnmatch.fnmatchcase(name, trace)


def _worse(difference: Difference, entry: str) -> str:
    """The report of a difference beyond its entry, "" if it is within."""
    figures, listed = difference.figures, _parse(entry)[1]
    if figures is None or "*" in entry:
        return ""
    if listed is None:
        return f"{difference.entry} has no figures in the table"
    return f"{difference.entry}, listed as {entry}" if figures.is_beyond(listed) else ""


def _renewed(entry: str, found: Iterable[Difference]) -> str:
    figures = next((each.figures for each in found if matches(each, entry)), None)
    return entry if figures is None or "*" in entry else f"{_parse(entry)[0]} ({figures})"


def _parse(entry: str) -> tuple[str, float | None]:
    """The pattern and the listed value of the fake."""
    found = FIGURES.match(entry)
    return (found[1], float(found[2])) if found else (entry, None)


def _round(number: float) -> float:
    return round(number, 2)
