"""Robots with services, as processes on this computer."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest
from robots import Robots


@pytest.fixture
def robots(lfield, alone, monkeypatch) -> Iterator[Callable[..., Robots]]:
    """`robots("alpha", "bravo")`: robots with inventory and keys, without running services."""

    # The inventory of the robots' folder is used.
    monkeypatch.delenv("LFIELD_INVENTORY")

    def prepare(*hosts: str, router: str = "") -> Robots:
        return Robots(lfield, hosts, alone["XDG_RUNTIME_DIR"], router)

    yield prepare
    lfield.end()
