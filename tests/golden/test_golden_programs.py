"""Every golden program does what its comments state; see lfield.testing.golden for the notation."""

from __future__ import annotations

from pathlib import Path

import pytest

from lfield.testing.golden import check

_PROGRAMS = sorted((Path(__file__).parent / "programs").glob("*.L"))


@pytest.mark.few(80)
@pytest.mark.parametrize("path", _PROGRAMS, ids=lambda path: path.stem)
def test_golden_program(path: Path) -> None:
    check(path)


def test_there_are_golden_programs() -> None:
    assert len(_PROGRAMS) >= 60
