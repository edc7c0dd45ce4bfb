"""The guide to capabilities as an exhaustive search: written from its text, not from the code."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, product
from typing import Any

from guide_worlds import ATTRIBUTES, LIVE, Asked, Tree, World

DEPTH, PER_RULE, MOST = 4, 16, 32
WEIGHTS = {"fitness": 1.0, "loss": 2.0, "part": 0.5, "hop": 0.1, "near": 0.2, "age": 0.2}
AXES = ("north", "east", "down")

Facts = Mapping[str, Any]


@dataclass(frozen=True)
class Way:
    """One result. `rules` lead down to the agent or the whole; `end` is its number, or its parts."""

    tree: str
    cost: float
    facts: Facts
    agents: frozenset[str]
    rules: tuple[str, ...]
    end: tuple[Any, ...]

    @property
    def place(self) -> tuple[Any, ...]:
        """The position of the result in the ranking."""
        return (self.cost, len(self.rules), self.rules, self.end)

    @property
    def score(self) -> float:
        return 1 / (1 + self.cost)


# --- conditions ----------------------------------------------------------------------------------------


def value_of(tree: Tree, facts: Facts) -> Any:
    """A number, a truth value or a text; None: unknown."""
    match tree:
        case ("is", name):
            return facts.get(name)
        case ("number" | "word", value):
            return value
        case ("!", operand):
            value = value_of(operand, facts)
            return None if value is None else not value
        case ("call", "distance", *arguments):
            return _distance(arguments, facts)
        case ("call", function, *arguments):
            values = [value_of(argument, facts) for argument in arguments]
            return None if None in values else {"min": min, "max": max}[function](values)
        case (sign, left, right):
            return _joined(sign, value_of(left, facts), value_of(right, facts))
    raise ValueError(tree)


def _joined(sign: str, left: Any, right: Any) -> Any:
    if sign == "&&":
        return False if False in (left, right) else None if None in (left, right) else True
    if sign == "||":
        return True if True in (left, right) else None if None in (left, right) else False
    if left is None or right is None:
        return None
    match sign:
        case "+":
            return left + right
        case "*":
            return left * right
        case "==":
            return _alike(left, right)
        case "!=":
            return not _alike(left, right)
        case "<":
            return left < right
        case "<=":
            return left <= right
        case ">":
            return left > right
        case ">=":
            return left >= right
    raise ValueError(sign)


def _alike(left: Any, right: Any) -> bool:
    if isinstance(left, frozenset) or isinstance(right, frozenset):
        one = left if isinstance(left, frozenset) else {left}
        other = right if isinstance(right, frozenset) else {right}
        return bool(one & other)
    return bool(left == right)


def _distance(arguments: Sequence[Tree], facts: Facts) -> float | None:
    if arguments[0][0] == "is":
        (_, one), (_, other) = arguments
        pairs = [(facts.get(f"{one}.{axis}"), facts.get(f"{other}.{axis}")) for axis in AXES]
    else:
        expected = [value_of(argument, facts) for argument in arguments]
        pairs = [(facts.get(axis), value) for axis, value in zip(AXES, expected, strict=False)]
    if any(None in pair for pair in pairs):
        return None
    return math.sqrt(sum((a - b) ** 2 for a, b in pairs))


def mentioned(tree: Tree) -> set[str]:
    """The attributes that a condition names."""
    match tree:
        case ("is", name):
            return {name}
        case ("number" | "word", _):
            return set()
        case ("call", "distance", *arguments):
            return set(AXES[: len(arguments)])
    return set().union(*(mentioned(part) for part in tree[1:] if isinstance(part, tuple)))


# --- all results --------------------------------------------------------------------------------------


class Oracle:
    """All answers to one query."""

    def __init__(self, world: World, asked: Asked) -> None:
        self.world, self.asked = world, asked
        self.weights = {**WEIGHTS, **world.ranking.get("weights", {})}
        self.shares = world.ranking.get("attributes", {})
        self.nearby = world.ranking.get("nearby", 50.0)
        trees = [asked.condition] if asked.condition is not None else []
        self.named = set().union(*(mentioned(tree) for tree in [*trees, *(key for key, _ in asked.order)]))
        self.here = next(
            (
                place
                for name, type, host in world.team
                if host == asked.host and (place := _place(self.facts(name, type, host)))
            ),
            None,
        )

    # --- agents -----------------------------------------------------------------------------------------

    def facts(self, name: str, type: str, host: str, primitive: str = "") -> dict[str, Any]:
        """The facts of an agent: its own before those of the device, the primitive and the type."""
        provider, own = self.world.providers[type], self.world.agents.get(name, {})
        found = {**provider["attributes"], **provider["serves"].get(primitive, {}).get("attributes", {})}
        for attribute in provider["live"]:
            found.pop(attribute, None)
            value, age = self.world.told[name].get(attribute, (None, math.inf))
            if age <= ATTRIBUTES[attribute]["max_age"]:
                found[attribute] = value
        found.update(own)
        sets = {key: frozenset(value) for key, value in found.items() if isinstance(value, list)}
        return {**found, **sets, "agent": name, "robot": host, "host": host}

    def rated(self, primitive: str) -> list[str]:
        """The attributes that count in the fitness."""
        found: set[str] = set()
        for name, type, host in self.world.team:
            if self._ever_serves(name, type, host, primitive):
                provider = self.world.providers[type]
                found |= {*provider["attributes"], *provider["live"], *self.world.agents.get(name, {})}
                found |= {*provider["serves"][primitive].get("attributes", {})}
        return [n for n in sorted(found) if "better" in ATTRIBUTES[n] and self.shares.get(n, 1.0) > 0]

    def _ever_serves(self, name: str, type: str, host: str, primitive: str) -> bool:
        served = self.world.providers[type]["serves"].get(primitive)
        if served is None:
            return False
        when = served.get("when")
        if when is None:
            return True
        measured = set(self.world.providers[type]["live"]) - set(self.world.agents.get(name, {}))
        # Each `when` of these worlds is about one attribute, and a device could report any value of it.
        return (
            bool(mentioned(when) & measured)
            or value_of(when, self.facts(name, type, host, primitive)) is True
        )

    def cost(self, name: str, type: str, host: str, primitive: str) -> float:
        facts, rated = self.facts(name, type, host, primitive), self.rated(primitive)
        penalties, total = 0.0, 0.0
        for attribute in rated:
            share = self.shares.get(attribute, 1.0)
            penalties, total = penalties + share * _penalty(attribute, facts.get(attribute)), total + share
        fitness = penalties / total if total else 0.0
        hop = 0 if host == self.asked.host else 1
        near = 0.0
        if self.here is not None:
            place = _place(facts)
            distance = None if place is None else _between(place, self.here)
            near = 0.5 if distance is None else distance / (self.nearby + distance)
        measured = set(self.world.providers[type]["live"]) - set(self.world.agents.get(name, {}))
        ages = [
            min(1.0, self.world.told[name][attribute][1] / ATTRIBUTES[attribute]["max_age"])
            for attribute in measured & ({*rated} | self.named)
            if attribute in self.world.told[name] and attribute in LIVE
        ]
        w = self.weights
        cost = w["fitness"] * fitness + w["hop"] * hop + w["near"] * near + w["age"] * max(ages, default=0.0)
        return round(cost, 9)

    # --- rules ------------------------------------------------------------------------------------------

    def ways(
        self,
        primitive: str,
        depth: int = DEPTH,
        passed: frozenset[str] = frozenset(),
        around: frozenset[str] = frozenset(),
    ) -> Iterator[Way]:
        """All results for a primitive, by at most `depth` rules.

        `passed` are the primitives of the chain, `around` the rules of the enclosing wholes.
        """
        for number, (name, type, host) in enumerate(self.world.team):
            served = self.world.providers[type]["serves"].get(primitive)
            if served is None or name in self.world.refused:
                continue
            facts = self.facts(name, type, host, primitive)
            if served.get("when") is None or value_of(served["when"], facts) is True:
                cost = self.cost(name, type, host, primitive)
                yield Way(name, cost, facts, frozenset([name]), (), (number,))
        if depth == 0:
            return
        for rule, rule_data in self.world.one_to_one.items():
            if rule_data["serves"] == primitive and rule_data["by"] not in passed | {primitive}:
                for way in self.ways(rule_data["by"], depth - 1, passed | {primitive}, around):
                    if rule_data.get("when") is None or value_of(rule_data["when"], way.facts) is True:
                        cost = round(way.cost + self.weights["loss"] * rule_data["loss"], 9)
                        tree = f"{rule}({way.tree})"
                        yield Way(tree, cost, way.facts, way.agents, (rule, *way.rules), way.end)
        for rule, rule_data in self.world.one_to_many.items():
            if rule_data["serves"] == primitive and rule not in around:
                yield from self._wholes(rule, rule_data, depth - 1, around | {rule})

    def _wholes(
        self, rule: str, said: Mapping[str, Any], depth: int, around: frozenset[str]
    ) -> Iterator[Way]:
        choices = []
        for need in said["needs"].values():
            found = self.ways(need["capability"], depth, around=around)
            choices.append(
                [w for w in found if need["when"] is None or value_of(need["when"], w.facts) is True]
            )
        for parts in product(*choices):
            composed = self._whole(rule, said, dict(zip(said["needs"], parts, strict=True)))
            if composed is not None:
                yield composed

    def _whole(self, rule: str, said: Mapping[str, Any], parts: Mapping[str, Way]) -> Way | None:
        distinct = list(parts) if said.get("distinct") is True else said.get("distinct") or []
        for one, other in combinations(distinct, 2):
            if parts[one].agents & parts[other].agents:
                return None
        of_parts = {f"{part}.{key}": value for part, way in parts.items() for key, value in way.facts.items()}
        facts = {name: value_of(tree, of_parts) for name, tree in said["attributes"].items()}
        facts = {name: value for name, value in facts.items() if value is not None}
        if any(value_of(where, {**of_parts, **facts}) is not True for where in said["where"]):
            return None
        for name in ("agent", "robot", "host"):
            every = [way.facts[name] for way in parts.values()]
            facts[name] = frozenset().union(*(v if isinstance(v, frozenset) else {v} for v in every))
        costs = sum(way.cost for way in parts.values())
        cost = costs + self.weights["loss"] * said["loss"] + self.weights["part"] * (len(parts) - 1)
        ways = list(parts.values())
        agents = frozenset[str]().union(*(way.agents for way in ways))
        tree = f"{rule}({','.join(way.tree for way in ways)})"
        return Way(tree, round(cost, 9), facts, agents, (rule,), tuple(way.place for way in ways))

    # --- answers ----------------------------------------------------------------------------------------

    def all_ways(self) -> list[Way]:
        """All offers, best first, without the limit."""
        condition = self.asked.condition
        found = self.ways(self.asked.primitive)
        ways = sorted(
            (w for w in found if condition is None or value_of(condition, w.facts) is True), key=self._place
        )
        best, rule_counts = [], dict.fromkeys(self.world.one_to_many, 0)
        for way in ways:
            composition = way.rules[-1] if way.rules and way.rules[-1] in rule_counts else None
            if composition is not None:
                rule_counts[composition] += 1
            if composition is None or rule_counts[composition] <= PER_RULE:
                best.append(way)
        return best

    def _place(self, way: Way) -> tuple[Any, ...]:
        keys = []
        for tree, descending in self.asked.order:
            value = value_of(tree, way.facts)
            keys.append((value is None, 0 if value is None else -value if descending else value))
        return (*keys, way.place)

    def offers(self) -> list[Way]:
        """The answer of a find."""
        return self.all_ways()[: self.asked.limit or MOST]

    def teams(self) -> list[tuple[Way, ...]]:
        """The answer of a find for teams."""
        members: dict[frozenset[str], Way] = {}
        for way in self.all_ways():
            members.setdefault(way.agents, way)
        found = []
        for numbers in combinations(range(len(members)), self.asked.size):
            team = [list(members.values())[number] for number in numbers]
            if all(not one.agents & other.agents for one, other in combinations(team, 2)):
                cost = sum(way.cost for way in team) + self.weights["part"] * (len(team) - 1)
                place = () if self.asked.order else (round(cost, 9),)
                found.append(((*place, *numbers), tuple(team)))
        found.sort(key=lambda pair: pair[0])
        return [team for _, team in found[: self.asked.limit or MOST]]


def _penalty(attribute: str, value: float | None) -> float:
    if value is None:
        return 0.5
    typical, amount = ATTRIBUTES[attribute]["typical"], max(0.0, value)
    more = ATTRIBUTES[attribute]["better"] == "more"
    return float((typical if more else amount) / (typical + amount))


def _place(facts: Facts) -> tuple[float, float, float | None] | None:
    north, east = facts.get("north"), facts.get("east")
    return None if north is None or east is None else (north, east, facts.get("down"))


def _between(one: tuple[float, float, float | None], other: tuple[float, float, float | None]) -> float:
    squares = (one[0] - other[0]) ** 2 + (one[1] - other[1]) ** 2
    if one[2] is not None and other[2] is not None:
        squares += (one[2] - other[2]) ** 2
    return math.sqrt(squares)
