"""The tests that plant a bug and must fail with it, in one list: `golden/planted bugs.txt`.

Each line is a bug, with the test that finds it; `pytest TEST` tries one. A bug that is dropped from a
catalogue, or a test that is renamed, changes the list.
"""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from importlib import import_module
from types import ModuleType

import pytest
from command_lines import ROOT

#: Where bugs are planted: files and their tests. Of a parametrized test each case is a bug.
FINDERS = {
    "tests/simulate/planted/test_planted.py": ("test_a_planted_bug_is_found",),
    "tests/simulate/test_fleet.py": ("test_a_sender_that_resumes_what_it_has_sent_is_found",),
    "tests/simulate/test_fleet_census.py": ("test_a_judge_that_takes_silence_for_a_loss_is_found",),
    "tests/quorum/test_quorum_property.py": (
        "test_what_leases_and_fences_rest_on_is_needed",
        "test_a_recovery_in_spite_of_a_termination_is_seen",
    ),
    "tests/mobility/test_mobility_property.py": ("test_a_broken_protocol_is_found_out",),
    "tests/mobility/test_mobility_walk.py": ("test_a_subtly_broken_protocol_is_found_out",),
    "tests/mobility/test_mobility_kept.py": (
        "test_a_host_that_comes_back_and_does_not_listen_is_found_out",
        "test_a_machine_that_keeps_too_little_is_found_out",
    ),
    "tests/host/reserve/test_reservations_property.py": ("test_what_is_broken_is_found",),
    "tests/matrix/test_security_matrix.py": ("test_a_planted_hole_is_noticed",),
    "tests/testing/fuzz/test_fuzz.py": (
        "test_a_planted_fault_is_found",
        "test_a_fault_in_the_text_of_the_engine_is_found",
    ),
    "tests/vm/maths/test_maths_lowering.py": ("test_a_planted_fault_is_found",),
}
#: Modules in which every public function with a parameter `patch` plants a bug.
CATALOGUES = ("tests/simulate/planted/planted_*.py", "tests/quorum/quorum_bugs.py")


def imported(file: str, patch: pytest.MonkeyPatch) -> ModuleType:
    """A test module: those of a folder import each other by bare names."""
    path = ROOT / file
    patch.syspath_prepend(path.parent)
    return import_module(path.stem)


def bugs_of(module: ModuleType, test: str) -> Iterator[str]:
    """The names of the bugs that a test plants: of its cases, or its own."""
    marks = getattr(getattr(module, test), "pytestmark", [])
    cases = next((mark.args[1] for mark in marks if mark.name == "parametrize"), None)
    if cases is None:
        yield test.removeprefix("test_")
        return
    for case in cases:
        bug = case[0] if isinstance(case, tuple) else case
        yield getattr(bug, "__name__", None) or getattr(bug, "name", None) or str(bug)


def listed(patch: pytest.MonkeyPatch) -> dict[str, list[str]]:
    """The bugs by the test that finds them."""
    return {
        f"{file}::{test}": list(bugs_of(imported(file, patch), test))
        for file, tests in FINDERS.items()
        for test in tests
    }


def test_every_planted_bug_is_still_planted(golden, monkeypatch: pytest.MonkeyPatch) -> None:
    found = listed(monkeypatch)
    for test, bugs in found.items():
        assert len(set(bugs)) == len(bugs)
        golden("planted bugs").check(test, "".join(f"{bug}\n" for bug in bugs))
    golden("planted bugs").has_only(found)


@pytest.mark.parametrize("pattern", CATALOGUES)
def test_every_bug_of_a_catalogue_is_planted_by_a_test(pattern: str, monkeypatch: pytest.MonkeyPatch) -> None:
    planted = {bug for bugs in listed(monkeypatch).values() for bug in bugs}
    for path in ROOT.glob(pattern):
        module = imported(path.relative_to(ROOT).as_posix(), monkeypatch)
        made = [function for _, function in inspect.getmembers(module, inspect.isfunction)]
        own = {f.__name__ for f in made if f.__module__ == module.__name__ and not f.__name__.startswith("_")}
        names = {name for name in own if "patch" in inspect.signature(getattr(module, name)).parameters}
        assert names <= planted
