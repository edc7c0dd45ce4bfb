"""Choice between the path of a link and that of its standby connection. Sans-IO.

The other path is used when this one is dead: data has awaited an acknowledgement for longer than the path can
cause. The other path is also used when it has been much better for a while, but only while no transfer or
message is under way.
"""

from __future__ import annotations

import math
from typing import Literal, NamedTuple

from lfield.net.health.traffic import Delivery

#: Minimum seconds without an acknowledgement after which a path is dead, and the factor over the limit of its
#: round trip: one lost packet is repeated within this time.
STALLED_AFTER, STALLED_ROUND_TRIPS = 0.3, 2.0
#: Number of variations added to the smoothed round trip (RFC 6298).
DEVIATIONS = 4.0
#: The other path is preferred if its delay is lower by this factor, by at least this number of seconds, for
#: this number of seconds.
BETTER_FACTOR, MIN_GAIN, BETTER_FOR = 2.0, 0.02, 30.0
#: Seconds without work after which no transfer or message is under way.
QUIET_FOR = 0.3
#: The delay in seconds by a lost packet in addition to a round trip: the margin of the retransmission
#: time-out.
REPEAT_TIME = 0.2
#: A path that works again this soon after it was left was slow, not dead. The limit is then doubled, up to a
#: factor, until no path was left for a while.
RETURNED_WITHIN, MAX_CAUTION, CAUTION_PERIOD = 2.0, 4.0, 60.0

#: The decision: no change, or use of the other path because this one is dead, or because the other one is
#: better.
Decision = Literal["", "dead", "better"]


class PathState(NamedTuple):
    """A reading of one path: `round_trip` is the smoothed round trip of heartbeats in seconds, 0 if unknown,
    `bound` its limit, `loss` a share from 0 to 1. `work` counts transfers and messages, sent and received.

    The round trip of the kernel contains the delays of acknowledgements, so it is only a limit.
    """

    delivery: Delivery
    round_trip: float = 0.0
    loss: float = 0.0
    bound: float = 0.0
    work: int = 0

    @property
    def delay(self) -> float:
        """The expected seconds until a packet is answered, with repetitions."""
        loss = min(self.loss, 0.99)
        return self.round_trip + loss / (1.0 - loss) * (self.round_trip + REPEAT_TIME)

    @property
    def limit(self) -> float:
        """Seconds within which an acknowledgement is expected."""
        kernel = self.delivery.round_trip + DEVIATIONS * self.delivery.variation
        return max(STALLED_AFTER, STALLED_ROUND_TRIPS * max(kernel, self.bound))


class PathChoice:
    """The paths to one host. Times are monotonic seconds."""

    def __init__(self) -> None:
        self._acked, self._pending_since = -1, math.inf
        self._work, self._worked_at = -1, 0.0
        #: The time since when the standby is better, and the time when a dead path was left.
        self._better_since, self._left_at = math.inf, -math.inf
        self._caution = 1.0

    def on_link(self) -> None:
        """The link runs over another connection from now on."""
        self._acked, self._pending_since, self._better_since = -1, math.inf, math.inf
        self._work = -1

    def on_left(self, now: float) -> None:
        """The path was left because it seemed dead."""
        if now - self._left_at > CAUTION_PERIOD:
            self._caution = 1.0
        self._left_at = now

    def on_standby(self, now: float) -> None:
        """A standby connection exists, so the other path works."""
        self._better_since = math.inf
        if now - self._left_at <= RETURNED_WITHIN:
            self._caution = min(MAX_CAUTION, 2.0 * self._caution)

    def decide(self, now: float, link: PathState, standby: PathState | None) -> Decision:
        """Decide after a reading of both paths; without a standby, whether one is needed."""
        delivery = link.delivery
        if not delivery.is_pending:
            self._pending_since = math.inf
        elif delivery.acked != self._acked or self._pending_since == math.inf:
            self._pending_since = now
        self._acked = delivery.acked
        if link.work != self._work:
            self._work, self._worked_at = link.work, now
        if now - self._left_at > CAUTION_PERIOD:
            self._caution = 1.0
        if now - self._pending_since >= self._caution * link.limit:
            return "dead"
        return "better" if self._is_better(now, link, standby) else ""

    def _is_better(self, now: float, link: PathState, standby: PathState | None) -> bool:
        if (
            standby is None
            or not standby.round_trip
            or link.delay < standby.delay + max(MIN_GAIN, (BETTER_FACTOR - 1.0) * standby.delay)
        ):
            self._better_since = math.inf
            return False
        self._better_since = min(self._better_since, now)
        is_quiet = not link.delivery.is_pending and now - self._worked_at >= QUIET_FOR
        return is_quiet and now - self._better_since >= BETTER_FOR
