"""Flights that end with their test."""

from __future__ import annotations

import pytest
from copter_flight import Flight
from groups import Group


@pytest.fixture
def flight(alone, lfield):
    """`flight(**options)`: a flying copter with its own host."""
    made: list[Flight] = []

    def begin(**options) -> Flight:
        made.append(Flight(lfield, alone, **options))
        return made[-1]

    yield begin
    for flown in made:
        flown.witness.close()
    lfield.end()


@pytest.fixture
def bounded(lfield):
    """`bounded(controller)`: a control group for processes of this test."""
    made: list[Group] = []

    def begin(controller: str) -> Group:
        made.append(Group(controller))
        return made[-1]

    yield begin
    lfield.end()
    for group in made:
        group.remove()
