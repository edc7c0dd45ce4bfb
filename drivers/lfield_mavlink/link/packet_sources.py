"""Sources of packets with one system id: one vehicle or two. Pure: packets and times in.

Two addresses behind one port that both keep sending heartbeats are two vehicles. After a change of address,
the old one falls silent and the board behind the new one is the same. Over several links one vehicle has
several addresses; it is identified by the unique id of its board, or without one by its time since boot.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from typing import Any, NamedTuple

from msgspec import Struct, field

from lfield_mavlink import log_messages
from lfield_mavlink.link.dialect import dialect
from lfield_mavlink.link.sender_separation import Board, HeartbeatContradictions, SenderSeparator

#: Seconds after its last packet for which an address is in use, and for which a second one with heartbeats is
#: a conflict.
USE_TIMEOUT, CONFLICT_TIME = 2.5, 4.0
#: Seconds for which both must send: packets of an abandoned address may arrive late.
OVERLAP_TIME = 0.5
#: Seconds of listening until a single vehicle is certain: an autopilot's heartbeat is 1 Hz.
LISTEN_TIME = 1.2
#: Addresses stored, queries for the unique id of each, and seconds between two queries.
MAX_SOURCES, MAX_QUERIES, QUERY_INTERVAL = 16, 5, 0.5
#: Difference of two boot clocks in seconds: the same vehicle over two links below; different vehicles above,
#: if two boards have one id, as all PX4 simulators do.
SAME_CLOCK, OTHER_CLOCK = 2.0, 5.0
#: The remedy for two vehicles.
REMEDY = "give each vehicle a system id of its own (MAV_SYSID, SYSID_THISMAV or MAV_SYS_ID)"
#: The number of times that a clock must go back within so many seconds to indicate two vehicles at one
#: address.
BACKWARDS, BACKWARDS_TIME = 3, 5.0
#: Seconds within which two vehicles at one address both answer two queries.
ALTERNATION_TIME = 2.0
#: Messages that may identify the vehicle behind an address.
_IDENTIFYING = (dialect.MAVLINK_MSG_ID_HEARTBEAT, dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION)


class Source(NamedTuple):
    """The number of a link, and the address behind it; '' for a link with a single peer."""

    link: int
    address: str = ""


class _SourceState(Struct):
    """The messages of one source."""

    at: float = -math.inf
    first_beat: float = math.inf
    beat: float = -math.inf
    board: Board | None = None
    #: The previously reported board, and the time of the change.
    former: Board | None = None
    changed: float = -math.inf
    #: The time when two boards were reported alternately.
    doubled: float = -math.inf
    #: Whether the source has sent heartbeats while the vehicle's own address did.
    is_rival: bool = False
    queries: int = 0
    queried_at: float = -math.inf
    #: The vehicle's boot clock minus ours in seconds, at the smallest delay.
    clock: float | None = None
    booted: float = -math.inf
    heartbeats: HeartbeatContradictions = field(default_factory=HeartbeatContradictions)
    strands: SenderSeparator = field(default_factory=SenderSeparator)
    backwards: deque[float] = field(default_factory=lambda: deque(maxlen=BACKWARDS))

    def on_packet(self, message: Any, now: float) -> None:
        """Handles a packet."""
        self.at = now
        if message.get_msgId() == dialect.MAVLINK_MSG_ID_HEARTBEAT:
            if now - self.beat > CONFLICT_TIME:
                self.first_beat, self.queries = now, 0
            self.beat = now
            self.heartbeats.on_heartbeat(message, now)
        elif message.get_msgId() == dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION:
            self._on_board(Board.from_message(message), now)
        elif message.get_msgId() == dialect.MAVLINK_MSG_ID_ATTITUDE:
            # One kind only: some senders have a different clock for each kind of message.
            self._on_clock(message.time_boot_ms / 1000.0, now)

    def _on_board(self, board: Board, now: float) -> None:
        """Handles a report of the board: a vehicle that replaces another one changes the board once."""
        if board == self.board:
            return
        if board == self.former and now - self.changed <= ALTERNATION_TIME:
            self.doubled = now
        self.board, self.former, self.changed = board, self.board, now

    def _on_clock(self, booted: float, now: float) -> None:
        if booted < self.booted - 1.0:
            self.backwards.append(now)
        self.booted, ahead = booted, booted - now
        if self.clock is None or ahead > self.clock or ahead < self.clock - SAME_CLOCK:
            self.clock = ahead

    def is_mixed(self, now: float) -> bool:
        """Whether two boards answer from this source, or two clocks alternate."""
        alternates = len(self.backwards) == BACKWARDS and now - self.backwards[0] <= BACKWARDS_TIME
        return alternates or now - self.doubled <= CONFLICT_TIME

    def is_same(self, other: _SourceState, *, both_send: bool) -> bool | None:
        """Whether two sources are one vehicle; None while unknown.

        `both_send`: both send now. The clock of a silent source may have restarted elsewhere.
        """
        own_board, other_board = self.board, other.board
        if own_board is None or other_board is None:
            if self.queries < MAX_QUERIES:
                return None
        elif own_board.uid or other_board.uid:
            if own_board.uid != other_board.uid or not both_send:
                return own_board.uid == other_board.uid
            return self._has_clock_of(other, OTHER_CLOCK)
        elif own_board != other_board:
            return False
        if not (both_send or self.is_rival):
            return True
        return self._has_clock_of(other, SAME_CLOCK)

    def _has_clock_of(self, other: _SourceState, apart: float) -> bool:
        """Whether two sources may be one vehicle, by their boot clocks.

        A rival is another vehicle unless the clocks are known to agree; any other source is the same
        vehicle unless the clocks are known to differ.
        """
        if self.clock is None or other.clock is None:
            return not self.is_rival
        return abs(self.clock - other.clock) <= apart


class Sources:
    """The addresses of one system id. `links` are the endpoints by number, for messages.

    `events` are log lines, and `moves` counts changes of the vehicle's address.
    """

    def __init__(self, system: int, links: Sequence[str]) -> None:
        self._system, self._links = system, links
        #: Whether a second vehicle may have its own address: behind a listening port, or on a second link.
        self._several = len(links) > 1 or any(link.startswith("udpin:") for link in links)
        self._states: dict[Source, _SourceState] = {}
        self._own: set[Source] = set()
        self._first = math.inf
        self._conflicting: dict[Source, float] = {}
        # Own addresses that a second vehicle uses as well.
        self._mixed: set[Source] = set()
        self.events: list[str] = []
        self.moves = 0

    # -- packets ------------------------------------------------------------------------------------------

    def accepts(self, source: Source) -> bool:
        """Whether packets from a source are the vehicle's, as far as known."""
        return source in self._own and source not in self._mixed

    def touch(self, source: Source, now: float) -> None:
        """Records a packet from one of the vehicle's own addresses that need not be decoded."""
        self._states[source].at = now

    def on_packet(self, source: Source, message: Any, now: float) -> bool:
        """Handles a packet of the vehicle's autopilot; returns whether it is accepted.

        Packets before the first heartbeat from an address are refused: they may not be an autopilot's.
        """
        state = self._states.get(source)
        if state is None:
            if message.get_msgId() != dialect.MAVLINK_MSG_ID_HEARTBEAT:
                return False
            state = self._add(source)
        state.on_packet(message, now)
        if source in self._own:
            return self._is_first(source, state, message, now)
        if not self._own:
            self._own.add(source)
            self._first = now
            return True
        if message.get_msgId() in _IDENTIFYING:
            self._on_other(source, state, now)
        return source in self._own

    def _add(self, source: Source) -> _SourceState:
        others = [each for each in self._states if each not in self._own]
        if len(self._states) >= MAX_SOURCES and others:
            oldest = min(others, key=lambda each: self._states[each].at)
            del self._states[oldest]
            self._conflicting.pop(oldest, None)
        return self._states.setdefault(source, _SourceState())

    def _on_other(self, source: Source, state: _SourceState, now: float) -> None:
        """Handles a heartbeat from an unknown address."""
        used = [each for each in self._own if now - self._states[each].at <= USE_TIMEOUT]
        if same_port := [each for each in used if each.link == source.link]:
            if any(self._states[each].at - state.first_beat >= OVERLAP_TIME for each in same_port):
                state.is_rival = True
                self._conflict(source, now)
            return
        is_same = self._is_same(state, used)
        if is_same is False:
            self._conflict(source, now)
        elif is_same:
            self._adopt(source, used)

    def _adopt(self, source: Source, used: Sequence[Source]) -> None:
        """Accepts an address of the vehicle: in addition to those in use on other links, or instead of
        all.
        """
        if not used:
            old_addresses = ", ".join(map(self._describe, sorted(self._own)))
            line = log_messages.ADDRESS_CHANGED.line(new=self._describe(source), old=old_addresses)
            self.events.append(line)
        self._own = {each for each in self._own if used and each.link != source.link} | {source}
        self._conflicting.pop(source, None)
        self.moves += 1

    def _is_same(self, state: _SourceState, used: Sequence[Source]) -> bool | None:
        results = [state.is_same(self._states[each], both_send=bool(used)) for each in used or self._own]
        return False if False in results else None if None in results else True

    def _is_first(self, source: Source, state: _SourceState, message: Any, now: float) -> bool:
        """Whether a packet from an own address is the vehicle's, not a second one's."""
        first = state.strands.is_first(message, now)
        if not state.is_mixed(now):
            self._mixed.discard(source)
            return first or not state.strands.is_doubled(now)
        if source not in self._mixed:
            self._mixed.add(source)
            line = log_messages.TWO_VEHICLES_MIXED.line(
                system=self._system, source=self._describe(source), remedy=REMEDY
            )
            self.events.append(line)
        return first

    def _conflict(self, source: Source, now: float) -> None:
        if now - self._conflicting.get(source, -math.inf) > CONFLICT_TIME:
            own = ", ".join(map(self._describe, sorted(self._own)))
            line = log_messages.TWO_VEHICLES.line(
                system=self._system, own=own, other=self._describe(source), remedy=REMEDY
            )
            self.events.append(line)
        self._conflicting[source] = now

    # -- results ------------------------------------------------------------------------------------------

    def conflict(self, now: float) -> str:
        """The addresses of two vehicles with this system id; '' for one vehicle."""
        conflicting = [each for each, at in self._conflicting.items() if now - at <= CONFLICT_TIME]
        if conflicting:
            names = " and ".join(map(self._describe, (*sorted(self._own), *sorted(conflicting))))
            return f"two vehicles send as system {self._system}: {names}"
        for each in sorted(self._own):
            if self._states[each].is_mixed(now):
                return f"two vehicles send as system {self._system}, both over {self._describe(each)}"
        return ""

    def is_settled(self, now: float) -> bool:
        """Whether the number of vehicles, one or two, is certain.

        Behind a single peer, certainty requires two queries for the board.
        """
        if not self._several or self.conflict(now):
            return True
        pending = (
            now - state.beat <= CONFLICT_TIME
            for source, state in self._states.items()
            if source not in self._own
        )
        return now - self._first >= LISTEN_TIME and not any(pending)

    def due(self, now: float) -> list[Source]:
        """The uncertain addresses to query for AUTOPILOT_VERSION now."""
        links = {each.link for each in self._own if now - self._states[each].at <= USE_TIMEOUT}
        due_sources = []
        for source, state in self._states.items():
            if source in self._own:
                is_due = now - state.heartbeats.contradicted <= CONFLICT_TIME
            else:
                is_unknown = state.board is None and source.link not in links
                is_due = is_unknown and now - state.beat <= CONFLICT_TIME and state.queries < MAX_QUERIES
            if is_due and now - state.queried_at >= QUERY_INTERVAL:
                state.queries, state.queried_at = state.queries + 1, now
                due_sources.append(source)
        return due_sources

    def address(self, link: int) -> str:
        """The vehicle's address behind a link; '' for all."""
        return next((each.address for each in self._own if each.link == link), "")

    def _describe(self, source: Source) -> str:
        """`udpin:0.0.0.0:14550 from 10.0.0.5:14555`."""
        endpoint = self._links[source.link]
        return f"{endpoint} from {source.address}" if source.address else endpoint
