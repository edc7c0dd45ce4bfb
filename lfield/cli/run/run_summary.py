"""The last line of `lfield up --all`: mission completed, or the failure and its host."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping

from lfield import exit_status
from lfield.host.process.run_result import RunResult
from lfield.text import log_messages
from lfield.text.log_messages import LogLine

#: The most hosts with reasons in the line, which must be readable for a large team.
MAX_REASONS = 2


def summary(
    statuses: Mapping[str, int], status: int, seconds: float, results: Mapping[str, RunResult]
) -> LogLine:
    """The last line of a run after `seconds`, from the exit status and the result of each host.

    The order of `statuses` is that of the reasons, after their severity.
    """
    hops = total_hops(results)
    if status == exit_status.DONE:
        return log_messages.MISSION_COMPLETED.line(seconds=seconds, hops=hops, status=status)
    if status == exit_status.INTERRUPTED:
        return log_messages.MISSION_INTERRUPTED.line(seconds=seconds, hops=hops, status=status)
    where, reason = _failure(statuses, status, results)
    return log_messages.MISSION_FAILED.line(
        where=where, seconds=seconds, hops=hops, status=status, reason=reason
    )


def _failure(statuses: Mapping[str, int], status: int, results: Mapping[str, RunResult]) -> tuple[str, str]:
    """The hosts where a mission failed, and the reasons."""
    failed = [host for host, each in statuses.items() if each == status]
    others = [host for host, each in statuses.items() if each not in (exit_status.DONE, status)]
    reasons: dict[str, str] = {}
    for host in failed + others:
        reason = results[host].reason
        if reason and reason not in reasons.values():
            reasons[host] = reason
    if not reasons:
        meaning = exit_status.MEANINGS.get(status, "a host was killed").partition(";")[0]
        return ", ".join(failed), meaning.removeprefix("the mission failed: ")
    (first, reason), *further = reasons.items()
    parts = [reason, *(f"{host}: {text}" for host, text in further[: MAX_REASONS - 1])]
    if len(further) >= MAX_REASONS:
        parts.append(f"failures on {len(further) - MAX_REASONS + 1} more hosts")
    return first, "; ".join(parts)


def total_hops(results: Mapping[str, RunResult]) -> int:
    """The hops of coordinators: for each start the largest number of any host, as a killed host reports
    none.
    """
    hops_by_start: dict[str, int] = defaultdict(int)
    for result in results.values():
        for start, hops in result.hops.items():
            hops_by_start[start] = max(hops_by_start[start], hops)
    return sum(hops_by_start.values())
