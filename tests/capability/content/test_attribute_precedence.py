"""Precedence of the statements of an attribute: a test for each cell of the guide's table."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import cast

import pytest

from lfield.capability.directory.agent_directory import AgentDirectory
from lfield.capability.directory.directory_delta import Unavailability
from lfield.capability.matching.matcher import Matcher
from lfield.capability.model import Registry
from lfield.capability.registry_reader.registry_files import read_registry
from lfield.clock import ManualClock
from lfield.host.directory_updates.agent_sampler import AgentSampler
from lfield.manifest import Observation
from lfield.vm.agent import Agent

GUIDE = Path(__file__).parents[3] / "lfield" / "docs" / "capabilities.md"

#: The places in which an attribute can be stated, and the test value of each place.
VALUES = {"type": 1.0, "device's report": 2.0, "primitive": 3.0, "device": 4.0, "binding": 5.0, "agent": 6.0}
#: Whether the attribute is measured.
NEVER = {"device", "device's report"}


def cells() -> Iterator[tuple[str, str, str]]:
    """Rows, columns and answers of the table, without the explanations."""
    text = GUIDE.read_text(encoding="utf-8")
    (table,) = re.findall(r"\| stated for \|.*\n.*\n((?:\|.*\n)+)", text)
    for line in table.splitlines():
        row, *answers = (re.sub(r"the | \(.*\)", "", cell).strip() for cell in line.strip("|").split("|"))
        for column, answer in zip(VALUES, answers, strict=True):
            if {row, column} != NEVER:
                yield row, column, answer


def registry_of(folder: Path, stated: Sequence[str]) -> Registry:
    """A registry that states the payload of a crane in some places."""
    own, served, agents = (
        f"payload: {VALUES[place]}" if place in stated else "" for place in ("type", "primitive", "agent")
    )
    live = "payload: scale.load" if NEVER.intersection(stated) else ""
    measured = str("device's report" not in stated).lower()
    path = folder / "crane.yaml"
    path.write_text(
        "registry: 1\n"
        "taxonomy: {skill: {meaning: all}}\n"
        f"attributes: {{payload: {{type: real, unit: kg, live: {measured}, max_age: 10.0}}}}\n"
        "primitives: {Lift: {id: skill, portals: {lift: {}}}}\n"
        "providers:\n"
        f"  Crane: {{attributes: {{{own}}}, live: {{{live}}},\n"
        f"    serves: {{Lift: {{attributes: {{{served}}}}}}}}}\n"
        f"agents: {{crane: {{{agents}}}}}\n",
        encoding="utf-8",
    )
    return read_registry([path])


def payload(registry: Registry, stated: Sequence[str] = (), load: Observation | None = None) -> float | None:
    """The resulting value on the host of the crane, whose device has reported that load."""
    bound = {"crane": {"payload": VALUES["binding"]}} if "binding" in stated else {}
    yard, clock = _Yard(load), ManualClock()
    directory = AgentDirectory(registry, [_Crane()], "yard", yard, clock)
    agents = {"crane": cast("Agent", _Crane())}
    sampler = AgentSampler(registry.attributes, agents, {"crane": ["scale"]}, yard, _Silent(), clock, bound)
    directory.set_own("crane", sampler.condition("crane", directory.live("crane")))
    (offer,) = Matcher(registry, directory).offers("Lift")
    fact = offer.facts.get("payload")
    return None if fact is None else float(fact.value)  # type: ignore[arg-type]  # a number


class _Crane:
    id, type, host, ended = "crane", "Crane", "yard", ""


class _Silent:
    """Portals that are not called."""

    def last(self, agent: str, portal: str) -> Observation | str | None:
        return None


class _Yard:
    """The devices of the yard, and its links."""

    down_since: Mapping[str, float] = {}

    def __init__(self, load: Observation | None) -> None:
        self._load = load

    def last(self, device: str, quantity: str) -> Observation | None:
        return self._load

    def unavailability(self, device: str) -> Unavailability | None:
        return None

    def last_contact(self, host: str) -> float | None:
        return None


@pytest.mark.parametrize(("row", "column", "answer"), list(cells()))
def test_precedence_of_two_statements_follows_the_table(
    tmp_path: Path, row: str, column: str, answer: str
) -> None:
    stated = sorted({row, column})
    value = next((VALUES[place] for place in stated if place in NEVER), None)
    load = None if value is None else Observation(value, ManualClock().monotonic() - 0.4)
    assert payload(registry_of(tmp_path, stated), stated, load) == VALUES[answer]


def test_table_has_every_pair() -> None:
    found = [(row, column) for row, column, _ in cells()]
    assert found == [(row, column) for row in VALUES for column in VALUES if {row, column} != NEVER]


@pytest.mark.parametrize("age", [None, 10.5])
@pytest.mark.parametrize("also", ["type", "primitive"])
def test_measured_attribute_without_a_fresh_value_is_unknown(
    tmp_path: Path, also: str, age: float | None
) -> None:
    load = None if age is None else Observation(3.0, ManualClock().monotonic() - age)
    assert payload(registry_of(tmp_path, ["device", also]), load=load) is None


@pytest.mark.parametrize("also", ["type", "primitive"])
def test_unreported_device_property_falls_back_to_the_type(tmp_path: Path, also: str) -> None:
    assert payload(registry_of(tmp_path, ["device's report", also])) == VALUES[also]
