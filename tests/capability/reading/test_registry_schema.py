"""The published schema and the reader: the schema accepts every file that the reader accepts."""

from __future__ import annotations

import copy
import json
from pathlib import Path
from typing import Any, get_args

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from jsonschema import Draft202012Validator
from registry_expectations import BASE, GOLDEN
from registry_texts import plain, registries

from lfield.capability.model import AttributeType, Better, Weights
from lfield.capability.registry_reader.registry_builder import MAX_NAME
from lfield.capability.registry_reader.registry_files import check_files, shipped, shipped_folder
from lfield.capability.registry_reader.rule_reader import MAX_NEEDS
from lfield.capability.registry_reader.unit_signatures import PORTAL_TYPES
from lfield.lang.capability_port import OFFER_METHODS
from lfield.manifest import Effect

SCHEMA = json.loads((shipped_folder() / "schema.json").read_text(encoding="utf-8"))
VALIDATOR = Draft202012Validator(SCHEMA)


def faults(document: object) -> list[str]:
    return [f"{list(e.absolute_path)}: {e.message}" for e in VALIDATOR.iter_errors(document)]


def test_schema_is_valid() -> None:
    Draft202012Validator.check_schema(SCHEMA)


@pytest.mark.parametrize("path", [*shipped(), BASE], ids=lambda p: p.stem)
def test_shipped_files_fit_the_schema(path: Path) -> None:
    assert faults(plain(path.read_text(encoding="utf-8"))) == []


def test_schema_lists_the_names_that_the_reader_knows() -> None:
    known = SCHEMA["$defs"]
    assert set(known["valueType"]["enum"]) == set(PORTAL_TYPES)
    assert set(known["portal"]["properties"]["effect"]["enum"]) == set(get_args(Effect))
    assert set(known["attribute"]["properties"]["type"]["enum"]) == set(get_args(AttributeType))
    assert set(known["attribute"]["properties"]["better"]["enum"]) == set(get_args(Better))
    assert set(known["primitive"]["properties"]["portals"]["propertyNames"]["not"]["enum"]) == OFFER_METHODS
    assert known["composition"]["properties"]["needs"]["maxProperties"] == MAX_NEEDS
    assert known["name"]["maxLength"] == MAX_NAME
    ranking = SCHEMA["properties"]["ranking"]["properties"]
    weights = ranking["weights"]["properties"]
    assert {*weights, *ranking} - {"weights"} == set(Weights.__struct_fields__)


def test_schema_allows_no_additional_keys() -> None:
    """Every mapping of the schema lists its keys."""
    open_ended = []
    waiting: list[tuple[str, Any]] = [("", SCHEMA)]
    while waiting:
        place, node = waiting.pop()
        if isinstance(node, dict):
            if "properties" in node and node.get("additionalProperties") is not False and "type" in node:
                open_ended.append(place)
            waiting += [(f"{place}/{key}", child) for key, child in node.items()]
        elif isinstance(node, list):
            waiting += [(f"{place}/{index}", child) for index, child in enumerate(node)]
    assert open_ended == []


@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(registries())
def test_registry_accepted_by_the_reader_fits_the_schema(tmp_path: Path, document: dict[str, Any]) -> None:
    file = tmp_path / "registry.yaml"
    file.write_text(json.dumps(document), encoding="utf-8")
    registry, found = check_files([BASE, file])
    assert registry is not None, "\n".join(d.render() for d in found)
    assert faults(document) == []


#: A registry with one entry of each kind.
WHOLE: dict[str, Any] = {
    "registry": 1,
    "taxonomy": {"skill.sewing": {"name": "Sewing", "aliases": ["skill.stitching"]}},
    "attributes": {"depth": {"type": "real", "unit": "m", "better": "more", "typical": 2.0, "max_age": 5.0}},
    "primitives": {
        "Sew": {
            "id": "skill.sewing",
            "portals": {
                "sew": {"parameters": {"length": {"type": "real", "unit": "m"}}, "effect": "actuate"}
            },
        }
    },
    "providers": {
        "Machine": {
            "attributes": {"payload": 1.0},
            "live": {"battery": "m.battery", "heat": {"from": "m.heat", "unit": "K"}},
            "serves": {"Sew": {"portals": {"sew": {"portal": "run", "arguments": ["length", 2]}}}},
        }
    },
    "equivalences": {
        "sewing-climbs": {
            "serves": "Grip",
            "by": "Sew",
            "portals": {"grip": {"portal": "sew", "arguments": [1.0]}},
        },
        "grip-and-sew": {
            "serves": "Lift",
            "needs": {"hand": {"capability": "Grip"}, "other": "Grip"},
            "distinct": ["hand", "other"],
            "through": "GripAndSew",
            "source": str(GOLDEN / "L" / "grip_and_climb.L"),
            "where": ["hand.payload > 1.0"],
            "attributes": {"payload": "hand.payload"},
            "loss": 0.5,
        },
    },
    "agents": {"arm1": {"payload": "3 g"}},
    "ranking": {"weights": {"loss": 1.0}, "attributes": {"payload": 2.0}},
}

