"""One attempt to hand a plan to a vehicle. Pure: messages and times in, messages out.

The vehicle asks for item after item; we answer, and repeat our last message when nothing comes.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from lfield_mavlink.link.dialect import AUTOPILOT, dialect
from lfield_mavlink.services.plan_items import Item, PlanKind

#: Silences in a row before an attempt has failed: at its beginning or its end, and in the middle, where
#: ArduPilot goes on to ask for 8 s. A silence is half a second.
QUESTIONS, SILENCES = 10, 16
#: A question that comes again sooner than after so many seconds is the same packet twice.
TWICE = 0.1
#: Messages that an attempt may take for each item, and beside them: a bound for a vehicle gone mad.
PER_ITEM, BESIDE = 10, 100

#: How a vehicle asks: ArduPilot by the first, which is deprecated, PX4 by the second.
REQUESTS = (dialect.MAVLINK_MSG_ID_MISSION_REQUEST, dialect.MAVLINK_MSG_ID_MISSION_REQUEST_INT)


class Upload:
    """`last` is the message that was sent last, first of all the one that begins the upload.

    When `over`, `why` says why it failed, '' when the vehicle has asked for every item; `refusal` is the
    MAV_MISSION_RESULT by which it refuses the plan as such, and `silent` that it has said nothing at all.
    """

    def __init__(self, system: int, kind: PlanKind, wire: Sequence[Item]) -> None:
        self._system, self._kind, self._wire = system, kind, wire
        self._handed: dict[int, float] = {}
        self._silences = 0
        self._budget = BESIDE + PER_ITEM * len(wire)
        self.last: Any = dialect.MAVLink_mission_count_message(system, AUTOPILOT, len(wire), int(kind))
        self.over = False
        self.why = ""
        self.refusal: int | None = None

    @property
    def silent(self) -> bool:
        """Whether nothing was asked for though there was something to hand out."""
        return bool(self._wire) and not self._handed

    def on_silence(self) -> Any | None:
        """Nothing came for half a second; the message to send, if any."""
        self._silences += 1
        most = SILENCES if self._handed and not self._complete else QUESTIONS
        if self._silences < most:
            return self.last
        self._end()
        return None

    def on_message(self, message: Any, now: float) -> Any | None:
        """A message about this kind of plan; the answer to send, if any."""
        self._budget -= 1
        if self._budget < 0:
            self._end()
        elif message.get_msgId() in REQUESTS:
            return self._on_request(message.seq, now)
        elif message.get_msgId() == dialect.MAVLINK_MSG_ID_MISSION_ACK:
            self._on_ack(message.type)
        return None

    @property
    def _complete(self) -> bool:
        """Whether every item was asked for."""
        return len(self._handed) == len(self._wire)

    def _on_request(self, number: int, now: float) -> Any | None:
        # A repeated packet must not be answered twice: each answer brings the next question, and every
        # later item would cross twice as well.
        if number >= len(self._wire) or now - self._handed.get(number, -TWICE) < TWICE:
            return None
        if number not in self._handed:
            self._silences = 0
        self._handed[number] = now
        self.last = self._wire[number].message(self._system, number, self._kind)
        return self.last

    def _on_ack(self, result: int) -> None:
        if result == dialect.MAV_MISSION_INVALID_SEQUENCE:
            # ArduPilot says this of an item that it did not ask for, as one that came twice, and goes on.
            return
        if result == dialect.MAV_MISSION_OPERATION_CANCELLED:
            self._end("it did not get the next item in time")
        elif result == dialect.MAV_MISSION_ACCEPTED:
            # Before the last item it is the word of an earlier upload that comes late.
            if self._complete:
                self._end()
        elif result == dialect.MAV_MISSION_ERROR and self._complete and self._silences:
            # What we repeated came after the end, and the word of that end was lost.
            self._end()
        else:
            self.refusal = result
            self._end()

    def _end(self, why: str = "") -> None:
        self.over = True
        if why or not self._complete:
            self.why = why or f"it asked for {len(self._handed)} of {len(self._wire)} items only"
