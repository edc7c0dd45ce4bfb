"""Two servos with the same id on a bus, and one servo whose answers are late."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from typing import cast

import pytest

from lfield_dynamixel.bus.half_duplex_bus import Bus
from lfield_dynamixel.bus.packets import INST_STATUS
from lfield_dynamixel.bus.servo_chain import Chain, Node

NODE = Node(1, 2)
ANSWER = NODE.codec.encode(NODE.number, INST_STATUS, b"\0" + bytes(4))
NOTHING, ONE, TWO = b"", ANSWER, ANSWER + ANSWER


class ScriptedBus:
    """A bus that returns these answers one after another, and then repeats the last one."""

    def __init__(self, answers: Sequence[bytes]) -> None:
        self._answers = list(answers)

    async def listen(self, *_: object, **__: object) -> bytes:
        return self._answers.pop(0) if len(self._answers) > 1 else self._answers[0]


def conflict(answers: Sequence[bytes]) -> str:
    chain = Chain(cast(Bus, ScriptedBus(answers)))
    return asyncio.run(chain.id_conflict(NODE, 132, 4))


@pytest.mark.parametrize(
    "answers",
    [[TWO], [ONE, TWO, TWO, ONE, TWO], [NOTHING, TWO, TWO, TWO, TWO]],
    ids=["all", "some", "one lost"],
)
def test_double_answers_report_two_servos(answers: Sequence[bytes]) -> None:
    assert "two servos answer to the id 1" in conflict(answers)


@pytest.mark.parametrize(
    "answers",
    [[ONE], [NOTHING, TWO, ONE], [NOTHING, TWO] * 6],
    ids=["in time", "one late", "each second one late"],
)
def test_late_answers_of_one_servo_do_not_report_a_second_servo(answers: Sequence[bytes]) -> None:
    assert conflict(answers) == ""
