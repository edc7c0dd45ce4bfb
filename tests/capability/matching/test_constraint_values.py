"""Values of conditions on known and unknown facts, and the reasons why they are not true."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from small_registry import constraint_of, over_parts

from lfield.capability.matching.condition_evaluator import conjuncts, distance_to, evaluator, fact_names
from lfield.capability.matching.failure_reasons import failure_reasons
from lfield.capability.model import Value

FACTS: Mapping[str, Value] = {
    "agent": "arm1",
    "payload": 1.2,
    "reach": 2,
    "ready": True,
    "power": "battery",
    "environment": frozenset(["aerial", "terrestrial"]),
}


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("payload >= 1.2", True),
        ("1.2 > payload", False),
        ("reach == 2.0", True),
        ("reach / 4 == 0.5", True),
        ("payload - reach * 2 < -2", True),
        ("max(payload, reach) + min(1, 2, 3) == 3", True),
        ("abs(-reach) == -(-2)", True),
        ("environment == aerial", True),
        ("environment != aerial", False),
        ("aquatic == environment", False),
        ("power == battery && power != cable", True),
        ('agent == "arm1"', True),
        ("ready == !ready", False),
        ("noise > 1", None),
        ("!(noise > 1)", None),
        ("noise > 1 && payload > 9", False),
        ("payload > 9 && noise > 1", False),
        ("noise > 1 && ready", None),
        ("noise > 1 || ready", True),
        ("noise > 1 || payload > 9", None),
        ("payload / (reach - 2) > 1", None),
        ("reach * 1e308 * 1e308 > 1", None),
        ('note == "x" || note != "x"', None),
    ],
)
def test_condition_is_true_false_or_unknown(text: str, value: bool | None) -> None:
    assert evaluator(constraint_of(text))(FACTS) is value


@pytest.mark.parametrize("north", [1e200, 1.7e308])
def test_distance_beyond_all_numbers_is_unknown(north: float) -> None:
    facts: dict[str, Value] = {"north": north, "east": 0.0, "down": 0.0}
    assert evaluator(constraint_of("distance(0.0, 0.0) > 1"))(facts) is None
    assert distance_to(facts, (-1.7e308, 0.0, 0.0)) is None
    between = {f"{part}.{axis}": at for part in ("a", "b") for axis, at in facts.items()} | {"b.north": 0.0}
    assert evaluator(over_parts("distance(a, b) > 1", ["a", "b"]))(between) is None


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("payload >= 2.0", ["payload 1.2 < 2.0"]),
        ("2.0 <= payload", ["payload 1.2 < 2.0"]),
        ("payload > 1.2 && reach < 2", ["payload 1.2 <= 1.2", "reach 2 >= 2"]),
        ("!(payload < 2)", ["payload 1.2 < 2"]),
        ("payload * 2 > reach + 1", ["payload * 2 2.4 <= reach + 1 3"]),
        ("environment == aquatic", ["environment is aerial and terrestrial, not aquatic"]),
        ("environment != aerial", ["environment is aerial and terrestrial"]),
        ("!(environment == aerial)", ["environment is aerial and terrestrial"]),
        ("cable == power", ["power is battery, not cable"]),
        ("ready == false", ["ready is true, not false"]),
        ("!ready", ["ready is true"]),
        ("noise < 1", ["noise is not stated"]),
        ("noise < 1 && payload >= 2", ["noise is not stated", "payload 1.2 < 2"]),
        ("noise < 1 || payload >= 2", ["noise is not stated and payload 1.2 < 2"]),
        ("!(ready && payload > 1)", ["ready is true and payload 1.2 > 1"]),
        ("!(ready || noise > 1)", ["ready is true and noise is not stated"]),
        ("payload / (reach - 2) > 1", ["payload / (reach - 2) > 1 has no value"]),
        ("payload >= 1 && ready", []),
    ],
)
def test_reasons_of_a_condition_that_is_not_true(text: str, why: list[str]) -> None:
    assert list(failure_reasons(constraint_of(text), FACTS, lambda name: f"{name} is not stated")) == why


@pytest.mark.parametrize(
    ("text", "value", "why"),
    [
        ("grip.robot != climb.robot", False, "grip.robot and climb.robot are both r1"),
        ("grip.robot == climb.robot", True, None),
        ("grip.agent == climb.agent", False, "grip.agent is a1, climb.agent is a2"),
        ("grip.environment == climb.environment", True, None),
        ("grip.payload >= climb.payload", False, "grip.payload 1 < climb.payload 2.5"),
        ("distance(grip, climb) < 5", False, "distance(grip, climb) 5 >= 5"),
        ("distance(grip, climb) <= climb.reach", None, "climb.reach is not stated"),
    ],
)
def test_condition_over_parts_is_evaluated(text: str, value: bool | None, why: str | None) -> None:
    facts: dict[str, Value] = {
        **{
            "grip.agent": "a1",
            "grip.robot": "r1",
            "grip.payload": 1.0,
            "grip.environment": frozenset(["aerial"]),
        },
        **{"climb.agent": "a2", "climb.robot": "r1", "climb.payload": 2.5},
        "climb.environment": frozenset(["aerial", "aquatic"]),
        **{"grip.north": 0.0, "grip.east": 0.0, "grip.down": 1.0},
        **{"climb.north": 3.0, "climb.east": 4.0, "climb.down": 1.0},
    }
    expression = over_parts(text, ["grip", "climb"], "boolean")
    assert evaluator(expression)(facts) is value
    assert failure_reasons(expression, facts, lambda n: f"{n} is not stated") == (
        () if why is None else (why,)
    )


def test_fact_names_are_those_in_the_expression() -> None:
    expression = over_parts("distance(a, b) < a.reach && a.reach > 1", ["a", "b"])
    assert fact_names(expression) == ("a.north", "a.east", "a.down", "b.north", "b.east", "b.down", "a.reach")
    assert [c.text for c in conjuncts(expression)] == ["distance(a, b) < a.reach", "a.reach > 1"]


# --- a comparison with Python's own operators, where any unknown part makes three values ----------------

_NUMBERS = st.sampled_from(["payload", "reach", "noise", "1", "2.5"])
_ATOMS = st.one_of(
    st.sampled_from(["ready", "true", "false"]),
    st.tuples(_NUMBERS, st.sampled_from(["<", "<=", ">", ">=", "==", "!="]), _NUMBERS),
)
_CONDITIONS = st.recursive(
    _ATOMS,
    lambda inner: st.one_of(
        st.tuples(st.just("!"), inner), st.tuples(inner, st.sampled_from(["&&", "||"]), inner)
    ),
    max_leaves=12,
)
_KNOWN = st.fixed_dictionaries(
    {},
    optional={
        "payload": st.sampled_from([0.0, 1.0, 2.5]),
        "reach": st.sampled_from([1, 2]),
        "noise": st.sampled_from([1.0, 3.0]),
        "ready": st.booleans(),
    },
)


@given(_CONDITIONS, _KNOWN)
def test_logic_is_three_valued_after_kleene(condition: Any, facts: dict[str, Value]) -> None:
    expression = constraint_of(_text(condition))
    expected = _kleene(condition, facts)
    assert evaluator(expression)(facts) is expected
    reasons = failure_reasons(expression, facts, lambda name: f"{name} is not stated")
    failing = [c for c in conjuncts(expression) if evaluator(c)(facts) is not True]
    assert len(reasons) == len(failing)
    assert bool(reasons) is (expected is not True)


def _text(condition: Any) -> str:
    match condition:
        case str():
            return condition
        case ("!", inner):
            return f"!({_text(inner)})"
        case (left, sign, right):
            return f"({_text(left)}) {sign} ({_text(right)})"
    raise AssertionError(condition)


def _kleene(condition: Any, facts: Mapping[str, Value]) -> Any:
    """-1, 0 and 1 for false, unknown and true: && is the least, || the greatest, ! the opposite."""
    return {-1: False, 0: None, 1: True}[_level(condition, facts)]


def _level(condition: Any, facts: Mapping[str, Value]) -> int:
    match condition:
        case "true" | "false":
            return 1 if condition == "true" else -1
        case str(name):
            return 0 if name not in facts else 1 if facts[name] else -1
        case ("!", inner):
            return -_level(inner, facts)
        case (left, "&&", right):
            return min(_level(left, facts), _level(right, facts))
        case (left, "||", right):
            return max(_level(left, facts), _level(right, facts))
        case (left, sign, right):
            sides = [facts.get(side, None) if side.isalpha() else float(side) for side in (left, right)]
            return 0 if None in sides else 1 if _compare(sides[0], sign, sides[1]) else -1
    raise AssertionError(condition)


def _compare(left: Any, sign: str, right: Any) -> bool:
    outcome = (left > right) - (left < right)
    return outcome in {"<": (-1,), "<=": (-1, 0), ">": (1,), ">=": (0, 1), "==": (0,), "!=": (-1, 1)}[sign]
