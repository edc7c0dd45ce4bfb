"""Fixtures for commands for a running team."""

from __future__ import annotations

import pytest


@pytest.fixture
def own(alone) -> dict[str, str]:
    """An environment in which commands find only the runs of one test, and no service."""
    return {**alone, "RUNTIME_DIRECTORY": f"{alone['XDG_RUNTIME_DIR']}/service/lfield"}
