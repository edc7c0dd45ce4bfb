"""Where the packets of one system id come from, and whether that is one vehicle. Pure: packets and times in.

Two addresses behind one port that both keep sending heartbeats are two vehicles. A vehicle whose address has
changed is not: the old address falls silent, and the board behind the new one is the same. Over several links
one vehicle is heard from several addresses; that it is one shows by the unique id of its board, and where it
tells none, by the clock since its start.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from lfield_mavlink.link.dialect import dialect
from lfield_mavlink.link.strands import Board, Heartbeats, Strands

#: Seconds after its last packet for which an address still counts as in use, and for which a second one that
#: sends heartbeats is a conflict.
IN_USE, LASTS = 2.5, 4.0
#: Seconds for which both must send: packets of an address that was given up may be overtaken.
BOTH = 0.5
#: Seconds that are listened before it is known that there is one vehicle: an autopilot's heartbeat is 1 Hz.
LISTENS = 1.2
#: Addresses that are remembered, and how often each is asked for its unique id, every so many seconds.
MOST, ASKS, ASK_AGAIN = 16, 5, 0.5
#: Seconds by which two clocks since the start may seem to differ over two links, and by which they do where
#: two boards tell one id, as all simulators of PX4 do.
SAME_CLOCK, OTHER_CLOCK = 2.0, 5.0
#: What is to be done about two vehicles.
REMEDY = "give each vehicle a system id of its own (MAV_SYSID, SYSID_THISMAV or MAV_SYS_ID)"
#: How often a clock goes back within so many seconds when two vehicles share one address.
BACKWARDS, WITHIN = 3, 5.0
#: Seconds within which two vehicles at one address both answer a question that is asked twice.
BY_TURNS = 2.0
#: Messages after which it may be known whose an address is.
_TELLING = (dialect.MAVLINK_MSG_ID_HEARTBEAT, dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION)


class Source(NamedTuple):
    """The number of a link, and the address behind it; '' where a link has one far end only."""

    link: int
    address: str = ""


@dataclass(slots=True)
class _Seen:
    """What came from one source."""

    at: float = -math.inf
    first_beat: float = math.inf
    beat: float = -math.inf
    board: Board | None = None
    #: The board that was told before this one, and when that changed.
    former: Board | None = None
    changed: float = -math.inf
    #: When two boards were told by turns.
    doubled: float = -math.inf
    #: Whether it has sent heartbeats while the vehicle's own address did.
    is_rival: bool = False
    asked: int = 0
    asked_at: float = -math.inf
    #: The vehicle's seconds since its start less ours, at the least delay.
    clock: float | None = None
    booted: float = -math.inf
    heartbeats: Heartbeats = field(default_factory=Heartbeats)
    strands: Strands = field(default_factory=Strands)
    backwards: deque[float] = field(default_factory=lambda: deque(maxlen=BACKWARDS))

    def on_packet(self, message: Any, now: float) -> None:
        """Take one in."""
        self.at = now
        if message.get_msgId() == dialect.MAVLINK_MSG_ID_HEARTBEAT:
            if now - self.beat > LASTS:
                self.first_beat, self.asked = now, 0
            self.beat = now
            self.heartbeats.on_heartbeat(message, now)
        elif message.get_msgId() == dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION:
            self._on_board(Board.of(message), now)
        elif message.get_msgId() == dialect.MAVLINK_MSG_ID_ATTITUDE:
            # One kind only: some senders give each kind of message a clock of its own.
            self._on_clock(message.time_boot_ms / 1000.0, now)

    def _on_board(self, board: Board, now: float) -> None:
        """A vehicle that takes another's place changes it once."""
        if board == self.board:
            return
        if board == self.former and now - self.changed <= BY_TURNS:
            self.doubled = now
        self.board, self.former, self.changed = board, self.board, now

    def _on_clock(self, booted: float, now: float) -> None:
        if booted < self.booted - 1.0:
            self.backwards.append(now)
        self.booted, ahead = booted, booted - now
        if self.clock is None or ahead > self.clock or ahead < self.clock - SAME_CLOCK:
            self.clock = ahead

    def is_mixed(self, now: float) -> bool:
        """Whether two boards answer from here, or two clocks come by turns."""
        by_turns = len(self.backwards) == BACKWARDS and now - self.backwards[0] <= WITHIN
        return by_turns or now - self.doubled <= LASTS

    def is_same(self, other: _Seen, *, both: bool) -> bool | None:
        """Whether both are one vehicle; None as long as that is not known.

        `both`: whether both send now. Of one that has fallen silent the clock may begin anew elsewhere.
        """
        mine, others = self.board, other.board
        if mine is None or others is None:
            if self.asked < ASKS:
                return None
        elif mine.uid or others.uid:
            if mine.uid != others.uid or not both:
                return mine.uid == others.uid
            return self._has_clock_of(other, OTHER_CLOCK)
        elif mine != others:
            return False
        if not (both or self.is_rival):
            return True
        return self._has_clock_of(other, SAME_CLOCK)

    def _has_clock_of(self, other: _Seen, apart: float) -> bool:
        """A rival is another vehicle unless its clock shows that it is not, others are none."""
        if self.clock is None or other.clock is None:
            return not self.is_rival
        return abs(self.clock - other.clock) <= apart


