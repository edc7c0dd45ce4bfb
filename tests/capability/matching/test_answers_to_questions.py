"""Reports of a search to a coordinator: the number of offers, omissions, and limits."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pytest

from lfield.capability.offer import Candidate, Fact
from lfield.capability.registry_reader.registry_files import read_registry
from lfield.errors import ConstraintError
from lfield.host.offer_queries import MatchResults
from lfield.vm.offer_objects import SearchIncomplete

REGISTRY = """
registry: 1
taxonomy: {skill: {meaning: all}}
attributes:
  payload: {type: real, better: more, typical: 2.0}
  reach: {type: real}
primitives:
  Lift: {id: skill, portals: {lift: {}}}
  Haul: {id: skill, portals: {haul: {}}}
  Carry: {id: skill, portals: {carry: {}}}
providers:
  Crane: {serves: {Lift: {}}}
equivalences:
  odd-pair:
    serves: Haul
    needs: {one: Lift, other: Lift}
    where: [one.reach - other.reach == 1234]
    through: Pair
    source: pair.L
  any-pair:
    serves: Carry
    needs: {one: Lift, other: Lift}
    distinct: true
    through: Pair
    source: pair.L
"""
MANY = 50
WAYS = {"Lift": ["byCrane"], "Haul": ["of_odd_pair"], "Carry": ["of_any_pair"]}


class Cranes:
    """Many cranes of one type."""

    def __init__(self, count: int) -> None:
        self.members = [
            Candidate(f"c{i}", "Crane", "yard", 0, number=i, facts={"reach": Fact(1.0 + i)})
            for i in range(count)
        ]

    def candidates(self, resource: str) -> Sequence[Candidate]:
        return self.members

    def location(self) -> None:
        return None


@pytest.fixture
def answers(tmp_path: Path) -> MatchResults:
    """Results for fifty cranes."""
    (tmp_path / "pair.L").write_text("", encoding="utf-8")
    path = tmp_path / "cranes.yaml"
    path.write_text(REGISTRY, encoding="utf-8")
    return MatchResults(read_registry([path]), Cranes(MANY), WAYS, {f"c{i}": i for i in range(MANY)})


def test_offer_reports_the_number_of_offers(answers: MatchResults) -> None:
    offers = answers.find_offers("Lift", None)
    assert (len(offers), offers[0].found, offers[0].note) == (32, MANY, "the best 32 of 50 offers are given")
    every = answers.find_offers("Lift", "limit 100")
    assert (len(every), every[0].found, every[0].note) == (MANY, MANY, "")
    assert answers.explain_others("Lift", None) == "the best 32 of 50 offers are given"
    assert answers.explain_others("Lift", "reach <= 3.0").splitlines()[0] == "there are 3 offers, by 3 agents"


def test_incomplete_search_without_offers_raises_an_exception(answers: MatchResults) -> None:
    cut = "odd-pair: more combinations of parts exist than could be tried"
    with pytest.raises(SearchIncomplete, match=f"no offer was found for Haul, but {cut}"):
        answers.find_offers("Haul", None)
    with pytest.raises(SearchIncomplete, match="no team of 2 was found for Haul"):
        answers.find_teams("Haul", None, 2)
    assert cut in answers.explain_others("Haul", None)
    # A condition that prunes before combining makes the search complete.
    assert answers.find_offers("Haul", 'agent == "c3"') == []


def test_team_search_over_limited_combinations_is_reported_as_incomplete(
    answers: MatchResults,
) -> None:
    # c0 is in all offered combinations; c1 and c2 could form another pair.
    assert {one.agent.partition("+")[0] for one in answers.find_offers("Carry", None)} == {"c0"}
    reason = "no team of 2 was found for Carry, but .*any-pair: only the best combinations can be in a team"
    for question in (None, "limit 5", "order by payload"):
        with pytest.raises(SearchIncomplete, match=reason):
            answers.find_teams("Carry", question, 2)
    assert answers.find_teams("Carry", None, 51) == []


def test_invalid_and_oversized_team_sizes(answers: MatchResults) -> None:
    for size in (0, -1, -(2**63)):
        with pytest.raises(ConstraintError, match="a team has one member at least"):
            answers.find_teams("Lift", None, size)
    assert answers.find_teams("Lift", "reach <= 3.0", 4) == []
    assert answers.find_teams("Lift", None, 2**63 - 1) == []
    (team,) = answers.find_teams("Lift", "reach <= 3.0", 3)
    assert [one.agent for one in team] == ["c0", "c1", "c2"]
    assert {one.found for one in team} == {3}
    assert len(answers.find_teams("Lift", "limit 100", 2)) == 100


def test_query_over_2000_characters_is_refused(answers: MatchResults) -> None:
    with pytest.raises(ConstraintError, match="longer than 2000 characters"):
        answers.find_offers("Lift", "reach > 1.0 && " * 700 + "true")
