"""Malicious registries: findings, never a traceback, in bounded time."""

from __future__ import annotations

import time
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from registry_expectations import BASE, GOLDEN

from lfield.capability.registry_reader.registry_builder import MAX_ENTRIES
from lfield.capability.registry_reader.registry_files import check_files
from lfield.text.yaml_source import MAX_BYTES

#: Upper bound in CPU seconds: a hundred times the time of a large valid file.
MAX_CPU_SECONDS = 30.0


def codes(tmp_path: Path, content: str | bytes) -> list[str]:
    """The codes of the findings in a file, in order, without an exception and within the time limit."""
    path = tmp_path / "hostile.yaml"
    path.write_bytes(content if isinstance(content, bytes) else content.encode("utf-8", "surrogatepass"))
    started = time.process_time()
    registry, found = check_files([BASE, path])
    assert time.process_time() - started < MAX_CPU_SECONDS
    for diagnostic in found:
        assert diagnostic.render()
    assert (registry is None) == any(d.severity == "error" for d in found)
    return [d.code for d in found]


BOMB = "a: &a [x,x,x,x,x,x,x,x,x]\n" + "".join(
    f"{after}: &{after} [{','.join(['*' + before] * 9)}]\n"
    for before, after in zip("abcdefgh", "bcdefghi", strict=True)
)


@pytest.mark.parametrize(
    ("text", "code"),
    [
        (BOMB, "Y103"),
        ("registry: 1\nproviders: {X: {attributes: {payload: .nan}}}\n", "Y107"),
        ("registry: 1\nproviders: {X: {attributes: {payload: .inf}}}\n", "Y107"),
        ("registry: 1\nproviders: {X: {attributes: {limbs: 99999999999999999999}}}\n", "Y107"),
        ("registry: 1\nproviders: {X: {attributes: {payload: 1e999}}}\n", "Y107"),
        ("registry: 1\nproviders: {X: {attributes: {payload: 1e999 g}}}\n", "C121"),
        ("registry: 1\nproviders: {X: {attributes: {limbs: 1e300}}}\n", "C121"),
        (f"registry: 1\nproviders: {{X: {{attributes: {{payload: {'9' * 5000} g}}}}}}\n", "C121"),
        (f"registry: {'1' * 5000}\n", "Y107"),
        ("registry: 1\nregistry: 1\n", "Y105"),
        ("registry: 1\n? [a]\n: 1\n", "Y106"),
        ("registry: 1\ntaxonomy: {1: {}}\n", "C102"),
        ("registry: !!python/object/apply:os.system [ls]\n", "Y104"),
        ("registry: 1\n---\nregistry: 1\n", "Y108"),
        ("registry: 1\ntaxonomy: " + "[" * 100_000, "Y102"),
        ("registry: 1\ntaxonomy: " + "{a: " * 100_000, "Y102"),
        ("- " * 100_000, "Y102"),
        ("#" * (MAX_BYTES + 1), "Y102"),
        ("registry: 1\nproviders: {X: {serves: {Lift: {when: '" + "(" * 1900 + "'}}}}\n", "C154"),
        ("registry: 1\nproviders: {X: {serves: {Lift: {when: '" + "!" * 90_000 + "'}}}}\n", "C154"),
        ("registry: 1\nproviders: {X: {serves: {Lift: {when: \"a\\0b\"}}}}\n", "C154"),
        ("registry: 1\nproviders: {X: {live: {battery: 'fc.battery[99999]'}}}\n", "C129"),
        ("registry: 1\ntaxonomy: {skill." + "a" * 500 + ": {}}\n", "C102"),
        ("registry: 1\nequivalences: {a: {serves: Lift, needs: {a: {capability: Grip}}, "
         "through: A, source: \"a\\0b\"}}\n", "C153"),
        ("registry: 1\nequivalences: {a: {serves: Lift, needs: {a: {capability: Grip}}, "
         f"through: A, source: {'x/' * 5000}}}}}\n", "C153"),
        ("a: \ud800\n", "Y109"),
        ("", "C100"),
        ("null", "C100"),
        ("[]", "Y112"),
        ("text", "Y112"),
    ],
)  # fmt: skip
def test_malicious_registry_is_refused(tmp_path: Path, text: str, code: str) -> None:
    assert code in codes(tmp_path, text)


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-le", "utf-32", "latin-1", "cp037"])
def test_other_encodings_are_refused(tmp_path: Path, encoding: str) -> None:
    assert set(codes(tmp_path, "registry: 1\ntaxonomy: {}  # é\n".encode(encoding))) & {"Y109", "Y101"}


def test_byte_order_mark_is_accepted(tmp_path: Path) -> None:
    assert codes(tmp_path, "\ufeffregistry: 1\n") == []


