"""Flights that end with their test."""

from __future__ import annotations

import pytest
from copter_flight import Flight
from groups import Group


@pytest.fixture
def flight(alone, lfield):
    """`flight(**options)`: a flying copter with its own host."""
    flights: list[Flight] = []

    def begin(**options) -> Flight:
        flights.append(Flight(lfield, alone, **options))
        return flights[-1]

    yield begin
    for flown in flights:
        flown.witness.close()
    lfield.end()


@pytest.fixture
def bounded(lfield):
    """`bounded(controller)`: a control group for processes of this test."""
    groups: list[Group] = []

    def begin(controller: str) -> Group:
        groups.append(Group(controller))
        return groups[-1]

    yield begin
    lfield.end()
    for group in groups:
        group.remove()
