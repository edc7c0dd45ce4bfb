"""Each golden program on the reference engine, and on two that take turns and are compared at every exit."""

from __future__ import annotations

import pytest

from lfield.testing.engines import either_engine

engine = pytest.fixture(autouse=True, params=["reference", "both"])(either_engine)
