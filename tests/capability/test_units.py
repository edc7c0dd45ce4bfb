from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lfield import units
from lfield.units import conversion, in_si, is_registry_unit, is_unit, suggestion

#: Every symbol of the tables, and some compound units.
COMPOUND = [
    "m/s",
    "km/h",
    "rad/s",
    "N m",
    "m/s2",
    "m/s^2",
    "kg m2/s2",
    "1/s",
    "m3/h",
    "J/kg/K",
    "deg/s",
    "mAh",
    "",
]
UNITS = [*units._symbols(), *COMPOUND]


@pytest.mark.parametrize(
    ("source", "target", "factor", "offset"),
    [
        ("mm", "m", 0.001, 0.0),
        ("m", "mm", 1000.0, 0.0),
        ("g", "kg", 0.001, 0.0),
        ("km/h", "m/s", 1 / 3.6, 0.0),
        ("rpm", "rad/s", math.pi / 30, 0.0),
        ("deg", "rad", math.pi / 180, 0.0),
        ("rev/min", "rpm", 1.0, 0.0),
        ("N m", "J", 1.0, 0.0),
        ("kg m2/s2", "N m", 1.0, 0.0),
        ("m/s^2", "m/s2", 1.0, 0.0),
        ("°C", "K", 1.0, 273.15),
        ("degF", "degC", 5 / 9, -160 / 9),
        ("K", "degC", 1.0, -273.15),
        ("%", "", 0.01, 0.0),
        ("1", "", 1.0, 0.0),
        ("hPa", "bar", 0.001, 0.0),
        ("Wh", "kJ", 3.6, 0.0),
        ("mAh", "C", 3.6, 0.0),
        ("V A", "W", 1.0, 0.0),
        ("m3/h", "L/min", 1000 / 60, 0.0),
        ("kn", "m/s", 1852 / 3600, 0.0),
        ("MiB", "B", 1048576.0, 0.0),
    ],
)
def test_unit_conversion(source: str, target: str, factor: float, offset: float) -> None:
    assert conversion(source, target) == pytest.approx((factor, offset), rel=1e-15, abs=1e-12)


@pytest.mark.parametrize(
    ("source", "target"),
    [
        ("m", "kg"),
        ("Hz", "rad/s"),
        ("m", "m2"),
        ("rad", ""),
        ("B", ""),
        ("kgs", "kg"),
        ("m", "metre"),
        ("degC/s", "K/s"),
    ],
)
def test_incompatible_units_are_not_converted(source: str, target: str) -> None:
    assert conversion(source, target) is None
    assert conversion(target, source) is None


@given(st.sampled_from(UNITS), st.sampled_from(UNITS), st.floats(-1e9, 1e9))
def test_conversion_is_reversible(source: str, target: str, amount: float) -> None:
    there, back = conversion(source, target), conversion(target, source)
    assert (there is None) == (back is None)
    if there is None or back is None:
        return
    converted = amount * there[0] + there[1]
    # Precision is lost to the offset of a scale: the greatest intermediate number counts.
    greatest = max(abs(amount), abs(converted * back[0]), abs(there[1] * back[0]), 1.0)
    assert math.isclose(converted * back[0] + back[1], amount, abs_tol=1e-13 * greatest)


@given(st.sampled_from(UNITS), st.sampled_from(UNITS), st.sampled_from(UNITS))
def test_conversion_by_way_of_a_third_unit(first: str, second: str, third: str) -> None:
    one, two, direct = conversion(first, second), conversion(second, third), conversion(first, third)
    if one is None or two is None:
        return
    assert direct is not None
    assert math.isclose(one[0] * two[0], direct[0], rel_tol=1e-14)


@given(st.text(max_size=60))
def test_any_text_is_a_unit_or_gets_a_suggestion(text: str) -> None:
    if not is_unit(text):
        assert suggestion(text)
        assert conversion(text, "m") is None


@pytest.mark.parametrize(
    "text", ["J/kg K", "m/", "/s", "//", "m//s", "2m", "m s/", "m2 2", "m-", "m" * 50, "m\0", "meter"]
)
def test_invalid_units_are_refused(text: str) -> None:
    assert not is_unit(text)


@pytest.mark.parametrize(
    ("text", "meant"),
    [("kgs", "kg"), ("Mm", "mm"), ("rads", "rad"), ("hpa", "hPa"), ("degc", "degC"), ("ohms", "ohm")],
)
def test_similar_unit_is_suggested(text: str, meant: str) -> None:
    assert suggestion(text) == f"did you mean '{meant}'?"


def test_registry_units_are_si_units() -> None:
    good = [
        "",
        "m",
        "kg",
        "m/s",
        "m/s2",
        "rad/s",
        "N m",
        "W",
        "V",
        "Hz",
        "J",
        "Pa",
        "deg",
        "°C",
        "degC",
        "K",
        "B",
        "A s",
    ]
    bad = ["mm", "km", "g", "%", "min", "rpm", "deg/s", "bar", "Wh", "degF", "nonsense"]
    assert [text for text in good if not is_registry_unit(text)] == []
    assert [text for text in bad if is_registry_unit(text)] == []


@given(st.sampled_from(UNITS))
def test_every_unit_has_an_si_equivalent(text: str) -> None:
    si = in_si(text)
    assert is_registry_unit(si)
    assert conversion(text, si) is not None
