"""How much processing time the messages of each member may take, and what follows when they take more.

A member is a host of the team. Its account is a leaky bucket: the time that its messages have taken, less
RATION of the time that has passed. Over ALLOWANCE the member is over its budget. Then:

- Messages of members within their budgets come first (`Standing.OVER`).
- PROBE_EVERY after the last probe it is probed again: coordinators and answers for it are withheld until its
  messages have taken next to nothing for PROBE. A host that waits for answers, as with every hop, then soon
  has nothing more to send: of each coordinator at most one transfer is under way. A host that sends without
  waiting continues, and what comes during the probe is a crowd. `FramedLink.weight` counts it: a second
  transfer of a coordinator whose first has no answer is a crowd by itself, and a proof.
- A member with a crowd is held to its ration (`Standing.HELD`), and after OVER_FOR its link is to be closed
  (`Standing.FLOOD`), unless the probe ends before and nothing is proven.

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
#: How long after the end of a probe the next one begins. A probe ends when the messages of the member have
#: taken no more than QUIET for so many seconds.
PROBE_EVERY, PROBE = 1.0, 0.1
QUIET = RATION * PROBE
#: The longest time for which a member is not read: its peer must not take the link for a dead one.
LONGEST_HOLD = 0.5
#: So many messages during a probe are a crowd; a long message counts as several (`FramedLink.weight`).
CROWD = 128
#: From this weight on it is proven that a member does not wait for answers; a backlog of messages has less.
PROVEN = 1 << 20


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
    #: When the next probe may begin; when the present one ends if no more comes, and what came since that
    #: was set last took, in seconds.
    probe_due: float = -math.inf
    probe_ends: float | None = None
    probed: float = 0.0
    #: Whether a crowd came, and since when the member has been over budget with one.
    is_crowded: bool = False
    is_proven: bool = False
    flooding_since: float = math.inf
    #: Since when it has been over budget and made new links.
    connecting_since: float = math.inf
    #: Since when it has been over its budget, and whether that is reported.
    over_since: float = math.inf
    is_reported: bool = False


class Rations:
    """The accounts of all members, by name."""

    def __init__(self) -> None:
        self._accounts: dict[str, _Account] = {}

    def on_work(self, member: str, seconds: float, now: float, weight: int = 0) -> Standing:
        """Messages of a member have taken `seconds`; `weight` is what has come of it during the probe."""
        account = self._account(member, now)
        account.level = min(account.level + max(0.0, seconds), ALLOWANCE + BEYOND)
        if account.probe_ends is not None:
            self._on_probed(account, seconds, now, weight)
        if account.level <= ALLOWANCE:
            return Standing.WITHIN
        account.over_since = min(account.over_since, now)
        if account.probe_ends is None and now >= account.probe_due:
            account.probe_ends, account.probed = now + PROBE, 0.0
        if not account.is_crowded:
            return Standing.OVER
        account.flooding_since = min(account.flooding_since, now)
        if now - account.flooding_since >= OVER_FOR:
            return Standing.FLOOD
        debt = (account.level - ALLOWANCE + PORTION) / RATION
        account.held_until = now + min(debt, LONGEST_HOLD)
        if account.probe_ends is not None:
            # Only while it is read can it show that it sends nothing.
            account.probe_ends, account.probed = account.held_until + PROBE, 0.0
        return Standing.HELD

    def on_handshake(self, member: str, seconds: float, now: float) -> Standing:
        """A new link of a member is proven. Who makes links while it is over its budget sends a crowd."""
        account = self._account(member, now)
        account.level = min(account.level + max(0.0, seconds), ALLOWANCE + BEYOND)
        if account.level <= ALLOWANCE:
            return Standing.WITHIN
        account.over_since = min(account.over_since, now)
        account.connecting_since = min(account.connecting_since, now)
        return Standing.FLOOD if now - account.connecting_since >= OVER_FOR else Standing.OVER

    def probe_ends(self, member: str) -> float | None:
        """When the probe of a member ends if no more comes, in seconds of the same clock; None without."""
        account = self._accounts.get(member)
        return None if account is None else account.probe_ends

    def on_probe_end(self, member: str, now: float) -> None:
        """The time that `probe_ends` has told is over: the member has shown that it waits for answers."""
        account = self._account(member, now)
        account.probe_ends, account.probe_due = None, now + PROBE_EVERY
        if not account.is_proven:
            account.is_crowded, account.flooding_since = False, math.inf

    def on_closed(self, member: str, now: float) -> None:
        """Its link was closed for a flood: the next link begins with the same debt, and a new term."""
        account = self._account(member, now)
        account.flooding_since = account.connecting_since = math.inf
        account.probe_ends, account.probe_due = None, -math.inf

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
    def _on_probed(account: _Account, seconds: float, now: float, weight: int) -> None:
        account.is_crowded = account.is_crowded or weight >= CROWD
        account.is_proven = account.is_proven or weight >= PROVEN
        account.probed += seconds
        if account.probed > QUIET:
            account.probe_ends, account.probed = now + PROBE, 0.0

    def _account(self, member: str, now: float) -> _Account:
        """The account of a member as it is now."""
        account = self._accounts.get(member)
        if account is None:
            account = self._accounts[member] = _Account(now)
        account.level = max(0.0, account.level - RATION * (now - account.at))
        account.at = now
        if account.level <= ALLOWANCE / 2:
            account.is_crowded = account.is_proven = account.is_reported = False
            account.flooding_since = account.over_since = account.connecting_since = math.inf
        return account