def test_section_with_too_many_entries_is_refused(tmp_path: Path) -> None:
    terms = "".join(f"  skill.t{n}: {{}}\n" for n in range(MAX_ENTRIES + 100))
    assert codes(tmp_path, f"registry: 1\ntaxonomy:\n{terms}") == ["C101"]


def test_deepest_possible_taxonomy_is_read(tmp_path: Path) -> None:
    ids = [".".join(["a"] * depth) for depth in range(1, 41)]
    terms = "".join(f"  {id}: {{}}\n" for id in ids)
    prims = "".join(f"  P{n}: {{id: {id}, portals: {{p: {{}}}}}}\n" for n, id in enumerate(ids * 5))
    assert codes(tmp_path, f"registry: 1\ntaxonomy:\n{terms}primitives:\n{prims}") == []


def test_cycle_of_thousands_of_rules_is_found(tmp_path: Path) -> None:
    count = 2000
    source = GOLDEN / "L" / "grip_and_climb.L"
    text = "registry: 1\nprimitives:\n"
    text += "".join(f"  P{n}: {{id: skill, portals: {{p: {{}}}}}}\n" for n in range(count))
    text += "equivalences:\n"
    text += "".join(f"  e{n}: {{serves: P{n}, by: P{(n + 1) % count}}}\n" for n in range(count))
    text += "".join(
        f"  c{n}: {{serves: P{n}, needs: {{a: {{capability: P{n}}}}}, through: C, source: {source}}}\n"
        for n in range(count)
    )
    text += f"  far: {{serves: P0, needs: {{a: {{capability: P1}}}}, through: C, source: {source}}}\n"
    assert codes(tmp_path, text) == ["C152"]


_WORDS = st.sampled_from(
    (
        *(
            "registry",
            "taxonomy",
            "attributes",
            "primitives",
            "providers",
            "equivalences",
            "agents",
            "ranking",
        ),
        *(
            "Lift",
            "Grip",
            "lift",
            "payload",
            "environment",
            "skill",
            "serves",
            "by",
            "needs",
            "portals",
            "type",
        ),
        *(
            "id",
            "unit",
            "live",
            "when",
            "where",
            "through",
            "source",
            "loss",
            "emit",
            "parameter",
            "constant",
        ),
        *(": ", ": ", "{", "}", "[", "]", ", ", "- ", "\n", "\n  ", "\n    ", "\n      ", "1", "2.5", "real"),
        *(
            "'",
            '"',
            "#",
            "&a",
            "*a",
            "!t",
            "|",
            ">",
            "?",
            "~",
            "true",
            "m/s",
            "payload >= 1",
            "\t",
            "\0",
            "é",
        ),
    )
)


@settings(max_examples=80, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.one_of(st.lists(_WORDS, max_size=60).map("".join), st.binary(max_size=300)))
def test_any_text_or_bytes_give_findings(tmp_path: Path, content: str | bytes) -> None:
    codes(tmp_path, content)


_KEYS = st.sampled_from(
    (
        *("name", "meaning", "aliases", "deprecated", "type", "unit", "better", "values", "live", "max_age"),
        *(
            "id",
            "portals",
            "parameters",
            "emit",
            "effect",
            "raises",
            "include",
            "attributes",
            "serves",
            "when",
        ),
        *("portal", "arguments", "parameter", "constant", "by", "needs", "capability", "where", "through"),
        *("source", "loss", "weights", "from", "Lift", "lift", "payload", "battery", "hand", "skill", "arm1"),
    )
)
_LEAVES = st.sampled_from(
    [None, True, 1, -1.5, "", "Lift", "Grip", "lift", "height", "kg", "real", "fc.b", "payload > 1"]
)
_TREES = st.recursive(
    _LEAVES,
    lambda inner: st.one_of(st.lists(inner, max_size=3), st.dictionaries(_KEYS, inner, max_size=4)),
    max_leaves=12,
)


@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    st.dictionaries(
        st.sampled_from(
            [
                "taxonomy",
                "attributes",
                "primitives",
                "providers",
                "equivalences",
                "agents",
                "ranking",
                "registry",
            ]
        ),
        st.one_of(
            _TREES,
            st.dictionaries(st.sampled_from(["Lift", "up", "skill.up", "Crane"]), _TREES, max_size=3),
        ),
    )
)
def test_any_structure_of_known_keys_gives_findings(tmp_path: Path, document: object) -> None:
    codes(tmp_path, flow(document))


def flow(value: object) -> str:
    """A value in YAML's flow style."""
    match value:
        case dict():
            return "{" + ", ".join(f"{key}: {flow(item)}" for key, item in value.items()) + "}"
        case list():
            return "[" + ", ".join(map(flow, value)) + "]"
        case None:
            return "null"
        case bool():
            return str(value).lower()
        case str():
            return f"'{value}'"
        case _:
            return str(value)
