"""What the readers of files found, told in the log."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from lfield.driver import Diagnostic

#: Warnings about a file that are told one by one.
MOST = 10


def tell_warnings(warnings: Sequence[Diagnostic], path: str, note: Callable[[str], None]) -> None:
    """One line for each warning, `file:line:column: warning[CODE]: sentence; hint`; of many the first."""
    ordered = sorted(warnings, key=lambda warning: warning.code)
    for warning in ordered[:MOST]:
        place = f"{warning.span.source.name}:{warning.span.line}:{warning.span.column}"
        note(f"{place}: warning[{warning.code}]: {warning.message}; {warning.hint}")
    if more := len(ordered[MOST:]):
        note(f"{path}: {more} more warning{'s' * (more != 1)}")
