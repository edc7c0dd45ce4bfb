"""What a host tells the others of its agents: only what changed, numbered so that nothing counts twice.

All times are on the monotonic clock of the host that holds the data; what travels are ages. Conditions and
samples are structs: in a lively team there are thousands of them in every second.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from msgspec import Struct
from msgspec.structs import replace

from lfield.capability.model import Attribute, Value
from lfield.capability.offer import Provenance

#: A real value has changed when it differs by more than this part of what is typical of its attribute.
NOTABLE = 0.005
#: A value is kept up to date while it is younger than this part of its attribute's `max_age`.
KEPT = 0.5
#: The begin of a trouble, and the time when a value was true, have changed beyond so many seconds.
JITTER = 1.0


@dataclass(frozen=True, slots=True)
class Trouble:
    """Why an agent cannot be called, and `since` when, where that is told: `unreachable`, `died of ...`."""

    reason: str
    since: float | None = None

    def sentence(self, now: float) -> str:
        """`axis: not heard for 3.2 s`."""
        if self.since is None:
            return self.reason
        seconds = max(0.0, now - self.since)
        return f"{self.reason} for {seconds:.{0 if seconds >= 10 else 1}f} s"


@dataclass(frozen=True, slots=True)
class Reserved:
    """A coordinator has an agent for itself `since` then: others are not offered it (decision 53)."""

    holder: str
    since: float

    def sentence(self, now: float) -> str:
        """`reserved by pilot for 12 s`."""
        return Trouble(f"reserved by {self.holder}", self.since).sentence(now)


class Sample(Struct, frozen=True, gc=False):
    """A value that was true at `when`, as it stood when somebody looked, at the time `at`.

    One that is `kept` never gets older than it was then, as long as something is heard from the host that
    has it. What was not measured but stated there, or told by a device of itself, does not get older at all.
    """

    value: Value
    when: float
    at: float
    kept: bool = True
    of: Provenance = "measured"


class Condition(Struct, frozen=True, gc=False):
    """How an agent is, or what changed about it: `trouble` and who has it `reserved` are always told, the
    others by attribute.

    An attribute is among `samples`, or it is `unknown` with the reason, or nothing was said of it.
    """

    trouble: Trouble | None = None
    samples: Mapping[str, Sample] = {}
    unknown: Mapping[str, str] = {}
    reserved: Reserved | None = None

    def updated(self, change: Condition) -> Condition:
        """This with what has changed."""
        samples = {name: s for name, s in self.samples.items() if name not in change.unknown}
        unknown = {name: why for name, why in self.unknown.items() if name not in change.samples}
        return Condition(
            change.trouble, {**samples, **change.samples}, {**unknown, **change.unknown}, change.reserved
        )


#: An agent of which nothing was said.
SILENCE = Condition()


@dataclass(frozen=True, slots=True)
class News:
    """What changed in the agents of a host since its news number `since`; 0 is everything there is.

    `life` tells one run of the host from the next, `sequence` grows within it.
    """

    life: int
    since: int
    sequence: int
    agents: Mapping[str, Condition]


class Announcer:
    """What one host has told of its agents, and what it has to tell next."""

    def __init__(self, attributes: Mapping[str, Attribute], life: int) -> None:
        self._attributes, self._life = attributes, life
        self._told: dict[str, Condition] = {}
        self._sequence = self._last_changes = 0

    def changes(self, conditions: Mapping[str, Condition]) -> News | None:
        """News for every host, None when there is nothing new."""
        found = {agent: self._change(agent, condition) for agent, condition in conditions.items()}
        changed = {agent: change for agent, change in found.items() if change is not None}
        if not changed:
            return None
        for agent, change in changed.items():
            self._told[agent] = self._told.get(agent, SILENCE).updated(change)
        since, self._last_changes = self._last_changes, self._sequence + 1
        return self._news(since, changed)

    def everything(self) -> News | None:
        """All that was told so far, for a host that was away; None when that is nothing."""
        # Not what is true now: the next changes are counted from what was told to all.
        return self._news(0, dict(self._told)) if self._told else None

    def _news(self, since: int, agents: Mapping[str, Condition]) -> News:
        self._sequence += 1
        return News(self._life, since, self._sequence, agents)

    def _change(self, agent: str, now: Condition) -> Condition | None:
        told = self._told.get(agent, SILENCE)
        samples = {
            name: marked
            for name, sample in now.samples.items()
            if self._differs(told.samples.get(name), marked := self._marked(name, sample), name)
        }
        unknown = {name: why for name, why in now.unknown.items() if told.unknown.get(name) != why}
        if (
            samples
            or unknown
            or _another(told.trouble, now.trouble)
            or _another_holder(told.reserved, now.reserved)
        ):
            return Condition(now.trouble, samples, unknown, now.reserved)
        return None

    def _marked(self, name: str, sample: Sample) -> Sample:
        lasts = sample.of != "measured" or sample.at - sample.when <= KEPT * self._attributes[name].max_age
        return replace(sample, kept=lasts)

    def _differs(self, told: Sample | None, now: Sample, name: str) -> bool:
        if told is None or (told.kept, told.of) != (now.kept, now.of):
            return True
        if not now.kept and abs(now.when - told.when) > JITTER:
            return True
        if isinstance(now.value, float) and isinstance(told.value, float):
            return abs(now.value - told.value) > NOTABLE * abs(self._attributes[name].typical)
        return now.value != told.value


def _another(told: Trouble | None, now: Trouble | None) -> bool:
    if told is None or now is None:
        return told is not now
    if told.reason != now.reason or (told.since is None) != (now.since is None):
        return True
    return told.since is not None and now.since is not None and abs(told.since - now.since) > JITTER


def _another_holder(told: Reserved | None, now: Reserved | None) -> bool:
    if told is None or now is None:
        return told is not now
    return told.holder != now.holder or abs(told.since - now.since) > JITTER
