"""Reports from any sender: the content fits its attributes, or the whole report is refused."""

from __future__ import annotations

import math

import pytest
from directory_team import AGENTS, ATTRIBUTES, PROVIDERS, REGISTRY
from hypothesis import given
from hypothesis import strategies as st

from lfield.capability.directory.directory_delta import (
    AgentCondition,
    AttributeSample,
    DirectoryDelta,
    ReservedBy,
    Unavailability,
)
from lfield.errors import WireError
from lfield.host.directory_updates.directory_codec import DirectoryCodec
from lfield.wire.codec import decode, encode
from lfield.wire.framing import HEADER_SIZE
from lfield.wire.messages import AgentUpdate, AttributeUpdate, DirectoryUpdate

INDEX = st.integers(0, 8)
AGE = st.floats(0.0, 1e9)
TEXT = st.text(max_size=10)
FACTS = st.builds(
    AttributeUpdate,
    INDEX,
    st.one_of(st.booleans(), st.integers(-9, 9), st.floats(), TEXT),
    AGE,
    st.booleans(),
    st.sampled_from(["stated", "told", "measured"]),
)
REPORTS = st.builds(
    DirectoryUpdate,
    st.integers(0, 3),
    st.integers(0, 3),
    st.integers(0, 3),
    st.lists(
        st.builds(
            AgentUpdate,
            INDEX,
            TEXT,
            st.none() | AGE,
            st.lists(FACTS, max_size=4),
            st.lists(st.tuples(INDEX, TEXT), max_size=3),
            TEXT,
            AGE,
        ),
        max_size=4,
    ),
)
TYPES = {"real": float, "int": int, "boolean": bool, "text": str}


def through_the_wire(report):
    frame = encode(report)
    return decode(frame[HEADER_SIZE - 1], frame[HEADER_SIZE:])


@given(REPORTS)
def test_any_report_is_refused_or_fits_the_registry(report):
    reports = DirectoryCodec(REGISTRY, AGENTS)
    try:
        changes = reports.decode("bravo", through_the_wire(report), 1000.0)
    except WireError:
        return
    for agent, condition in changes.agents.items():
        deployed = next(a for a in AGENTS if a.id == agent)
        assert deployed.host == "bravo"
        for name, sample in condition.samples.items():
            assert name in PROVIDERS[deployed.type].live or sample.of == "stated"
            assert type(sample.value) is TYPES[ATTRIBUTES[name].type]
            assert not isinstance(sample.value, float) or math.isfinite(sample.value)
            assert sample.at - sample.when >= 0.0


@given(st.floats(0.0, 100.0), st.floats(-5.0, 100.0), st.booleans())
def test_times_become_ages_and_times_again(age, later, kept):
    # A sample time in the future comes from a wrong clock: the value counts as new.
    sample = AttributeSample(0.5, 1000.0 - age, 1000.0, kept)
    held = ReservedBy("pilot", 990.0)
    change = AgentCondition(
        Unavailability("fc: no message", 1000.0), {"battery": sample}, {"mode": "x" * 1000}, held
    )
    reports = DirectoryCodec(REGISTRY, AGENTS)
    report = through_the_wire(reports.encode(DirectoryDelta(7, 3, 4, {"arm2": change}), 1000.0 + later))
    changes = reports.decode("bravo", report, 50.0)
    assert (changes.incarnation, changes.since, changes.sequence) == (7, 3, 4)
    found = changes.agents["arm2"]
    assert found.unavailability == Unavailability("fc: no message", pytest.approx(50.0 - max(0.0, later)))
    assert found.reserved == ReservedBy("pilot", pytest.approx(50.0 - max(0.0, 10.0 + later)))
    expected = age if kept else max(0.0, age + later)
    assert found.samples["battery"] == AttributeSample(
        0.5, pytest.approx(50.0 - expected, abs=1e-9), 50.0, kept
    )
    assert len(found.unknown["mode"]) == 256
