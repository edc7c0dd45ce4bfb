"""The guide to capabilities: its files pass the checks, its figures equal those of the ranking."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import pytest
from shipped_registry import REGISTRY

from lfield import units
from lfield.capability.condition_compiler import compile_constraint
from lfield.capability.condition_tree import MAX_LIMIT
from lfield.capability.matching import ranking
from lfield.capability.matching.matcher import Matcher
from lfield.capability.matching.plan_search import SearchLimits
from lfield.capability.model import Registry
from lfield.capability.offer import Candidate, Fact
from lfield.capability.program_types.program_check import check_against, check_classes
from lfield.capability.registry_reader.registry_files import check_files, read_registry
from lfield.capability.registry_reader.unit_signatures import signatures_of
from lfield.lang.parser import parse_file
from lfield.text.source_text import Diagnostics, Source

GUIDE = (Path(__file__).parents[3] / "lfield" / "docs" / "capabilities.md").read_text(encoding="utf-8")
_BLOCK = re.compile(r"^( *)```(.*)\n((?:.*\n)*?)\1```$", re.MULTILINE)


def blocks(kind: str) -> list[str]:
    """The code blocks of a kind, without the indentation of a list."""
    return [
        textwrap.dedent(text)
        for _, head, text in _BLOCK.findall(GUIDE)
        if head == kind or head.startswith(f"{kind} forklift/")
    ]


@dataclass
class Team:
    """A team that is given completely by the test."""

    members: Sequence[Candidate] = field(default_factory=tuple)

    def candidates(self, resource: str) -> Sequence[Candidate]:
        """The agents of a type."""
        return [member for member in self.members if member.type == resource]

    def location(self) -> None:
        """The position of the querying host is not known."""


def mission(tmp_path: Path, text: str) -> Registry:
    """The shipped registry with a file of the guide, whose L class is beside it."""
    (rule,) = blocks("java L/fork_and_go.L")
    (tmp_path / "L").mkdir()
    (tmp_path / "L/fork_and_go.L").write_text(rule, encoding="utf-8")
    path = tmp_path / "mission.capabilities.yaml"
    path.write_text(text, encoding="utf-8")
    registry, found = check_files(mission=path)
    assert [d.render() for d in found] == []
    assert registry is not None
    return registry


@pytest.mark.parametrize("text", blocks("yaml"), ids=lambda text: text.splitlines()[1] or "walk-through")
def test_every_yaml_block_of_the_guide_is_a_valid_registry(tmp_path: Path, text: str) -> None:
    registry = mission(tmp_path, text)
    found = Diagnostics()
    check_classes(registry, found)
    assert [d.render() for d in found.in_order()] == []


def walk_through() -> str:
    """The file about the forklift."""
    (text,) = [text for text in blocks("yaml") if "Forklift" in text]
    return text


def test_walk_through_matches_its_program(tmp_path: Path) -> None:
    registry, found = mission(tmp_path, walk_through()), Diagnostics()
    (program,) = [text for text in blocks("java") if "resource Forklift" in text]
    check_against(registry, signatures_of([parse_file(Source("forklift.L", program), found)]), found)
    assert [d.render() for d in found.in_order()] == []
    assert registry.providers["Forklift"].attributes["payload"] == 1200.0
    assert registry.providers["Forklift"].attributes["speed"] == pytest.approx(2.5)
    (height,) = registry.providers["Forklift"].serves["Lift"].portals["lift"].arguments
    assert height.factor == 1000.0


def test_walk_through_gives_the_stated_answers(tmp_path: Path) -> None:
    registry = mission(tmp_path, walk_through())
    old = {name: Fact(value) for name, value in registry.agents["old"].items()}
    team = Team((Candidate("old", "Forklift", "yard", 1, facts=old), Candidate("new", "Forklift", "hall")))
    matcher = Matcher(registry, team)
    assert [offer.agent for offer in matcher.offers("Lift")] == ["new", "old"]
    constraint = compile_constraint("payload >= 600", registry.attributes)
    assert "old: payload 500 < 600" in GUIDE
    assert "old: payload 500 < 600" in map(str, matcher.explain("Lift", constraint))
    assert {offer.realisation for offer in matcher.offers("FollowPath")} == {"of_point_by_point"}


TERMS = ("fitness", "loss", "part", "hop", "near", "age")


def test_figures_of_the_guide_equal_those_of_the_registry() -> None:
    assert f"{len(REGISTRY.primitives)} primitives" in GUIDE
    numbers = ("", "one", "two", "three", "four", "five")
    limits = SearchLimits()
    assert f"to a depth of {numbers[limits.depth]}" in GUIDE
    assert ("the best sixteen combinations" in GUIDE) == (limits.per_rule == 16)
    weights = REGISTRY.weights
    *terms, last = [f"`{name}` {getattr(weights, name):g}" for name in TERMS]
    stated = f"The weights are {', '.join(terms)} and {last}, and `nearby` is {weights.nearby:g} m."
    assert stated in " ".join(GUIDE.split())
    assert limits.combinations == 1000
    assert "a thousand failures at most" in GUIDE
    assert "at most 32 or the query's limit" in " ".join(GUIDE.split())
    assert limits.offers == 32
    assert f"from 1 to {MAX_LIMIT}" in GUIDE


def test_cost_formula_of_the_guide_equals_the_code() -> None:
    rows = (
        ("an agent", "", ranking.AGENT),
        ("one-to-one", "the cost of the substitute", ranking.ONE_TO_ONE),
        ("one-to-many", "the sum of the parts' costs", ranking.ONE_TO_MANY),
        ("a team", "the sum of the members' costs", ranking.TEAM),
    )
    lines = []
    for kind, base, terms in rows:
        summands = [base, *(f"{weight} * {amount}" for weight, amount in terms.items())]
        lines.append(f"{kind:<17}{'  +  '.join(filter(None, summands))}")
    assert "```text drawing\n{}\n```".format("\n".join(lines)) in GUIDE


def test_units_of_the_guide_are_known() -> None:
    (line,) = re.findall(r"is written as text: (.*)\.", GUIDE)
    for amount in re.findall(r"`([^`]+)`", line.partition("Compound")[0]):
        assert units.is_unit(amount.split(" ", 1)[1]), amount


# --- the worked example of the ranking ----------------------------------------------------------------

EXAMPLE = """
registry: 1
taxonomy: {skill: {name: Skill, meaning: all}}
attributes:
  payload: {type: real, unit: kg, better: more, typical: 2.0}
  battery: {type: real, better: more, typical: 1.0, live: true, max_age: 10.0}
