"""The matcher compared with an exhaustive search, on small random registries.

The oracle has conditions as tuples and computes costs by the formula of ranking.py independently; it
shares only the data with the matcher.
"""

from __future__ import annotations

import operator
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from small_registry import (
    ATTRIBUTES,
    Crew,
    candidate,
    composition,
    constraint_of,
    equivalence,
    provider,
    registry,
)

from lfield.capability.matching.matcher import Matcher
from lfield.capability.matching.plan_search import SearchLimits
from lfield.capability.model import Composition, Equivalence, Registry
from lfield.capability.offer import Candidate, Offer, Rejection

DEPTH = 3
EVERYTHING = SearchLimits(depth=DEPTH, per_rule=10**6, combinations=10**6, failures=10**6, offers=10**6)
COMPARE = {"<": operator.lt, "<=": operator.le, ">": operator.gt, ">=": operator.ge}
OPPOSITE = {"<": ">=", "<=": ">", ">": "<=", ">=": "<"}

PRIMITIVES = ("P", "Q", "R", "S")
Condition = tuple[tuple[str, str, float], ...]


@dataclass(frozen=True)
class World:
    """A registry with its team; `conditions` are those of rules and needs, by `rule` or `rule.need`."""

    registry: Registry
    crew: Crew
    conditions: Mapping[str, Condition]
    apart: Mapping[str, str]


@dataclass(frozen=True)
class Plan:
    """A result of the oracle: a name for the whole tree, and the facts of an offer."""

    tree: str
    cost: float
    facts: Mapping[str, float]
    hosts: frozenset[str]


# --- random worlds ------------------------------------------------------------------------------------

_VALUES = st.sampled_from([0.5, 1.0, 2.0, 4.0])
_NAMES = ("payload", "reach", "noise")
_FACTS = st.dictionaries(st.sampled_from(_NAMES), _VALUES, max_size=3)
_CONDITION = st.lists(
    st.tuples(st.sampled_from(_NAMES), st.sampled_from(list(COMPARE)), _VALUES), max_size=2
).map(tuple)
_LOSS = st.sampled_from([0.0, 0.25, 1.0])
_PRIMITIVE = st.sampled_from(PRIMITIVES)


def text_of(condition: Condition) -> str:
    """A condition in L."""
    return " && ".join(f"{name} {sign} {value}" for name, sign, value in condition)


@st.composite
def worlds(draw: st.DrawFn) -> World:
    entries: list[Any] = []
    conditions: dict[str, Condition] = {}
    apart: dict[str, str] = {}
    for type in "AB":
        serves = draw(st.sets(_PRIMITIVE, min_size=1, max_size=2))
        entries.append(provider(type, sorted(serves), **draw(_FACTS)))
    for name in draw(st.sets(st.sampled_from(["e1", "e2", "e3", "e4"]))):
        serves, by = draw(st.permutations(PRIMITIVES))[:2]
        conditions[name] = draw(_CONDITION)
        entries.append(equivalence(name, serves, by, text_of(conditions[name]), draw(_LOSS)))
    for name in draw(st.sets(st.sampled_from(["c1", "c2"]))):
        serves = draw(_PRIMITIVE)
        needs = {}
        for need in ("a", "b"):
            conditions[f"{name}.{need}"] = draw(_CONDITION)
            needs[need] = (draw(_PRIMITIVE), text_of(conditions[f"{name}.{need}"]))
        apart[name] = draw(st.sampled_from(["", "!=", "=="]))
        where = [f"a.robot {apart[name]} b.robot"] if apart[name] else []
        entries.append(
            composition(name, serves, needs, where, draw(_LOSS), payload="min(a.payload, b.payload)")
        )
    members = [
        candidate(
            f"x{i}",
            draw(st.sampled_from("AB")),
            draw(st.sampled_from(["h1", "h2"])),
            hops=draw(st.integers(0, 1)),
            refusal=draw(st.sampled_from(["", "", "", "gone"])),
            **draw(_FACTS),
        )
        for i in range(draw(st.integers(1, 3)))
    ]
    return World(registry(*entries), Crew(*members), conditions, apart)


