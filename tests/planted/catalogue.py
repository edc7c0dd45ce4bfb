"""The catalogue of planted bugs: description, planting function, and the test that must find the bug.

    python tests/planted/catalogue.py --write            writes tests/planted/README.md
    python tests/planted/catalogue.py --run [WORD]       plants every bug whose row contains this word

`make test` plants a sample, `make test-more` all. A planted bug that no test finds is a gap in the tests.
"""

from __future__ import annotations

import argparse
import inspect
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
PAGE = Path(__file__).with_name("README.md")

PATCH = "patch of the code"
MACHINE = "subclass that breaks one rule"
SOURCE = "edit in a copy of `lfield`"
ENGINE = "subclass of the engine"
TEXT = "edit of the engine's WebAssembly"


@dataclass(frozen=True)
class BugFinder:
    """A test that must fail with each bug that it plants; each case is a bug."""

    file: str
    test: str
    planted: str

    @property
    def node(self) -> str:
        return f"{self.file}::{self.test}"


FINDERS = (
    BugFinder("tests/simulate/planted/test_planted.py", "test_a_planted_bug_is_found", PATCH),
    BugFinder("tests/simulate/services/test_planted_pushes.py", "test_a_planted_push_bug_is_found", PATCH),
    BugFinder(
        "tests/simulate/sequencing/test_planted_sequencing.py",
        "test_a_planted_sequencing_bug_is_found",
        PATCH,
    ),
    BugFinder("tests/simulate/test_fleet.py", "test_a_sender_that_resumes_what_it_has_sent_is_found", PATCH),
    BugFinder(
        "tests/simulate/test_fleet_liveness.py",
        "test_a_judge_that_counts_a_silent_host_as_lost_is_found",
        PATCH,
    ),
    BugFinder(
        "tests/replication/lease/test_quorum_property.py",
        "test_a_broken_lease_rule_is_found",
        PATCH,
    ),
    BugFinder(
        "tests/replication/lease/test_quorum_property.py",
        "test_a_recovery_despite_a_termination_is_found",
        PATCH,
    ),
    BugFinder(
        "tests/replication/transfer/test_mobility_property.py",
        "test_a_broken_transfer_protocol_is_found",
        MACHINE,
    ),
    BugFinder(
        "tests/replication/transfer/test_mobility_walk.py",
        "test_a_protocol_that_is_broken_after_restarts_is_found",
        MACHINE,
    ),
    BugFinder(
        "tests/replication/transfer/test_mobility_kept.py",
        "test_a_restarted_host_that_ignores_a_failover_is_found",
        MACHINE,
    ),
    BugFinder(
        "tests/replication/transfer/test_mobility_kept.py",
        "test_a_host_that_stores_too_little_is_found",
        MACHINE,
    ),
    BugFinder(
        "tests/host/reserve/test_reservations_property.py", "test_a_broken_reservation_rule_is_found", MACHINE
    ),
    BugFinder("tests/matrix/test_security_matrix.py", "test_a_planted_security_hole_is_found", SOURCE),
    BugFinder("tests/fuzz/test_fuzz.py", "test_a_planted_fault_is_found", ENGINE),
    BugFinder("tests/fuzz/test_fuzz.py", "test_planted_fault_in_the_engine_text_is_found", TEXT),
    BugFinder("tests/vm/turns/test_loops.py", "test_a_planted_loop_bug_is_found", PATCH),
    BugFinder("tests/vm/calls/test_operator_input.py", "test_a_planted_read_bug_is_found", PATCH),
    BugFinder("tests/vm/maths/test_maths_lowering.py", "test_a_planted_fault_is_found", PATCH),
    BugFinder("tests/lang/test_planted_language_bugs.py", "test_a_planted_language_bug_is_found", PATCH),
)
#: Modules that plant bugs. In modules of functions each public function with a parameter `patch` is one.
SOURCES = ("tests/**/planted_*.py", "tests/replication/lease/quorum_bugs.py")
#: Folders whose modules the tests import by bare names.
_IMPORTED = (
    "tests/fuzz",
    "tests/host/person_calls",
    "tests/net",
    "tests/net/memory",
    "tests/simulate",
    "tests/vm",
)


@dataclass(frozen=True)
class PlantedBug:
    """One row: the name of a bug, its description, and the test that finds it."""

    name: str
    broken: str
    finder: BugFinder
    #: The number of bugs of this test in `make test`; None for all.
    sample: int | None

    @property
    def command(self) -> str:
        """The command that finds the bug in every run."""
        return "make test" if self.sample is None else "make test-more"


