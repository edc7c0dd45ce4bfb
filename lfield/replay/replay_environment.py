"""The outside of a core in a replay: its clock, its environment, its random bytes."""

from __future__ import annotations

from collections import deque
from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Any

from msgspec.structs import replace

from lfield.bytecode.program import DeviceCallRecord
from lfield.capability.directory.directory_delta import Unavailability
from lfield.errors import DeviceError
from lfield.host.recording.host_records import ReadingChange, RecordedAnswer
from lfield.host.recording.recorded_environment import PENDING_ANSWER, Question
from lfield.manifest import DeviceValue, Observation
from lfield.vm.engine_interface import Reading
from lfield.vm.host_interface import PENDING, Pending


class ReplayedBytes:
    """Random bytes, as recorded."""

    def __init__(self) -> None:
        self._drawn: deque[bytes] = deque()

    def extend(self, drawn: Iterable[bytes]) -> None:
        """Add the bytes that were drawn in the next turn."""
        self._drawn.extend(drawn)

    def clear(self) -> None:
        """Discard the bytes that were not drawn."""
        self._drawn.clear()

    def __call__(self, size: int) -> bytes:
        # A replay that has diverged may draw more than was recorded.
        return self._drawn.popleft() if self._drawn else bytes(size)


class ReplayEnvironment:
    """The recorded answers of a host's environment: the last one to each question.

    `calls` are the numbers of device calls. `unknown` collects questions that were never answered.
    """

    def __init__(self, calls: Mapping[DeviceCallRecord, int]) -> None:
        self._calls = calls
        self._answers: dict[tuple[str | int, ...], RecordedAnswer] = {}
        self.readings: list[Reading] = []
        self.unknown: list[str] = []

    def use_calls(self, calls: Mapping[DeviceCallRecord, int]) -> None:
        """Use other numbers of device calls: those of the recorded program, for the calls of another one."""
        self._calls = calls

    def preset(self, answers: Iterable[RecordedAnswer]) -> None:
        """Set answers for questions without one: another program may ask earlier than the recorded one."""
        for answer in answers:
            self._answers.setdefault((answer.question, *answer.arguments), answer)

    def apply(self, answers: Sequence[RecordedAnswer], changes: Sequence[ReadingChange]) -> None:
        """Set the changes of the next turn."""
        for change in changes:
            self.readings[change.number].update(change.raw, change.until)
        for answer in answers:
            if answer.question == Question.READING and isinstance(answer.value, list):
                _, raw, until = answer.value
                self._add_reading(raw, until)
            self._answers[answer.question, *answer.arguments] = answer

    def clear(self) -> None:
        """Forget all answers and readings."""
        self._answers.clear()
        self.readings.clear()

    def restore(self, answers: Sequence[RecordedAnswer], readings: Sequence[ReadingChange]) -> None:
        """Set all answers and readings of a checkpoint."""
        for reading in readings:
            self._add_reading(reading.raw, reading.until)
        self.apply(answers, ())

    @property
    def known(self) -> Collection[RecordedAnswer]:
        """The last answers to all questions."""
        return self._answers.values()

    @property
    def answers(self) -> list[RecordedAnswer]:
        """The last answers to all questions, for `restore`."""
        return [
            replace(answer, value=answer.value[0])
            if answer.question == Question.READING and isinstance(answer.value, list)
            else answer
            for answer in self._answers.values()
        ]

    @property
    def reading_changes(self) -> list[ReadingChange]:
        """The readings as they are now, for `restore`."""
        return [ReadingChange(n, each.word, each.until) for n, each in enumerate(self.readings)]

    def _add_reading(self, raw: int, until: float) -> None:
        self.readings.append(Reading())
        self.readings[-1].update(raw, until)

    def _find(self, question: Question, *arguments: str | int) -> RecordedAnswer | None:
        found = self._answers.get((int(question), *arguments))
        if found is None:
            self.unknown.append(f"{question.name.lower()}{arguments}")
        return found

    def _value(self, question: Question, *arguments: str | int) -> Any:
        found = self._find(question, *arguments)
        if found is not None and found.error:
            raise DeviceError(found.error[0], found.error[1], kind=found.error[2])
        return None if found is None else found.value

    @property
    def down_since(self) -> Mapping[str, float]:
        """See `LinkContacts`."""
        return self._value(Question.DOWN_SINCE) or {}

    def last_contact_at(self, host: str) -> float | None:
        """See `LinkContacts`."""
        found: float | None = self._value(Question.LAST_CONTACT, host)
        return found

    def round_trip(self, host: str) -> float | None:
        """See `Environment`."""
        found: float | None = self._value(Question.ROUND_TRIP, host)
        return found

    def answer_timeout(self, host: str) -> float | None:
        """See `Environment`."""
        found: float | None = self._value(Question.ANSWER_TIMEOUT, host)
        return found

    def last(self, device: str, quantity: str) -> Observation | None:
        """See `DeviceReadings`."""
        found = self._value(Question.LAST, device, quantity)
        return None if found is None else Observation(*found)

    def unavailability(self, device: str) -> Unavailability | None:
        """See `DeviceReadings`."""
        found = self._value(Question.TROUBLE, device)
        return None if found is None else Unavailability(*found)

    def may_be_cancelled(self, agent: str, call: DeviceCallRecord) -> bool:
        """See `Environment`."""
        return bool(self._value(Question.MAY_BE_CANCELLED, agent, self._calls[call]))

    def query(self, agent: str, call: DeviceCallRecord) -> DeviceValue | Pending:
        """See `Environment`. Raises DeviceError."""
        key = Question.QUERY, agent, self._calls[call]
        if key not in self._answers and call.effect != "query":
            return PENDING
        value = self._value(*key)
        found: DeviceValue | Pending = PENDING if value == PENDING_ANSWER else value
        return found

    def reading(self, agent: str, call: DeviceCallRecord) -> Reading | None:
        """See `Environment`."""
        found = self._value(Question.READING, agent, self._calls[call])
        if found is None:
            return None
        return self.readings[found[0] if isinstance(found, list) else found]
