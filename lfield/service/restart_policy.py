"""Decides whether a mission's host that has ended is started again. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from lfield import exit_status

#: Seconds before a restart; at most `MAX_RESTARTS` within `PERIOD` seconds.
RESTART_DELAY, MAX_RESTARTS, PERIOD = 2.0, 5, 600.0
#: Statuses after which a host is restarted: a crash; a device or network that is not available yet.
RESTARTED = (exit_status.SOFTWARE, exit_status.UNAVAILABLE)


class Verdict(NamedTuple):
    """Whether to restart, and the reason of the host's end."""

    restarts: bool
    reason: str


def judge(status: int, reason: str, earlier: Sequence[float], now: float) -> Verdict:
    """The verdict about an exit status; of a signal that is its negative number.

    `earlier` are the times of the restarts so far, in seconds as `now`.
    """
    reason_text = reason or (
        f"killed by signal {-status}"
        if status < 0
        else exit_status.MEANINGS.get(status, f"status {status}").partition(";")[0]
    )
    if status == exit_status.NO_OUTPUT and not reason:
        # On a full disk the host cannot store its reason either.
        reason_text += "; its disk may be full: make room"
    if status >= 0 and status not in RESTARTED:
        return Verdict(False, reason_text)
    recent = [time for time in earlier if now - time < PERIOD]
    if len(recent) >= MAX_RESTARTS:
        return Verdict(
            False, f"it has failed {len(recent) + 1} times in {PERIOD:g} s, the last time: {reason_text}"
        )
    return Verdict(True, reason_text)
