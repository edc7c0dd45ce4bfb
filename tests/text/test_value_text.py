"""Text of device values."""

from __future__ import annotations

import math

import pytest

from lfield.text.value_text import value_text


@pytest.mark.parametrize(
    ("value", "words"),
    [
        (True, "yes"),
        (4.2, "4.20"),
        ([-0.004, -0.006], "(0.00 -0.01)"),
        (-999_999.0, "-999999.00"),
        (-1_789_999_999.123, "-1.79e09"),
        (1e300, "1e300"),
        (math.nan, "nan"),
        (math.inf, "inf"),
        ([1.0, 2.5e7], "(1.00 2.5e07)"),
    ],
)
def test_number_is_shown_in_bounded_length(value, words):
    assert value_text(value) == words
