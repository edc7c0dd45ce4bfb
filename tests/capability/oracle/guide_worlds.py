"""Registries and teams drawn at random, as plain data: what the guide calls them, and nothing of the code.

A world is made of what stands in YAML, and of what the devices tell. Conditions are nested tuples, which are
written as text for the registry and evaluated by the oracle in its own way.
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
    """A registry as its sections, its team, what is told, and questions."""

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
    """A question; `host` is where it is asked, `size` how many make a team."""

    primitive: str
    host: str
    condition: Tree | None
    order: list[tuple[Tree, bool]]
    limit: int | None
    size: int

    @property
    def text(self) -> str:
        """As it is written."""
        said = [] if self.condition is None else [written(self.condition)]
        if self.order:
            keys = (f"{written(tree)}{' desc' if descending else ''}" for tree, descending in self.order)
            said.append(f"order by {', '.join(keys)}")
        if self.limit is not None:
            said.append(f"limit {self.limit}")
        return " ".join(said)


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


def world(dice: random.Random) -> World:
    """A small world with something of everything."""
    made = World()
    for type in ("Crane", "Mule", "Tower", "Wagon", "Nobody"):
        made.providers[type] = _provider(dice)
    for name in dice.sample(["a-way", "b-way", "c-way", "d-way", "e-way"], dice.randint(0, 4)):
        serves, by = dice.sample(PRIMITIVES, 2)
        rule: dict[str, Any] = {"serves": serves, "by": by, "loss": dice.choice([0.0, 0.0, 0.0, 0.25])}
        if dice.random() < 0.4:
            rule["when"] = condition(dice, 1)
        made.one_to_one[name] = rule
    for number in range(dice.randint(4, 8)):
        _join(made, dice, f"x{number}")
    served = [name for _, type, _ in made.team for name in made.providers[type]["serves"]]
    for name in dice.sample(["all-of-them", "both", "crew", "duo"], dice.randint(1, 3)):
        made.one_to_many[name] = _whole(dice, served)
    if dice.random() < 0.4:
        weights = {name: dice.choice([0.0, 0.1, 1.0, 3.0]) for name in dice.sample(_WEIGHTS, 2)}
        made.ranking = {"weights": weights, "attributes": {dice.choice(NUMBERS): dice.choice([0.0, 3.0])}}
        made.ranking["nearby"] = dice.choice([5.0, 50.0])
    return made


_WEIGHTS = ("fitness", "loss", "part", "hop", "near", "age")


def _facts(dice: random.Random, most: int) -> dict[str, Any]:
    found: dict[str, Any] = {n: dice.choice(AMOUNTS) for n in dice.sample(NUMBERS, dice.randint(0, most))}
    if dice.random() < 0.5:
        found["slot"] = dice.randint(1, 3)
    if dice.random() < 0.5:
        found["tools"] = sorted(dice.sample(["arm", "hook", "sling"], dice.randint(1, 2)))
    return found


def _provider(dice: random.Random) -> dict[str, Any]:
    serves: dict[str, Any] = {}
    for primitive in dice.sample(PRIMITIVES, dice.randint(1, 3)):
        served: dict[str, Any] = {}
        if dice.random() < 0.3:
            served["attributes"] = _facts(dice, 1)
        if dice.random() < 0.2:
            served["when"] = dice.choice([_has_tool(dice), (">=", ("is", "battery"), ("number", 0.3))])
        serves[primitive] = served
    live = {n for n in ("battery", "heat") if dice.random() < 0.4}
    if dice.random() < 0.6:
        live |= {"north", "east"} | ({"down"} if dice.random() < 0.5 else set())
    return {"attributes": _facts(dice, 2), "live": sorted(live), "serves": serves}


def _join(made: World, dice: random.Random, name: str) -> None:
    type = dice.choice([t for t in made.providers if t != "Nobody"])
    made.team.append((name, type, dice.choice(HOSTS)))
    if dice.random() < 0.5:
        made.agents[name] = _facts(dice, 2)
    if dice.random() < 0.1:
        made.agents.setdefault(name, {})["battery"] = 0.5
    if dice.random() < 0.1:
        made.refused[name] = "gone"
    made.told[name] = {
        attribute: (round(dice.choice([0.0, 0.25, 1.0, 3.0, 4.0]), 3), dice.choice([0.0, 0.5, 2.0, 4.0, 9.0]))
        for attribute in made.providers[type]["live"]
        if dice.random() < 0.9
    }


def _whole(dice: random.Random, served: list[str]) -> dict[str, Any]:
    """A rule with parts, most often such that somebody serves."""
    needs = {
        part: {
            "capability": dice.choice(served if dice.random() < 0.8 else PRIMITIVES),
            "when": condition(dice, 1) if dice.random() < 0.2 else None,
        }
        for part in ("left", "mid", "right")[: dice.choice([1, 2, 2, 2, 3])]
    }
    parts = list(needs)
    rule: dict[str, Any] = {"serves": dice.choice(PRIMITIVES), "needs": needs, "where": [], "attributes": {}}
    rule["loss"] = dice.choice([0.0, 0.25, 0.5])
    if len(parts) > 1 and dice.random() < 0.5:
        rule["distinct"] = True if dice.random() < 0.5 else dice.sample(parts, 2)
    for _ in range(dice.choice([0, 1, 1, 2])):
        rule["where"].append(_between(dice, *(dice.sample(parts, 2) if len(parts) > 1 else parts * 2)))
    for name in dice.sample(NUMBERS, dice.randint(0, 2)):
        values = [("is", f"{part}.{name}") for part in parts]
        single = len(values) == 1
        rule["attributes"][name] = values[0] if single else ("call", dice.choice(["min", "max"]), *values)
    if dice.random() < 0.3:
        rule["attributes"] |= {axis: ("is", f"{parts[0]}.{axis}") for axis in ("north", "east")}
    if dice.random() < 0.3:
        rule["attributes"]["slot"] = ("is", f"{parts[-1]}.slot")
    return rule


def _between(dice: random.Random, one: str, other: str) -> Tree:
    """A condition over two parts, or over one."""
    number = dice.choice(NUMBERS)
    first, second = ("is", f"{one}.{number}"), ("is", f"{other}.{number}")
    return dice.choice(
        [
            ("==", ("is", f"{one}.slot"), ("is", f"{other}.slot")),
            ("==", ("is", f"{one}.tools"), ("is", f"{other}.tools")),
            ("!=", ("is", f"{one}.robot"), ("is", f"{other}.robot")),
            (">=", ("+", first, second), ("number", 2.0)),
            ("<=", first, second),
            (dice.choice(["<", ">="]), ("call", dice.choice(["min", "max"]), first, second), ("number", 1.0)),
            (dice.choice(["<", ">="]), ("number", 1.0), ("call", dice.choice(["min", "max"]), first, second)),
            ("<=", ("call", "distance", ("is", one), ("is", other)), ("number", 4.0))
            if one != other
            else (">=", first, ("number", 1.0)),
            ("==", ("is", f"{one}.agent"), ("word", f"x{dice.randint(0, 3)}")),
            ("||", ("==", ("is", f"{one}.slot"), ("number", 1)), (">", second, ("number", 1.0))),
        ]
    )


def _has_tool(dice: random.Random) -> Tree:
    return ("==", ("is", "tools"), ("word", dice.choice(["arm", "hook", "sling"])))


def condition(dice: random.Random, depth: int) -> Tree:
    """A condition over the attributes of one offer."""
    if depth > 0 and dice.random() < 0.5:
        sign = dice.choice(["&&", "&&", "||", "!"])
        if sign == "!":
            return ("!", condition(dice, depth - 1))
        return (sign, condition(dice, depth - 1), condition(dice, depth - 1))
    name = dice.choice((*NUMBERS, "battery", "slot"))
    return dice.choice(
        [
            (dice.choice(["<", "<=", ">", ">=", "=="]), ("is", name), ("number", dice.choice(AMOUNTS))),
            (">=", ("number", 2.0), ("is", name)),
            (">", ("+", ("is", "payload"), ("is", "reach")), ("number", 2.0)),
            _has_tool(dice),
            (dice.choice(["==", "!="]), ("is", "agent"), ("word", f"x{dice.randint(0, 4)}")),
            (dice.choice(["==", "!="]), ("is", "robot"), ("word", dice.choice(HOSTS))),
            ("<=", ("call", "distance", ("number", 1.0), ("number", 2.0)), ("number", 4.0)),
        ]
    )


def question(made: World, dice: random.Random) -> Asked:
    """A question to such a world, most often for what some rule serves."""
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
    chosen = dice.sample(keys, dice.choice([0, 0, 0, 1, 2]))
    return Asked(
        dice.choice(ruled if dice.random() < 0.8 else PRIMITIVES),
        dice.choice(HOSTS),
        condition(dice, 2) if dice.random() < 0.5 else None,
        [(key, dice.random() < 0.5) for key in chosen],
        dice.choice([None, None, None, 1, 3]),
        dice.choice([1, 2, 2, 3, 4]),
    )
