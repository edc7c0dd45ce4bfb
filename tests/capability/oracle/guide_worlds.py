"""Registries and teams drawn at random, as plain data in the terms of the guide, without the code.

A world has the content of the YAML file and the reports of the devices. Conditions are nested tuples, which
are written as text for the registry and evaluated independently by the oracle.
"""

from __future__ import annotations

import random
from dataclasses import dataclass, field
from typing import Any

#: Name: unit or type, better, typical, whether it is live.
ATTRIBUTES: dict[str, dict[str, Any]] = {
    "payload": {"type": "real", "unit": "kg", "better": "more", "typical": 2.0},
    "reach": {"type": "real", "unit": "m", "better": "more", "typical": 1.0},
    "noise": {"type": "real", "better": "less", "typical": 4.0},
    "battery": {"type": "real", "better": "more", "typical": 1.0, "live": True, "max_age": 10.0},
    "heat": {"type": "real", "better": "less", "typical": 50.0, "live": True, "max_age": 4.0},
    "slot": {"type": "int"},
    "tools": {"type": "set", "values": ["arm", "hook", "sling"]},
    "north": {"type": "real", "unit": "m", "live": True, "max_age": 8.0},
    "east": {"type": "real", "unit": "m", "live": True, "max_age": 8.0},
    "down": {"type": "real", "unit": "m", "live": True, "max_age": 8.0},
}
NUMBERS = ("payload", "reach", "noise")
LIVE = ("battery", "heat", "north", "east", "down")
PRIMITIVES = ("Carry", "Drive", "Grip", "Haul", "Lift")
AMOUNTS = (0.5, 1.0, 1.0, 2.0, 3.0)
HOSTS = ("alpha", "bravo", "charlie")

Tree = tuple[Any, ...]


@dataclass
class World:
    """A registry as its sections, its team, and the reports."""

    providers: dict[str, dict[str, Any]] = field(default_factory=dict)
    one_to_one: dict[str, dict[str, Any]] = field(default_factory=dict)
    one_to_many: dict[str, dict[str, Any]] = field(default_factory=dict)
    agents: dict[str, dict[str, Any]] = field(default_factory=dict)
    ranking: dict[str, Any] = field(default_factory=dict)
    #: Name, type and host, in the order of the deployment.
    team: list[tuple[str, str, str]] = field(default_factory=list)
    #: By agent: live values with their ages.
    told: dict[str, dict[str, tuple[float, float]]] = field(default_factory=dict)
    refused: dict[str, str] = field(default_factory=dict)


@dataclass
class Asked:
    """A query; `host` is the querying host, `size` the number of members of a team."""

    primitive: str
    host: str
    condition: Tree | None
    order: list[tuple[Tree, bool]]
    limit: int | None
    size: int

    @property
    def text(self) -> str:
        """The query as text."""
        parts = [] if self.condition is None else [written(self.condition)]
        if self.order:
            keys = (f"{written(tree)}{' desc' if descending else ''}" for tree, descending in self.order)
            parts.append(f"order by {', '.join(keys)}")
        if self.limit is not None:
            parts.append(f"limit {self.limit}")
        return " ".join(parts)


def written(tree: Tree) -> str:
    """A condition or value as text."""
    match tree:
        case ("is", name):
            return str(name)
        case ("word", text):
            return f'"{text}"'
        case ("number", value):
            return repr(value)
        case ("call", function, *arguments):
            return f"{function}({', '.join(written(a) for a in arguments)})"
        case ("!", operand):
            return f"!({written(operand)})"
        case (sign, left, right):
            return f"({written(left)} {sign} {written(right)})"
    raise ValueError(tree)


# --- drawing -------------------------------------------------------------------------------------------


