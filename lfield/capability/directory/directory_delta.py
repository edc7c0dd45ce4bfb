"""Delta encoding of directory updates between hosts: only changes, numbered so that none is applied twice.

All times are on the monotonic clock of the host that holds the data; messages contain ages. Conditions and
samples are structs: in a lively team there are thousands of them in every second.
"""

from __future__ import annotations

from collections.abc import Mapping

from msgspec import Struct
from msgspec.structs import replace

from lfield.capability.model import Attribute, Value
from lfield.capability.offer import Provenance

#: A real value has changed when it differs by more than this part of the typical value of its attribute.
CHANGE_THRESHOLD = 0.005
#: A value is kept up to date while it is younger than this part of its attribute's `max_age`.
FRESH_SHARE = 0.5
#: Smallest change (s) of the time of a value, or of the start of an unavailability, that is sent.
TIME_TOLERANCE = 1.0


class Unavailability(Struct, frozen=True):
    """The reason why an agent cannot be called, and `since` when, if known: `unreachable`, `died of ...`."""

    reason: str
    since: float | None = None

    def sentence(self, now: float) -> str:
        """`axis: no message for 3.2 s`."""
        if self.since is None:
            return self.reason
        seconds = max(0.0, now - self.since)
        return f"{self.reason} for {seconds:.{0 if seconds >= 10 else 1}f} s"


class ReservedBy(Struct, frozen=True):
    """The reservation of an agent by a coordinator, `since` then: others are not offered it (decision 53)."""

    holder: str
    since: float

    def sentence(self, now: float) -> str:
        """`reserved by pilot for 12 s`."""
        return Unavailability(f"reserved by {self.holder}", self.since).sentence(now)


class AttributeSample(Struct, frozen=True, gc=False):
    """A value measured at `when` and read at `at`.

    With `is_kept_current` its age does not grow while its host is connected. A value that was stated, or
    reported once by a device, has no age.
    """

    value: Value
    when: float
    at: float
    is_kept_current: bool = True
    of: Provenance = "measured"


class AgentCondition(Struct, frozen=True, gc=False):
    """State of an agent, or its changes.

    `unavailability` and the holder of its reservation (`reserved`) are always sent, the others by attribute.
    An attribute is among `samples`, or it is `unknown` with the reason, or absent.
    """

    unavailability: Unavailability | None = None
    samples: Mapping[str, AttributeSample] = {}
    unknown: Mapping[str, str] = {}
    reserved: ReservedBy | None = None

    def updated(self, change: AgentCondition) -> AgentCondition:
        samples = {name: s for name, s in self.samples.items() if name not in change.unknown}
        unknown = {name: reason for name, reason in self.unknown.items() if name not in change.samples}
        return AgentCondition(
            change.unavailability,
            {**samples, **change.samples},
            {**unknown, **change.unknown},
            change.reserved,
        )


#: An agent without values.
UNCHANGED = AgentCondition()


class DirectoryDelta(Struct, frozen=True):
    """The changes of the agents of a host since its news number `since`; 0 means the full state.

    `incarnation` identifies one run of the host, `sequence` grows within it.
    """

    incarnation: int
    since: int
    sequence: int
    agents: Mapping[str, AgentCondition]


class DeltaEncoder:
    """The directory state that one host has sent, and computes the next delta."""

    def __init__(self, attributes: Mapping[str, Attribute], incarnation: int) -> None:
        self._attributes, self._incarnation = attributes, incarnation
        self._sent: dict[str, AgentCondition] = {}
        self._sequence = self._last_changes = 0

    def next_delta(self, conditions: Mapping[str, AgentCondition]) -> DirectoryDelta | None:
        """The changes for every host, None when there are none."""
        found = {agent: self._change(agent, condition) for agent, condition in conditions.items()}
        changed = {agent: change for agent, change in found.items() if change is not None}
        if not changed:
            return None
        for agent, change in changed.items():
            self._sent[agent] = self._sent.get(agent, UNCHANGED).updated(change)
        since, self._last_changes = self._last_changes, self._sequence + 1
        return self._delta(since, changed)

    def full_delta(self) -> DirectoryDelta | None:
        """The full state sent so far, for a host that was disconnected; None if nothing was sent."""
        # Not the current state: the next deltas are relative to the state that was sent to all.
        return self._delta(0, dict(self._sent)) if self._sent else None

    def _delta(self, since: int, agents: Mapping[str, AgentCondition]) -> DirectoryDelta:
        self._sequence += 1
        return DirectoryDelta(self._incarnation, since, self._sequence, agents)

    def _change(self, agent: str, now: AgentCondition) -> AgentCondition | None:
        sent = self._sent.get(agent, UNCHANGED)
        samples = {
            name: marked
            for name, sample in now.samples.items()
            if self._differs(sent.samples.get(name), marked := self._marked(name, sample), name)
        }
        unknown = {name: reason for name, reason in now.unknown.items() if sent.unknown.get(name) != reason}
        if (
            samples
            or unknown
            or _is_other_reason(sent.unavailability, now.unavailability)
            or _is_other_holder(sent.reserved, now.reserved)
        ):
            return AgentCondition(now.unavailability, samples, unknown, now.reserved)
        return None

    def _marked(self, name: str, sample: AttributeSample) -> AttributeSample:
        lasts = (
            sample.of != "measured" or sample.at - sample.when <= FRESH_SHARE * self._attributes[name].max_age
        )
        return replace(sample, is_kept_current=lasts)

    def _differs(self, sent: AttributeSample | None, now: AttributeSample, name: str) -> bool:
        if sent is None or (sent.is_kept_current, sent.of) != (now.is_kept_current, now.of):
            return True
        if not now.is_kept_current and abs(now.when - sent.when) > TIME_TOLERANCE:
            return True
        if isinstance(now.value, float) and isinstance(sent.value, float):
            return abs(now.value - sent.value) > CHANGE_THRESHOLD * abs(self._attributes[name].typical)
        return now.value != sent.value


def _is_other_reason(sent: Unavailability | None, now: Unavailability | None) -> bool:
    if sent is None or now is None:
        return sent is not now
    if sent.reason != now.reason or (sent.since is None) != (now.since is None):
        return True
    return sent.since is not None and now.since is not None and abs(sent.since - now.since) > TIME_TOLERANCE


def _is_other_holder(sent: ReservedBy | None, now: ReservedBy | None) -> bool:
    if sent is None or now is None:
        return sent is not now
    return sent.holder != now.holder or abs(sent.since - now.since) > TIME_TOLERANCE
