"""How late a press comes, by the clock of the server alone, whatever that of a browser shows. Pure.

Each look says when it was made, and a press says how long the page had had the last one (browser/team.js). So
`pressed` is when that was on the server's clock, or as much earlier as the look was under way.
"""

from __future__ import annotations

#: For so many seconds what lets vehicles move again may be under way.
PROMPT = 10.0
#: What does so. STOP and Pause make a team safer: late is better than never.
_RELEASES = ("lift", "resume")

UNSEEN = "the page had not seen the team yet; look, and press it again"


def refusal(order: object, pressed: object, now: float) -> str:
    """Why that order is not given any more, '' when it is."""
    if order not in _RELEASES:
        return ""
    late = _late(pressed, now)
    if late is None:
        return UNSEEN
    if late <= PROMPT:
        return ""
    return f"it came {late:.0f} s after it was pressed, which is too late; look, and press it again"


def told(reason: str, pressed: object, now: float) -> str:
    """The reason of a stop, which says how late it came when that was late."""
    late = _late(pressed, now)
    return reason if late is None or late <= PROMPT else f"{reason}; it came {late:.0f} s late"


def _late(pressed: object, now: float) -> float | None:
    """Seconds; None where nobody knows it, as of a press that is still to come."""
    if isinstance(pressed, bool) or not isinstance(pressed, int | float) or pressed > now + PROMPT:
        return None
    return max(0.0, now - pressed)
