"""Epoch numbers (fencing tokens) of the starts of a coordinator: allocation and order. Sans-IO.

A home host counts its starts 1, 2, 3 ... A recovery needs a number that is above all known numbers and that
no other host allocates: the next multiple of `GENERATION_STRIDE` plus the number of its host. A home that
knows of a recovery continues with multiples of `GENERATION_STRIDE`. The number shows whether a start is a
recovery (decision 27).

    1, 2, 3     starts by the home
    65537       recovered by the first host of the deployment, after any of these
    131072      started by the home after that
"""

from __future__ import annotations

#: The distance between two starts of a home, which leaves numbers for recoveries by every host; teams are far
#: smaller.
GENERATION_STRIDE = 1 << 16


def next_start(newest: int) -> int:
    """The number of the next start by the home, after the `newest` known one (0 for none)."""
    return newest + 1 if newest + 1 < GENERATION_STRIDE else _next_stride(newest)


def next_recovery(newest: int, host: int) -> int:
    """The number of a recovery by this host (numbered from 0); no other host allocates it."""
    return _next_stride(newest) + host + 1


def is_recovery(generation: int) -> bool:
    """Whether a start is a recovery, authorised by an operator or a majority."""
    return generation >= GENERATION_STRIDE and generation % GENERATION_STRIDE != 0


def outranks(generation: int, other: int) -> bool:
    """Whether the start `generation` continues when both may be alive.

    The newest recovery wins; without a recovery, the earliest start, which has done work.
    """
    if is_recovery(generation) != is_recovery(other):
        return is_recovery(generation)
    return generation > other if is_recovery(generation) else generation < other


def blocks(generation: int, other: int, *, alive: bool) -> bool:
    """Whether a start, given whether it is `alive`, prevents another start from running.

    A recovery supersedes all earlier starts, whether or not the recovery succeeded.
    """
    return (alive and outranks(generation, other)) or (is_recovery(generation) and generation > other)


def stop_reason(agent: str, generation: int, by: int, host: str) -> str:
    """The log sentence for a start that was stopped because of another one, known to `host`."""
    if is_recovery(by):
        return f"{agent} was recovered (start {by}, says {host}), so start {generation} was stopped"
    return f"an earlier start of {agent} is alive on {host}, so this later one was stopped"


def _next_stride(newest: int) -> int:
    return (newest // GENERATION_STRIDE + 1) * GENERATION_STRIDE
