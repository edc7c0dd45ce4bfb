"""Valid conditions over attributes, and the errors of invalid ones."""

from __future__ import annotations

import contextlib

import pytest
from hypothesis import given
from hypothesis import strategies as st
from small_registry import ATTRIBUTES, constraint_of

from lfield.capability.condition_compiler import compile_constraint, parse_expression
from lfield.capability.condition_parser import MAX_LENGTH
from lfield.capability.condition_tree import Mistake
from lfield.capability.matching.condition_checker import NameScope, check_expression
from lfield.errors import ConstraintError


@pytest.mark.parametrize(
    "text",
    [
        "payload >= 2.0",
        "payload >= 2.0 && environment == terrestrial",
        'environment != "aerial" || !ready',
        "power == battery && ready == true",
        "cable == power",
        "abs(-noise) / 4 < min(payload, reach, 3)",
        'agent != "arm2" && robot == "r1" && host == "r1"',
        'note == "anything at all"',
        "ready",
        "(payload + 1) * -2 <= - reach",
    ],
)
def test_valid_condition_compiles(text: str) -> None:
    assert compile_constraint(text, ATTRIBUTES).text == text


@pytest.mark.parametrize(
    ("text", "place", "message", "hint"),
    [
        ("paylod >= 2", "paylod", "there is no attribute 'paylod'", "did you mean 'payload'?"),
        ("ready && xyzzy", "xyzzy", "there is no attribute 'xyzzy'", "text is in double quotes"),
        ("environment == areal", "areal", "'environment' is never 'areal'", "did you mean 'aerial'?"),
        ('power == "wind"', '"wind"', "'power' is never 'wind'", "its values are battery and cable"),
        ("payload = 2", "=", "'=' is an assignment", "compare with =="),
        ("payload", "payload", "this is a number, not true or false", "compare it, as in payload >= 2.0"),
        ("payload > environment", "environment", "'>' takes numbers; this is a set", ""),
        ("payload && ready", "payload", "'&&' takes booleans; this is a number", ""),
        ("payload == ready", "payload == ready", "'==' compares a number with true or false", ""),
        ("payload % 2 == 0", "%", "'%' is not an operator of conditions", ""),
        ("ready and true", "and", "L has no operator 'and'", "write &&"),
        ("not ready", "not", "L has no 'not'", "write !"),
        ("payload > 1)", ")", "')' is not expected here", "the condition ends before it"),
        ("sin(payload) > 0", "sin", "there is no function 'sin' here", "did you mean 'min'?"),
        ("max(payload) > 0", "max(payload)", "max() takes 2 to 16 arguments, not 1", ""),
        ("abs(1, 2) > 0", "abs(1, 2)", "abs() takes 1 argument, not 2", ""),
        ("payload != null", "null", "null is not a value of an attribute", ""),
        ("payload[0] > 1", "payload[0]", "this is not allowed in a condition over attributes", ""),
        ("new Lift() == ready", "new Lift()", "this is not allowed in a condition over attributes", ""),
        ("grip.payload > 1", "grip.payload", "an attribute has no members", "write its name alone"),
        (
            "distance(a, b) < 1",
            "a",
            "the coordinates of a place are number literals",
            "such as distance(12.0, 4.0)",
        ),
        ("distance(1) < 1", "distance(1)",
         "distance() here takes a place: north, east and optionally down",
         "such as distance(12.0, 4.0), in metres"),
        ("ready ? ready : ready", "?", "L has no ? : expression", ""),
        ("payload >= 2 ready", "ready", "'ready' is not expected here", "the condition ends before it"),
        ("payload >= 2 kg", "kg", "'kg' is not expected here",
         "numbers have no units: write the value in SI units, such as m, s and rad"),
    ],
)  # fmt: skip
def test_error_is_reported_at_its_place(text: str, place: str, message: str, hint: str) -> None:
    (mistake,) = mistakes(text)
    assert text[mistake.start : mistake.end] == place
    assert (mistake.message, mistake.hint) == (message, hint)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "the condition is empty"),
        (" \n", "the condition is empty"),
        ("payload >=", "expected an expression, found the end of the text"),
        ("ready || " * 500, "this is longer than 2000 characters"),
        ("(" * 500 + "ready", "this is nested more than 100 levels deep"),
        ("!" * 500 + "ready", "this is nested more than 100 levels deep"),
    ],
)
def test_malformed_condition_is_refused(text: str, message: str) -> None:
    (mistake,) = mistakes(text)
    assert mistake.message == message


