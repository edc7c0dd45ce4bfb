"""A folder for imports."""

from __future__ import annotations

from pathlib import Path

import pytest
from imports import Imports


@pytest.fixture
def imports(tmp_path: Path) -> Imports:
    return Imports(tmp_path)