primitives:
  Lift: {id: skill, portals: {lift: {}}}
  Climb: {id: skill, portals: {climb: {}}}
  Grip: {id: skill, portals: {grip: {}}}
providers:
  Crane: {attributes: {payload: 6.0}, serves: {Lift: {}}}
  Copter: {attributes: {payload: 0.5}, live: {battery: fc.battery}, serves: {Climb: {}}}
  Hand: {attributes: {payload: 0.2}, serves: {Grip: {}}}
equivalences:
  climb-lifts: {serves: Lift, by: Climb, portals: {lift: climb}, loss: 0.3}
  grip-and-climb:
    serves: Lift
    needs: {hand: {capability: Grip}, copter: {capability: Climb}}
    through: GripAndClimb
    source: whole.L
    loss: 0.5
"""


def example_team(crane: str = "Crane", copter: str = "Copter", hand: str = "Hand") -> Team:
    """Crane, copter and hand, of these types."""
    return Team(
        (
            Candidate("crane", crane, "here"),
            Candidate("copter", copter, "sky", 1, facts={"battery": Fact(1.0, 5.0)}),
            Candidate("hand", hand, "bench", 1),
        )
    )


def figures() -> Iterator[tuple[float, float]]:
    """Cost and score of every row of the table."""
    (table,) = re.findall(r"\| offer \| F \| cost \| score \|\n.*\n((?:\|.*\n)+)", GUIDE)
    for row in table.splitlines():
        _, _, cost, score = (cell.strip() for cell in row.strip("|").split("|"))
        yield float(cost.rpartition("= ")[2]), float(score)


def test_worked_example_equals_the_ranking(tmp_path: Path) -> None:
    (tmp_path / "whole.L").write_text("", encoding="utf-8")
    path = tmp_path / "example.yaml"
    path.write_text(EXAMPLE, encoding="utf-8")
    offers = Matcher(read_registry([path]), example_team()).offers("Lift")
    assert [offer.kind for offer in offers] == ["direct", "equivalent", "composed"]
    ratings = [(round(offer.cost, 3), round(offer.score, 3)) for offer in offers]
    assert ratings == list(figures())


def test_types_without_an_agent_in_the_team_do_not_change_scores(tmp_path: Path) -> None:
    """The same example with the whole shipped registry: no stock type is in the team, so none counts."""
    path = tmp_path / "mission.capabilities.yaml"
    path.write_text(STOCKED, encoding="utf-8")
    registry = read_registry(mission=path)
    offers = Matcher(registry, example_team("Bridge", "Kite")).offers("Lift")
    assert (offers[0].agent, round(offers[0].score, 3)) == ("crane", 0.800)
    assert [round(offer.cost, 3) for offer in offers if offer.rule == "climb-carries"] == [1.45]


STOCKED = """
registry: 1
providers:
  Bridge: {attributes: {payload: 6.0}, serves: {Lift: {portals: {lift: up, lower: down}}}}
  Kite:
    attributes: {payload: 0.5}
    live: {battery: fc.battery}
    serves: {Climb: {portals: {climb: up, descend: down}}}
equivalences:
  climb-carries: {serves: Lift, by: Climb, portals: {lift: climb, lower: descend}, loss: 0.3}
"""