@pytest.mark.parametrize("sign", ["&&", "||"])
def test_long_chain_is_not_deep_nesting(sign: str) -> None:
    chain = f" {sign} ".join(["ready", "payload >= 2", "!ready"] * 50)
    assert mistakes(chain) == []
    found, _ = parse_expression(chain)
    assert found is not None
    assert found.tree.height < 12
    assert found.tree.span.text == chain


def test_all_errors_are_reported_at_once() -> None:
    with pytest.raises(ConstraintError) as error:
        constraint_of("paylod > 1 && reach == aerial && environment == areal")
    assert error.value.problems == (
        "there is no attribute 'paylod' (did you mean 'payload'?)",
        "there is no attribute 'aerial' (text is in double quotes)",
        "'environment' is never 'areal' (did you mean 'aerial'?)",
    )


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("grip.robot != climb.robot", None),
        ("distance(grip, climb) <= climb.reach", None),
        ("grip.environment == climb.environment", None),
        ("grip.environment == aerial", None),
        ("payload >= 1", None),
        ("reach >= 1", "'reach' is ambiguous: several parts have it"),
        ("grp.reach >= 1", "there is no part 'grp'"),
        ("grip.rech >= 1", "there is no attribute 'rech'"),
        ("grip == climb", "parts cannot be compared"),
        ("distance(grip) < 1", "distance() takes two parts"),
        ("distance(grip, payload) < 1", "distance() takes two parts"),
        ("grip.a.b == 1", "this is not a part"),
        ("grip < climb", "'<' takes numbers; this is a part"),
    ],
)
def test_condition_over_parts_is_checked(text: str, message: str | None) -> None:
    expression, found = parse_expression(text)
    assert expression is not None
    found = check_expression(
        expression, NameScope.of_parts(ATTRIBUTES, ["grip", "climb"], ["payload"]), "boolean"
    )
    messages = [mistake.message for mistake in found]
    assert messages[:1] == ([] if message is None else [message])


def test_distance_requires_position_attributes() -> None:
    expression, _ = parse_expression("distance(grip, climb) < 1")
    assert expression is not None
    attributes = {name: a for name, a in ATTRIBUTES.items() if name != "down"}
    (mistake,) = check_expression(expression, NameScope.of_parts(attributes, ["grip", "climb"]), "boolean")
    assert mistake.message == "distance() needs the attributes down"


@pytest.mark.parametrize(
    ("text", "wanted", "message"),
    [
        ("payload + 1", "number", None),
        ("environment", "set", None),
        ("ready", "any", None),
        ("ready", "number", "this is true or false, not a number"),
        ("power", "set", "this is text, not a set"),
    ],
)
def test_expression_is_checked_for_its_expected_type(text: str, wanted: str, message: str | None) -> None:
    expression, _ = parse_expression(text)
    assert expression is not None
    found = check_expression(expression, NameScope.of_offer(ATTRIBUTES), wanted)  # type: ignore[arg-type]  # a parameter
    assert [m.message for m in found] == ([] if message is None else [message])


def test_text_in_an_error_is_truncated() -> None:
    with pytest.raises(ConstraintError) as error:
        constraint_of("x" * MAX_LENGTH)
    assert len(error.value.text) == 80


_WORDS = [
    *ATTRIBUTES,
    "agent",
    "aerial",
    "true",
    "null",
    "new",
    "this",
    "distance",
    "min",
    '"',
    "2.0",
    "1e999",
]
_SIGNS = [
    "&&",
    "||",
    "!",
    "==",
    "<",
    "=",
    "?",
    ":",
    "(",
    ")",
    "[",
    "]",
    ",",
    ".",
    "-",
    "/",
    "/*",
    "//",
    ";",
    "{",
]


@given(st.one_of(st.text(max_size=60), st.lists(st.sampled_from(_WORDS + _SIGNS), max_size=20).map(" ".join)))
def test_any_text_is_compiled_or_refused_with_places(text: str) -> None:
    with contextlib.suppress(ConstraintError):
        compile_constraint(text, ATTRIBUTES)
    for mistake in parse_expression(text)[1]:
        assert 0 <= mistake.start <= mistake.end <= max(len(text), 1)


def mistakes(text: str) -> list[Mistake]:
    """The errors of a condition on an offer."""
    expression, found = parse_expression(text)
    return (
        found
        if expression is None
        else check_expression(expression, NameScope.of_offer(ATTRIBUTES), "boolean")
    )
