"""Leaky-bucket CPU budgets of members (hosts of the team), with probes that detect flooding. Sans-IO.

The account of a member is the CPU time of its messages minus CPU_SHARE of the elapsed time. Above BURST the
member is over its budget. Then:

- Messages of members within their budgets come first (`BudgetState.OVER`).
- PROBE_EVERY after the last probe, a new one starts: coordinators and answers for the member are withheld
  until its messages have used almost no time for PROBE. A host that waits for answers, as every hop does,
  soon has no more messages to send: each coordinator has at most one transfer in flight. A host that sends
  without waiting accumulates a crowd of messages, counted by `FramedLink.weight`. A second transfer of a
  coordinator whose first has no answer is a crowd and a proof.
- A member with a crowd is limited to its ration (`BudgetState.HELD`). After MAX_EXCESS_TIME its link is
  closed (`BudgetState.FLOOD`), unless the probe ends earlier without a proof.

So a hop is never the reason for a closed link, also on a slow computer. Times are in seconds.
"""

from __future__ import annotations

import math
from enum import Enum, auto

from msgspec import Struct

#: Long-term share of one processor for the messages of a member.
CPU_SHARE = 0.1
#: Burst of CPU time of a member in seconds, and the maximum debt counted beyond this burst.
BURST, MAX_DEBT = 0.5, 0.05
#: Burst of a member that is limited to its ration, in seconds.
HELD_BURST = 0.002
#: Seconds over budget after which a link is closed.
MAX_EXCESS_TIME = 5.0
#: Seconds between the end of a probe and the next one. A probe ends when the messages of the member have used
#: no more than PROBE_LIMIT for this many seconds.
PROBE_EVERY, PROBE = 1.0, 0.1
PROBE_LIMIT = CPU_SHARE * PROBE
#: Longest pause of reading: the link must not seem dead to the peer.
LONGEST_HOLD = 0.5
#: Messages during a probe that make a crowd; a long message counts as several (`FramedLink.weight`).
CROWD_WEIGHT = 128
#: Weight that proves that a member does not wait for answers; a backlog of messages has less.
PROOF_WEIGHT = 1 << 20


class BudgetState(Enum):
    """The treatment of the next message of a member."""

    #: The message is processed at once.
    WITHIN = auto()
    #: The message is processed when no message of a member within its budget waits.
    OVER = auto()
    #: The message is not processed before `CpuBudgets.held_until`.
    HELD = auto()
    #: The message is not processed: the link is to be closed.
    FLOOD = auto()


class _Account(Struct):
    at: float
    #: CPU time not yet repaid.
    level: float = 0.0
    held_until: float = -math.inf
    #: The time when the next probe may start; the time when the present one ends without further messages;
    #: the CPU time used since that was set, in seconds.
    probe_due: float = -math.inf
    probe_ends: float | None = None
    probed: float = 0.0
    #: Whether a crowd was counted, whether it is a proof, and the time since when the member is over budget
    #: with a crowd.
    is_crowded: bool = False
    is_proven: bool = False
    flooding_since: float = math.inf
    #: The time since when the member makes new links while over budget.
    connecting_since: float = math.inf
    #: The time since when the member is over its budget, and whether this was logged.
    over_since: float = math.inf
    is_reported: bool = False


class CpuBudgets:
    """The accounts of all members, by name."""

    def __init__(self) -> None:
        self._accounts: dict[str, _Account] = {}

    def on_work(self, member: str, seconds: float, now: float, weight: int = 0) -> BudgetState:
        """Charge a member with `seconds`; `weight` is the weight of the messages that arrived during the
        probe.
        """
        account = self._account(member, now)
        account.level = min(account.level + max(0.0, seconds), BURST + MAX_DEBT)
        if account.probe_ends is not None:
            self._on_probed(account, seconds, now, weight)
        if account.level <= BURST:
            return BudgetState.WITHIN
        account.over_since = min(account.over_since, now)
        if account.probe_ends is None and now >= account.probe_due:
            account.probe_ends, account.probed = now + PROBE, 0.0
        if not account.is_crowded:
            return BudgetState.OVER
        account.flooding_since = min(account.flooding_since, now)
        if now - account.flooding_since >= MAX_EXCESS_TIME:
            return BudgetState.FLOOD
        excess_time = (account.level - BURST + HELD_BURST) / CPU_SHARE
        account.held_until = now + min(excess_time, LONGEST_HOLD)
        if account.probe_ends is not None:
            # A member can show that it sends no messages only while its link is read.
            account.probe_ends, account.probed = account.held_until + PROBE, 0.0
        return BudgetState.HELD

    def on_handshake(self, member: str, seconds: float, now: float) -> BudgetState:
        """Charge a member for a handshake. New links while over budget count as a crowd."""
        account = self._account(member, now)
        account.level = min(account.level + max(0.0, seconds), BURST + MAX_DEBT)
        if account.level <= BURST:
            return BudgetState.WITHIN
        account.over_since = min(account.over_since, now)
        account.connecting_since = min(account.connecting_since, now)
        return BudgetState.FLOOD if now - account.connecting_since >= MAX_EXCESS_TIME else BudgetState.OVER

    def probe_ends(self, member: str) -> float | None:
        """The end of a member's probe without further messages, in seconds; None without a probe."""
        account = self._accounts.get(member)
        return None if account is None else account.probe_ends

    def on_probe_end(self, member: str, now: float) -> None:
        """The time of `probe_ends` has passed: the member waits for answers."""
        account = self._account(member, now)
        account.probe_ends, account.probe_due = None, now + PROBE_EVERY
        if not account.is_proven:
            account.is_crowded, account.flooding_since = False, math.inf

    def on_closed(self, member: str, now: float) -> None:
        """The link of a member was closed for flooding: the next link starts with the same debt and a new
        MAX_EXCESS_TIME.
        """
        account = self._account(member, now)
        account.flooding_since = account.connecting_since = math.inf
        account.probe_ends, account.probe_due = None, -math.inf

    def held_until(self, member: str) -> float:
        """The time when reading of a member resumes, in seconds of the same clock."""
        account = self._accounts.get(member)
        return -math.inf if account is None else account.held_until

    def may_report(self, member: str, now: float) -> bool:
        """Whether to log that a member is over its budget: once, with a crowd or after MAX_EXCESS_TIME."""
        account = self._account(member, now)
        is_new = account.is_crowded or now - account.over_since >= MAX_EXCESS_TIME
        is_new, account.is_reported = is_new and not account.is_reported, account.is_reported or is_new
        return is_new

    @staticmethod
    def _on_probed(account: _Account, seconds: float, now: float, weight: int) -> None:
        account.is_crowded = account.is_crowded or weight >= CROWD_WEIGHT
        account.is_proven = account.is_proven or weight >= PROOF_WEIGHT
        account.probed += seconds
        if account.probed > PROBE_LIMIT:
            account.probe_ends, account.probed = now + PROBE, 0.0

    def _account(self, member: str, now: float) -> _Account:
        """The account of a member, updated to this time."""
        account = self._accounts.get(member)
        if account is None:
            account = self._accounts[member] = _Account(now)
        account.level = max(0.0, account.level - CPU_SHARE * (now - account.at))
        account.at = now
        if account.level <= BURST / 2:
            account.is_crowded = account.is_proven = account.is_reported = False
            account.flooding_since = account.over_since = account.connecting_since = math.inf
        return account