# --- the oracle ---------------------------------------------------------------------------------------


def holds(condition: Condition, facts: Mapping[str, float]) -> bool:
    """Whether every comparison is known and true."""
    return all(name in facts and COMPARE[sign](facts[name], value) for name, sign, value in condition)


def facts_of(world: World, member: Candidate) -> dict[str, float]:
    """The known facts of an agent."""
    own = {name: fact.value for name, fact in member.facts.items()}
    return {**world.registry.providers[member.type].attributes, **own}  # type: ignore[dict-item]  # numbers only


def agent_cost(world: World, primitive: str, member: Candidate) -> float:
    facts = facts_of(world, member)
    stated = {
        name
        for other in world.crew.members
        if primitive in world.registry.providers[other.type].serves
        for name in facts_of(world, other)
    }
    penalties = []
    for name in stated:
        typical, value = ATTRIBUTES[name].typical, facts.get(name)
        if value is None:
            penalties.append(0.5)
        else:
            penalties.append((typical if ATTRIBUTES[name].better == "more" else value) / (typical + value))
    return (sum(penalties) / len(penalties) if penalties else 0.0) + 0.1 * member.hops


def everything(
    world: World, primitive: str, depth: int, passed: frozenset[str], used: frozenset[str]
) -> Iterator[Plan]:
    """Every plan; `passed` are the primitives of the chain, `used` the compositions above."""
    for member in world.crew.members:
        if primitive in world.registry.providers[member.type].serves and not member.refusal:
            cost = agent_cost(world, primitive, member)
            yield Plan(member.agent, cost, facts_of(world, member), frozenset([member.host]))
    if depth == 0:
        return
    for rule in world.registry.equivalences.values():
        if rule.serves == primitive and rule.by not in passed | {primitive}:
            for plan in everything(world, rule.by, depth - 1, passed | {primitive}, used):
                if holds(world.conditions[rule.name], plan.facts):
                    tree = f"{rule.name}({plan.tree})"
                    yield Plan(tree, plan.cost + 2.0 * rule.loss, plan.facts, plan.hosts)
    for whole in world.registry.compositions.values():
        if whole.serves == primitive and whole.name not in used:
            yield from combined(world, whole, depth - 1, used | {whole.name})


def combined(world: World, rule: Composition, depth: int, used: frozenset[str]) -> Iterator[Plan]:
    parts = [
        [
            plan
            for plan in everything(world, need.primitive, depth, frozenset(), used)
            if holds(world.conditions[f"{rule.name}.{need.name}"], plan.facts)
        ]
        for need in rule.needs.values()
    ]
    for a in parts[0]:
        for b in parts[1]:
            shared = bool(a.hosts & b.hosts)
            if world.apart[rule.name] == ("!=" if shared else "=="):
                continue
            facts = {}
            if "payload" in a.facts and "payload" in b.facts:
                facts["payload"] = min(a.facts["payload"], b.facts["payload"])
            cost = a.cost + b.cost + 2.0 * rule.loss + 0.5
            yield Plan(f"{rule.name}({a.tree},{b.tree})", cost, facts, a.hosts | b.hosts)


# --- comparisons --------------------------------------------------------------------------------------


def tree_of(offer: Offer) -> str:
    """The same name of a tree for an offer."""
    return f"{offer.rule}({','.join(map(tree_of, offer.parts.values()))})" if offer.parts else offer.agent


