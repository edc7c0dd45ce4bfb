"""Differences with what was measured, and the table of those that stay: pure, without a flight.

An entry of the table is the key of a difference, with figures where there are some, real one first:
`51.6 top speed (8.1 / 6.9 m/s)`. The figures are its bound: between the two the fake may move, beyond them
by no more than the slack of its kind. An entry with `*` means several differences and bounds none.
"""

from __future__ import annotations

import fnmatch
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

#: Trace or pattern -> reason -> entries.
Table = dict[str, dict[str, list[str]]]

#: The reason of what nobody has mended yet.
TO_BE_MENDED = "to be mended"
FIGURES = re.compile(r"^(.*) \((?:-?[\d.]+ / )?(-?[\d.]+)(?: [^\d()]+)?\)$", re.DOTALL)


@dataclass(frozen=True, slots=True)
class Figures:
    """What was measured of the real one and of the fake, in a unit.

    real    None where it is nothing by its kind: of how long two states differ
    slack   how much further from the real one than listed the fake may be, or on the other side of it
    """

    real: float | None
    fake: float
    slack: float
    unit: str = "s"

    def __str__(self) -> str:
        fake = f"{_round(self.fake):g} {self.unit}"
        return fake if self.real is None else f"{_round(self.real):g} / {fake}"

    def is_beyond(self, listed: float) -> bool:
        """Whether the fake is further from the real one than where it was listed, or opposite."""
        low, high = sorted((self.real or 0.0, listed))
        return not low - self.slack <= _round(self.fake) <= high + self.slack


@dataclass(frozen=True, slots=True)
class Difference:
    """One thing that the fake did otherwise, with a detail for people."""

    key: str
    detail: str = ""
    figures: Figures | None = None

    @property
    def entry(self) -> str:
        """How it is written into the table."""
        key = self.key.replace("*", "?")
        return f"{key} ({self.figures})" if self.figures else key


@dataclass(frozen=True, slots=True)
class Verdict:
    """Of one recording: what is different, what of it is not listed or worse than listed, what is gone."""

    found: list[Difference]
    unlisted: list[Difference]
    worse: list[str]
    stale: list[str]


def once(found: Iterable[Difference]) -> list[Difference]:
    """Each key once; how long it was so is added up."""
    kept: dict[str, Difference] = {}
    for each in found:
        before = kept.get(each.key)
        kept[each.key] = _sum(before, each) if before else each
    return list(kept.values())


def _sum(one: Difference, other: Difference) -> Difference:
    if one.figures is None or other.figures is None or other.figures.real is not None:
        return other
    figures = replace(one.figures, fake=one.figures.fake + other.figures.fake)
    return Difference(one.key, f"{one.detail}, {other.detail}", figures)


def judge(name: str, found: list[Difference], table: Table) -> Verdict:
    """The differences of one recording held against the table."""
    own = [entry for listed in (table.get(name) or {}).values() for entry in listed]
    common = [entry for listed in _common(name, table) for entry in listed]
    unlisted = [each for each in found if not any(matches(each, entry) for entry in [*own, *common])]
    worse = [
        text for each in found for entry in own if matches(each, entry) and (text := _worse(each, entry))
    ]
    stale = [entry for entry in own if not any(matches(each, entry) for each in found)]
    return Verdict(found, unlisted, worse, stale)


def matches(difference: Difference, entry: str) -> bool:
    """Whether an entry is about this difference, whatever its figures are."""
    pattern = _parse(entry)[0] if difference.figures else entry
    # `[` is no pattern.
    return fnmatch.fnmatchcase(difference.key, pattern.replace("[", "[[]"))


def reason(name: str, difference: Difference, table: Table) -> str:
    """Why a difference stays, "" when it is not listed."""
    for trace, reasons in table.items():
        if trace == name or _is_pattern_of(trace, name):
            for why, listed in reasons.items():
                if any(matches(difference, entry) for entry in listed):
                    return why
    return ""


def renew(table: Table, name: str, verdict: Verdict) -> None:
    """Put what is new into the table, take out what is gone, and write what is measured now."""
    kept = {
        why: [_renewed(entry, verdict.found) for entry in listed if entry not in verdict.stale]
        for why, listed in (table.get(name) or {}).items()
    }
    kept.setdefault(TO_BE_MENDED, []).extend(each.entry for each in verdict.unlisted)
    kept = {why: listed for why, listed in kept.items() if listed}
    table.pop(name, None)
    if kept:
        table[name] = kept


def unbounded(table: Table) -> list[str]:
    """Entries for several differences that are about more than texts: nothing would bound them."""
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
    """What to say when a difference is beyond its entry, "" when it is not."""
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
    """The pattern and where the fake was."""
    found = FIGURES.match(entry)
    return (found[1], float(found[2])) if found else (entry, None)


def _round(number: float) -> float:
    return round(number, 2)
