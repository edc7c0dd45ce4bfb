"""A search among 200 rules that stand on one another up to depth 4: one-to-one, and compositions of two.

Rules are drawn at random, always from a primitive to later ones, so that there are chains of all lengths.
The primitives are asked for one after the other, each by a new query.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Sequence
from pathlib import Path

from harness.checkout import Checkout
from harness.figure import GROWTH, Figure, Opener
from harness.processes import Processes
from harness.samples import Contender, timed

from lfield.capability.condition_compiler import compile_constraint, parse_expression
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
)
from lfield.capability.offer import Candidate
from lfield.text.source_text import Source, Span

RULES, PRIMITIVES, AGENTS = 200, 40, 20
#: How many agents the growth is measured from, and to.
FEW, MANY = 100, 400
SOME, NOBODY, MORE = "some fulfil", "nobody fulfils", "half compositions, more agents"

_HERE = Span(Source("compositions", ""), 0, 0)
_NAMES = [f"P{i}" for i in range(PRIMITIVES)]
_PAYLOAD = {"payload": Attribute("payload", "real", _HERE, better="more", typical=2.0)}


class _Team:
    """Agents of ten types."""

    def __init__(self, count: int = AGENTS) -> None:
        self.members = [Candidate(f"a{i}", f"T{i % 10}", f"host{i}", 1) for i in range(count)]

    def candidates(self, resource: str) -> Sequence[Candidate]:
        return [member for member in self.members if member.type == resource]

    def here(self) -> None:
        """Nobody knows where is asked."""


def searching(compositions: float) -> Opener:
    """All primitives, with a condition and with one that nobody fulfils."""

    def opener(checkout: Checkout, processes: Processes) -> Contender:
        matcher = Matcher(_registry(compositions), _Team())
        some, nobody = _queries(matcher, "payload >= 1.5"), _queries(matcher, "payload >= 99.0")
        return lambda: {SOME: some(), NOBODY: nobody()}

    return opener


def growing(checkout: Checkout, processes: Processes) -> Contender:
    """The same search among more and more agents."""
    asking = {
        _agents(count): _queries(Matcher(_registry(0.5), _Team(count)), "payload >= 1.5")
        for count in (FEW, MANY)
    }
    return lambda: {case: ask() for case, ask in asking.items()}


def _agents(count: int) -> str:
    return f"{count} agents"


def _queries(matcher: Matcher, text: str) -> Callable[[], list[float]]:
    """Asks for each primitive, and gives the seconds; the first time is not among them."""
    constraint = compile_constraint(text, _PAYLOAD)

    def ask() -> list[float]:
        return [timed(lambda n=name: matcher.offers(n, constraint)) for name in _NAMES]

    ask()
    return ask


# --- a random registry --------------------------------------------------------------------------------


def _registry(compositions: float) -> Registry:
    chance = random.Random(1)
    providers = [
        Provider(
            f"T{i}",
            {name: ServedPrimitive(name, {}, _HERE) for name in chance.sample(_NAMES[PRIMITIVES // 2 :], 4)},
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
    expression, _ = parse_expression(text)
    assert expression is not None
    assert not check_expression(expression, NameScope.of_parts(_PAYLOAD, ["a", "b"]), "any")
    return expression


#: What n log n is multiplied by per ten times as many, between the two sizes.
_N_LOG_N = (MANY / FEW * math.log(MANY) / math.log(FEW)) ** (1 / math.log10(MANY / FEW))

FIGURE = Figure(
    "A search for compositions",
    {
        "half compositions": searching(0.5),
        "all compositions": searching(1.0),
        MORE: growing,
    },
    rounds=2,
    sizes={_agents(count): count for count in (FEW, MANY)},
    targets={
        SOME: "50.0 ms",
        NOBODY: "50.0 ms",
        f"{MORE}: {GROWTH}": f"{_N_LOG_N:.2f}x n log n",
    },
    notes=(
        f"{RULES} rules over {PRIMITIVES} primitives, {AGENTS} agents, depth 4, the best 16 of each rule",
    ),
)
