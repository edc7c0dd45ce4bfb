"""The orders of the page's buttons, and the refusal of orders that arrive too late.

Delays are measured by the server's clock alone. Each snapshot carries the time when it was made, and a press
adds the time for which the page has had the last snapshot (browser/team.js). So `pressed` is the time of the
press by the server's clock, too early by at most the time that the snapshot was in transit.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Mapping

from lfield.operator.dashboard.operator_actions import OperatorActions, OrderOutcome

#: The reason of a stop from the page, in the logs of the hosts.
REASON = "on the page of lfield watch"
#: Maximum delay (s) of an order that lets vehicles move again, and of a line of input.
MAX_DELAY = 10.0
#: These orders. STOP and Pause make a team safer and are executed however late; a late line would answer
#: another question.
_RELEASES = ("lift", "resume", "type")

NOT_SHOWN_YET = "the page had no state of the team yet; check the state, and press it again"


def buttons(actions: OperatorActions, reason: str) -> Mapping[str, Callable[[], Awaitable[OrderOutcome]]]:
    """The action of each button; `reason` is that of a stop."""
    return {
        "stop": lambda: actions.stop(reason),
        "lift": actions.lift,
        "pause": actions.pause,
        "resume": actions.resume,
    }


def refusal(order: object, pressed: object, now: float) -> str:
    """The reason why an order is refused as too late, '' when it is accepted.

    `pressed` is the unchecked value from the page, `now` the time by the same clock (s). A release without a
    valid time is refused.
    """
    if order not in _RELEASES:
        return ""
    late = _late(pressed, now)
    if late is None:
        return NOT_SHOWN_YET
    if late <= MAX_DELAY:
        return ""
    return f"it arrived {late:.0f} s after the press, which is too late; check the state, and press it again"


def stop_reason(reason: str, pressed: object, now: float) -> str:
    """The reason of a stop, with its delay if it is late."""
    late = _late(pressed, now)
    return reason if late is None or late <= MAX_DELAY else f"{reason}; it arrived {late:.0f} s late"


def _late(pressed: object, now: float) -> float | None:
    """Seconds; None for a value that is not a number or in the future."""
    if isinstance(pressed, bool) or not isinstance(pressed, int | float) or pressed > now + MAX_DELAY:
        return None
    return max(0.0, now - pressed)
