"""Whatever stands in a file, an import refuses it or writes a registry without mistakes."""

from __future__ import annotations

import json
import tempfile
from contextlib import suppress
from pathlib import Path

from hypothesis import given, settings
from hypothesis import strategies as st
from imports import Imports

from lfield.errors import ProgramError

TEXTS = st.text(max_size=60)
VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | TEXTS,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(TEXTS, inner, max_size=3),
    max_leaves=12,
)
SERVICE_TYPES = st.sampled_from(["std_srvs/Empty", "std_srvs/srv/Trigger", "std_srvs/SetBool", "x/Y"])
SERVICES = st.dictionaries(
    TEXTS, st.fixed_dictionaries({"type": SERVICE_TYPES, "description": TEXTS}), max_size=4
)
REFERENCES = st.sampled_from(["A", "B", "C", "pkg/A", "pkg/B", "else/A"])


def spec(**fields: st.SearchStrategy) -> st.SearchStrategy:
    return st.fixed_dictionaries({"spec_version": st.just(1), "description": TEXTS, **fields})


SPECS = st.one_of(
    spec(name=REFERENCES | TEXTS, interface=st.fixed_dictionaries({"services": SERVICES}) | VALUES),
    spec(name=REFERENCES | TEXTS, redefines=REFERENCES | VALUES, remappings=VALUES),
    spec(name=REFERENCES | TEXTS, implements=REFERENCES | VALUES, depends_on=VALUES),
)
SHEETS = st.fixed_dictionaries(
    {"typeSpecification": st.fixed_dictionaries({"seriesName": TEXTS}) | VALUES},
    optional={
        "manufacturer": VALUES,
        "physicalParameters": st.dictionaries(st.sampled_from(["speedMax", "width"]) | TEXTS, VALUES),
        "protocolFeatures": st.fixed_dictionaries({"agvActions": VALUES}),
        "loadSpecification": st.fixed_dictionaries({"loadSets": VALUES}),
    },
)


def yaml_of(value: dict) -> str:
    """JSON is YAML; a first line keeps it from being taken for a factsheet."""
    return "# a spec\n" + json.dumps(value, ensure_ascii=False)


def imported_well(texts: list[str]) -> None:
    with tempfile.TemporaryDirectory() as folder:
        imports = Imports(Path(folder))
        files: dict[str, str | bytes] = {
            f"{number}.txt": text.encode("utf-8", "surrogatepass") for number, text in enumerate(texts)
        }
        with suppress(ProgramError):
            imports.registry(imports.run(files))


@settings(max_examples=60)
@given(st.lists(SPECS.map(yaml_of), min_size=1, max_size=5))
def test_any_specs(texts):
    imported_well(texts)


@settings(max_examples=40)
@given(st.lists(SHEETS.map(json.dumps), min_size=1, max_size=3))
def test_any_factsheets(texts):
    imported_well(texts)


@settings(max_examples=40)
@given(VALUES.map(json.dumps) | TEXTS)
def test_anything(text):
    imported_well([text])
