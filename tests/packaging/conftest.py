"""The systemd unit of the service, and its settings."""

from __future__ import annotations

import re
from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def unit() -> Path:
    return Path(__file__).parents[2] / "deploy" / "lfield.service"


@pytest.fixture(scope="session")
def settings(unit: Path) -> dict[str, list[str]]:
    """The values of every key of the unit, in their order."""
    values: dict[str, list[str]] = {}
    for line in unit.read_text(encoding="utf-8").splitlines():
        if match := re.fullmatch(r"([A-Za-z]+)=(.*)", line):
            values.setdefault(match[1], []).append(match[2])
    return values
