"""Violated promises."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Breach:
    """A violated promise: its name, its true time, its hosts, and a sentence."""

    name: str
    at: float
    hosts: tuple[str, ...]
    sentence: str

    def __str__(self) -> str:
        return f"{self.name} at {self.at:.3f} s on {', '.join(self.hosts) or 'no host'}: {self.sentence}"


class Breaches(list[Breach]):
    """All violations that were found, each kind once. `now` is true time in seconds."""

    def __init__(self, now: Callable[[], float]) -> None:
        super().__init__()
        self._now = now

    def add(self, name: str, hosts: tuple[str, ...], sentence: str) -> None:
        """Add a violation, if it is the first of its kind."""
        if all(name != breach.name for breach in self):
            self.append(Breach(name, self._now(), hosts, sentence))
