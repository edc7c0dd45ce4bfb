"""Which statement of an attribute counts: a test for each cell of the guide's table."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from pathlib import Path

import pytest

from lfield.capability.matching.matcher import Matcher
from lfield.capability.model import Registry
from lfield.capability.reading.reader import read_registry
from lfield.operator.query import from_hosts
from lfield.wire.observing import Told, ToldFact

GUIDE = Path(__file__).parents[3] / "lfield" / "docs" / "capabilities.md"

#: The places in which an attribute can be stated, and the value that each of these tests states there.
VALUES = {"type": 1.0, "primitive": 2.0, "device": 3.0, "agent": 4.0}


def cells() -> Iterator[tuple[str, str, str]]:
    """The rows, columns and answers of the table, without what explains them."""
    text = GUIDE.read_text(encoding="utf-8")
    (table,) = re.findall(r"\| stated for \|.*\n.*\n((?:\|.*\n)+)", text)
    for line in table.splitlines():
        row, *answers = (re.sub(r"the | \(.*\)", "", cell).strip() for cell in line.strip("|").split("|"))
        for column, answer in zip(VALUES, answers, strict=True):
            yield row, column, answer


def registry_of(folder: Path, stated: Sequence[str]) -> Registry:
    """A registry that states the payload of a crane in some places."""
    own, served, live, agents = (
        f"payload: {VALUES[place]}" if place in stated else ""
        for place in ("type", "primitive", "device", "agent")
    )
    live = "payload: scale.load" if live else ""
    path = folder / "crane.yaml"
    path.write_text(
        "registry: 1\n"
        "taxonomy: {skill: {meaning: all}}\n"
        "attributes: {payload: {type: real, unit: kg, live: true, max_age: 10.0}}\n"
        "primitives: {Lift: {id: skill, portals: {lift: {}}}}\n"
        "providers:\n"
        f"  Crane: {{attributes: {{{own}}}, live: {{{live}}},\n"
        f"    serves: {{Lift: {{attributes: {{{served}}}}}}}}}\n"
        f"agents: {{crane: {{{agents}}}}}\n",
        encoding="utf-8",
    )
    return read_registry([path])


def payload(registry: Registry, told: dict[str, ToldFact]) -> float | None:
    """What counts in the end, when the host of the crane tells that of it."""
    (crane,) = [Told("crane", "", told, {})]
    team = from_hosts(registry, [_Crane()], {"yard": {"crane": crane}}, ())
    (offer,) = Matcher(registry, team).offers("Lift")
    fact = offer.facts.get("payload")
    return None if fact is None else float(fact.value)  # type: ignore[arg-type]  # a number


class _Crane:
    id, type, host = "crane", "Crane", "yard"


@pytest.mark.parametrize(("row", "column", "answer"), list(cells()))
def test_who_wins(tmp_path: Path, row: str, column: str, answer: str) -> None:
    stated = {row, column}
    told = {"payload": ToldFact(VALUES["device"], 0.4)} if "device" in stated else {}
    assert payload(registry_of(tmp_path, sorted(stated)), told) == VALUES[answer]


def test_the_table_has_every_pair() -> None:
    found = [(row, column) for row, column, _ in cells()]
    assert found == [(row, column) for row in VALUES for column in VALUES]


@pytest.mark.parametrize("told", [{}, {"payload": ToldFact(3.0, 10.5)}])
@pytest.mark.parametrize("also", ["type", "primitive"])
def test_what_a_device_does_not_tell_is_not_known(
    tmp_path: Path, also: str, told: dict[str, ToldFact]
) -> None:
    assert payload(registry_of(tmp_path, ["device", also]), told) is None
