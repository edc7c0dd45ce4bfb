"""Each golden program on two engines in turn, compared; or on the reference engine."""

from __future__ import annotations

import pytest
from parametrized_cases import engines

from switching_engine import either_engine

engine = pytest.fixture(autouse=True)(either_engine)


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    if "engine" in metafunc.fixturenames:
        metafunc.parametrize("engine", engines(metafunc.config), indirect=True)
