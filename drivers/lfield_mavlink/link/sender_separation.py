"""Separates the packets of two vehicles with one system id at one address. Pure.

Clocks and boards identify the sender of some messages, the sequence number that of the others: each vehicle
counts its own.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from lfield_mavlink.link.dialect import dialect

#: Apparent jump of a clock by link delays, in seconds; seconds after which a silent clock is dropped.
JITTER, GIVEN_UP = 0.8, 3.0
#: Seconds within which two clocks are concurrent; a restarting vehicle is silent for longer.
CONCURRENT_WITHIN = 0.5
#: Packets that may be lost in a row within so many seconds after the first vehicle's clock, before the next
#: packet is not accepted as its heartbeat.
NEAR, SOON = 32, 0.3
_DECISIVE = (dialect.MAVLINK_MSG_ID_HEARTBEAT, dialect.MAVLINK_MSG_ID_CURRENT_MODE)
#: Frequent messages with the time since boot.
_TIMED = (dialect.MAVLINK_MSG_ID_ATTITUDE, dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED)
#: Seconds in which an armed vehicle that is disarmed in between is probably two vehicles.
CONTRADICTS = 2.5


class Board(NamedTuple):
    """A board as in AUTOPILOT_VERSION: its unique id ('' for none), and its firmware."""

    uid: str
    firmware: tuple[int, ...]

    @classmethod
    def from_message(cls, message: Any) -> Board:
        """The board of uid2 and uid: PX4's simulators all have the same uid, ArduPilot has only uid2."""
        uid2 = bytes(message.uid2).rstrip(b"\0")
        uid = uid2.hex() + (f"-{message.uid:x}" if message.uid else "") if uid2 or message.uid else ""
        versions = (message.flight_sw_version, message.middleware_sw_version, message.os_sw_version)
        kinds = (message.board_version, message.vendor_id, message.product_id)
        return cls(uid, (*versions, *kinds, *message.flight_custom_version))


class SenderSeparator:
    """The packets of one address in two sequences: the first vehicle's, and the rest."""

    def __init__(self) -> None:
        self._board: Board | None = None
        # By kind of message, as some senders have a clock per kind: the first vehicle's boot clock minus ours
        # in seconds, and the time of the last message.
        self._clocks: dict[int, tuple[float, float]] = {}
        self._clock_at = self._other_at = -math.inf
        # The last sequence number of each of the two.
        self._last: dict[bool, int] = {}

    def is_first(self, message: Any, now: float) -> bool:
        """Whether a packet is the first vehicle's; meaningless with a single vehicle."""
        kind, number = message.get_msgId(), message.get_seq()
        if kind == dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION:
            first = self._has_first_board(Board.from_message(message))
        elif kind in _TIMED and message.time_boot_ms:
            first = self._has_first_clock(kind, message.time_boot_ms / 1000.0 - now, now)
        else:
            first = self._follows_first(kind, number, now)
        self._last[first] = number
        return first

    def _follows_first(self, kind: int, number: int, now: float) -> bool:
        """Whether a packet soon follows, by its number, the previous one of the first vehicle."""
        behind = self._gap(True, number)
        if kind in _DECISIVE and now - self._clock_at <= SOON and NEAR < behind < 256:
            self._other_at = now
            return False
        return behind <= self._gap(False, number)

    def _has_first_board(self, board: Board) -> bool:
        self._board = self._board or board
        return board == self._board

    def _has_first_clock(self, kind: int, ahead: float, now: float) -> bool:
        clock, at = self._clocks.get(kind, (ahead, now))
        if now - at <= GIVEN_UP and abs(ahead - clock) > JITTER:
            self._other_at = now
            return False
        self._clocks[kind] = ahead, now
        self._clock_at = now
        return True

    def is_doubled(self, now: float) -> bool:
        """Whether the clock of a second vehicle was received just now."""
        return max(now - self._clock_at, now - self._other_at) <= CONCURRENT_WITHIN

    def _gap(self, strand: bool, number: int) -> int:
        return (number - self._last[strand] - 1) % 256 if strand in self._last else 256


class HeartbeatContradictions:
    """Whether alternating heartbeats indicate two vehicles."""

    def __init__(self) -> None:
        self._reported: tuple[int, ...] = ()
        self._former: tuple[int, ...] = ()
        self._reported_at = self._former_at = -math.inf
        #: The time when a heartbeat last equalled the one before the previous one.
        self.contradicted = -math.inf

    def on_heartbeat(self, message: Any, now: float) -> None:
        """Handles a heartbeat: armed or not, and the type."""
        armed = message.base_mode & dialect.MAV_MODE_FLAG_SAFETY_ARMED
        report = (armed, message.autopilot, message.type)
        if report != self._reported:
            if report == self._former and now - self._former_at <= CONTRADICTS:
                self.contradicted = now
            self._former, self._former_at = self._reported, self._reported_at
        self._reported, self._reported_at = report, now
