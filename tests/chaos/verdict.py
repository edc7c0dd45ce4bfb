"""Judges what was printed: which calls were served, which may have been, and which missions are complete."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass
class Verdict:
    """One round. `walkers` are those that were begun, each with how many numbers it is to have stamped."""

    walkers: Mapping[str, int]
    served: Counter[tuple[str, int]] = field(default_factory=Counter)
    perhaps: set[tuple[str, int]] = field(default_factory=set)
    walked: Counter[str] = field(default_factory=Counter)
    tracebacks: int = 0

    def hear(self, line: str) -> None:
        """A line of any host."""
        self.tracebacks += line.startswith("Traceback ")
        match line.split():
            case ["stamped", who, number]:
                self.served[who, int(number)] += 1
            case [who, "perhaps", number]:
                self.perhaps.add((who.rstrip(":"), int(number)))
            case [who, "walked", _]:
                self.walked[who.rstrip(":")] += 1

    @property
    def under_way(self) -> bool:
        """Whether all have had a number stamped."""
        return self.walkers.keys() <= {who for who, _ in self.served}

    @property
    def complete(self) -> bool:
        """Whether all have come to their ends."""
        return self.walkers.keys() <= self.walked.keys()

    @property
    def twice(self) -> list[tuple[str, int]]:
        """The calls that were served more than once."""
        return [call for call, times in self.served.items() if times > 1]

    @property
    def skipped(self) -> list[tuple[str, int]]:
        """The calls that nobody served, although whoever made them went on without being told."""
        known = self.served.keys() | self.perhaps
        found = []
        for who, numbers in self.walkers.items():
            seen = [number for name, number in known if name == who]
            end = numbers if who in self.walked else max(seen, default=-1)
            found += [(who, number) for number in range(end) if (who, number) not in known]
        return found
