"""The cost of an offer equals the formula of ranking.py."""

from __future__ import annotations

import random

import pytest
from msgspec.structs import replace
from small_registry import Crew, candidate, composition, constraint_of, equivalence, provider, registry

from lfield.capability.matching.matcher import Matcher
from lfield.capability.model import Registry, Weights
from lfield.capability.offer import Candidate, Fact, Offer

CRANE = provider("Crane", ["Lift"], payload=6.0)
QUIET = provider("Quiet", ["Lift"], payload=2.0, noise=1.0)


def costs(made: Registry, *members: Candidate, constraint: str = "") -> dict[str, float]:
    """The cost of every offer for Lift, by agent."""
    offers = Matcher(made, Crew(*members)).offers("Lift", constraint_of(constraint) if constraint else None)
    return {offer.agent: offer.cost for offer in offers}


def test_typical_value_costs_one_half() -> None:
    crane, here = candidate("x", "Crane", payload=2.0), candidate("y", "Crane", hops=0, payload=2.0)
    assert costs(registry(CRANE), crane, here) == pytest.approx({"x": 0.5 + 0.1, "y": 0.5})


def test_better_value_costs_less_in_both_directions() -> None:
    members = [
        candidate("strong", "Crane"),
        candidate("quiet", "Quiet"),
        candidate("mute", "Quiet", noise=-1.0),
    ]
    found = costs(registry(CRANE, QUIET), *members)
    assert found["strong"] == pytest.approx((2 / (2 + 6) + 0.5) / 2 + 0.1)
    assert found["quiet"] == pytest.approx((2 / (2 + 2) + 1 / (4 + 1)) / 2 + 0.1)
    assert found["mute"] == pytest.approx((2 / (2 + 2) + 0) / 2 + 0.1)


def test_attributes_are_weighted() -> None:
    weights = Weights(fitness=10.0, hop=0.0, attributes={"payload": 3.0})
    found = costs(registry(QUIET, weights=weights), candidate("x", "Quiet"))
    assert found["x"] == pytest.approx(10 * (3 * 0.5 + 1 * 0.2) / 4)


def test_attribute_with_weight_zero_does_not_count() -> None:
    weights = Weights(attributes={"payload": 0.0, "noise": 0.0})
    assert costs(registry(QUIET, weights=weights), candidate("x", "Quiet")) == pytest.approx({"x": 0.1})


def test_unknown_value_ranks_between_good_and_bad() -> None:
    found = costs(
        registry(provider("Any", ["Lift"]), agents={"good": {"payload": 6.0}, "bad": {"payload": 0.5}}),
        candidate("silent", "Any"),
        candidate("good", "Any", payload=6.0),
        candidate("bad", "Any", payload=0.5),
    )
    assert list(found) == ["good", "silent", "bad"]


@pytest.mark.parametrize(("age", "share"), [(0.0, 0.0), (5.0, 0.5), (10.0, 1.0), (99.0, 1.0)])
def test_age_of_queried_live_values_counts(age: float, share: float) -> None:
    member = candidate("x", "Crane", battery=Fact(1.0, age), east=Fact(0.0, 2.5))
    base = 2 / (2 + 6) + 0.1
    assert costs(registry(CRANE), member) == pytest.approx({"x": base})
    if age <= 10:
        found = costs(registry(CRANE), member, constraint="battery > 0.5")
        assert found == pytest.approx({"x": base + 0.2 * share})
    found = costs(registry(CRANE), member, constraint="battery > 0.5 || ready || payload > 1")
    assert found == pytest.approx({"x": base + 0.2 * share})


def test_rules_add_their_loss_and_parts_add_up() -> None:
    parts = provider("Part", ["Grip", "Climb"], payload=2.0)
    one = equivalence("one", "Lift", "Climb", loss=0.25)
    both = composition("both", "Lift", {"a": "Grip", "b": "Climb", "c": "Climb"}, loss=1.0)
    offers = Matcher(registry(parts, one, both), Crew(candidate("x", "Part", hops=0))).offers("Lift")
    assert [(o.realisation, o.cost) for o in offers] == [
        ("as_one", pytest.approx(0.5 + 2 * 0.25)),
        ("of_both", pytest.approx(3 * 0.5 + 2 * 1.0 + 0.5 * 2)),
    ]
    assert offers[0].score == pytest.approx(1 / 2)


def test_ties_are_ordered_by_rules_names_and_deployment() -> None:
    types = [provider("A", ["Lift", "Climb"]), provider("B", ["Lift"])]
    rules = [equivalence("y", "Lift", "Climb"), equivalence("x", "Lift", "Climb")]
    crew = Crew(candidate("b1", "B"), candidate("a2", "A"), candidate("a1", "A"))
    offers = Matcher(registry(*types, *rules), crew).offers("Lift")
    assert [f"{o.realisation} {o.agent}" for o in offers] == [
        *("byB b1", "byA a2", "byA a1"),
        *("as_x a2", "as_x a1", "as_y a2", "as_y a1"),
    ]


def test_at_equal_cost_fewer_rules_come_first() -> None:
    types = [provider("A", ["Climb"]), provider("B", ["Step"])]
    rules = [
        equivalence("z", "Lift", "Climb"),
        equivalence("a", "Lift", "Reach"),
        equivalence("b", "Reach", "Step"),
    ]
    crew = Crew(candidate("two", "B"), candidate("one", "A"))
    offers = Matcher(registry(*types, *rules), crew).offers("Lift")
    assert [offer.agent for offer in offers] == ["one", "two"]


