"""Queries with parameters: values with any characters are bound to the parsed text."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from lfield.capability.condition_compiler import compile_constants, compile_query, compile_template
from lfield.capability.condition_parser import parse_query
from lfield.capability.matching.condition_evaluator import evaluator
from lfield.capability.model import Attribute, OfferQuery
from lfield.capability.program_types.query_compiler import numbered_query, read_placeholders
from lfield.capability.query_values import SEPARATOR, bind, split_values
from lfield.capability.registry_reader.registry_files import read_registry
from lfield.errors import BundleError, ConstraintError
from lfield.mission.registry_part import decode_registry, encode_registry

ATTRIBUTES = {
    "payload": Attribute("payload", "real", unit="kg"),
    "north": Attribute("north", "real", unit="m"),
    "east": Attribute("east", "real", unit="m"),
    "down": Attribute("down", "real", unit="m"),
    "heat": Attribute("heat", "real", unit="°C"),
    "colour": Attribute("colour", "text"),
    "safe": Attribute("safe", "boolean"),
}
TEMPLATE = "payload >= $n0 && colour == $t1 || safe == $b2 order by distance($n0, 4.0)"


def encoded(*values: object) -> str:
    """The encoding that a program appends to the text of a query."""
    found = ""
    for value in values:
        if isinstance(value, bool):
            found += f"b{str(value).lower()} on\0"
        elif isinstance(value, str):
            found += f"t{len(value)} name\0{value}"
        else:
            found += f"n{value!r} kg\0"
    return found


@given(
    st.lists(
        st.one_of(st.booleans(), st.integers(), st.floats(allow_nan=False, allow_infinity=False), st.text())
    )
)
def test_values_are_decoded_unchanged(values: list[object]) -> None:
    text, found = split_values(TEMPLATE + SEPARATOR + encoded(*values))
    assert text == TEMPLATE + SEPARATOR
    assert found == values
    assert list(map(type, found or [])) == list(map(type, values))


@given(st.text(), st.text())
def test_text_value_cannot_change_the_query(asked: str, colour: str) -> None:
    """The value is compared literally: quotes, operators and separators in it have no meaning."""
    template = compile_template("colour == $t0 && payload >= 2", ATTRIBUTES)
    _, values = split_values("x" + SEPARATOR + encoded(asked))
    assert values is not None
    condition = bind(template, values).condition
    assert condition is not None
    judge = evaluator(condition)
    assert judge({"colour": colour, "payload": 3.0}) is (colour == asked)
    assert judge({"colour": asked, "payload": 3.0}) is True
    assert judge({"colour": asked, "payload": 1.0}) is False


@given(st.text(max_size=40))
def test_explained_query_has_its_values_as_literals(asked: str) -> None:
    """The explained query parses to the same condition: quotes are escaped, other characters unchanged."""
    template = compile_template("colour == $t0", ATTRIBUTES)
    condition = bind(template, [asked]).condition
    assert condition is not None
    assert condition.tree.span.text == condition.text
    if asked.isprintable() and asked.isascii():
        found = compile_query(condition.text, ATTRIBUTES).condition
        assert found is not None
        assert evaluator(found)({"colour": asked}) is True


def test_places_are_shifted_by_the_values() -> None:
    bound = bind(compile_template(TEMPLATE, ATTRIBUTES), [1234.5, 'a"b', True])
    assert bound.condition is not None
    assert bound.condition.text == 'payload >= 1234.5 && colour == "a\\"b" || safe == true '
    assert [key.value.text for key in bound.order] == ["distance(1234.5, 4.0)"]
    assert bound.order[0].value.tree.span.text == "distance(1234.5, 4.0)"


@pytest.mark.parametrize(
    "values",
    [
        "",
        "n1 x\0",
        "n1 x\0t1 y\0",
        "n1 x\0t9 y\0abc",
        "n1 x\0t1 y\0ab1 z\0",
        "b1 x\0t1 y\0ab1 z\0",
        "t1 x\0at1 y\0abtrue z\0",
        "x",
        "n1 x",
        "n1;",
        "n1 x\0n2 y\0btrue z\0",
    ],
)
def test_values_of_another_type_or_number_are_refused(values: str) -> None:
    template = compile_template(TEMPLATE, ATTRIBUTES)
    with pytest.raises(ConstraintError):
        bind(template, split_values(TEMPLATE + SEPARATOR + values)[1] or [])


@pytest.mark.parametrize("number", ["nan", "inf", "-inf", "1e999"])
def test_non_finite_number_is_refused(number: str) -> None:
    text = f"agent == $t0 && payload > $n1{SEPARATOR}t1 who\0mn{number} at[$i].kg\0"
    with pytest.raises(ConstraintError, match=r"\$at\[\$i\].kg is .*, not a finite number") as refused:
        split_values(text)
    assert refused.value.text == "agent == $who && payload > $at[$i].kg"


@given(st.text())
def test_any_encoded_text_is_decoded_or_refused(text: str) -> None:
    try:
        _, found = split_values(SEPARATOR + text)
    except ConstraintError:
        return
    assert found is not None


def test_only_a_compiled_query_has_parameters() -> None:
    with pytest.raises(ConstraintError):
        compile_query("payload >= $n0", ATTRIBUTES)
    with pytest.raises(ConstraintError, match="no parameter"):
        compile_template("payload >= $kg", ATTRIBUTES)
    constants = compile_constants(["payload > $n0", "payload > $n0" + SEPARATOR, "payload > 1"], ATTRIBUTES)
    assert list(constants) == ["payload > $n0" + SEPARATOR, "payload > 1"]


# --- the side of the compiler -------------------------------------------------------------------------------


def test_placeholders_are_numbered_and_equal_ones_share_a_value() -> None:
    text = (
        "payload >= $mass[g] && north < $at[0] || $name == colour && payload > $mass[kg] order by $at[0] * 2"
    )
    assert [one.path for one in read_placeholders(text).placeholders] == [
        "mass",
        "at[0]",
        "name",
        "mass",
        "at[0]",
    ]
    found = numbered_query(text, {"mass": "number", "at[0]": "number", "name": "text"}, ATTRIBUTES)
    assert found.mistakes == ()
    assert found.text == "payload >= $n0 && north < $n1 || $t2 == colour && payload > $n3 order by $n1 * 2"
    assert [(one.path, one.factor, one.offset) for one in found.values] == [
        ("mass", 0.001, 0.0),
        ("at[0]", 1.0, 0.0),
        ("name", 1.0, 0.0),
        ("mass", 1.0, 0.0),
    ]


@pytest.mark.parametrize(
    ("text", "factor", "offset"),
    [
        ("heat < $x[K]", 1.0, -273.15),
        ("heat < $x[degC]", 1.0, 0.0),
        ("distance($x[km], 0) < 3", 1000.0, 0.0),
        ("distance(0, 0) < $x[ft]", 0.3048, 0.0),
        ("min(payload, $x[t]) > 1", 1000.0, 0.0),
        ("payload * $x[km/h] > 1", 1 / 3.6, 0.0),
        ("-$x[g] < payload", 0.001, 0.0),
    ],
)
def test_units_are_converted_to_the_unit_of_the_other_side(text: str, factor: float, offset: float) -> None:
    found = numbered_query(text, {"x": "number"}, ATTRIBUTES)
    assert found.mistakes == ()
    assert (found.values[0].factor, found.values[0].offset) == pytest.approx((factor, offset))


@pytest.mark.parametrize(
    "text",
    [
        "payload > $x[m]",
        "payload + $x < north",
        "distance($x[kg], 1.0) < 2",
        "distance($x, 1.0) < payload",
        "max(payload, north, $x) > 1",
        "payload == $x && north == payload",
        "payload > $x order by payload + north",
    ],
)
def test_mismatched_dimension_is_refused(text: str) -> None:
    assert numbered_query(text, {"x": "number"}, ATTRIBUTES).mistakes


def test_units_are_not_compared_without_parameters() -> None:
    """Queries of programs of 0.4, and those of `lfield query`, remain valid."""
    compile_query("payload > north || payload + north < 3", ATTRIBUTES)


def test_placeholders_within_quotes_are_found() -> None:
    found = read_placeholders('colour == "$name" && payload > $kg')
    assert [(one.path, one.start, one.end) for one in found.quoted] == [("name", 10, 17)]
    assert [one.path for one in found.placeholders] == ["kg"]


def test_condition_without_placeholders_is_parsed_as_before() -> None:
    text = "payload >= 2 && colour == red"
    assert parse_query(text, parameters=True)[1] == parse_query(text)[1] == []


# --- in a bundle -------------------------------------------------------------------------------------------


def stored(*texts: str) -> dict[str, OfferQuery]:
    """Queries of a program after a round trip of the registry through a bundle."""
    registry = read_registry([Path(__file__).parents[1] / "golden" / "programs" / "hauling.yaml"])
    compiled = compile_constants(texts, registry.attributes)
    assert len(compiled) == len(texts)
    return dict(decode_registry(encode_registry(replace(registry, constraints=compiled))).constraints)


def test_bundle_keeps_queries_with_order_and_parameters() -> None:
    template = "payload > $n0 order by distance($n1, 2.0), north desc limit 3" + SEPARATOR
    found = stored(template, "order by distance(1.0, 2.0), payload desc")
    bound = bind(found[template], [1, 2.5])
    assert bound.condition is not None
    assert evaluator(bound.condition)({"payload": 2.0}) is True
    assert [key.value.text for key in bound.order] == ["distance(2.5, 2.0)", "north"]
    assert bound.limit == 3
    other = found["order by distance(1.0, 2.0), payload desc"]
    assert [key.value.tree.span.text for key in other.order] == ["distance(1.0, 2.0)", "payload"]


def test_bundle_with_an_invalid_parameter_type_is_refused() -> None:
    registry = read_registry([Path(__file__).parents[1] / "golden" / "programs" / "hauling.yaml"])
    template = "payload > $n0" + SEPARATOR
    data = encode_registry(replace(registry, constraints=compile_constants([template], registry.attributes)))
    assert data.count(b"\xa2n0") == 1
    for wrong in (b"\xa2x0", b"\xa2nn", b"\xa2t0", b"\xa20n"):
        with pytest.raises((BundleError, msgspec.ValidationError)):
            decode_registry(data.replace(b"\xa2n0", wrong))
