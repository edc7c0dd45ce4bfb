"""All suitable agents are agents_for among any number of combinations; an incomplete search is reported."""

from __future__ import annotations

import pytest
from small_registry import Crew, candidate, composition, constraint_of, provider, registry

from lfield.capability.matching.matcher import Matcher
from lfield.capability.model import Composition

FORK, CART = provider("Fork", ["Lift"]), provider("Cart", ["Move"])
PAIR = {"fork": "Lift", "cart": "Move"}
MANY = 400


def forks_and_carts(rule: Composition, many: int = MANY) -> Matcher:
    """The last cart is in the slot of the first fork, and so on: the cheapest fork and cart do not fit."""
    forks = [candidate(f"f{i}", "Fork", note=f"slot {i}", payload=1.0 + i) for i in range(many)]
    carts = [candidate(f"c{i}", "Cart", note=f"slot {many - 1 - i}", payload=1.0 + i) for i in range(many)]
    return Matcher(registry(FORK, CART, rule), Crew(*forks, *carts))


def agents_for(matcher: Matcher, question: str = "") -> list[str]:
    return [offer.agent for offer in matcher.offers("Haul", constraint_of(question) if question else None)]


def test_parts_in_the_same_slot_are_found() -> None:
    matcher = forks_and_carts(composition("pair", "Haul", PAIR, ["fork.note == cart.note"]))
    agents = agents_for(matcher)
    assert len(agents) == 16
    assert set(agents) <= {f"f{i}+c{MANY - 1 - i}" for i in range(MANY)}
    assert matcher.find("Haul").notes == ["pair: only the best 16 combinations are offered"]


@pytest.mark.parametrize(
    "where",
    [
        'fork.agent == "f7" && cart.note == "slot 7"',
        "!(fork.note != cart.note) && fork.payload < 9 && fork.payload > 7",
        "(fork.note == cart.note || fork.payload > 999) && fork.payload < 9 && fork.payload > 7",
        "(fork.payload + cart.payload < 0 || fork.note == cart.note) && fork.payload < 9 && fork.payload > 7",
        "!(fork.note != cart.note && fork.payload < 999) && fork.payload < 9 && fork.payload > 7",
        'fork.agent == "f7" && fork.note == cart.note',
        "fork.payload < 9 && fork.payload > 7 && fork.note == cart.note",
        'cart.agent == "c392" && fork.note == cart.note',
        "fork.payload + cart.payload * 0 == 8 && fork.note == cart.note",
    ],
)
def test_condition_on_one_part_prunes(where: str) -> None:
    assert agents_for(forks_and_carts(composition("pair", "Haul", PAIR, [where]))) == ["f7+c392"]


@pytest.mark.parametrize(
    "question",
    ['agent == "f7" && agent == "c392"', 'robot == "f7" && agent == "c392" && agent != "f4"'],
)
def test_query_for_members_prunes(question: str) -> None:
    assert agents_for(forks_and_carts(composition("pair", "Haul", PAIR)), question) == ["f7+c392"]


def test_query_over_the_whole_prunes_its_parts() -> None:
    worth = {"payload": "min(fork.payload, cart.payload)", "noise": "max(fork.payload, cart.payload)"}
    rule = composition("pair", "Haul", PAIR, ["fork.note == cart.note"], **worth)
    matcher = forks_and_carts(rule, 1000)
    assert sorted(agents_for(matcher, "payload >= 500")) == ["f499+c500", "f500+c499"]
    assert sorted(agents_for(matcher, "501 >= noise")) == ["f499+c500", "f500+c499"]


def test_chain_of_three_is_found_among_a_thousand_million() -> None:
    many = 1000
    types = [FORK, CART, provider("Arm", ["Grip"])]
    rule = composition(
        "three",
        "Haul",
        {"fork": "Lift", "arm": "Grip", "cart": "Move"},
        ["fork.note == cart.note", "cart.reach == arm.reach"],
    )
    team = [candidate(f"f{i}", "Fork", note=f"slot {i}", payload=1.0 + i) for i in range(many)]
    team += [candidate(f"c{i}", "Cart", note=f"slot {many - 1 - i}", reach=float(i)) for i in range(many)]
    team += [candidate(f"a{i}", "Arm", reach=i + 998.0) for i in range(many)]
    assert sorted(agents_for(Matcher(registry(*types, rule), Crew(*team)))) == ["f0+a1+c999", "f1+a0+c998"]


def test_sets_are_joined_by_a_common_member() -> None:
    rule = composition("pair", "Haul", PAIR, ["fork.environment == cart.environment"])
    air, water, both = frozenset(["aerial"]), frozenset(["aquatic"]), frozenset(["aerial", "aquatic"])
    team = [candidate(f"f{i}", "Fork", environment=e) for i, e in enumerate((air, water, both, frozenset()))]
    team += [candidate("c", "Cart", environment=air), candidate("d", "Cart")]
    assert agents_for(Matcher(registry(FORK, CART, rule), Crew(*team))) == ["f0+c", "f2+c"]


def test_distinct_parts_are_found_among_equal_agents() -> None:
    rule = composition(
        "all", "Haul", {f"p{i}": "Lift" for i in range(6)}, distinct=tuple(f"p{i}" for i in range(6))
    )
    six = Crew(*[candidate(f"f{i}", "Fork", payload=1.0 + i) for i in range(6)])
    assert len(agents_for(Matcher(registry(FORK, rule), six))) == 16
    five = Crew(*six.members[:5])
    assert agents_for(Matcher(registry(FORK, rule), five)) == []


def test_one_alternative_is_found_when_the_other_cannot_be_indexed() -> None:
    rule = composition("pair", "Haul", PAIR, ["fork.note == cart.note || distance(fork, cart) <= fork.reach"])
    agents = agents_for(forks_and_carts(rule, 100))
    assert len(agents) == 16
    assert set(agents) <= {f"f{99 - i}+c{i}" for i in range(100)}


def test_rule_may_need_the_primitive_that_it_serves() -> None:
    rule = composition("two", "Lift", {"left": "Lift", "right": "Lift"}, distinct=("left", "right"))
    forks = Crew(*[candidate(f"f{i}", "Fork") for i in range(3)])
    offers = Matcher(registry(FORK, rule), forks).offers("Lift")
    pairs = ["f0+f1", "f0+f2", "f1+f0", "f1+f2", "f2+f0", "f2+f1"]
    assert [offer.agent for offer in offers] == ["f0", "f1", "f2", *pairs]


def test_incomplete_search_over_a_sum_is_reported() -> None:
    rule = composition("pair", "Haul", PAIR, ["fork.reach - cart.reach == 1234"])
    team = [candidate(f"f{i}", "Fork", reach=1.0 + i) for i in range(100)]
    team += [candidate(f"c{i}", "Cart", reach=1.0 + i) for i in range(100)]
    matcher = Matcher(registry(FORK, CART, rule), Crew(*team))
    assert matcher.offers("Haul") == []
    (line, *_) = matcher.explain("Haul")
    assert "more combinations of parts exist than could be tried" in line.reasons