class Sources:
    """The addresses of one system id. `links` are the endpoints by number, for words.

    `events` are sentences for the log, and `moves` counts how often the vehicle came from another address.
    """

    def __init__(self, system: int, links: Sequence[str]) -> None:
        self._system, self._links = system, links
        #: Whether a second vehicle may be told by its address: behind a port that listens, or a second link.
        self._several = len(links) > 1 or any(link.startswith("udpin:") for link in links)
        self._seen: dict[Source, _Seen] = {}
        self._own: set[Source] = set()
        self._first = math.inf
        self._rivals: dict[Source, float] = {}
        # Own addresses from which a second vehicle sends, too.
        self._mixed: set[Source] = set()
        self.events: list[str] = []
        self.moves = 0

    # -- packets ------------------------------------------------------------------------------------------

    def accepts(self, source: Source) -> bool:
        """Whether packets from there are the vehicle's, as far as is known."""
        return source in self._own and source not in self._mixed

    def touch(self, source: Source, now: float) -> None:
        """A packet that need not be read came from one of the vehicle's own addresses."""
        self._seen[source].at = now

    def on_packet(self, source: Source, message: Any, now: float) -> bool:
        """A packet of the vehicle's autopilot; whether it is believed.

        What comes from an address before its first heartbeat is not: it may be no autopilot's.
        """
        seen = self._seen.get(source)
        if seen is None:
            if message.get_msgId() != dialect.MAVLINK_MSG_ID_HEARTBEAT:
                return False
            seen = self._add(source)
        seen.on_packet(message, now)
        if source in self._own:
            return self._is_first(source, seen, message, now)
        if not self._own:
            self._own.add(source)
            self._first = now
            return True
        if message.get_msgId() in _TELLING:
            self._on_other(source, seen, now)
        return source in self._own

    def _add(self, source: Source) -> _Seen:
        others = [each for each in self._seen if each not in self._own]
        if len(self._seen) >= MOST and others:
            oldest = min(others, key=lambda each: self._seen[each].at)
            del self._seen[oldest]
            self._rivals.pop(oldest, None)
        return self._seen.setdefault(source, _Seen())

    def _on_other(self, source: Source, seen: _Seen, now: float) -> None:
        """A heartbeat from an address that is not known as the vehicle's."""
        used = [each for each in self._own if now - self._seen[each].at <= IN_USE]
        if same_port := [each for each in used if each.link == source.link]:
            if any(self._seen[each].at - seen.first_beat >= BOTH for each in same_port):
                seen.is_rival = True
                self._conflict(source, now)
            return
        same = self._is_same(seen, used)
        if same is False:
            self._conflict(source, now)
        elif same:
            self._adopt(source, used)

    def _adopt(self, source: Source, used: Sequence[Source]) -> None:
        """The vehicle sends from there: beside the other links that are in `use`, or instead of all."""
        if not used:
            before = ", ".join(map(self._words, sorted(self._own)))
            self.events.append(f"heard from {self._words(source)}, no longer from {before}")
        self._own = {each for each in self._own if used and each.link != source.link} | {source}
        self._rivals.pop(source, None)
        self.moves += 1

    def _is_same(self, seen: _Seen, used: Sequence[Source]) -> bool | None:
        found = [seen.is_same(self._seen[each], both=bool(used)) for each in used or self._own]
        return False if False in found else None if None in found else True

    def _is_first(self, source: Source, seen: _Seen, message: Any, now: float) -> bool:
        """Whether a packet from an own address is the vehicle's, and not of a second one behind it."""
        first = seen.strands.is_first(message, now)
        if not seen.is_mixed(now):
            self._mixed.discard(source)
            return first or not seen.strands.is_doubled(now)
        if source not in self._mixed:
            self._mixed.add(source)
            self.events.append(
                f"two vehicles send as system {self._system}, both over {self._words(source)}: the telemetry "
                f"of the second is ignored, but both get what is sent; {REMEDY}"
            )
        return first

    def _conflict(self, source: Source, now: float) -> None:
        if now - self._rivals.get(source, -math.inf) > LASTS:
            own = ", ".join(map(self._words, sorted(self._own)))
            self.events.append(
                f"two vehicles send as system {self._system}: {own}, and {self._words(source)}, which is "
                f"ignored; {REMEDY}"
            )
        self._rivals[source] = now

    # -- what follows -------------------------------------------------------------------------------------

    def conflict(self, now: float) -> str:
        """Which addresses are two vehicles with this system id; '' when none are."""
        rivals = [each for each, at in self._rivals.items() if now - at <= LASTS]
        if rivals:
            names = " and ".join(map(self._words, (*sorted(self._own), *sorted(rivals))))
            return f"two vehicles send as system {self._system}: {names}"
        for each in sorted(self._own):
            if self._seen[each].is_mixed(now):
                return f"two vehicles send as system {self._system}, both over {self._words(each)}"
        return ""

    def is_settled(self, now: float) -> bool:
        """Whether it is known that there is one vehicle, or that there are two.

        Of two behind one far end that is known once both have been asked for their boards.
        """
        if not self._several or self.conflict(now):
            return True
        pending = (now - seen.beat <= LASTS for source, seen in self._seen.items() if source not in self._own)
        return now - self._first >= LISTENS and not any(pending)

    def due(self, now: float) -> list[Source]:
        """The addresses to ask for AUTOPILOT_VERSION now: who sends from there is not certain."""
        links = {each.link for each in self._own if now - self._seen[each].at <= IN_USE}
        found = []
        for source, seen in self._seen.items():
            if source in self._own:
                waits = now - seen.heartbeats.contradicted <= LASTS
            else:
                unknown = seen.board is None and source.link not in links
                waits = unknown and now - seen.beat <= LASTS and seen.asked < ASKS
            if waits and now - seen.asked_at >= ASK_AGAIN:
                seen.asked, seen.asked_at = seen.asked + 1, now
                found.append(source)
        return found

    def address(self, link: int) -> str:
        """Where the vehicle is behind a link; '' for everywhere."""
        return next((each.address for each in self._own if each.link == link), "")

    def _words(self, source: Source) -> str:
        """`udpin:0.0.0.0:14550 from 10.0.0.5:14555`."""
        endpoint = self._links[source.link]
        return f"{endpoint} from {source.address}" if source.address else endpoint
