"""Values of portal calls as bytes: decoding restores them, and bytes of a peer cost bounded work."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lfield.vm.person_calls.l_object import LObject
from lfield.vm.person_calls.value_codec import (
    MAX_DEPTH,
    MAX_VALUES,
    UnsendableValue,
    decode_values,
    encode_values,
)

KEYS = st.text(max_size=5) | st.integers(-(2**63), 2**63 - 1)
PLAIN = st.none() | st.booleans() | KEYS | st.floats(allow_nan=False)
VALUES = st.recursive(
    PLAIN,
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(KEYS, inner, max_size=3)
        | st.builds(
            lambda name, fields: LObject(name, **fields),
            st.text(min_size=1, max_size=5),
            st.dictionaries(st.sampled_from(["x", "y", "next"]), inner, max_size=3),
        )
    ),
    max_leaves=10,
)


@given(st.lists(VALUES, max_size=4))
def test_values_are_restored_by_decoding(values: list[object]) -> None:
    assert decode_values(encode_values(values, 1 << 20)) == values


@given(st.binary(max_size=200))
def test_any_bytes_are_decoded_or_refused(data: bytes) -> None:
    try:
        values = decode_values(data)
    except UnsendableValue:
        return
    assert isinstance(values, list)


def nested(depth: int) -> list[object]:
    value: list[object] = []
    for _ in range(depth - 1):
        value = [value]
    return value


@pytest.mark.parametrize(
    "value",
    [nested(MAX_DEPTH + 1), [0] * MAX_VALUES, object(), {None: 1}, {LObject("A"): 1}, 1 << 70, "\ud800"],
    ids=["deep", "many", "foreign", "key", "object key", "large", "surrogate"],
)
def test_a_value_without_an_encoding_is_refused(value: object) -> None:
    with pytest.raises(UnsendableValue):
        encode_values([value], 1 << 20)


def test_cyclic_values_and_many_aliases_are_refused() -> None:
    ring: list[object] = []
    ring.append(ring)
    many: list[object] = [1]
    for _ in range(30):
        many = [many, many]
    for value in (ring, many):
        with pytest.raises(UnsendableValue):
            encode_values([value], 1 << 20)


@pytest.mark.parametrize("data", [b"\x91" * 40, b"\x91" * 100_000, b"\x91\xc7\x00\x01", b"\x91\xd4\x01\x90"])
def test_hostile_bytes_are_refused(data: bytes) -> None:
    with pytest.raises(UnsendableValue):
        decode_values(data)


def test_the_encoded_size_is_limited() -> None:
    assert encode_values(["a" * 100], 110)
    with pytest.raises(UnsendableValue):
        encode_values(["a" * 100], 100)
    assert decode_values(encode_values([nested(MAX_DEPTH)], 1 << 20)) == [nested(MAX_DEPTH)]
