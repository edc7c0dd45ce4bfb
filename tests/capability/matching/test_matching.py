"""Offers, their order, and the explanations of refusals."""

from __future__ import annotations

import pytest
from small_registry import Crew, candidate, composition, constraint_of, equivalence, provider, registry

from lfield.capability.matching.explanation import render_refusals
from lfield.capability.matching.matcher import Matcher
from lfield.capability.matching.plan_search import SearchLimits
from lfield.capability.offer import Fact, Offer

CRANE = provider("Crane", ["Lift"], payload=50.0, environment=frozenset(["terrestrial"]))
ARM = provider("Arm", ["Grip"], payload=0.5)
COPTER = provider("Copter", ["Climb"], payload=0.4)
ROVER = provider("Rover", ["Grip", "Climb"], payload=1.0)
CLIMB_LIFTS = equivalence("climb-lifts", "Lift", "Climb", when="payload >= 0.2", loss=0.3)
GRIP_AND_CLIMB = composition(
    "grip-and-climb",
    "Lift",
    {"grip": ("Grip", "payload >= 0.1"), "climb": "Climb"},
    ["grip.robot != climb.robot"],
    loss=0.5,
    payload="min(grip.payload, climb.payload)",
)


def brief(offers: list[Offer]) -> list[str]:
    """Offers in short form."""
    return [f"{offer.realisation} {offer.agent}" for offer in offers]


def explained(matcher: Matcher, primitive: str, constraint: str = "") -> list[str]:
    """The lines of an explanation."""
    return render_refusals(
        matcher.explain(primitive, constraint_of(constraint) if constraint else None)
    ).splitlines()


def test_direct_offers_prefer_own_facts_to_those_of_the_type() -> None:
    crew = Crew(candidate("crane1", "Crane", "truck"), candidate("crane2", "Crane", payload=2.5))
    matcher = Matcher(registry(CRANE), crew)
    first, second = matcher.offers("Lift")
    assert (first.primitive, first.kind, first.realisation, first.agent, first.host) == (
        *("Lift", "direct", "byCrane", "crane1", "truck"),
    )
    assert first.facts["payload"] == Fact(50.0)
    assert second.facts["payload"] == Fact(2.5)
    assert not first.parts
    assert [offer.agent for offer in matcher.offers("Lift", constraint_of("payload < 3"))] == ["crane2"]
    assert [o.agent for o in matcher.offers("Lift", constraint_of('robot == "truck" && agent != "x"'))] == [
        "crane1"
    ]


def test_equivalent_offer_shows_its_part() -> None:
    crew = Crew(candidate("c1", "Copter"), candidate("c2", "Copter", payload=0.1))
    (offer,) = Matcher(registry(COPTER, CLIMB_LIFTS), crew).offers("Lift")
    assert (offer.kind, offer.realisation, offer.rule) == ("equivalent", "as_climb_lifts", "climb-lifts")
    behind = offer.parts["as_climb_lifts"]
    assert (behind.primitive, behind.kind, behind.agent) == ("Climb", "direct", "c1")
    assert (offer.agent, offer.facts) == ("c1", behind.facts)
    assert offer.cost == pytest.approx(behind.cost + 2.0 * 0.3)


def test_composition_selects_its_parts_and_computes_its_attributes() -> None:
    crew = Crew(candidate("arm1", "Arm"), candidate("c1", "Copter"), candidate("arm2", "Arm", payload=0.01))
    (offer,) = Matcher(registry(ARM, COPTER, GRIP_AND_CLIMB), crew).offers("Lift")
    assert (offer.kind, offer.realisation, offer.agent, offer.host) == (
        *("composed", "of_grip_and_climb", "arm1+c1", "arm1+c1"),
    )
    grip, climb = offer.parts["of_grip_and_climb_grip"], offer.parts["of_grip_and_climb_climb"]
    assert (grip.agent, climb.agent) == ("arm1", "c1")
    assert offer.facts == {"payload": Fact(0.4)}
    assert offer.cost == grip.cost + climb.cost + 2.0 * 0.5 + 0.5


def test_one_agent_may_be_two_parts_unless_forbidden() -> None:
    crew = Crew(candidate("r1", "Rover"))
    free = composition("alone", "Lift", {"grip": "Grip", "climb": "Climb"})
    matcher = Matcher(registry(ROVER, GRIP_AND_CLIMB, free), crew)
    assert brief(matcher.offers("Lift")) == ["of_alone r1"]
    assert explained(matcher, "Lift") == [
        "grip-and-climb: no suitable combination of parts",
        "  r1+r1: grip.robot and climb.robot are both r1",
    ]


