"""Kinds of findings as tables: the code, sentence and hint of each are defined once.

The front end and the registry reader have a table each; codes, wording and documentation are generated from
the table and cannot diverge.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from msgspec import Struct

from lfield.text.source_text import Diagnostic, Span
from lfield.text.terminal_escape import truncate

if TYPE_CHECKING:
    from lfield.errors import ReportableFinding

#: The longest excerpt of the user's text in a message, in characters.
MAX_FIELD = 200
#: The maximum number of findings that are printed as text.
MAX_RENDERED = 50


class FindingKind(Struct, frozen=True):
    """One kind of finding; `sentence` and `hint` are templates with `{names}` filled in by `at`."""

    code: str
    sentence: str
    hint: str = ""
    severity: str = "error"

    def at(self, span: Span, *, hint: str | None = None, **values: object) -> Diagnostic:
        """The finding at a position; a `hint` replaces the hint of the table."""
        fields = {name: truncate(str(value), MAX_FIELD) for name, value in values.items()}
        advice = self.hint.format(**fields) if hint is None else hint
        return Diagnostic(self.code, self.sentence.format(**fields), span, advice, self.severity)


class FindingTable(dict[str, FindingKind]):
    """Messages by code; all codes start with one of `codes`, codes of warnings start with `warnings`."""

    def __init__(self, *codes: str, warnings: str) -> None:
        super().__init__()
        self._codes, self._warnings = codes, warnings

    def message(self, code: str, sentence: str, hint: str = "") -> FindingKind:
        """Add a kind of finding."""
        assert code not in self, code
        assert code.startswith(self._codes), code
        severity = "warning" if code.startswith(self._warnings) else "error"
        self[code] = FindingKind(code, sentence, hint, severity)
        return self[code]


def render_findings(findings: Sequence[ReportableFinding]) -> str:
    """The first MAX_RENDERED findings as text, and the number of further ones."""
    lines = [finding.render() for finding in findings[:MAX_RENDERED]]
    if (more := len(findings) - MAX_RENDERED) > 0:
        lines.append(f"... and {more} more; 'lfield check --json' prints all")
    return "\n".join(lines)


def tally(errors: int, warnings: int) -> str:
    """The number of findings: "no errors", "1 error", "2 errors, 1 warning"."""
    counts = [
        f"{count} {noun}{'s' * (count != 1)}"
        for count, noun in ((errors, "error"), (warnings, "warning"))
        if count
    ]
    return ", ".join(counts if errors else ["no errors", *counts])
