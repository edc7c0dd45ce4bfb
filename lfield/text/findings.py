"""Kinds of findings as a table: each has a code, a sentence and a hint, and is worded in one place.

The front end and the reader of the registry have a table each; codes, wording and documentation of both
come from it and cannot drift apart.
"""

from __future__ import annotations

from dataclasses import dataclass

from lfield.text.source import Diagnostic, Span
from lfield.text.visible import clipped

#: So much of a name, a list, a text of the reader is repeated to them.
LONGEST_WORD = 200


@dataclass(frozen=True, slots=True)
class Message:
    """One kind of finding; `sentence` and `hint` are templates with `{names}` filled in by `at`."""

    code: str
    sentence: str
    hint: str = ""
    severity: str = "error"

    def at(self, span: Span, *, hint: str | None = None, **values: object) -> Diagnostic:
        """The finding at a place; `hint`, when given, replaces the table's hint."""
        said = {name: clipped(str(value), LONGEST_WORD) for name, value in values.items()}
        advice = self.hint.format(**said) if hint is None else hint
        return Diagnostic(self.code, self.sentence.format(**said), span, advice, self.severity)


class Table(dict[str, Message]):
    """Messages by code, in the order of the codes; codes that begin with `warnings` are warnings."""

    def __init__(self, warnings: str) -> None:
        super().__init__()
        self._warnings = warnings

    def message(self, code: str, sentence: str, hint: str = "") -> Message:
        """Add a kind of finding."""
        assert code not in self, code
        severity = "warning" if code.startswith(self._warnings) else "error"
        self[code] = Message(code, sentence, hint, severity)
        return self[code]


def tally(errors: int, warnings: int) -> str:
    """How many there are: "no mistakes", "1 error", "2 errors, 1 warning"."""
    counts = [
        f"{count} {word}{'s' * (count != 1)}"
        for count, word in ((errors, "error"), (warnings, "warning"))
        if count
    ]
    return ", ".join(counts if errors else ["no mistakes", *counts])
