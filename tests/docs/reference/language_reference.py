"""The generated table of lfield/docs/language.md: the library.

`python tests/docs/reference/language_reference.py --write` writes it to the page, between its markers
(`<!-- library -->` ... `<!-- end of library -->`).
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from pathlib import Path

from lfield.lang.language_library import (
    ENUM_METHODS,
    ENUM_VALUE_METHODS,
    EXCEPTION_METHODS,
    FUNCTIONS,
    LIBRARY_OF_ARRAYS,
    LIBRARY_OF_FUTURES,
    LIBRARY_OF_MAPS,
    LOOP_METHODS,
    PROXY_METHODS,
    RACES,
    STRING_METHODS,
    LibraryFunction,
    array_methods,
)
from lfield.lang.types import Type, array_of

PAGE = Path(__file__).parents[3] / "lfield" / "docs" / "language.md"

_WHERE = {"any": "everywhere", "resource": "resources", "coordinator": "coordinators"}


def updated(document: str) -> str:
    """The document with the current table."""
    return _between(document, "library", library_table())


def library_table() -> str:
    """Every function of the library, and the built-in methods, as a Markdown table."""
    rows = [(_heading(f), f"{f.result}", _WHERE[f.scope], f.meaning) for f in FUNCTIONS]
    for receiver, methods in (
        ("array", (*array_methods(array_of(Type("T"))), *LIBRARY_OF_ARRAYS)),
        ("map", LIBRARY_OF_MAPS),
        ("future", LIBRARY_OF_FUTURES),
        ("futures", RACES),
        ("string", STRING_METHODS),
        ("member", ENUM_VALUE_METHODS),
        ("Enum", ENUM_METHODS),
        ("exception", EXCEPTION_METHODS),
        ("loop", LOOP_METHODS),
        ("proxy", PROXY_METHODS),
    ):
        rows += [(f"{receiver}.{_heading(f)}", f"{f.result}", _WHERE[f.scope], f.meaning) for f in methods]
    return _table(("call", "result", "where", "meaning"), [(f"`{c}`", r, w, m) for c, r, w, m in rows])


def _heading(function: LibraryFunction) -> str:
    return f"{function.name}({', '.join(map(str, function.parameters))})"


def _table(head: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> str:
    lines = [head, ("---",) * len(head), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _between(document: str, name: str, content: str) -> str:
    """The document with new content between the markers of that name. Raises ValueError without markers."""
    start, end = f"<!-- {name} -->", f"<!-- end of {name} -->"
    before, found, rest = document.partition(start)
    _, closed, after = rest.partition(end)
    if not (found and closed):
        raise ValueError(f"the markers {start} and {end} are missing")
    return f"{before}{start}\n{content}\n{end}{after}"


def main() -> None:
    """Print the page with its table, or write it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true", help=f"write the table to {PAGE.name}")
    text = updated(PAGE.read_text(encoding="utf-8"))
    if parser.parse_args().write:
        PAGE.write_text(text, encoding="utf-8")
    else:
        print(text, end="")


if __name__ == "__main__":
    main()
