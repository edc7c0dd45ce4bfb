"""Stability of the best offer under irrelevant changes, and the growth of the time of a find.

For the primitive `Lift` these facts are irrelevant: attributes of types without agents, attributes of agents
that do not lift, and attributes without a preferred direction. Each team is drawn once, and the irrelevant
facts are drawn again for each seed.
"""

from __future__ import annotations

import random
from collections.abc import Sequence
from pathlib import Path

from harness.checkout import Checkout
from harness.figure import GROWTH, Figure
from harness.number_text import PERCENT
from harness.processes import Processes
from harness.samples import Contender, timed
from msgspec import structs
from msgspec.structs import replace

from lfield.capability.condition_compiler import compile_query, parse_expression
from lfield.capability.matching.condition_checker import (
    NameScope,
    check_expression,
)
from lfield.capability.matching.matcher import Matcher
from lfield.capability.model import (
    Attribute,
    Composition,
    Equivalence,
    Expression,
    Need,
    Primitive,
    Provider,
    Registry,
    ServedPrimitive,
    Value,
    Weights,
)
from lfield.capability.offer import Candidate, Fact, Offer

TEAMS, SEEDS = 100, 20
SIZES = (10, 100, 1000, 3000)
SAME = "the best stays the best"

_RELEVANT, _IRRELEVANT = ("payload", "reach", "noise"), ("length", "width", "colour", "wheels")
_ATTRIBUTES = {
    name: Attribute(name, "real", better=better, typical=2.0)
    for name, better in (
        *((name, "more") for name in ("payload", "reach", "length", "width")),
        *((name, "less") for name in ("noise", "wheels")),
        ("colour", "none"),
    )
} | {
    "battery": Attribute("battery", "real", better="more", live=True, max_age=10.0),
    "slot": Attribute("slot", "int"),
}


class _Team:
    """The agents of a team by type."""

    def __init__(self, members: Sequence[Candidate]) -> None:
        self.by_type: dict[str, list[Candidate]] = {}
        for number, member in enumerate(members):
            self.by_type.setdefault(member.type, []).append(structs.replace(member, number=number))

    def candidates(self, resource: str) -> Sequence[Candidate]:
        return self.by_type.get(resource, ())

    def location(self) -> None:
        """The host of the caller is unknown."""


def _registry(
    providers: Sequence[Provider], *rules: Equivalence | Composition, **agents: dict[str, Value]
) -> Registry:
    return Registry(
        terms={},
        attributes=_ATTRIBUTES,
        primitives={name: Primitive(name, name, {}) for name in ("Lift", "Climb", "Grip", "Haul")},
        providers={provider.type: provider for provider in providers},
        equivalences={rule.name: rule for rule in rules if isinstance(rule, Equivalence)},
        compositions={rule.name: rule for rule in rules if isinstance(rule, Composition)},
        agents=agents,
    )


# --- stability ----------------------------------------------------------------------------------------


def _best(team: int, seed: int) -> str:
    """The best agent for `Lift` in a team, with irrelevant facts drawn by the seed."""
    drawn, other = random.Random(team), random.Random(f"{team} {seed}")
    types = [_provider(f"T{i}", "Lift" if i % 2 else "Climb", _RELEVANT, drawn) for i in range(8)]
    members = [Candidate(f"a{i}", f"T{i}", f"h{i}", drawn.randint(0, 1)) for i in range(8)]
    stands_in = Equivalence("climbs", "Lift", "Climb", {}, loss=0.02)
    irrelevant = [_provider(f"N{i}", other.choice(["Lift", "Climb"]), _IRRELEVANT, other) for i in range(4)]
    grips = {f"g{i}": _facts(_IRRELEVANT, other) for i in range(2)}
    irrelevant.append(_provider("Hand", "Grip", _RELEVANT, other))
    members += [Candidate(name, "Hand", "far", 1) for name in grips]
    weights = Weights(hop=drawn.choice([0.03, 0.1]))
    weighted_registry = replace(_registry([*types, *irrelevant], stands_in, **grips), weights=weights)
    return _found(Matcher(weighted_registry, _Team(members)))[0].agent


def _found(matcher: Matcher) -> Sequence[Offer]:
    return matcher.offers("Lift")


def _provider(type: str, serves: str, names: Sequence[str], drawn: random.Random) -> Provider:
    return Provider(type, {serves: ServedPrimitive(serves, {})}, attributes=_facts(names, drawn))


