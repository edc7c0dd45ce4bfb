"""The core's environment while it is recorded: each answer that differs from the last one is noted.

In one turn a question has one answer, so a replay needs a table of the present answers only.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from enum import IntEnum
from math import copysign
from typing import Any, Protocol, TypeVar, cast

from lfield.bytecode.program import DeviceCallRecord
from lfield.capability.directory.directory_delta import Unavailability
from lfield.errors import DeviceError, RecordingError
from lfield.host.effects import Environment
from lfield.host.recording.host_records import ReadingChange, RecordedAnswer
from lfield.manifest import DeviceValue, Observation
from lfield.vm.engine_interface import Reading
from lfield.vm.host_interface import Pending


class Question(IntEnum):
    """The questions of the core."""

    #: The hash of an enumeration is a function in Python, and each question is looked up by its number.
    __hash__ = int.__hash__

    DOWN_SINCE = 0
    LAST_CONTACT = 1
    ROUND_TRIP = 2
    ANSWER_TIMEOUT = 3
    LAST = 4
    TROUBLE = 5
    QUERY = 6
    READING = 7
    MAY_BE_CANCELLED = 8


T = TypeVar("T")
#: An empty list that is never changed.
_NOTHING: list[Any] = []
#: The recorded form of PENDING among the answers to a query.
PENDING_ANSWER = ["pending"]
_UNASKED = object()
_LAST_CONTACT = int(Question.LAST_CONTACT)


class Turns(Protocol):
    """The turns of the core."""

    @property
    def in_turn(self) -> bool:
        """Whether a turn is under way."""


class RecordedEnvironment:
    """Passes the questions on to `inner`. Notes no answer outside of `turns`."""

    def __init__(self, inner: Environment, calls: Mapping[DeviceCallRecord, int], turns: Turns) -> None:
        self._inner, self._calls, self._turns = inner, calls, turns
        #: The last answer to each question, and the questions of this turn.
        self._known: dict[tuple[str | int, ...], object] = {}
        self._repeated_keys: set[tuple[str | int, ...]] = set()
        #: The time of the last message from each host: the answers of this turn, and the last ones.
        self._contacts: dict[str, float | None] = {}
        self._known_contacts: dict[str, float | None] = {}
        self._changes: list[RecordedAnswer] = []
        #: The readings by number, and the readings that are recorded.
        self._readings: list[Reading] = []
        self._recorded: list[tuple[int, float]] = []
        #: Whether `drain_changed_readings` can return a reading.
        self.has_readings = False

    # --- turns ----------------------------------------------------------------------------------------

    def start(self) -> None:
        """The recording begins: the core has asked no question before."""
        self._known.clear()
        self._repeated_keys.clear()
        self._contacts.clear()
        self._changes.clear()

    def drain_changed_readings(self) -> list[ReadingChange]:
        """A turn begins: the readings that have changed since the last one."""
        changed: list[ReadingChange] = []
        for number, (reading, known) in enumerate(zip(self._readings, self._recorded, strict=True)):
            now = reading.word, reading.until
            if now != known:
                changed.append(ReadingChange(number, *now))
                self._recorded[number] = now
        return changed

    def drain_answers(self) -> list[RecordedAnswer]:
        """A turn has ended: its new answers."""
        if self._repeated_keys:
            self._repeated_keys.clear()
        changes = self._changes
        if self._contacts:
            for host, found in self._contacts.items():
                if self._known_contacts.get(host, _UNASKED) != found:
                    self._known_contacts[host] = found
                    changes.append(RecordedAnswer(_LAST_CONTACT, [host], found))
            self._contacts.clear()
        if not changes:
            return _NOTHING
        self._changes = []
        return changes

    @property
    def answers(self) -> list[RecordedAnswer]:
        """The last answers to all questions."""
        contacts = [RecordedAnswer(_LAST_CONTACT, [host], at) for host, at in self._known_contacts.items()]
        return [*contacts, *(_answer(key, value) for key, value in self._known.items())]

    @property
    def readings(self) -> list[ReadingChange]:
        """The readings as of the last turn."""
        return [ReadingChange(number, *known) for number, known in enumerate(self._recorded)]

    def number_of(self, reading: Reading) -> int:
        """The number of a reading that the core has received. Raises RecordingError for another reading."""
        for number, each in enumerate(self._readings):
            if each is reading:
                return number
        raise RecordingError("a checkpoint cannot contain a reading that was not recorded")

    # --- questions ------------------------------------------------------------------------------------

    @property
    def down_since(self) -> Mapping[str, float]:
        """See `LinkContacts`."""
        found: Mapping[str, float] = self._inner.down_since
        if self._turns.in_turn:
            self._note((Question.DOWN_SINCE,), dict(found))
        return found

    def last_contact_at(self, host: str) -> float | None:
        """See `LinkContacts`."""
        # `_note` would take longer: each hop asks this question, and gets another answer.
        if not self._turns.in_turn:
            return self._inner.last_contact_at(host)
        if host in self._contacts:
            return self._contacts[host]
        found = self._contacts[host] = self._inner.last_contact_at(host)
        return found

    def round_trip(self, host: str) -> float | None:
        """See `Environment`."""
        return self._note((Question.ROUND_TRIP, host), self._inner.round_trip(host))

    def answer_timeout(self, host: str) -> float | None:
        """See `Environment`."""
        return self._note((Question.ANSWER_TIMEOUT, host), self._inner.answer_timeout(host))

    def last(self, device: str, quantity: str) -> Observation | None:
        """See `DeviceReadings`."""
        return self._note((Question.LAST, device, quantity), self._inner.last(device, quantity))

    def unavailability(self, device: str) -> Unavailability | None:
        """See `DeviceReadings`."""
        return self._note((Question.TROUBLE, device), self._inner.unavailability(device))

    def may_be_cancelled(self, agent: str, call: DeviceCallRecord) -> bool:
        """See `Environment`."""
        key = Question.MAY_BE_CANCELLED, agent, self._calls[call]
        return self._note(key, self._inner.may_be_cancelled(agent, call))

    def query(self, agent: str, call: DeviceCallRecord) -> DeviceValue | Pending:
        """See `Environment`. Raises DeviceError."""
        key = Question.QUERY, agent, self._calls[call]
        if self._turns.in_turn and key in self._repeated_keys:
            known = self._known[key]
            if isinstance(known, DeviceError):
                raise DeviceError(known.device, known.reason, kind=known.kind)
            return cast("DeviceValue | Pending", known)
        try:
            return self._note(key, self._inner.query(agent, call))
        except DeviceError as error:
            self._note(key, error)
            raise

    def reading(self, agent: str, call: DeviceCallRecord) -> Reading | None:
        """See `Environment`."""
        latest = self._inner.reading(agent, call)
        if not self._turns.in_turn:
            return latest
        key = Question.READING, agent, self._calls[call]
        if latest is None:
            self._note(key, None)
            return None
        number = next((n for n, each in enumerate(self._readings) if each is latest), len(self._readings))
        if number == len(self._readings):
            self._readings.append(latest)
            self.has_readings = True
            self._recorded.append((latest.word, latest.until))
            # The word is recorded at the beginning of a turn, and this turn is under way.
            self._change(key, number, [number, latest.word, latest.until])
        elif self._known.get(key) != number:
            # The reading was lost, or was known as the reading of another call.
            self._change(key, number, number)
        return latest

    def _change(self, key: tuple[str | int, ...], number: int, answer: object) -> None:
        self._known[key] = number
        self._changes.append(RecordedAnswer(Question.READING, list(key[1:]), answer))

    def _note(self, key: tuple[str | int, ...], value: T) -> T:
        if not self._turns.in_turn:
            return value
        if key in self._repeated_keys:
            return cast(T, self._known[key])
        self._repeated_keys.add(key)
        known = self._known.get(key, _UNASKED)
        if known is _UNASKED or not _is_same(known, value):
            self._known[key] = value
            self._changes.append(_answer(key, value))
        return value


def _is_same(previous: object, value: object) -> bool:
    """Whether a replay with `previous` computes the same as with `value`.

    Equal values can differ: 0.0 and -0.0, and 1, 1.0 and True in a sequence.
    """
    if previous is value or type(previous) is not type(value):
        return previous is value
    if type(value) is float:
        return previous == value and (value != 0.0 or copysign(1.0, value) == copysign(1.0, previous))
    match value:
        case DeviceError(device=device, reason=reason, kind=kind):
            other = cast(DeviceError, previous)
            return (other.device, other.reason, other.kind) == (device, reason, kind)
        case list() | tuple():
            others = cast("Sequence[object]", previous)
            return len(value) == len(others) and all(map(_is_same, others, value))
        case Observation():
            found = cast(Observation, previous)
            return found.when == value.when and _is_same(found.value, value.value)
    return previous == value


def _answer(key: tuple[str | int, ...], value: object) -> RecordedAnswer:
    question, arguments = int(key[0]), list(key[1:])
    match value:
        case DeviceError():
            return RecordedAnswer(question, arguments, None, (value.device, value.reason, value.kind))
        case Pending():
            return RecordedAnswer(question, arguments, PENDING_ANSWER)
        case Unavailability():
            return RecordedAnswer(question, arguments, [value.reason, value.since])
        case Observation():
            return RecordedAnswer(question, arguments, [value.value, value.when])
        case _:
            return RecordedAnswer(question, arguments, value)
