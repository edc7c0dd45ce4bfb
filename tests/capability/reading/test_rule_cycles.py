"""Cycles through needs, compared with an exhaustive search."""

from __future__ import annotations

import re
from itertools import pairwise
from pathlib import Path

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from registry_expectations import GOLDEN

from lfield.capability.registry_reader.registry_files import check_files

SOURCE = GOLDEN / "L" / "grip_and_climb.L"
NAMES = [f"P{n}" for n in range(6)]

#: The served primitive, the serving ones, and whether the rule is composed (and needs all of them).
Rule = tuple[str, list[str], bool]

#: The served primitive, the serving one, and the rule.
Edge = tuple[str, str, str]

_NAME = st.sampled_from(NAMES)
_RULES = st.lists(
    st.tuples(_NAME, st.lists(_NAME, min_size=1, max_size=3, unique=True), st.booleans()), max_size=8
)


def registry(rules: list[Rule]) -> tuple[str, set[Edge], set[tuple[str, str]]]:
    """The YAML of some rules, the edges with their rules, and the edges that are needs."""
    text = "registry: 1\ntaxonomy: {skill: {}}\nprimitives:\n"
    text += "".join(f"  {name}: {{id: skill, portals: {{p: {{}}}}}}\n" for name in NAMES)
    text += "equivalences:\n" if rules else ""
    edges, needs = set(), set()
    for number, (serves, by, composed) in enumerate(rules):
        rule = f"r{number}"
        if not composed and by[0] != serves:
            text += f"  {rule}: {{serves: {serves}, by: {by[0]}}}\n"
            edges.add((serves, by[0], rule))
        else:
            parts = ", ".join(f"n{index}: {{capability: {name}}}" for index, name in enumerate(by))
            text += f"  {rule}: {{serves: {serves}, needs: {{{parts}}}, through: C, source: {SOURCE}}}\n"
            edges |= {(serves, name, rule) for name in by}
            needs |= {(name, rule) for name in by}
    return text, edges, needs


def reachable(edges: set[Edge], start: str) -> set[str]:
    found = {start}
    while more := {to for source, to, _ in edges if source in found} - found:
        found |= more
    return found


@settings(max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(_RULES)
def test_exactly_the_cycles_through_a_need_are_found(
    tmp_path: Path, rules: list[tuple[str, list[str], bool]]
) -> None:
    text, edges, needs = registry(rules)
    file = tmp_path / "rules.yaml"
    file.write_text(text, encoding="utf-8")
    _, found = check_files([file])
    reported = set()
    for diagnostic in found:
        assert diagnostic.code == "C152"
        path = diagnostic.message.partition(": ")[2].split(" -> ")
        steps = [re.fullmatch(r"(\w+)(?: \((\w+)\))?", step) for step in path]
        nodes = [(step[1], step[2]) for step in steps if step is not None]
        assert len(nodes) == len(path)
        assert nodes[0][0] == nodes[-1][0]
        for (before, _), (after, rule) in pairwise(nodes):
            assert (before, after, rule) in edges
        reported.add(nodes[1])
    serves = {rule: source for source, _, rule in edges}
    assert reported == {
        (need, rule)
        for need, rule in needs
        if need != serves[rule] and serves[rule] in reachable(edges, need)
    }
