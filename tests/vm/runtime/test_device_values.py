"""The result of a driver is a value of the type in its manifest, or a DeviceError that names the device."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lfield.bytecode.program import (
    ARRAY,
    BOOLEAN,
    INT,
    REAL,
    STRING,
    VOID,
    Core,
    Debug,
    Program,
    TypeRecord,
)
from lfield.driver.value_types import VALUE_CHECKS, conform
from lfield.errors import DeviceError
from lfield.vm.memory.block import Block
from lfield.vm.memory.word_codec import decode_value, encode_device_value

PROGRAM = Program(
    Core((*map(TypeRecord, range(8)), TypeRecord(ARRAY, REAL), TypeRecord(ARRAY, INT)), (), (), (), (), b""),
    Debug((), ()),
    bytes(32),
)
KINDS = {
    "void": VOID,
    "boolean": BOOLEAN,
    "int": INT,
    "real": REAL,
    "string": STRING,
    "real[]": 8,
    "int[]": 9,
}
#: A whole number that is too large for a real.
TOO_LARGE = 10**400

SCALARS = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(),
    st.sampled_from([2**63, 2**63 - 1, -(2**63), -(2**63) - 1, TOO_LARGE, 10**5000]),
    st.floats(),
    st.text(max_size=5),
    st.binary(max_size=3),
)
VALUES = st.one_of(SCALARS, st.lists(SCALARS, max_size=4), st.tuples(st.integers()), st.just({}))


def value_in_l(kind: str, value: object) -> object:
    """The value in L."""
    block = Block.empty(bytes(32), 1 << 16)
    return decode_value(
        block, PROGRAM, KINDS[kind], encode_device_value(block, PROGRAM, KINDS[kind], value, "fc")
    )  # type: ignore


def same(left: object, right: object) -> bool:
    """Whether two values are equal in L: of the same type, and NaN equals NaN."""
    if isinstance(left, list) and isinstance(right, list):
        return len(left) == len(right) and all(map(same, left, right))
    if isinstance(left, float) and isinstance(right, float) and math.isnan(left):
        return math.isnan(right)
    return type(left) is type(right) and left == right


@given(kind=st.sampled_from(list(KINDS)), value=VALUES)
def test_a_result_is_a_value_or_an_error_that_names_the_device(kind: str, value: object) -> None:
    try:
        found = value_in_l(kind, value)
    except DeviceError as error:
        error_fields = error.device, error.reason[:20], len(error.reason) < 300
        assert error_fields == ("fc", "its driver returned ", True)
        return
    if value is None:
        # Only a text or an array may be null.
        assert kind in ("void", "string", "real[]", "int[]")
        assert found == (0 if kind == "void" else None)
    elif isinstance(value, str):
        assert found == value.encode("utf-8", "replace").decode()
    else:
        assert same(found, conform(value, kind))


@given(kind=st.sampled_from(list(KINDS)), value=VALUES)
def test_a_value_accepted_by_the_guard_is_accepted_by_the_machine(kind: str, value: object) -> None:
    try:
        sent = conform(value, kind)
    except ValueError:
        return
    value_in_l(kind, sent)


@pytest.mark.parametrize(
    ("kind", "value"),
    [
        ("real", True),
        ("int", True),
        ("boolean", 1),
        ("boolean", None),
        ("int", None),
        ("int", 1.0),
        ("real", "1.0"),
        ("real", TOO_LARGE),
        ("void", 0),
        ("string", b"text"),
        ("int[]", [1, 1.5]),
        ("int[]", ["text"]),
        ("int[]", [True]),
        ("int[]", [2**63]),
        ("int[]", [None]),
        ("real[]", [1.0, "text"]),
        ("real[]", [False]),
        ("real[]", [[1.0]]),
        ("real[]", "text"),
    ],
)
def test_a_value_of_another_type_is_an_error(kind: str, value: object) -> None:
    with pytest.raises(
        DeviceError, match=r"^fc: its driver returned .*, but its manifest states another type$"
    ):
        value_in_l(kind, value)


def test_every_type_of_a_driver_is_tested() -> None:
    assert set(KINDS) == set(VALUE_CHECKS)
    assert same(value_in_l("real[]", [1, 2.5]), [1.0, 2.5])
    assert same(value_in_l("int[]", [1, -(2**63)]), [1, -(2**63)])
