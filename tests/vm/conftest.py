"""Runs each test of the machine on two alternating engines that are compared, or on the reference engine."""

from __future__ import annotations

import pytest
from parametrized_cases import engines

from switching_engine import either_engine

#: Folders with tests of parts of an engine, without a machine.
PARTS = {"maths", "runtime", "wasm"}
engine = pytest.fixture(autouse=True)(either_engine)


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    if "engine" in metafunc.fixturenames and metafunc.definition.path.parent.name not in PARTS:
        metafunc.parametrize("engine", engines(metafunc.config), indirect=True)