def test_module(file: str) -> ModuleType:
    """A test module; those of a folder import each other by bare names."""
    for folder in (*_IMPORTED, str(Path(file).parent)):
        if (path := str(ROOT / folder)) not in sys.path:
            sys.path.insert(0, path)
    return import_module(Path(file).stem)


def _first_sentence(text: str | None) -> str:
    return " ".join((text or "").split("\n\n")[0].split()).rstrip(".")


def _described(bug: Any) -> tuple[str, str]:
    """Name and description of a bug: two attributes, or name and docstring of a function or class."""
    if hasattr(bug, "broken"):
        return bug.name, bug.broken
    return bug.__name__, _first_sentence(bug.__doc__)


def _bugs_of(finder: BugFinder) -> Iterator[PlantedBug]:
    test = getattr(test_module(finder.file), finder.test)
    marks = {mark.name: mark for mark in getattr(test, "pytestmark", [])}
    sample = marks["few"].args[0] if "few" in marks else None
    if "parametrize" not in marks:
        name = finder.test.removeprefix("test_")
        yield PlantedBug(name, _first_sentence(test.__doc__), finder, sample)
        return
    for case in marks["parametrize"].args[1]:
        name, broken = _described(case[0] if isinstance(case, tuple) else case)
        yield PlantedBug(name, broken, finder, sample)


def planted_bugs() -> list[PlantedBug]:
    """All planted bugs, by the test that finds them."""
    return [bug for finder in FINDERS for bug in _bugs_of(finder)]


def planting_functions() -> set[str]:
    """The names of all functions in `SOURCES` that plant a bug."""
    found = set()
    for path in sorted(path for pattern in SOURCES for path in ROOT.glob(pattern)):
        module = test_module(path.relative_to(ROOT).as_posix())
        for name, function in inspect.getmembers(module, inspect.isfunction):
            own = function.__module__ == module.__name__ and not name.startswith("_")
            if own and "patch" in inspect.signature(function).parameters:
                found.add(name)
    return found


def page() -> str:
    """The catalogue as a page."""
    bugs = planted_bugs()
    lines = [
        "# Planted bugs",
        "",
        f"{len(bugs)} bugs that are planted on purpose; for each there is a test that must fail with it.",
        "`make test-more` plants all of them, `make test` a sample of each group.",
        "`python tests/planted/catalogue.py --run WORD` plants those whose row contains this word.",
        "`python tests/planted/catalogue.py --write` writes this page.",
        "",
    ]
    for finder in FINDERS:
        own = [bug for bug in bugs if bug.finder == finder]
        sample = own[0].sample
        count = len(own) if sample is None else min(sample, len(own))
        lines += [
            f"## `{finder.file}`, `{finder.test}`",
            "",
            f"Planted by: {finder.planted}. `make test` finds {count} of {len(own)}"
            + (", `make test-more` all." if count < len(own) else "."),
            "",
            "| bug | what is broken |",
            "|---|---|",
            *(f"| {_cell(bug.name)} | {_cell(bug.broken)} |" for bug in own),
            "",
        ]
    return "\n".join(lines).rstrip("\n") + "\n"


def _cell(text: str) -> str:
    return text.replace("|", "\\|")


def run(word: str) -> int:
    """Plant the bugs whose row contains this word; returns 0 if each is found."""
    rows = [bug for bug in planted_bugs() if word in f"{bug.name} {bug.broken} {bug.finder.node}"]
    missed = 0
    for finder in FINDERS:
        own = [bug for bug in rows if bug.finder == finder]
        if not own:
            continue
        names = [] if len(own) == sum(1 for _ in _bugs_of(finder)) else [f"[{bug.name}]" for bug in own]
        nodes = [finder.node + name for name in names] or [finder.node]
        done = subprocess.run(
            [sys.executable, "-m", "pytest", "-n", "0", "--every-case", "--timeout", "3600", *nodes], cwd=ROOT
        )
        missed += done.returncode != 0
        print(f"{finder.node}: {len(own)} bugs, {'all found' if not done.returncode else 'NOT ALL FOUND'}")
    return 1 if missed or not rows else 0


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    what = parser.add_mutually_exclusive_group(required=True)
    what.add_argument("--write", action="store_true")
    what.add_argument("--run", nargs="?", const="", metavar="WORD")
    args = parser.parse_args()
    if args.write:
        PAGE.write_text(page(), encoding="utf-8")
        return 0
    return run(args.run)


if __name__ == "__main__":
    sys.exit(main())
