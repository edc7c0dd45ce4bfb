"""The house stays tidy: what STYLE.md says of files, folders, functions and names, held against the code."""

from __future__ import annotations

import ast
from collections import Counter
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PRODUCT = ("lfield", "drivers", "sim-adapters")
EVERYTHING = (*PRODUCT, "tests", "examples")

MOST_FILES, MOST_LINES, LEAST_LINES, LONGEST_FUNCTION = 14, 400, 60, 60

#: Files that pytest tells apart, or that nobody imports.
NAMESAKES = ("conftest.py", "run.py")

#: Longer than others for a reason: tables, which are read by looking things up.
TABLES: dict[str, str] = {
    "lfield/lang/messages.py": "what the front end can say, by its codes",
    "lfield/lang/tree.py": "the nodes of the checked tree, all of which name one another",
}
#: Shorter than others, each one idea that nothing else is about.
SMALL = {
    "drivers/lfield_mavlink/link/events.py": "what a link reports to its driver",
    "lfield/driver/network/attempts.py": "the pauses between attempts to connect, and their log lines",
    "lfield/authority/keys.py": "keys as bytes, and the names of their files",
    "lfield/authority/minted.py": "keys of one run, in memory",
    "lfield/authority/pages/making_pages.py": "where the folder of an authority has pages",
    "lfield/wire/reservations.py": "what is said of reservations, all of it",
    "lfield/capability/ways.py": "names that compiler and machine share",
    "lfield/clock.py": "a word that everybody speaks",
    "lfield/devices/measuring.py": "what is done for lateness to decide",
    "lfield/operator/web/page.py": "the one page, of the one component",
    "lfield/driver/settings.py": "a value that drivers and hosts share",
    "lfield/operator/sight/following/beside.py": "what fails beside a body of code",
    "lfield/host/process/stop_words.py": "what ends a host",
    "lfield/host/dumping.py": "where the block of a dead agent goes",
    "lfield/host/logbook.py": "the two streams of a host",
    "lfield/host/sight/programs.py": "for how long programs have run",
    "lfield/net/paths/reasons.py": "what errors of sockets mean, a table",
    "lfield/net/waiting/bars.py": "the back-off of a member that sent too much",
    "lfield/net/control.py": "the door of a fake, from outside",
    "lfield/simulate/judging/breaches.py": "what a judge says, for all of them",
    "lfield/simulate/judging/saved.py": "what is asked of simulated journals",
    "lfield/simulate/time.py": "the jumping clock",
    "lfield/testing/offers.py": "a team for golden programs",
    "lfield/testing/reports.py": "the guard's end of a driver, for tests",
    "lfield/text/numbers.py": "three types of options",
    "lfield/text/findings.py": "the table class of all findings",
    "lfield/text/values.py": "values of devices in words",
    "lfield/vm/maths/library.py": "which instruction is which function, a table",
    "lfield/vm/wasm/choice.py": "what may be chosen, without wasmtime",
    "lfield/vm/wasm/calls.py": "how Python calls WebAssembly",
    "lfield/vm/wasm/runtime/functions.py": "the runtime's text and its functions",
    "lfield/vm/memory/parcels.py": "what waits to be fetched, as bytes",
}


#: Names that begin with an underscore and are documented for others: named tuples', python-can's, asyncio's
#: for those who make loops, wasmtime's for those who call without its conversions.
DOCUMENTED = {
    *("_replace", "_asdict", "_recv_internal", "_get_running_loop", "_set_running_loop"),
    *("_context", "_func", "_from_ptr"),
}


def files(*folders: str) -> list[Path]:
    """All Python files of some folders of the project."""
    return sorted(path for folder in folders for path in (ROOT / folder).rglob("*.py"))


def name_of(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


@cache
def seen_in(path: Path) -> tuple[dict[str, int], list[str]]:
    """How long its functions are, and where it uses private names of others; its tree is not kept."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    nodes = list(ast.walk(tree))
    return functions(nodes), [f"{name_of(path)}:{line}: {name}" for line, name in private_uses(nodes)]


def length(path: Path) -> int:
    return len(path.read_text(encoding="utf-8").splitlines())


def test_no_folder_has_more_than_14_files() -> None:
    counts = {}
    for path in files(*EVERYTHING):
        counts[name_of(path.parent)] = counts.get(name_of(path.parent), 0) + 1
    assert {folder: count for folder, count in counts.items() if count > MOST_FILES} == {}


def test_no_two_test_files_have_one_name() -> None:
    """pytest imports them, and what they share, by their bare names: of two it takes one for the other.

    What is in a package is imported by the name of that too.
    """
    bare = (path for path in files("tests", "examples") if not (path.parent / "__init__.py").is_file())
    names = Counter(path.name for path in bare if path.name not in NAMESAKES)
    assert [name for name, count in names.items() if count > 1] == []


def test_a_file_is_one_idea_of_60_to_400_lines() -> None:
    """Faces of packages and commands aside: those are as short as they can be."""
    lengths = {name_of(path): length(path) for path in files(*PRODUCT)}
    long = {name: lines for name, lines in lengths.items() if lines > MOST_LINES and name not in TABLES}
    assert long == {}
    short = {name: lines for name, lines in lengths.items() if lines < LEAST_LINES and not may_be_short(name)}
    assert short == {}


def may_be_short(name: str) -> bool:
    """A package's face, what Python runs, or a command; or it is in the table."""
    return (
        Path(name).name in ("__init__.py", "__main__.py") or name.startswith("lfield/cli/") or name in SMALL
    )


def test_the_tables_of_exceptions_name_no_file_that_needs_none() -> None:
    assert [name for name in TABLES if length(ROOT / name) <= MOST_LINES] == []
    assert [name for name in SMALL if length(ROOT / name) >= LEAST_LINES] == []


def test_a_function_fits_a_screen() -> None:
    found = {f"{name_of(path)}:{name}": n for path in files(*PRODUCT) for name, n in seen_in(path)[0].items()}
    assert {name: lines for name, lines in found.items() if lines > LONGEST_FUNCTION} == {}


def functions(nodes: list[ast.AST]) -> dict[str, int]:
    """The longest of each name."""
    found: dict[str, int] = {}
    for node in nodes:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            assert node.end_lineno is not None
            lines = node.end_lineno - node.lineno + 1
            found[node.name] = max(lines, found.get(node.name, 0))
    return found


def private_uses(nodes: list[ast.AST]) -> Iterator[tuple[int, str]]:
    """Lines that use a private name of something that is defined in another file."""
    own = {node.attr for node in nodes if isinstance(node, ast.Attribute) and of_self(node)}
    own |= DOCUMENTED | {n.name for n in nodes if isinstance(n, ast.FunctionDef | ast.AsyncFunctionDef)}
    for node in nodes:
        if isinstance(node, ast.Attribute) and private(node.attr) and node.attr not in own:
            yield node.lineno, node.attr
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("lfield"):
            for alias in node.names:
                if private(alias.name):
                    yield node.lineno, alias.name


def of_self(node: ast.Attribute) -> bool:
    return isinstance(node.value, ast.Name) and node.value.id in ("self", "cls")


def private(name: str) -> bool:
    return name.startswith("_") and not name.endswith("__")


@pytest.mark.parametrize("path", files(*PRODUCT), ids=name_of)
def test_nobody_uses_the_private_names_of_another_file(path: Path) -> None:
    assert seen_in(path)[1] == []
