"""300 random registries and teams: offers, order and scores equal those of the guide."""

from __future__ import annotations

import json
import random
from pathlib import Path
from typing import Any

import pytest
from guide_oracle import Oracle, Way
from guide_worlds import ATTRIBUTES, PRIMITIVES, Asked, World, question, world, written

from lfield.capability.condition_compiler import compile_query
from lfield.capability.matching.matcher import Matcher
from lfield.capability.model import ANY_OFFER, Registry
from lfield.capability.offer import Offer
from lfield.capability.registry_reader.registry_files import check_files
from lfield.operator.team_query import roster_from_hosts
from lfield.wire.observer_messages import AttributeReading, DirectoryEntry

WORLDS, QUESTIONS = 300, 5


class Deployed:
    """An agent of the deployment."""

    def __init__(self, id: str, type: str, host: str) -> None:
        self.id, self.type, self.host = id, type, host


def document(made: World) -> dict[str, Any]:
    """The world in the form of a registry file."""
    portals = {"go": {}}
    providers = {}
    for type, fields in made.providers.items():
        served = {
            primitive: {k: written(v) if k == "when" else v for k, v in how.items()}
            for primitive, how in fields["serves"].items()
        }
        live = {attribute: f"d.{attribute}" for attribute in fields["live"]}
        providers[type] = {"attributes": fields["attributes"], "live": live, "serves": served}
    rules: dict[str, Any] = {}
    for name, fields in made.one_to_one.items():
        rules[name] = {k: written(v) if k == "when" else v for k, v in fields.items()}
    for name, fields in made.one_to_many.items():
        needs = {
            part: need["capability"]
            if need["when"] is None
            else {"capability": need["capability"], "when": written(need["when"])}
            for part, need in fields["needs"].items()
        }
        worth = {attribute: written(tree) for attribute, tree in fields["attributes"].items()}
        where = [written(tree) for tree in fields["where"]]
        rules[name] = {**fields, "needs": needs, "attributes": worth, "where": where}
        rules[name] |= {"through": "Together", "source": "together.L"}
    return {
        "registry": 1,
        "taxonomy": {
            "skill": {"meaning": "all"},
            **{f"skill.{p.lower()}": {"meaning": p} for p in PRIMITIVES},
        },
        "attributes": ATTRIBUTES,
        "primitives": {p: {"id": f"skill.{p.lower()}", "portals": portals} for p in PRIMITIVES},
        "providers": providers,
        "equivalences": rules,
        "agents": made.agents,
        "ranking": made.ranking,
    }


def registry_of(made: World, folder: Path) -> Registry | None:
    """The registry as lfield reads it; None where a rule leads back to itself."""
    (folder / "together.L").write_text("", encoding="utf-8")
    path = folder / "world.yaml"
    path.write_text(json.dumps(document(made)), encoding="utf-8")
    registry, found = check_files([path])
    assert {d.code for d in found} <= {"C152"}, "\n".join(d.render() for d in found)
    return registry


def drawn(seed: int, folder: Path) -> tuple[World, Registry, random.Random]:
    """A world whose registry is accepted."""
    rng = random.Random(seed)
    while True:
        made = world(rng)
        registry = registry_of(made, folder)
        if registry is not None:
            return made, registry, rng


def matcher_of(made: World, registry: Registry, host: str) -> Matcher:
    deployed = [Deployed(*member) for member in made.team]
    told = {
        name: DirectoryEntry(
            name,
            made.refused.get(name, ""),
            {n: AttributeReading(value, age) for n, (value, age) in made.told[name].items()},
            {},
        )
        for name, *_ in made.team
    }
    return Matcher(registry, roster_from_hosts(registry, deployed, {host: told}, (), host))


def tree_of(offer: Offer) -> str:
    return f"{offer.rule}({','.join(map(tree_of, offer.parts.values()))})" if offer.parts else offer.agent


def shown(ways: list[Way]) -> list[tuple[str, Any]]:
    return [(way.tree, pytest.approx(way.score, abs=1e-9)) for way in ways]


@pytest.mark.few(15)
@pytest.mark.parametrize("seed", range(WORLDS))
def test_search_equals_the_guide(seed: int, tmp_path: Path) -> None:
    made, registry, rng = drawn(seed, tmp_path)
    for _ in range(QUESTIONS):
        drawn_question = question(made, rng)
        compare(made, registry, drawn_question)


def compare(made: World, registry: Registry, asked: Asked) -> None:
    oracle, matcher = Oracle(made, asked), matcher_of(made, registry, asked.host)
    constraint_of = compile_query(asked.text, registry.attributes) if asked.text else ANY_OFFER
    answer = matcher.find(asked.primitive, constraint_of)
    assert [(tree_of(offer), offer.score) for offer in answer.offers] == shown(oracle.offers())
    assert (answer.count, answer.cut) == (len(oracle.all_ways()), ())
    teams = matcher.teams(asked.primitive, asked.size, constraint_of)
    assert [[(tree_of(o), o.score) for o in team] for team in teams.teams] == [
        shown(list(team)) for team in oracle.teams()
    ]
    assert teams.agents == len(frozenset[str]().union(*(way.agents for way in oracle.all_ways())))
