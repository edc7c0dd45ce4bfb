"""Every planted bug is in the catalogue, with a description and the test that finds it."""

from __future__ import annotations

from collections import Counter

from catalogue import FINDERS, PAGE, ROOT, page, planted_bugs, planting_functions

#: A smaller number would mean that bugs were removed.
LEAST = 145


def test_the_page_is_the_catalogue() -> None:
    assert PAGE.read_text(encoding="utf-8") == page(), "python tests/planted/catalogue.py --write"


def test_every_bug_has_a_name_of_its_own_and_a_sentence() -> None:
    bugs = planted_bugs()
    assert len(bugs) >= LEAST
    names = Counter((bug.finder.node, bug.name) for bug in bugs)
    assert [name for name, count in names.items() if count > 1] == []
    assert [bug.name for bug in bugs if len(bug.broken) < 10] == []


def test_every_function_that_plants_a_bug_is_in_the_catalogue() -> None:
    assert planting_functions() - {bug.name for bug in planted_bugs()} == set()


def test_every_test_that_plants_bugs_is_a_finder() -> None:
    """Finders are recognised by their names; none of them may be missing from the catalogue."""
    named = {
        f"{path.relative_to(ROOT).as_posix()}::{line.split('(')[0].removeprefix('def ')}"
        for path in (ROOT / "tests").rglob("test_*.py")
        for line in path.read_text(encoding="utf-8").splitlines()
        if line.startswith(("def test_a_planted_", "def test_a_broken_reservation_rule_is_found"))
    }
    assert named <= {finder.node for finder in FINDERS}
