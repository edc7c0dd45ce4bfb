"""Fixtures for commands for a running team."""

from __future__ import annotations

import pytest


@pytest.fixture
def own(alone) -> dict[str, str]:
    """The environment of commands that find only the runs of one test, not even a service's."""
    return {**alone, "RUNTIME_DIRECTORY": f"{alone['XDG_RUNTIME_DIR']}/service/lfield"}
