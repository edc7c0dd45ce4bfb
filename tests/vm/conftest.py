"""Each test of the machine on the reference engine, and on two that take turns and are compared."""

from __future__ import annotations

import pytest

from lfield.testing.engines import either_engine

#: What tries parts of one engine has no machine.
PARTS = {"maths", "runtime", "wasm"}
engine = pytest.fixture(autouse=True)(either_engine)


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    if "engine" in metafunc.fixturenames and metafunc.definition.path.parent.name not in PARTS:
        metafunc.parametrize("engine", ["reference", "both"], indirect=True)
