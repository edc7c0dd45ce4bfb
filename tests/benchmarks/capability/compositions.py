"""A search among 200 rules that stand on one another up to depth 4: one-to-one, and compositions of two.

Rules are drawn at random, always from a primitive to later ones, so that there are chains of all lengths.
The primitives are asked for one after the other, each by a new query.
"""

from __future__ import annotations

import math
import random
from collections.abc import Sequence
from pathlib import Path

from harness import Figure, Row, median, milliseconds, percentile, timed, times

from lfield.capability.matching.expression import Scope, check, compile_constraint, parse
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
    Served,
)
from lfield.capability.offer import Candidate
from lfield.source import Source, Span

RULES, PRIMITIVES, AGENTS = 200, 40, 20
#: How many agents the growth is measured from.
FEW = 100
#: Seconds that a search may take.
TARGET = 50e-3

_HERE = Span(Source("compositions", ""), 0, 0)
_NAMES = [f"P{i}" for i in range(PRIMITIVES)]
_PAYLOAD = {"payload": Attribute("payload", "real", _HERE, better="more", typical=2.0)}


class _Team:
    """Agents of ten types."""

    def __init__(self, count: int = AGENTS) -> None:
        self.members = [Candidate(f"a{i}", f"T{i % 10}", f"host{i}", 1) for i in range(count)]

    def candidates(self, resource: str) -> Sequence[Candidate]:
        return [member for member in self.members if member.type == resource]


def figure() -> Figure:
    """Half of the rules compositions, and all of them."""
    rows = [
        *_rows("half compositions", compositions=0.5),
        *_rows("all compositions", compositions=1.0),
        *_growth(),
    ]
    notes = (
        f"{RULES} rules over {PRIMITIVES} primitives, {AGENTS} agents, depth 4, the best 16 of each rule",
    )
    return Figure("A search for compositions; ratio to the target, of growth to n log n", rows, notes)


def _rows(case: str, compositions: float) -> list[Row]:
    """All primitives, with a condition and with one that nobody fulfils."""
    matcher = Matcher(_registry(compositions), _Team())
    rows = []
    for measured, text in (("some fulfil", "payload >= 1.5"), ("nobody fulfils", "payload >= 99.0")):
        constraint = compile_constraint(text, _PAYLOAD)
        offers = max(len(matcher.offers(name, constraint)) for name in _NAMES)
        samples = [_query(matcher, name, constraint) for name in _NAMES]
        rows.append(
            Row(
                case if not rows else "",
                f"{measured}: up to {offers} offers",
                milliseconds(median(samples)),
                milliseconds(percentile(samples, 99)),
                times(median(samples) / TARGET),
                milliseconds(TARGET),
            )
        )
    return rows


def _growth() -> list[Row]:
    """The same search among more and more agents, against n log n."""
    constraint = compile_constraint("payload >= 1.5", _PAYLOAD)
    registry, rows, before = _registry(0.5), [], 0.0
    for count in (FEW, 4 * FEW):
        matcher = Matcher(registry, _Team(count))
        took = median([_query(matcher, name, constraint) for _ in range(3) for name in _NAMES])
        bound = 4 * math.log(4 * FEW) / math.log(FEW)
        ratio = times(took / before / bound) if before else ""
        target = f"{bound:.2f}x, n log n" if before else ""
        shown = f"{milliseconds(took)}, {times(took / before)}" if before else milliseconds(took)
        rows.append(Row("growth" if not before else "", f"{count} agents", shown, "", ratio, target))
        before = took
    return rows


def _query(matcher: Matcher, name: str, constraint: Expression) -> float:
    return timed(lambda: matcher.offers(name, constraint))


# --- a random registry --------------------------------------------------------------------------------


def _registry(compositions: float) -> Registry:
    chance = random.Random(1)
    providers = [
        Provider(
            f"T{i}",
            {name: Served(name, {}, _HERE) for name in chance.sample(_NAMES[PRIMITIVES // 2 :], 4)},
            _HERE,
            attributes={"payload": chance.uniform(0.5, 9.0)},
        )
        for i in range(10)
    ]
    drawn = [_rule(i, chance, compositions) for i in range(RULES)]
    return Registry(
        terms={},
        attributes=_PAYLOAD,
        primitives={name: Primitive(name, name, {}, _HERE) for name in _NAMES},
        providers={provider.type: provider for provider in providers},
        equivalences={rule.name: rule for rule in drawn if isinstance(rule, Equivalence)},
        compositions={rule.name: rule for rule in drawn if isinstance(rule, Composition)},
    )


def _rule(number: int, chance: random.Random, compositions: float) -> Equivalence | Composition:
    place = chance.randrange(PRIMITIVES - 4)
    later = _NAMES[place + 1 :]
    loss = chance.uniform(0.0, 0.5)
    if chance.random() >= compositions:
        return Equivalence(f"e{number}", _NAMES[place], chance.choice(later), {}, _HERE, loss=loss)
    needs = {name: Need(name, chance.choice(later), _HERE) for name in ("a", "b")}
    return Composition(
        f"c{number}",
        _NAMES[place],
        needs,
        "Through",
        Path("through.L"),
        _HERE,
        where=(_over_parts("a.robot != b.robot"),),
        attributes={"payload": _over_parts("min(a.payload, b.payload)")},
        loss=loss,
    )


def _over_parts(text: str) -> Expression:
    expression, _ = parse(text)
    assert expression is not None
    assert not check(expression, Scope.of_parts(_PAYLOAD, ["a", "b"]), "any")
    return expression
