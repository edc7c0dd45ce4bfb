"""Hosts a and b of the mobility core, and a coordinator that has left a."""

import pytest
from mobility_hosts import TOUR, Host, seal


@pytest.fixture
def a() -> Host:
    """A host on which the coordinator runs."""
    host = Host("a")
    host.mobility.start(TOUR, 1)
    return host


@pytest.fixture
def b() -> Host:
    return Host("b")


@pytest.fixture
def away(a, b) -> Host:
    """Host a, from which the coordinator has been sent to b, at time 0; no answer yet."""
    a.mobility.on_linked(b.hello())
    a.mobility.depart(TOUR, "b", seal, 0.0)
    return a
