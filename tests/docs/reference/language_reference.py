"""The generated tables of lfield/docs/language.md: the library and the messages of the front end.

`python tests/docs/reference/language_reference.py --write` writes them to the page, between its markers
(`<!-- library -->` ... `<!-- end of library -->`).
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Iterable
from pathlib import Path

from lfield.lang.language_library import (
    EXCEPTION_METHODS,
    FUNCTIONS,
    PROXY_METHODS,
    STRING_METHODS,
    LibraryFunction,
)
from lfield.lang.messages import TABLE

PAGE = Path(__file__).parents[3] / "lfield" / "docs" / "language.md"

_WHERE = {"any": "everywhere", "resource": "resources", "coordinator": "coordinators"}


def updated(document: str) -> str:
    """The document with both tables as they are now."""
    return _between(_between(document, "library", library_table()), "messages", message_table())


def library_table() -> str:
    """Every function of the library, and the built-in methods, as a Markdown table."""
    rows = [(_heading(f), f"{f.result}", _WHERE[f.scope], f.meaning) for f in FUNCTIONS]
    length = LibraryFunction("length", (), STRING_METHODS[0].result, "", meaning="number of elements")
    for receiver, methods in (
        ("array", (length,)),
        ("string", STRING_METHODS),
        ("exception", EXCEPTION_METHODS),
        ("proxy", PROXY_METHODS),
    ):
        rows += [(f"{receiver}.{_heading(f)}", f"{f.result}", _WHERE[f.scope], f.meaning) for f in methods]
    return _table(("call", "result", "where", "meaning"), [(f"`{c}`", r, w, m) for c, r, w, m in rows])


def message_table() -> str:
    """Every message of the front end as a Markdown table."""
    return _table(
        ("code", "sentence", "hint"),
        [(m.code, _template(m.sentence), _template(m.hint)) for m in TABLE.values()],
    )


def _heading(function: LibraryFunction) -> str:
    return f"{function.name}({', '.join(map(str, function.parameters))})"


def _template(text: str) -> str:
    """A message with its blanks in angle brackets: `'‹name›'`."""
    blanks = re.sub(r"\{(\w+)\}", r"‹\1›", text.replace("{{", "\0").replace("}}", "\1"))
    return blanks.replace("\0", "{").replace("\1", "}").replace("|", "\\|")


def _table(head: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> str:
    lines = [head, ("---",) * len(head), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _between(document: str, name: str, content: str) -> str:
    """The document with new content between the markers of that name. ValueError when they are missing."""
    start, end = f"<!-- {name} -->", f"<!-- end of {name} -->"
    before, found, rest = document.partition(start)
    _, closed, after = rest.partition(end)
    if not (found and closed):
        raise ValueError(f"the markers {start} and {end} are missing")
    return f"{before}{start}\n{content}\n{end}{after}"


def main() -> None:
    """Print the page with its tables, or write it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true", help=f"write the tables to {PAGE.name}")
    text = updated(PAGE.read_text(encoding="utf-8"))
    if parser.parse_args().write:
        PAGE.write_text(text, encoding="utf-8")
    else:
        print(text, end="")


if __name__ == "__main__":
    main()
