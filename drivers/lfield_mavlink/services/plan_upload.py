"""One attempt to upload a plan. Pure: messages and times in, messages out.

The vehicle requests item after item; the last message is repeated when nothing arrives.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from lfield_mavlink.link.dialect import AUTOPILOT, dialect
from lfield_mavlink.services.plan_items import Item, PlanKind

#: Consecutive silences of half a second until an attempt fails: at its start or end, and within, where
#: ArduPilot repeats requests for 8 s.
MAX_SILENCES, MAX_SILENCES_WITHIN = 10, 16
#: A request that is repeated within so many seconds is a duplicate packet.
TWICE = 0.1
#: Bound of messages per item, and in addition, for a malfunctioning vehicle.
PER_ITEM, FIXED = 10, 100

#: Requests of ArduPilot (deprecated) and PX4.
REQUESTS = (dialect.MAVLINK_MSG_ID_MISSION_REQUEST, dialect.MAVLINK_MSG_ID_MISSION_REQUEST_INT)


class Upload:
    """The state of one upload: `last` is the last message sent, initially the one that starts the upload.

    When `is_over`, `reason` is the reason of a failure, '' when the vehicle has requested every item;
    `refusal` is the MAV_MISSION_RESULT for the whole plan, `is_silent` whether there was no response.
    """

    def __init__(self, system: int, kind: PlanKind, wire: Sequence[Item]) -> None:
        self._system, self._kind, self._wire = system, kind, wire
        self._sent_at: dict[int, float] = {}
        self._silences = 0
        self._budget = FIXED + PER_ITEM * len(wire)
        self.last: Any = dialect.MAVLink_mission_count_message(system, AUTOPILOT, len(wire), int(kind))
        self.is_over = False
        self.reason = ""
        self.refusal: int | None = None

    @property
    def is_silent(self) -> bool:
        """Whether no item was requested of a plan that has some."""
        return bool(self._wire) and not self._sent_at

    def on_silence(self) -> Any | None:
        """Handles half a second without a message; returns the message to send, if any."""
        self._silences += 1
        maximum = MAX_SILENCES_WITHIN if self._sent_at and not self._is_complete else MAX_SILENCES
        if self._silences < maximum:
            return self.last
        self._end()
        return None

    def on_message(self, message: Any, now: float) -> Any | None:
        """Handles a message about this kind of plan; returns the answer, if any."""
        self._budget -= 1
        if self._budget < 0:
            self._end()
        elif message.get_msgId() in REQUESTS:
            return self._on_request(message.seq, now)
        elif message.get_msgId() == dialect.MAVLINK_MSG_ID_MISSION_ACK:
            self._on_ack(message.type)
        return None

    @property
    def _is_complete(self) -> bool:
        """Whether every item was requested."""
        return len(self._sent_at) == len(self._wire)

    def _on_request(self, number: int, now: float) -> Any | None:
        # A repeated packet must not be answered twice: each answer causes the next request, which would
        # double every later item.
        if number >= len(self._wire) or now - self._sent_at.get(number, -TWICE) < TWICE:
            return None
        if number not in self._sent_at:
            self._silences = 0
        self._sent_at[number] = now
        self.last = self._wire[number].message(self._system, number, self._kind)
        return self.last

    def _on_ack(self, result: int) -> None:
        if result == dialect.MAV_MISSION_INVALID_SEQUENCE:
            # ArduPilot sends this for an item that it did not request, such as a duplicate, and continues.
            return
        if result == dialect.MAV_MISSION_OPERATION_CANCELLED:
            self._end("it did not get the next item in time")
        elif result == dialect.MAV_MISSION_ACCEPTED:
            # Before the last item it is a late message of an earlier upload.
            if self._is_complete:
                self._end()
        elif result == dialect.MAV_MISSION_ERROR and self._is_complete and self._silences:
            # Our repetition arrived after the end, whose message was lost.
            self._end()
        else:
            self.refusal = result
            self._end()

    def _end(self, reason: str = "") -> None:
        self.is_over = True
        if reason or not self._is_complete:
            self.reason = reason or f"it requested {len(self._sent_at)} of {len(self._wire)} items only"