#: Place and new value; ... removes the key.
MUTATIONS: list[tuple[str, object]] = [
    ("registry", 2),
    ("registry", "1"),
    ("registry", True),
    ("registry", ...),
    ("extra", {}),
    ("taxonomy", []),
    ("taxonomy/Skill", {}),
    ("taxonomy/skill.sewing/aliases", "skill.stitching"),
    ("taxonomy/skill.sewing/aliases", ["Not an id"]),
    ("taxonomy/skill.sewing/nick", "x"),
    ("taxonomy/skill.sewing/name", 7),
    ("attributes/Depth", {"type": "real"}),
    ("attributes/depth/type", ...),
    ("attributes/depth/type", "float"),
    ("attributes/depth/better", "higher"),
    ("attributes/depth/typical", 0),
    ("attributes/depth/typical", "2"),
    ("attributes/depth/max_age", 0),
    ("attributes/depth/live", "yes"),
    ("attributes/depth/values", "low"),
    ("primitives/sew", {"id": "skill.sewing", "portals": {"sew": {}}}),
    ("primitives/Sew/id", ...),
    ("primitives/Sew/portals", {}),
    ("primitives/Sew/portals", ...),
    ("primitives/Sew/portals/score", {}),
    ("primitives/Sew/portals/sew/emit", "Real"),
    ("primitives/Sew/portals/sew/effect", "act"),
    ("primitives/Sew/portals/sew/raises", ["oops"]),
    ("primitives/Sew/portals/sew/parameters/length/type", ...),
    ("primitives/Sew/portals/sew/parameters/length/type", "long"),
    ("primitives/Sew/portals/sew/parameters/length/default", 1),
    ("providers/machine", {}),
    ("providers/Machine/attributes/payload", None),
    ("providers/Machine/attributes/payload", {"min": 1}),
    ("providers/Machine/live/battery", "battery"),
    ("providers/Machine/live/battery", 3),
    ("providers/Machine/live/heat/from", ...),
    ("providers/Machine/live/heat/scale", 2),
    ("providers/Machine/serves", ["Sew"]),
    ("providers/Machine/serves/Sew/loss", 0.5),
    ("providers/Machine/serves/Sew/when", None),
    ("providers/Machine/serves/Sew/when", ["legal"]),
    ("providers/Machine/serves/Sew/portals/sew", 3),
    ("providers/Machine/serves/Sew/portals/sew/target", "run"),
    ("providers/Machine/serves/Sew/portals/sew/arguments", "length"),
    ("providers/Machine/serves/Sew/portals/sew/arguments", [None]),
    ("providers/Machine/serves/Sew/portals/sew/arguments", [{"unit": "mm"}]),
    ("providers/Machine/serves/Sew/portals/sew/arguments", [{"constant": []}]),
    ("providers/Machine/serves/Sew/portals/sew/arguments", [{"constant": 1, "unit": "mm"}]),
    ("providers/Machine/serves/Sew/portals/sew/emit", {}),
    ("equivalences/Sewing", {"serves": "Grip", "by": "Sew", "portals": {"grip": "sew"}}),
    ("equivalences/sewing-climbs/serves", ...),
    ("equivalences/sewing-climbs/by", ...),
    ("equivalences/sewing-climbs/loss", 1.5),
    ("equivalences/sewing-climbs/through", "X"),
    ("equivalences/grip-and-sew/by", "Grip"),
    ("equivalences/grip-and-sew/needs", {}),
    ("equivalences/grip-and-sew/needs", ["Grip"]),
    ("equivalences/grip-and-sew/needs/hand/capability", ...),
    ("equivalences/grip-and-sew/needs/hand/count", 2),
    ("equivalences/grip-and-sew/through", "grip"),
    ("equivalences/grip-and-sew/through", ...),
    ("equivalences/grip-and-sew/source", ...),
    ("equivalences/grip-and-sew/loss", -0.1),
    ("equivalences/grip-and-sew/where", "hand.payload > 1.0"),
    ("equivalences/grip-and-sew/attributes/payload", None),
    ("agents/arm1", 3),
    ("ranking/weights/loss", -1),
    ("ranking/weights/luck", 1),
    ("ranking/attributes/payload", "heavy"),
    ("ranking/other", {}),
]


def mutated(place: str, value: object) -> dict[str, Any]:
    """WHOLE with one change."""
    document = copy.deepcopy(WHOLE)
    *path, last = place.split("/")
    node = document
    for key in path:
        node = node[key]
    if value is ...:
        del node[last]
    else:
        node[last] = value
    return document


def read(tmp_path: Path, document: dict[str, Any]) -> bool:
    """Whether the reader accepts it."""
    file = tmp_path / "registry.yaml"
    file.write_text(json.dumps(document), encoding="utf-8")
    return check_files([BASE, file])[0] is not None


def test_complete_registry_is_accepted_by_reader_and_schema(tmp_path: Path) -> None:
    assert faults(WHOLE) == []
    assert read(tmp_path, WHOLE)


@pytest.mark.parametrize(("place", "value"), MUTATIONS, ids=[f"{p}={v!r}" for p, v in MUTATIONS])
def test_invalid_change_is_refused_by_reader_and_schema(tmp_path: Path, place: str, value: object) -> None:
    document = mutated(place, value)
    assert faults(document) != []
    assert not read(tmp_path, document)


@settings(max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.data())
def test_change_accepted_by_the_reader_fits_the_schema(tmp_path: Path, data: st.DataObject) -> None:
    document, node = copy.deepcopy(WHOLE), None
    node = document
    while isinstance(node, dict) and node:
        key = data.draw(st.sampled_from(sorted(node)))
        if not isinstance(node[key], dict) or data.draw(st.integers(0, 3)) == 0:
            junk = [None, True, 0, -1, 1.5, "x", "X", "a.b", "fc.x", [], ["x"], {}, {"a": 1}, {"unit": "m"}]
            node[key] = data.draw(st.sampled_from(junk))
            break
        node = node[key]
    if read(tmp_path, document):
        assert faults(document) == []
