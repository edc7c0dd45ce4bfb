"""What the buttons of the page do, and what of that is not done any more when a press comes late.

How late it is goes by the clock of the server alone, whatever that of a browser shows.

Each look says when it was made, and a press says how long the page had had the last one (browser/team.js). So
`pressed` is when that was on the server's clock, or as much earlier as the look was under way.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Mapping

from lfield.operator.dashboard.operator_actions import OperatorActions, OrderOutcome

#: What is written into the logs of the hosts when somebody presses STOP here.
REASON = "on the page of lfield watch"
#: For so many seconds what lets vehicles move again may be under way.
MAX_DELAY = 10.0
#: What does so. STOP and Pause make a team safer: late is better than never.
_RELEASES = ("lift", "resume")

NOT_SHOWN_YET = "the page had not seen the team yet; look, and press it again"


def buttons(actions: OperatorActions, reason: str) -> Mapping[str, Callable[[], Awaitable[OrderOutcome]]]:
    """What each of them does; the reason is that of a stop."""
    return {
        "stop": lambda: actions.stop(reason),
        "lift": actions.lift,
        "pause": actions.pause,
        "resume": actions.resume,
    }


def refusal(order: object, pressed: object, now: float) -> str:
    """Why that order is not given any more, '' when it is.

    `pressed` is whatever came as that, and `now` the time by the same clock (s). Who does not say when it was
    pressed releases nothing.
    """
    if order not in _RELEASES:
        return ""
    late = _late(pressed, now)
    if late is None:
        return NOT_SHOWN_YET
    if late <= MAX_DELAY:
        return ""
    return f"it came {late:.0f} s after it was pressed, which is too late; look, and press it again"


def stop_reason(reason: str, pressed: object, now: float) -> str:
    """The reason of a stop, which says how late it came when that was late."""
    late = _late(pressed, now)
    return reason if late is None or late <= MAX_DELAY else f"{reason}; it came {late:.0f} s late"


def _late(pressed: object, now: float) -> float | None:
    """Seconds; None where nobody knows it, as of a press that is still to come."""
    if isinstance(pressed, bool) or not isinstance(pressed, int | float) or pressed > now + MAX_DELAY:
        return None
    return max(0.0, now - pressed)
