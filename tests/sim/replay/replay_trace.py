"""A recording of an autopilot: lines with their times, and queries by time."""

from __future__ import annotations

import bisect
import gzip
import json
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

FOLDER = Path(__file__).parent / "traces"
#: Seconds between two lines that were recorded with the same time.
TIME_STEP = 1e-7
#: Of SYS_STATUS: the autopilot may be armed.
PRE_ARM = 0x10000000


@dataclass(frozen=True, slots=True)
class Line:
    """One message, `dir` "in" (to the autopilot) or "out", or a "note" of the recorder; seconds."""

    t: float
    dir: str
    type: str = ""
    fields: dict[str, Any] = field(default_factory=dict)
    text: str = ""
    system: int = 255
    heartbeat: bool | None = None

    def get(self, name: str) -> float:
        """A number of the message; NaN if it is none."""
        value = self.fields.get(name)
        return math.nan if value is None else float(value)


@dataclass
class Trace:
    """The lines of one recording, in the order of their times."""

    name: str
    header: dict[str, Any]
    lines: list[Line]

    @property
    def scenario(self) -> str:
        """The letter and name of the scenario: `c-speed`."""
        return self.name.partition(".")[2]

    @property
    def px4(self) -> bool:
        return bool(self.header["autopilot"].startswith("PX4"))

    @cached_property
    def inputs(self) -> list[Line]:
        return [line for line in self.lines if line.dir == "in"]

    @cached_property
    def notes(self) -> list[Line]:
        return [line for line in self.lines if line.dir == "note"]

    @cached_property
    def by_type(self) -> dict[str, list[Line]]:
        """The messages of the autopilot, by type."""
        found: dict[str, list[Line]] = {}
        for line in self.lines:
            if line.dir == "out":
                found.setdefault(line.type, []).append(line)
        return found

    def out(self, *types: str) -> list[Line]:
        """All messages of some types."""
        if len(types) == 1:
            return self.by_type.get(types[0], [])
        return sorted((line for t in types for line in self.by_type.get(t, [])), key=lambda line: line.t)

    def between(self, start: float, end: float, *types: str) -> list[Line]:
        """The messages of some types from a time on and before another."""
        lines = self.out(*types)
        low = bisect.bisect_left(lines, start, key=lambda line: line.t)
        high = bisect.bisect_left(lines, end, key=lambda line: line.t)
        return lines[low:high]

    def last(self, kind: str, t: float) -> Line | None:
        """The newest message of a type at a time."""
        lines = self.out(kind)
        index = bisect.bisect_right(lines, t, key=lambda line: line.t)
        return lines[index - 1] if index else None

    def first(self, kind: str, is_so: Callable[[Line], bool] = lambda _: True) -> float | None:
        """The time of the first message of a type that fulfils a condition."""
        return next((line.t for line in self.out(kind) if is_so(line)), None)

    @property
    def end(self) -> float:
        return self.lines[-1].t if self.lines else 0.0


def names() -> list[str]:
    """All recordings."""
    return sorted(path.name.removesuffix(".jsonl.gz") for path in FOLDER.glob("*.jsonl.gz"))


def read(name: str) -> Trace:
    """One recording. Raises FileNotFoundError."""
    with gzip.open(FOLDER / f"{name}.jsonl.gz", "rt", encoding="utf-8") as file:
        header = json.loads(file.readline())
        return Trace(name, header, list(_lines(file)))


def _lines(file: Any) -> Iterator[Line]:
    """Makes times increase from line to line, so that an answer is after its request."""
    t = 0.0
    for text in file:
        raw = json.loads(text)
        t = max(raw["t"], t + TIME_STEP)
        yield Line(
            t, raw["dir"], raw.get("type", ""), raw.get("fields", {}),
            raw.get("text", ""), raw.get("sys", 255), raw.get("heartbeat"),
        )  # fmt: skip