def test_constraint_applies_to_all_agents_of_a_whole() -> None:
    crew = Crew(candidate("arm1", "Arm"), candidate("c1", "Copter"), candidate("c2", "Copter"))
    matcher = Matcher(registry(ARM, COPTER, GRIP_AND_CLIMB), crew)
    assert brief(matcher.offers("Lift", constraint_of('agent != "c1"'))) == ["of_grip_and_climb arm1+c2"]
    assert brief(matcher.offers("Lift", constraint_of('robot == "c1"'))) == ["of_grip_and_climb arm1+c1"]


def test_attribute_without_a_rule_is_unknown_for_the_whole() -> None:
    crew = Crew(candidate("arm1", "Arm", reach=1.0), candidate("c1", "Copter", reach=1.0))
    matcher = Matcher(registry(ARM, COPTER, GRIP_AND_CLIMB), crew)
    assert explained(matcher, "Lift", "reach > 0.5") == [
        "grip-and-climb: no suitable combination of parts",
        "  arm1+c1: reach is not stated",
    ]


def test_where_may_use_attributes_of_the_whole() -> None:
    both = composition(
        "both", "Lift", {"a": "Grip", "b": "Climb"}, ["payload >= 0.3"], payload="a.payload - b.payload"
    )
    crew = Crew(candidate("arm1", "Arm"), candidate("arm2", "Arm", payload=0.9), candidate("c1", "Copter"))
    matcher = Matcher(registry(ARM, COPTER, both), crew)
    assert brief(matcher.offers("Lift")) == ["of_both arm2+c1"]


def test_reason_of_an_unknown_attribute_of_a_whole() -> None:
    both = composition("both", "Lift", {"a": "Grip", "b": "Climb"}, noise="a.noise + b.noise")
    crew = Crew(candidate("arm1", "Arm", noise=1.0), candidate("c1", "Copter"))
    matcher = Matcher(registry(ARM, COPTER, both), crew)
    assert explained(matcher, "Lift", "noise < 9") == [
        "both: no suitable combination of parts",
        "  arm1+c1: noise is not known, of b, noise is not stated",
    ]


def test_parts_within_reach_of_each_other() -> None:
    near = composition(
        "near", "Lift", {"grip": "Grip", "climb": "Climb"}, ["distance(grip, climb) <= climb.reach"]
    )
    at = {"east": Fact(0.0, 1.0), "down": Fact(0.0, 1.0)}
    crew = Crew(
        candidate("arm1", "Arm", north=Fact(0.0, 1.0), **at),
        candidate("arm2", "Arm", north=Fact(9.0, 1.0), **at),
        candidate("arm3", "Arm"),
        candidate("c1", "Copter", north=Fact(1.0, 1.0), reach=2.0, **at),
    )
    matcher = Matcher(registry(ARM, COPTER, near), crew)
    assert brief(matcher.offers("Lift")) == ["of_near arm1+c1"]
    only_far = Matcher(registry(ARM, COPTER, near), Crew(*crew.members[1:]))
    assert explained(only_far, "Lift") == [
        "near: no suitable combination of parts",
        "  arm2+c1: distance(grip, climb) 8 > climb.reach 2",
        "  arm3+c1: the position of grip is not known",
    ]


def test_rules_are_chained_up_to_the_limit() -> None:
    rules = [equivalence(f"r{i}", f"P{i}", f"P{i + 1}", loss=0.1) for i in range(4)]
    top = equivalence("top", "Top", "P0")
    crew = Crew(candidate("x", "Type"))
    matcher = Matcher(registry(provider("Type", ["P4"]), *rules, top), crew)
    (offer,) = matcher.offers("P0")
    assert (offer.realisation, offer.agent) == ("as_r0", "x")
    assert matcher.offers("Top") == []
    assert explained(matcher, "Top")[-1].strip() == "r3: at most 4 rules are chained"


def test_composition_counts_as_one_rule_of_the_depth() -> None:
    one = composition("one", "Lift", {"a": "Climb"})
    two = composition("two", "Climb", {"a": "Step"})
    full_registry = registry(provider("Stepper", ["Step"]), one, two, equivalence("top", "Top", "Lift"))
    crew = Crew(candidate("s", "Stepper"))
    for depth, found in ((2, []), (3, ["as_top s"])):
        assert brief(Matcher(full_registry, crew, limits=SearchLimits(depth=depth)).offers("Top")) == found


