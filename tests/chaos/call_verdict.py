"""Verdict on the output of hosts: served calls, possibly served calls, and complete missions."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field

#: Part of the exception's message after a majority has recovered a coordinator of a silent host.
RECOVERED = "was recovered on"


@dataclass
class CallVerdict:
    """The verdict on one round. `walkers` has the number of stamps of each started walker.

    The life number of a walker changes after a report of a possible call. A *recovered* walker continues from
    an earlier state after such a report: repetitions from there are no breach.
    """

    walkers: Mapping[str, int]
    served: Counter[tuple[str, int]] = field(default_factory=Counter)
    #: Calls that must not be served again.
    final: set[tuple[str, int]] = field(default_factory=set)
    twice: list[tuple[str, int]] = field(default_factory=list)
    #: Calls that began for a walker after a later life of it had been observed.
    outdated: list[tuple[str, int]] = field(default_factory=list)
    perhaps: set[tuple[str, int]] = field(default_factory=set)
    walked: Counter[str] = field(default_factory=Counter)
    #: Calls that were repeated after a recovery, as intended.
    repeated: int = 0
    #: For each recovery, the seconds since a post last observed the walker.
    recoveries: list[float] = field(default_factory=list)
    #: The host that last served each walker.
    where: dict[str, str] = field(default_factory=dict)
    tracebacks: int = 0
    _lives: dict[str, list[int]] = field(default_factory=dict)
    _last: dict[str, float] = field(default_factory=dict)

    def on_line(self, line: str, host: str = "", now: float = 0.0) -> None:
        """Evaluate an output line of a host, at a time in seconds."""
        self.tracebacks += line.startswith("Traceback ")
        match line.split(maxsplit=4):
            case ["stamped", who, life, number]:
                self.where[who], self._last[who] = host, now
                self._stamped((who, int(number)), int(life))
            case [who, "perhaps", number, life, why]:
                self._on_exception(who.rstrip(":"), int(number), int(life), why, now)
            case [who, "walked", _]:
                self.walked[who.rstrip(":")] += 1

    def _stamped(self, call: tuple[str, int], life: int) -> None:
        if self._lives.setdefault(call[0], [life])[-1] != life:
            self.outdated.append(call)
        if call in self.final:
            self.twice.append(call)
        self.repeated += call in self.served and call not in self.final
        self.served[call] += 1
        self.final.add(call)

    def _on_exception(self, who: str, number: int, life: int, why: str, now: float) -> None:
        self.perhaps.add((who, number))
        self._lives.setdefault(who, []).append(life)
        if RECOVERED in why:
            self.recoveries.append(now - self._last.get(who, now))
            self.final = {call for call in self.final if call[0] != who or call[1] <= number}

    @property
    def under_way(self) -> bool:
        """True if every walker has a first stamp."""
        return self.walkers.keys() <= {agent for agent, _ in self.served}

    @property
    def complete(self) -> bool:
        """True if every walker has finished."""
        return self.walkers.keys() <= self.walked.keys()

    @property
    def skipped(self) -> list[tuple[str, int]]:
        """Calls that were not served although their caller continued without a report."""
        known = self.served.keys() | self.perhaps
        found = []
        for agent, numbers in self.walkers.items():
            observed = [number for name, number in known if name == agent]
            end = numbers if agent in self.walked else max(observed, default=-1)
            found += [(agent, number) for number in range(end) if (agent, number) not in known]
        return found