@settings(deadline=None, max_examples=80)
@given(worlds(), _PRIMITIVE, _CONDITION)
def test_all_plans_are_found_the_cheapest_first(world: World, primitive: str, condition: Condition) -> None:
    matcher = Matcher(world.registry, world.crew, limits=EVERYTHING)
    offers = matcher.offers(primitive, constraint_of(text_of(condition)) if condition else None)
    nothing = frozenset[str]()
    plans = [p for p in everything(world, primitive, DEPTH, nothing, nothing) if holds(condition, p.facts)]
    expected = sorted((plan.tree, pytest.approx(plan.cost)) for plan in plans)
    assert sorted((tree_of(offer), offer.cost) for offer in offers) == expected
    costs = [offer.cost for offer in offers]
    assert costs == sorted(costs)


@settings(deadline=None, max_examples=80)
@given(worlds(), _PRIMITIVE, _CONDITION)
def test_cheapest_plan_of_each_composition_is_offered(
    world: World, primitive: str, condition: Condition
) -> None:
    limits = SearchLimits(depth=DEPTH, per_rule=1, offers=10**6)
    offers = Matcher(world.registry, world.crew, limits=limits).offers(
        primitive, constraint_of(text_of(condition)) if condition else None
    )
    nothing = frozenset[str]()
    plans = [p for p in everything(world, primitive, DEPTH, nothing, nothing) if holds(condition, p.facts)]
    for rule in world.registry.compositions:
        costs = [plan.cost for plan in plans if bottom(plan.tree) == rule]
        found = [offer.cost for offer in offers if bottom(tree_of(offer)) == rule]
        assert found == ([pytest.approx(min(costs))] if costs else [])


def bottom(tree: str) -> str:
    """The composition below the chain of one-to-one rules, '' when it is an agent."""
    found = re.match(r"(?:e\d\()*(c\d)\(", tree)
    return found[1] if found else ""


@settings(deadline=None, max_examples=80)
@given(worlds(), _PRIMITIVE, _CONDITION)
def test_every_agent_is_offered_or_refused_with_a_true_reason(
    world: World, primitive: str, condition: Condition
) -> None:
    matcher = Matcher(world.registry, world.crew, limits=EVERYTHING)
    constraint = constraint_of(text_of(condition)) if condition else None
    offers, refusals = matcher.offers(primitive, constraint), matcher.explain(primitive, constraint)
    by_subject = {refusal.subject: refusal for refusal in refusals}
    assert len(by_subject) == len(refusals)
    direct = {offer.agent for offer in offers if offer.kind == "direct"}
    for member in world.crew.members:
        if primitive in world.registry.providers[member.type].serves:
            assert (member.agent in direct) is not (member.agent in by_subject)
    by_rule = {offer.rule for offer in offers}
    for rule in rules_for(world, primitive):
        refusal = by_subject.get(rule.name)
        assert rule.name in by_rule or refusal is not None
        if refusal is not None and refusal.reasons[0].startswith("no "):
            assert rule.name not in by_rule
    for refusal in flat(refusals):
        assert refusal.reasons
        assert all(is_true(world, refusal.subject, reason) for reason in refusal.reasons)


def rules_for(world: World, primitive: str) -> list[Equivalence | Composition]:
    rules = [*world.registry.equivalences.values(), *world.registry.compositions.values()]
    return [rule for rule in rules if rule.serves == primitive]


def flat(refusals: tuple[Rejection, ...] | list[Rejection]) -> Iterator[Rejection]:
    for refusal in refusals:
        yield refusal
        yield from flat(refusal.inner)


def is_true(world: World, subject: str, reason: str) -> bool:
    """Whether a statement about an agent is true; for others, whether the comparison is true."""
    members = {member.agent: member for member in world.crew.members}
    compared = re.fullmatch(r"(\w+) ([\d.]+) (<|<=|>|>=) ([\d.]+)", reason)
    if compared:
        name, value, sign, limit = compared.groups()
        right = COMPARE[sign](float(value), float(limit))
        return right and (subject not in members or facts_of(world, members[subject])[name] == float(value))
    if subject in members:
        missing = re.fullmatch(r"(\w+) is not stated", reason)
        if missing:
            return missing[1] not in facts_of(world, members[subject])
        return reason == members[subject].refusal == "gone"
    return True
