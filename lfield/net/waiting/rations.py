"""How much processing time the messages of each member may take, and what follows when they take more.

A member is a host of the team. Its account is a leaky bucket: the time that its messages have taken, less
RATION of the time that has passed. Over ALLOWANCE the member is over its budget. Then:

- Messages of members within their budgets come first (`Standing.OVER`).
- Once every PROBE_EVERY its link is not read for PROBE. A host that waits for answers before it sends on, as
  with every hop, has sent only a few messages by then. A host that sends without waiting has sent a crowd;
  of large transfers two of one coordinator, the second before an answer to the first, are one.
- A member with a crowd is held to its ration (`Standing.HELD`), and after OVER_FOR its link is to be closed
  (`Standing.FLOOD`).

So a hop costs what it costs on any computer, however slow, and is never the reason for a closed link.
Pure: time and processing time are parameters, both in seconds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum, auto

#: The part of one processor that the messages of a member may take for long.
RATION = 0.1
#: Processing time that a member may take at once, and the most that is counted beyond that.
ALLOWANCE, BEYOND = 0.5, 0.05
#: Processing time that a member which is held to its ration gets at once.
PORTION = 0.002
#: A link is closed after so long over budget.
OVER_FOR = 5.0
#: How often a member over budget is not read for a while, and for how long.
PROBE_EVERY, PROBE = 1.0, 0.1
#: The longest time for which a member is not read: its peer must not take the link for a dead one.
LONGEST_HOLD = 0.5
#: So many messages in one read are a crowd; a long message counts as several (`FramedLink.weight`).
CROWD = 64


class Standing(Enum):
    """How the next message of a member is to be treated."""

    #: It may be taken.
    WITHIN = auto()
    #: It may be taken when no message of a member within its budget waits.
    OVER = auto()
    #: Not before `Rations.held_until`.
    HELD = auto()
    #: Never: the link is to be closed.
    FLOOD = auto()


@dataclass(slots=True)
class _Account:
    at: float
    #: Processing time that is not paid off yet.
    level: float = 0.0
    held_until: float = -math.inf
    probe_due: float = -math.inf
    #: Whether a crowd came in one read, and since when the member has been over budget with one.
    is_crowded: bool = False
    flooding_since: float = math.inf
    #: Since when it has been over budget and made new links.
    connecting_since: float = math.inf
    #: Whether it was held since its last read began, and before the one that is being taken.
    was_held: bool = False
    is_after_hold: bool = False
    #: The weight of what came since the last hold, as far as that belongs together.
    after_hold: int = 0
    #: Since when it has been over its budget, and whether that is reported.
    over_since: float = math.inf
    is_reported: bool = False


class Rations:
    """The accounts of all members, by name."""

    def __init__(self) -> None:
        self._accounts: dict[str, _Account] = {}

    def on_work(self, member: str, seconds: float, now: float, weight: int = 0) -> Standing:
        """Messages of a member have taken `seconds`; what was taken of its read so far has that `weight`."""
        account = self._account(member, now)
        account.level = min(account.level + max(0.0, seconds), ALLOWANCE + BEYOND)
        if weight >= CROWD:
            account.is_crowded = True
        if account.level <= ALLOWANCE:
            return Standing.WITHIN
        account.over_since = min(account.over_since, now)
        if account.is_crowded:
            account.flooding_since = min(account.flooding_since, now)
            if now - account.flooding_since >= OVER_FOR:
                return Standing.FLOOD
            debt = (account.level - ALLOWANCE + PORTION) / RATION
            return self._hold(account, now + min(debt, LONGEST_HOLD))
        if now >= account.probe_due:
            account.probe_due = now + PROBE_EVERY
            return self._hold(account, now + PROBE)
        return Standing.OVER

    def on_handshake(self, member: str, seconds: float, now: float) -> Standing:
        """A new link of a member is proven. Who makes links while it is over its budget sends a crowd."""
        account = self._account(member, now)
        account.level = min(account.level + max(0.0, seconds), ALLOWANCE + BEYOND)
        if account.level <= ALLOWANCE:
            return Standing.WITHIN
        account.over_since = min(account.over_since, now)
        account.connecting_since = min(account.connecting_since, now)
        return Standing.FLOOD if now - account.connecting_since >= OVER_FOR else Standing.OVER

    def on_read(self, member: str, now: float) -> None:
        """Bytes of a member have come, of which nothing was taken yet."""
        account = self._account(member, now)
        account.is_after_hold, account.was_held = account.was_held, False

    def on_drained(self, member: str, weight: int, now: float, *, is_amid: bool = False) -> None:
        """All of a read was taken. A small one after a hold shows that the member waits for answers.

        Where it ends amid a message, the next read belongs to it.
        """
        account = self._account(member, now)
        if not account.is_after_hold:
            return
        account.after_hold += weight
        if is_amid:
            account.was_held = True
        elif account.after_hold < CROWD:
            account.is_crowded, account.flooding_since = False, math.inf

    def on_closed(self, member: str, now: float) -> None:
        """Its link was closed for a flood: the next link begins with the same debt, and a new term."""
        account = self._account(member, now)
        account.flooding_since = account.connecting_since = math.inf

    def held_until(self, member: str) -> float:
        """When a member is to be read on, in seconds of the same clock."""
        account = self._accounts.get(member)
        return -math.inf if account is None else account.held_until

    def may_report(self, member: str, now: float) -> bool:
        """Whether it is news that a member is over its budget: once, with a crowd or after OVER_FOR."""
        account = self._account(member, now)
        is_news = account.is_crowded or now - account.over_since >= OVER_FOR
        is_news, account.is_reported = is_news and not account.is_reported, account.is_reported or is_news
        return is_news

    @staticmethod
    def _hold(account: _Account, until: float) -> Standing:
        account.held_until, account.was_held, account.after_hold = until, True, 0
        return Standing.HELD

    def _account(self, member: str, now: float) -> _Account:
        """The account of a member as it is now."""
        account = self._accounts.get(member)
        if account is None:
            account = self._accounts[member] = _Account(now)
        account.level = max(0.0, account.level - RATION * (now - account.at))
        account.at = now
        if account.level <= ALLOWANCE / 2:
            account.is_crowded = account.is_reported = False
            account.flooding_since = account.over_since = account.connecting_since = math.inf
        return account
