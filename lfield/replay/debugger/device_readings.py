"""Readings of devices in a host's core at a moment: the last answers that it has received."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import NamedTuple

from lfield.bytecode.program import BOOLEAN, REAL
from lfield.host.recording.recorded_environment import PENDING_ANSWER, Question
from lfield.replay.debugger.moment import Moment
from lfield.vm.memory.word_codec import real_from_bits


class DeviceReading(NamedTuple):
    """The last value of a query of a device: agent, device field, instruction."""

    agent: str
    device: str
    instruction: str
    value: object

    @property
    def name(self) -> str:
        """AGENT.DEVICE.INSTRUCTION."""
        return f"{self.agent}.{self.device}.{self.instruction}"

    def is_named(self, path: tuple[str, ...]) -> bool:
        """Whether a name refers to the reading: its last part, with or without those before."""
        names = self.agent, self.device, self.instruction
        return path in (names, names[1:], names[2:], (self.agent, self.instruction))


def device_readings(moment: Moment) -> list[DeviceReading]:
    """All readings, in the order in which they were first known; a query of several arguments has one."""
    # A reading is newer than the answer to a query.
    return list({each.name: each for each in _readings(moment)}.values())


def reading_named(
    readings: Iterable[DeviceReading], path: tuple[str, ...], agent: str = ""
) -> DeviceReading | None:
    """The reading of that name, preferably of an agent."""
    found = [each for each in readings if each.is_named(path)]
    return next((each for each in found if each.agent == agent), found[0] if found else None)


def _readings(moment: Moment) -> Iterator[DeviceReading]:
    program = moment.table.program
    environment = moment.environment
    answers = [each for each in environment.known if each.question in (Question.QUERY, Question.READING)]
    for answer in sorted(answers, key=lambda each: each.question):
        if answer.error:
            continue
        agent, number = answer.arguments
        call = program.core.device_calls[int(number)]
        value = answer.value
        if value is None or value == PENDING_ANSWER:
            continue
        if answer.question == Question.READING:
            word = environment.readings[value[0] if isinstance(value, list) else value].word
            kind = program.core.types[call.result].kind
            value = real_from_bits(word) if kind == REAL else bool(word) if kind == BOOLEAN else word
        yield DeviceReading(str(agent), call.field, call.instruction, value)