def test_part_may_be_composed_itself() -> None:
    inner = composition("inner", "Climb", {"one": "Step", "two": "Step"}, ["one.agent != two.agent"])
    crew = Crew(candidate("arm1", "Arm"), candidate("s1", "Stepper"), candidate("s2", "Stepper"))
    types = [ARM, provider("Stepper", ["Step"])]
    outer = composition("outer", "Lift", {"grip": "Grip", "climb": "Climb"}, ['climb.robot != "s3"'])
    offers = Matcher(registry(*types, inner, outer), crew).offers("Lift")
    assert brief(offers) == ["of_outer arm1+s1+s2", "of_outer arm1+s2+s1"]


def test_cyclic_rules_end() -> None:
    types = [provider("A", ["P"]), provider("B", ["Q"])]
    there, back = equivalence("there", "P", "Q", loss=0.1), equivalence("back", "Q", "P", loss=0.1)
    itself = composition("itself", "P", {"one": "P", "two": "Q"})
    matcher = Matcher(registry(*types, there, back, itself), Crew(candidate("a", "A"), candidate("b", "B")))
    assert [o.agent for o in matcher.offers("P") if o.kind != "composed"] == ["a", "b"]
    assert {o.agent for o in matcher.offers("P") if o.kind == "composed"} == {"a", "b", "a+b", "b+a"}


def test_one_subsumption_does_not_follow_another() -> None:
    types = [provider("A", ["Retrieve"])]
    rules = [
        equivalence("Retrieve-is-Haul", "Haul", "Retrieve"),
        equivalence("Haul-is-Move", "Move", "Haul"),
        equivalence("Retrieve-is-Move", "Move", "Retrieve"),
    ]
    matcher = Matcher(registry(*types, *rules), Crew(candidate("a", "A")))
    assert brief(matcher.offers("Move")) == ["as_Retrieve_is_Move a"]


def test_provider_may_serve_on_a_condition() -> None:
    crew = Crew(candidate("c1", "Copter", power="cable"), candidate("c2", "Copter", power="battery"))
    matcher = Matcher(registry(provider("Copter", ["Climb"], when="power == battery")), crew)
    assert brief(matcher.offers("Climb")) == ["byCopter c2"]
    assert explained(matcher, "Climb") == ["c1: power is cable, not battery"]


@pytest.mark.parametrize(
    ("member", "line"),
    [
        (candidate("x", "Crane", refusal="unreachable for 12 s"), "x: unreachable for 12 s"),
        (candidate("x", "Crane", payload=1.2, battery=1.0), "x: payload 1.2 < 2.0"),
        (candidate("x", "Crane"), "x: battery is not stated"),
        (candidate("x", "Crane", unknown={"battery": "fc is silent"}), "x: fc is silent"),
        (candidate("x", "Crane", battery=Fact(0.9, 12.0)), "x: battery is 12 s old, at most 10 s"),
        (candidate("x", "Crane", battery=Fact(0.9, 10.25)), "x: battery is 10.25 s old, at most 10 s"),
        (candidate("x", "Crane", battery=Fact(float("nan"), 1.0)), "x: battery is not a number"),
        (candidate("x", "Crane", battery=Fact(0.1, 1.0)), "x: battery 0.1 <= 0.5"),
    ],
)  # fmt: skip
def test_reason_why_an_agent_is_not_offered(member: object, line: str) -> None:
    matcher = Matcher(registry(CRANE), Crew(member))  # type: ignore[arg-type]  # a parameter
    assert matcher.offers("Lift", constraint_of("payload >= 2.0 && battery > 0.5")) == []
    assert explained(matcher, "Lift", "payload >= 2.0 && battery > 0.5") == [line]


def test_outdated_value_does_not_fall_back_to_the_type() -> None:
    crew = Crew(candidate("x", "Car", battery=Fact(0.9, 30.0)))
    matcher = Matcher(registry(provider("Car", ["Move"], battery=0.7)), crew)
    assert matcher.offers("Move", constraint_of("battery > 0.1")) == []
    assert "battery" not in matcher.offers("Move")[0].facts


def test_explanation_descends_into_rules() -> None:
    crew = Crew(
        candidate("c1", "Copter", payload=0.1), candidate("arm1", "Arm", refusal="its devices failed")
    )
    matcher = Matcher(registry(CRANE, ARM, COPTER, CLIMB_LIFTS, GRIP_AND_CLIMB), crew)
    assert matcher.offers("Lift", constraint_of("payload >= 1")) == []
    assert explained(matcher, "Lift", "payload >= 1") == [
        "climb-lifts: no Climb",
        "  c1: payload 0.1 < 0.2; payload 0.1 < 1",
        "grip-and-climb: no Grip",
        "  arm1: its devices failed",
    ]


