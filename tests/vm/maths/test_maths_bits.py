"""The same bits on every computer: a table of results, and the one NaN (decision 58)."""

from __future__ import annotations

import math
import struct

import pytest
from bits_of_maths import ROWS
from hypothesis import given
from hypothesis import strategies as st

from lfield.testing.golden import run_text
from lfield.vm.maths.intrinsics import MATHS
from lfield.vm.memory.word_codec import NAN_WORD, bits_of_real, canonical, real_from_bits


@pytest.mark.parametrize("row", ROWS.strip().splitlines())
def test_the_table_of_bits(row: str) -> None:
    given_, _, expected = row.partition(" = ")
    name, *numbers = given_.split()
    assert MATHS[name](*map(float.fromhex, numbers)).hex() == expected


@given(st.integers(0, (1 << 51) - 1), st.booleans(), st.booleans())
def test_every_nan_is_stored_as_one_word(payload: int, quiet: bool, negative: bool) -> None:
    word = (0x7FF0 << 48) | payload + 1 | (quiet << 51) | 0
    value = real_from_bits(word - (1 << 63) if negative else word)
    assert math.isnan(value)
    assert bits_of_real(value) == NAN_WORD
    assert struct.pack("<d", canonical(value)) == struct.pack("<q", NAN_WORD)


@given(st.floats(allow_nan=False))
def test_any_other_real_keeps_its_bits(value: float) -> None:
    assert struct.pack("<q", bits_of_real(value)) == struct.pack("<d", value)


#: Expressions that make a NaN, or calculate with one.
_MADE = ["i - i", "0.0 * i", "-(i - i)", "(i - i) + 1.0", "(i - i) * i", "(i - i) / 2.0", "2.0 / (i - i)"]
_MADE += [f"{name}(i - i)" for name in ("abs", "sin", "cos", "tan", "asin", "acos", "exp", "log", "sqrt")]
_MADE += [f"{name}(i - i)" for name in ("floor", "ceil", "round")]
_MADE += [
    "pow(i - i, 2.0)",
    "atan2(1.0, i - i)",
    "min(i - i, 1.0)",
    "max(1.0, i - i)",
    "(i - i) % 3.0",
    "3.0 % (i - i)",
]


@pytest.mark.parametrize("expression", _MADE)
def test_every_operation_makes_the_same_nan(expression: str) -> None:
    init = f"init(string[] arg) {{ real i = 1e308 * 10.0; x = {expression}; }}"
    _, machine = run_text(f"resource R {{ real x; {init} portal p() {{}} }}")
    block = machine.agents["r"].block
    assert block.w[block.w[6 + 1] + 1] == NAN_WORD
