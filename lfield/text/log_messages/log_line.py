"""A log line with its code and level, and the kinds of log lines, as tables."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from math import isfinite
from typing import Literal, NamedTuple

Level = Literal["info", "warning", "error"]


class LogLine(str):
    """The text of a log line, with the code and the level of its message, and the values of its template."""

    __slots__ = ("code", "level", "template_values")

    def __new__(cls, text: str, code: str, level: Level, template_values: Mapping[str, object]) -> LogLine:
        """The constructor is called by `LogMessage.line`, `report_line`, and readers of lines that a host has
        logged.
        """
        line = super().__new__(cls, text)
        line.code, line.level = code, level
        line.template_values = template_values
        return line

    code: str
    level: Level
    template_values: Mapping[str, object]

    def as_data(self) -> dict[str, object]:
        """Code, level, text and fields as JSON values; a value that is no number or text becomes text."""
        plain = {
            name: value if isinstance(value, int) or _is_finite(value) else str(value)
            for name, value in self.template_values.items()
        }
        return {"code": self.code, "level": self.level, "text": str(self), "fields": plain}


def _is_finite(value: object) -> bool:
    """Whether `value` is a number that JSON can represent."""
    return isinstance(value, float) and isfinite(value)


class Clause(NamedTuple):
    """A part of a template that is made from values, which stay plain data."""

    values: tuple[str, ...]
    text: Callable[..., str]


@dataclass(frozen=True, slots=True)
class LogMessage:
    """One kind of log line; `meaning` explains the template where necessary.

    `clauses` are the fields of the template that are no values.
    """

    code: str
    template: str
    level: Level = "info"
    meaning: str = ""
    clauses: Mapping[str, Clause] = field(default_factory=dict, compare=False)

    def line(self, **values: object) -> LogLine:
        """The line with the values of its template and of its clauses."""
        default_values = {
            name: clause.text(*(values[each] for each in clause.values))
            for name, clause in self.clauses.items()
        }
        return LogLine(self.template.format(**values, **default_values), self.code, self.level, values)


class LogTable(dict[str, LogMessage]):
    """Messages by their code."""

    def message(
        self, code: str, template: str, level: Level = "info", meaning: str = "", **clauses: Clause
    ) -> LogMessage:
        """Add a kind of log line."""
        assert code not in self, code
        self[code] = LogMessage(code, template, level, meaning, clauses)
        return self[code]


def json_line(time: float, host: str, line: LogLine) -> str:
    """A log line as a JSON object in ASCII, with its time in seconds since 1970 UTC, and a line feed."""
    return json.dumps({"time": round(time, 6), "host": host, **line.as_data()}) + "\n"