def _facts(names: Sequence[str], drawn: random.Random) -> dict[str, Value]:
    return {name: drawn.uniform(1.0, 4.0) for name in drawn.sample(list(names), drawn.randint(1, len(names)))}


def stability(checkout: Checkout, processes: Processes) -> Contender:
    """Per cent of the teams and seeds in which the best agent stays the same."""

    def measure() -> dict[str, list[float]]:
        bests = [[_best(team, seed) for seed in range(SEEDS)] for team in range(TEAMS)]
        same = sum(best == team[0] for team in bests for best in team)
        return {SAME: [100.0 * same / (TEAMS * SEEDS)]}

    return measure


# --- growth -------------------------------------------------------------------------------------------


def _over_parts(text: str, parts: Sequence[str]) -> Expression:
    expression, _ = parse_expression(text)
    assert expression is not None
    assert not check_expression(expression, NameScope.of_parts(_ATTRIBUTES, parts), "any")
    return expression


def _composed(name: str, parts: dict[str, str], where: str) -> Composition:
    needs = {part: Need(part, primitive) for part, primitive in parts.items()}
    return Composition(
        name, "Haul", needs, "Through", Path("through.L"), where=(_over_parts(where, list(parts)),)
    )


_TWO = _composed("two", {"a": "Lift", "b": "Climb"}, "a.slot == b.slot")
_THREE = _composed("three", {"a": "Lift", "b": "Climb", "c": "Grip"}, "a.slot == b.slot && b.slot == c.slot")
_TYPES = (("Fork", "Lift"), ("Cart", "Climb"), ("Hand", "Grip"))
_STANDS_IN = Equivalence("lifts", "Haul", "Lift", {}, loss=0.1)
_GROWN = {
    "direct": ("Lift", (), ""),
    "direct, on a condition": ("Lift", (), "payload >= 3 && battery > 0.2"),
    "equivalent": ("Haul", (_STANDS_IN,), ""),
    "composed of two": ("Haul", (_TWO,), ""),
    "composed of three": ("Haul", (_THREE,), ""),
    "by an order": ("Lift", (), "order by payload desc"),
    "teams of two": ("Lift", (), ""),
}


def _members(count: int, age: float) -> list[Candidate]:
    drawn = random.Random(1)
    return [
        Candidate(
            f"a{i}",
            _TYPES[i % 3][0],
            f"h{i}",
            1,
            facts={
                "payload": Fact(drawn.uniform(0.5, 9.0)),
                "slot": Fact(i // 3),
                "battery": Fact(drawn.uniform(0.1, 0.9), age),
            },
        )
        for i in range(count)
    ]


def growing(case: str, lively: bool) -> Contender:
    """Seconds of a query in teams of all sizes."""
    primitive, rules, text = _GROWN[case]
    weighted_registry = _registry([Provider(t, {p: ServedPrimitive(p, {})}) for t, p in _TYPES], *rules)
    wish = compile_query(text, _ATTRIBUTES) if text else None

    def ask(count: int) -> list[float]:
        teams = [_Team(_members(count, 0.1 * turn)) for turn in range(8)]
        team = _Team([])
        team.by_type = teams[0].by_type
        matcher = Matcher(weighted_registry, team)
        asked = [matcher.teams, primitive, 2] if case == "teams of two" else [matcher.find, primitive]
        times = []
        for turn in teams:
            if lively:
                team.by_type = turn.by_type
            times.append(timed(lambda: asked[0](*asked[1:], *([wish] if wish else []))))
        return times[1:]

    def measure() -> dict[str, list[float]]:
        return {f"{count} agents": ask(count) for count in SIZES}

    return measure


FIGURE = Figure(
    "Who is found among many",
    {
        "irrelevant attributes": stability,
        **{
            f"{case}, {how}": lambda _c, _p, case=case, how=how: growing(case, how == "lively")
            for case in _GROWN
            for how in ("still", "lively")
        },
    },
    rounds=2,
    units={SAME: PERCENT},
    sizes={f"{count} agents": count for count in SIZES},
    targets={SAME: "100.00 %", GROWTH: "15.00x", "direct, lively: 1000 agents": "5.00 ms"},
    notes=(f"{TEAMS} teams, each beside {SEEDS} draws of what is irrelevant",),
)