def world(rng: random.Random) -> World:
    """A small world with all features."""
    made = World()
    for type in ("Crane", "Mule", "Tower", "Wagon", "Nobody"):
        made.providers[type] = _provider(rng)
    for name in rng.sample(["a-way", "b-way", "c-way", "d-way", "e-way"], rng.randint(0, 4)):
        serves, by = rng.sample(PRIMITIVES, 2)
        rule: dict[str, Any] = {"serves": serves, "by": by, "loss": rng.choice([0.0, 0.0, 0.0, 0.25])}
        if rng.random() < 0.4:
            rule["when"] = condition(rng, 1)
        made.one_to_one[name] = rule
    for number in range(rng.randint(4, 8)):
        _join(made, rng, f"x{number}")
    served = [name for _, type, _ in made.team for name in made.providers[type]["serves"]]
    for name in rng.sample(["all-of-them", "both", "crew", "duo"], rng.randint(1, 3)):
        made.one_to_many[name] = _whole(rng, served)
    if rng.random() < 0.4:
        weights = {name: rng.choice([0.0, 0.1, 1.0, 3.0]) for name in rng.sample(_WEIGHTS, 2)}
        made.ranking = {"weights": weights, "attributes": {rng.choice(NUMBERS): rng.choice([0.0, 3.0])}}
        made.ranking["nearby"] = rng.choice([5.0, 50.0])
    return made


_WEIGHTS = ("fitness", "loss", "part", "hop", "near", "age")


def _facts(rng: random.Random, most: int) -> dict[str, Any]:
    found: dict[str, Any] = {n: rng.choice(AMOUNTS) for n in rng.sample(NUMBERS, rng.randint(0, most))}
    if rng.random() < 0.5:
        found["slot"] = rng.randint(1, 3)
    if rng.random() < 0.5:
        found["tools"] = sorted(rng.sample(["arm", "hook", "sling"], rng.randint(1, 2)))
    return found


def _provider(rng: random.Random) -> dict[str, Any]:
    serves: dict[str, Any] = {}
    for primitive in rng.sample(PRIMITIVES, rng.randint(1, 3)):
        served: dict[str, Any] = {}
        if rng.random() < 0.3:
            served["attributes"] = _facts(rng, 1)
        if rng.random() < 0.2:
            served["when"] = rng.choice([_has_tool(rng), (">=", ("is", "battery"), ("number", 0.3))])
        serves[primitive] = served
    live = {n for n in ("battery", "heat") if rng.random() < 0.4}
    if rng.random() < 0.6:
        live |= {"north", "east"} | ({"down"} if rng.random() < 0.5 else set())
    return {"attributes": _facts(rng, 2), "live": sorted(live), "serves": serves}


def _join(made: World, rng: random.Random, name: str) -> None:
    type = rng.choice([t for t in made.providers if t != "Nobody"])
    made.team.append((name, type, rng.choice(HOSTS)))
    if rng.random() < 0.5:
        made.agents[name] = _facts(rng, 2)
    if rng.random() < 0.1:
        made.agents.setdefault(name, {})["battery"] = 0.5
    if rng.random() < 0.1:
        made.refused[name] = "gone"
    made.told[name] = {
        attribute: (round(rng.choice([0.0, 0.25, 1.0, 3.0, 4.0]), 3), rng.choice([0.0, 0.5, 2.0, 4.0, 9.0]))
        for attribute in made.providers[type]["live"]
        if rng.random() < 0.9
    }


def _whole(rng: random.Random, served: list[str]) -> dict[str, Any]:
    """A rule with parts, usually such that agents serve them."""
    needs = {
        part: {
            "capability": rng.choice(served if rng.random() < 0.8 else PRIMITIVES),
            "when": condition(rng, 1) if rng.random() < 0.2 else None,
        }
        for part in ("left", "mid", "right")[: rng.choice([1, 2, 2, 2, 3])]
    }
    parts = list(needs)
    rule: dict[str, Any] = {"serves": rng.choice(PRIMITIVES), "needs": needs, "where": [], "attributes": {}}
    rule["loss"] = rng.choice([0.0, 0.25, 0.5])
    if len(parts) > 1 and rng.random() < 0.5:
        rule["distinct"] = True if rng.random() < 0.5 else rng.sample(parts, 2)
    for _ in range(rng.choice([0, 1, 1, 2])):
        rule["where"].append(_between(rng, *(rng.sample(parts, 2) if len(parts) > 1 else parts * 2)))
    for name in rng.sample(NUMBERS, rng.randint(0, 2)):
        values = [("is", f"{part}.{name}") for part in parts]
        single = len(values) == 1
        rule["attributes"][name] = values[0] if single else ("call", rng.choice(["min", "max"]), *values)
    if rng.random() < 0.3:
        rule["attributes"] |= {axis: ("is", f"{parts[0]}.{axis}") for axis in ("north", "east")}
    if rng.random() < 0.3:
        rule["attributes"]["slot"] = ("is", f"{parts[-1]}.slot")
    return rule


