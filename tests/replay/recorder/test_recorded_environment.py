"""Each answer of a recorded environment is the answer in its replay, to the bit."""

from __future__ import annotations

import math
from itertools import permutations
from types import SimpleNamespace
from typing import Any

import msgspec
import pytest

from lfield.bytecode.program import DeviceCallRecord
from lfield.errors import DeviceError
from lfield.host.recording.host_records import ReadingChange, RecordedAnswer
from lfield.host.recording.recorded_environment import RecordedEnvironment
from lfield.manifest import Observation
from lfield.replay.replay_environment import ReplayEnvironment
from lfield.vm.engine_interface import Reading
from lfield.vm.host_interface import PENDING

#: Values that are equal to each other, or to themselves only if they have the same bits.
VALUES = (0.0, -0.0, 0, False, math.nan, [0.0, 1], [-0.0, 1], [0.0, 1.0], [0.0, True], None, "0", PENDING)


class World:
    """An environment and its replay, with two device calls."""

    def __init__(self) -> None:
        self.calls = [DeviceCallRecord(0, "fc", "Vehicle", name, (), 0, "query") for name in ("one", "two")]
        numbers = {call: number for number, call in enumerate(self.calls)}
        self.answers: dict[DeviceCallRecord, Any] = {}
        self.readings: dict[DeviceCallRecord, Reading | None] = {}
        inner: Any = SimpleNamespace(
            query=lambda agent, call: self._query(call),
            reading=lambda agent, call: self.readings.get(call),
            last=lambda device, quantity: Observation(self.answers[self.calls[0]], 1.0),
        )
        self.turns = SimpleNamespace(in_turn=False)
        self.recorded = RecordedEnvironment(inner, numbers, self.turns)
        self.replayed = ReplayEnvironment(numbers)

    def _query(self, call: DeviceCallRecord) -> Any:
        found = self.answers[call]
        if isinstance(found, DeviceError):
            raise found
        return found

    def turn(self, ask) -> tuple[Any, Any]:
        """The answers of a question in a turn: recorded, replayed."""
        changes = self.recorded.drain_changed_readings()
        self.turns.in_turn = True
        found = ask(self.recorded)
        self.turns.in_turn = False
        answers = self.recorded.drain_answers()
        self.replayed.apply(
            msgspec.msgpack.decode(msgspec.msgpack.encode(answers), type=list[RecordedAnswer]),
            msgspec.msgpack.decode(msgspec.msgpack.encode(changes), type=list[ReadingChange]),
        )
        return found, ask(self.replayed)


@pytest.mark.parametrize("pair", list(permutations(VALUES, 2)))
def test_an_answer_that_follows_an_equal_one_is_replayed(pair) -> None:
    world = World()
    for value in (*pair, pair[0], pair[0]):
        world.answers[world.calls[0]] = value
        found, replayed = world.turn(lambda environment: environment.query("lead", world.calls[0]))
        assert repr(found) == repr(replayed) == repr(value)
        if value is not PENDING:
            found, replayed = world.turn(lambda environment: environment.last("fc", "battery"))
            assert repr(found) == repr(replayed)


def test_a_reading_lost_between_turns_is_replayed() -> None:
    world = World()
    reading = Reading()
    reading.update(7, 1.0)
    for number, found in enumerate([reading, None, reading, None, None, reading]):
        world.readings[world.calls[0]] = found
        reading.update(7 + number, 1.0)
        one, other = world.turn(lambda environment: environment.reading("lead", world.calls[0]))
        assert one is found
        assert (other is None) == (found is None)
        assert other is None or (other.word, other.until) == (reading.word, reading.until)


def test_two_calls_with_one_reading_are_replayed() -> None:
    world = World()
    reading = Reading()
    reading.update(7, 1.0)
    world.readings = dict.fromkeys(world.calls, reading)
    for call in (*world.calls, *world.calls):
        found, replayed = world.turn(lambda environment, call=call: environment.reading("lead", call))
        assert found is reading
        assert replayed.word == 7


def test_a_reading_requested_between_two_turns_is_not_recorded() -> None:
    world = World()
    reading = Reading()
    world.readings[world.calls[0]] = reading
    world.recorded.reading("lead", world.calls[0])
    reading.update(7, 1.0)
    _, replayed = world.turn(lambda environment: environment.reading("lead", world.calls[0]))
    assert replayed.word == 7