def test_at_equal_cost_the_better_first_part_comes_first() -> None:
    parts = provider("Part", ["Grip", "Climb"])
    both = composition("both", "Lift", {"a": "Grip", "b": "Climb"}, distinct=("a", "b"))
    crew = Crew(candidate("good", "Part", payload=6.0), candidate("bad", "Part", payload=0.5))
    offers = Matcher(registry(parts, both), Crew(*reversed(crew.members))).offers("Lift")
    assert [offer.agent for offer in offers] == ["good+bad", "bad+good"]
    assert offers[0].cost == offers[1].cost


def test_distance_counts_when_the_position_of_the_query_is_known() -> None:
    at = {"east": 0.0, "down": -2.0}
    team = [candidate("far", "Crane", north=150.0, **at), candidate("near", "Crane", north=0.0, **at)]
    team += [candidate("lost", "Crane"), candidate("flat", "Crane", north=50.0, east=0.0)]
    base = 2 / (2 + 6) + 0.1
    assert set(costs(registry(CRANE), *team).values()) == {base}
    offers = Matcher(registry(CRANE), Crew(*team, place=(0.0, 0.0, -2.0))).offers("Lift")
    found = {offer.agent: pytest.approx(offer.cost - base) for offer in offers}
    assert found == {"near": 0.0, "flat": 0.2 * 0.5, "lost": 0.2 * 0.5, "far": 0.2 * 0.75}
    assert [offer.agent for offer in offers] == ["near", "lost", "flat", "far"]
    beyond = candidate("beyond", "Crane", north=1e200, **at)
    (offer,) = Matcher(registry(CRANE), Crew(beyond, place=(0.0, 0.0, -2.0))).offers("Lift")
    assert offer.cost == pytest.approx(base + 0.2 * 0.5)


def test_agents_that_never_serve_do_not_count() -> None:
    """Attributes of agents of other types, or of types without an agent, do not count either."""
    gripping = provider("Quiet", ["Lift"], when="power == cable", noise=1.0)
    other = provider("Nobody", ["Lift"], reach=1.0)
    full_registry = registry(CRANE, gripping, other, provider("Elsewhere", ["Climb"], noise=3.0))
    crane = candidate("x", "Crane", hops=0)
    for team in ([crane], [crane, candidate("q", "Quiet")], [crane, candidate("e", "Elsewhere", reach=2.0)]):
        assert costs(full_registry, *team)["x"] == pytest.approx(0.25)
    quiet = candidate("q", "Quiet", power="cable")
    assert costs(full_registry, crane, quiet)["x"] == pytest.approx((0.25 + 0.5) / 2)
    lost = candidate("q", "Quiet", power="cable", refusal="unreachable for 12 s")
    assert costs(full_registry, crane, lost)["x"] == pytest.approx((0.25 + 0.5) / 2)


def test_terms_of_a_cost_add_up_to_the_cost() -> None:
    parts = provider("Part", ["Grip", "Climb"], payload=2.0, noise=1.0)
    both = composition("both", "Reach", {"a": "Grip", "b": "Climb"}, loss=0.5)
    crew = Crew(candidate("x", "Part", battery=Fact(1.0, 4.0), north=3.0, east=4.0), place=(0.0, 0.0, None))
    matcher = Matcher(registry(parts, both, equivalence("one", "Lift", "Reach", loss=0.25)), crew)
    (offer,) = matcher.offers("Lift", constraint_of("payload > 1 || battery > 0.5 || true"))

    def check(one: Offer) -> None:
        terms = sum(term.weight * term.amount for term in one.terms)
        assert one.cost == pytest.approx(terms + sum(part.cost for part in one.parts.values()))
        for part in one.parts.values():
            check(part)

    check(offer)
    (cost,) = offer.parts.values()
    grip = cost.parts["of_both_a"]
    assert [term.name for term in grip.terms] == ["fitness", "hop", "near", "age"]
    assert grip.terms[0].amount == pytest.approx(sum(p.share * p.penalty for p in grip.penalties))
    assert grip.terms[2].amount == pytest.approx(5 / 55)


def test_order_of_the_registry_does_not_matter() -> None:
    types = [provider(f"T{i}", ["Lift", "Grip", "Climb"], payload=0.1 * i, noise=0.7) for i in range(4)]
    rules = [
        *(equivalence(f"e{i}", "Lift", "Climb", loss=0.1) for i in range(3)),
        composition("c", "Lift", {"a": "Grip", "b": "Climb"}, payload="a.payload + b.payload"),
    ]
    full_registry = registry(*types, *rules)
    crew = Crew(*[candidate(f"x{i}{j}", f"T{i}", reach=0.3 * j) for i in range(4) for j in range(3)])
    expected = Matcher(full_registry, crew).offers("Lift", constraint_of("payload >= 0.1"))
    refused = Matcher(full_registry, crew).explain("Lift", constraint_of("payload >= 0.1"))
    shuffle = random.Random(1)
    for _ in range(5):
        mixed = replace(
            full_registry,
            **{
                section: dict(
                    shuffle.sample(entries := list(getattr(full_registry, section).items()), len(entries))
                )
                for section in ("attributes", "primitives", "providers", "equivalences", "compositions")
            },
        )
        assert Matcher(mixed, crew).offers("Lift", constraint_of("payload >= 0.1")) == expected
        assert Matcher(mixed, crew).explain("Lift", constraint_of("payload >= 0.1")) == refused
