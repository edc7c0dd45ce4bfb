"""Coroutine tests of services, in virtual time."""

from __future__ import annotations

import pytest

from lfield.simulate.jumping_loop import run_jumping


@pytest.fixture(scope="session")
def runner():
    return lambda test: run_jumping(test())
