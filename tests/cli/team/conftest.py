"""What commands for a running team are tried with."""

from __future__ import annotations

from pathlib import Path

import pytest


@pytest.fixture
def own(alone, tmp_path: Path) -> dict[str, str]:
    """The environment of commands that find no run but those of one test, not even a service's."""
    return {**alone, "TMPDIR": str(tmp_path), "RUNTIME_DIRECTORY": f"{tmp_path}/service/lfield"}
