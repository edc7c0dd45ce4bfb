"""The golden programs of constants, enums, functions and parameters detect the planted bugs."""

from __future__ import annotations

from pathlib import Path

import pytest
from lang_expectations import CAPABILITIES, GOLDEN, assert_exactly
from planted_language_bugs import BUGS, LanguageBug

from lfield.lang.frontend import check_file
from lfield.testing.golden import check

_PROGRAMS = Path(__file__).parents[1] / "golden" / "programs"


def _check(program: str) -> None:
    path = GOLDEN / "errors" / f"{program}.L"
    if path.exists():
        assert_exactly(path, check_file(path, capabilities=CAPABILITIES).diagnostics)
    else:
        check(_PROGRAMS / f"{program}.L")


@pytest.mark.few(3)
@pytest.mark.parametrize("bug", BUGS, ids=lambda bug: bug.name)
def test_a_planted_language_bug_is_found(bug: LanguageBug, monkeypatch: pytest.MonkeyPatch) -> None:
    _check(bug.program)
    bug.plant(monkeypatch)
    with pytest.raises(Exception):  # noqa: B017 - an assertion, or an error of the compiler
        _check(bug.program)
