"""Queries of the registry: their primitives and condition, and invalid input."""

from __future__ import annotations

from functools import cache

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lfield.capability.model import Registry
from lfield.capability.registry_reader.registry_files import read_registry
from lfield.errors import ProgramError, UsageError
from lfield.operator.query_parser import parse_query


@cache
def registry() -> Registry:
    return read_registry()


def asked(text: str) -> tuple[list[str], str | None]:
    """The primitives and the condition of a query."""
    question = parse_query(text, registry())
    constraint = question.constraint.text.strip() if question.constraint is not None else None
    return [primitive.name for primitive in question.primitives], constraint


@pytest.mark.parametrize(
    ("text", "primitives", "constraint"),
    [
        ("Lift", ["Lift"], None),
        ("  Lift  ", ["Lift"], None),
        ("Lift where payload >= 2.0", ["Lift"], "payload >= 2.0"),
        ("Lift where(payload >= 2.0)", ["Lift"], "(payload >= 2.0)"),
        ("Lift\nwhere payload >= 2.0\n  && reach > 1\n", ["Lift"], "payload >= 2.0\n  && reach > 1"),
        ('Lift where agent == "where is it"', ["Lift"], 'agent == "where is it"'),
        ("skill.security", ["Scout", "Sentry"], None),
        ("skill.lifting where payload >= 2.0", ["Lift"], "payload >= 2.0"),
        ("maneuverability.directional_force", ["Move", "Climb"], None),
    ],
)
def test_a_query_has_its_primitives_and_condition(text, primitives, constraint):
    assert asked(text) == (primitives, constraint)


@pytest.mark.parametrize("text", ["", " ", "Lift payload >= 2.0", "Lift wherever", "Lift " * 2000])
def test_an_invalid_query_is_refused(text):
    with pytest.raises(UsageError):
        asked(text)


def test_mistakes_are_reported_at_their_place_in_the_query():
    with pytest.raises(ProgramError) as refused:
        asked("Lfit where paylod >= 2.0")
    assert [d.span.text for d in refused.value.diagnostics] == ["Lfit", "paylod"]


WORDS = st.sampled_from(
    ["Lift", "where", "payload", ">=", "2.0", "&&", "(", ")", "skill", ".", '"', "\n", "é"]
)


@given(st.text(max_size=200) | st.lists(WORDS, max_size=12).map(" ".join))
def test_any_text_is_answered_or_refused(text):
    try:
        primitives, _ = asked(text)
    except (UsageError, ProgramError) as refused:
        for diagnostic in getattr(refused, "diagnostics", ()):
            diagnostic.render()
    else:
        assert primitives
