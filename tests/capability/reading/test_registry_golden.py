"""Golden registries: every message of the table at its place, and no other."""

from pathlib import Path

import pytest
from registry_expectations import BASE, GOLDEN, assert_exactly, expected

from lfield.capability.registry_reader.messages import TABLE
from lfield.capability.registry_reader.registry_files import check_files

CASES = sorted(path for path in (GOLDEN / "errors").iterdir())

#: Reported for a file that is too long to be golden; test_registry_hostile.py tests it.
LONG = {"C101"}


@pytest.mark.parametrize("case", CASES, ids=lambda p: p.stem)
def test_registry_has_exactly_the_expected_diagnostics(case: Path) -> None:
    assert_exactly(case)


def test_every_code_has_a_golden_case() -> None:
    told = {code for case in CASES for *_, code, _ in expected(case)}
    assert set(TABLE) - LONG <= told
    for case in CASES:
        assert case.stem[:4] in {code for *_, code, _ in expected(case)}, case.name


def test_base_of_all_cases_has_no_diagnostics() -> None:
    registry, found = check_files([BASE])
    assert [d.render() for d in found] == []
    assert registry is not None