def _between(rng: random.Random, one: str, other: str) -> Tree:
    """A condition over two parts, or over one."""
    number = rng.choice(NUMBERS)
    first, second = ("is", f"{one}.{number}"), ("is", f"{other}.{number}")
    return rng.choice(
        [
            ("==", ("is", f"{one}.slot"), ("is", f"{other}.slot")),
            ("==", ("is", f"{one}.tools"), ("is", f"{other}.tools")),
            ("!=", ("is", f"{one}.robot"), ("is", f"{other}.robot")),
            (">=", ("+", first, second), ("number", 2.0)),
            ("<=", first, second),
            (rng.choice(["<", ">="]), ("call", rng.choice(["min", "max"]), first, second), ("number", 1.0)),
            (rng.choice(["<", ">="]), ("number", 1.0), ("call", rng.choice(["min", "max"]), first, second)),
            ("<=", ("call", "distance", ("is", one), ("is", other)), ("number", 4.0))
            if one != other
            else (">=", first, ("number", 1.0)),
            ("==", ("is", f"{one}.agent"), ("word", f"x{rng.randint(0, 3)}")),
            ("||", ("==", ("is", f"{one}.slot"), ("number", 1)), (">", second, ("number", 1.0))),
        ]
    )


def _has_tool(rng: random.Random) -> Tree:
    return ("==", ("is", "tools"), ("word", rng.choice(["arm", "hook", "sling"])))


def condition(rng: random.Random, depth: int) -> Tree:
    """A condition over the attributes of one offer."""
    if depth > 0 and rng.random() < 0.5:
        sign = rng.choice(["&&", "&&", "||", "!"])
        if sign == "!":
            return ("!", condition(rng, depth - 1))
        return (sign, condition(rng, depth - 1), condition(rng, depth - 1))
    name = rng.choice((*NUMBERS, "battery", "slot"))
    return rng.choice(
        [
            (rng.choice(["<", "<=", ">", ">=", "=="]), ("is", name), ("number", rng.choice(AMOUNTS))),
            (">=", ("number", 2.0), ("is", name)),
            (">", ("+", ("is", "payload"), ("is", "reach")), ("number", 2.0)),
            _has_tool(rng),
            (rng.choice(["==", "!="]), ("is", "agent"), ("word", f"x{rng.randint(0, 4)}")),
            (rng.choice(["==", "!="]), ("is", "robot"), ("word", rng.choice(HOSTS))),
            ("<=", ("call", "distance", ("number", 1.0), ("number", 2.0)), ("number", 4.0)),
        ]
    )


def question(made: World, rng: random.Random) -> Asked:
    """A query to such a world, usually for a primitive that a rule serves."""
    rules = (*made.one_to_one.values(), *made.one_to_many.values(), *made.one_to_many.values())
    ruled = [rule["serves"] for rule in rules]
    keys: list[Tree] = [
        ("is", "payload"),
        ("is", "noise"),
        ("is", "battery"),
        ("*", ("is", "reach"), ("is", "payload")),
        ("call", "distance", ("number", 1.0), ("number", 3.0)),
        ("call", "distance", ("number", 0.0), ("number", 3.0), ("number", 1.0)),
    ]
    chosen = rng.sample(keys, rng.choice([0, 0, 0, 1, 2]))
    return Asked(
        rng.choice(ruled if rng.random() < 0.8 else PRIMITIVES),
        rng.choice(HOSTS),
        condition(rng, 2) if rng.random() < 0.5 else None,
        [(key, rng.random() < 0.5) for key in chosen],
        rng.choice([None, None, None, 1, 3]),
        rng.choice([1, 2, 2, 3, 4]),
    )