def test_explanation_of_a_primitive_is_given_once() -> None:
    rules = [equivalence("one", "Lift", "Climb"), equivalence("two", "Lift", "Climb")]
    matcher = Matcher(registry(COPTER, *rules), Crew(candidate("c1", "Copter", refusal="gone")))
    assert explained(matcher, "Lift") == ["one: no Climb", "  c1: gone", "two: no Climb", "  Climb: as above"]


def test_rule_that_accepts_every_agent_is_not_refused() -> None:
    rules = [equivalence("one", "Lift", "Climb"), equivalence("two", "Lift", "Climb")]
    assert explained(Matcher(registry(COPTER, *rules), Crew(candidate("c1", "Copter"))), "Lift") == []


def test_rule_that_excludes_agents_names_them() -> None:
    crew = Crew(candidate("c1", "Copter"), candidate("c2", "Copter", payload=0.1))
    assert explained(Matcher(registry(COPTER, CLIMB_LIFTS), crew), "Lift") == [
        "climb-lifts: not with every Climb",
        "  c2: payload 0.1 < 0.2",
    ]


def test_only_the_ways_of_the_program_are_offered() -> None:
    crew = Crew(candidate("crane1", "Crane"), candidate("arm1", "Arm"), candidate("c1", "Copter"))
    everything = registry(CRANE, ARM, COPTER, CLIMB_LIFTS, GRIP_AND_CLIMB)
    ways = {"Lift": {"byCrane", "of_grip_and_climb"}, "Grip": {"byArm"}, "Climb": {"byCopter"}}
    offers = Matcher(everything, crew, ways).offers("Lift")
    assert brief(offers) == ["byCrane crane1", "of_grip_and_climb arm1+c1"]
    assert brief(Matcher(everything, crew, {"Lift": ["as_climb_lifts"]}).offers("Lift")) == []


def test_best_combinations_are_offered_and_the_limit_is_noted() -> None:
    arms = [candidate(f"arm{i}", "Arm", payload=0.5 + i) for i in range(5)]
    crew = Crew(*arms, candidate("c1", "Copter"))
    matcher = Matcher(registry(ARM, COPTER, GRIP_AND_CLIMB), crew, limits=SearchLimits(per_rule=2))
    assert brief(matcher.offers("Lift")) == ["of_grip_and_climb arm4+c1", "of_grip_and_climb arm3+c1"]
    assert explained(matcher, "Lift") == []
    assert matcher.find("Lift").notes == ["grip-and-climb: only the best 2 combinations are offered"]


def test_best_32_are_offered_and_all_are_counted() -> None:
    cranes = [candidate(f"crane{i}", "Crane", payload=1.0 + i) for i in range(40)]
    matcher = Matcher(registry(CRANE), Crew(*cranes))
    assert brief(matcher.offers("Lift")) == [f"byCrane crane{i}" for i in range(39, 7, -1)]
    assert matcher.count("Lift") == 40
    assert (
        matcher.count("Lift", constraint_of("payload > 39.5"))
        == len(matcher.offers("Lift", constraint_of("payload > 39.5")))
        == 1
    )


def test_search_stopped_at_its_limit_is_reported() -> None:
    crew = Crew(*[candidate(f"r{i}", "Rover") for i in range(5)])
    never = composition("never", "Lift", {"a": "Grip", "b": "Climb"}, ["a.payload > b.payload"])
    matcher = Matcher(registry(ROVER, never), crew, limits=SearchLimits(combinations=3))
    lines = explained(matcher, "Lift")
    assert (
        lines[0]
        == "never: no suitable combination of parts; more combinations of parts exist than could be tried"
    )
    assert len(lines) == 1 + 16


def test_query_asks_each_type_once_and_sees_changes() -> None:
    crew = Crew(candidate("c1", "Copter"), candidate("c2", "Copter"))
    matcher = Matcher(registry(COPTER, CLIMB_LIFTS), crew)
    assert len(matcher.offers("Lift")) == 2
    # The ranking asks once more for the agents of the type.
    assert crew.asked == 2
    crew.members[0] = candidate("c1", "Copter", payload=0.1)
    assert brief(matcher.offers("Lift")) == ["as_climb_lifts c2"]
    assert crew.asked == 3
    crew.members[1] = candidate("c2", "Copter", refusal="gone")
    assert matcher.offers("Lift") == []


def test_unknown_primitive_has_no_offers() -> None:
    matcher = Matcher(registry(CRANE), Crew(candidate("crane1", "Crane")))
    assert matcher.offers("Fly") == []
    assert matcher.explain("Fly") == []
