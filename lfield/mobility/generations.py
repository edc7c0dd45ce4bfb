"""The numbers of the starts of a coordinator: which is minted next, and which of two goes on. Pure.

A home counts its starts 1, 2, 3 ... A recovery must have a number above all that are known, and no other
host may mint the same: so it takes the next multiple of `STRIDE`, plus the number of its host. A home that
knows of a recovery goes on with multiples of `STRIDE`. Whether a number is a recovery's can be seen from it
(`lfield/docs/decisions/0043-a-recovery-outranks-every-earlier-start.md`).

    1, 2, 3     starts by the home
    65537       recovered by the first host of the deployment, after any of these
    131072      started by the home after that
"""

from __future__ import annotations

#: Room for the recoveries of all hosts between two starts of a home; a team has far fewer hosts.
STRIDE = 1 << 16


def next_start(newest: int) -> int:
    """The number of a start that a home makes, after the `newest` that is known; 0 if there was none."""
    return newest + 1 if newest + 1 < STRIDE else _next_stride(newest)


def next_recovery(newest: int, host: int) -> int:
    """The number of a recovery that the host of this number (from 0) makes; no other host mints it."""
    return _next_stride(newest) + host + 1


def is_recovery(generation: int) -> bool:
    """Whether a start is a recovery: somebody, or a majority, says that no earlier one goes on."""
    return generation >= STRIDE and generation % STRIDE != 0


def outranks(one: int, other: int) -> bool:
    """Which of two starts that may both be alive goes on: whether it is `one`.

    The newest recovery does; without one the earliest start, which has done work.
    """
    if is_recovery(one) != is_recovery(other):
        return is_recovery(one)
    return one > other if is_recovery(one) else one < other


def stops(one: int, other: int, *, alive: bool) -> bool:
    """Whether a start, of which it is known whether it is `alive`, is why another one must not go on.

    A recovery ends all that was before it, whatever has become of it since.
    """
    return (alive and outranks(one, other)) or (is_recovery(one) and one > other)


def why_stopped(agent: str, generation: int, by: int, host: str) -> str:
    """The sentence for a start that another one has stopped, of which `host` knows."""
    if is_recovery(by):
        return f"{agent} was recovered (start {by}, says {host}), so start {generation} was stopped"
    return f"an earlier start of {agent} is alive on {host}, so this later one was stopped"


def _next_stride(newest: int) -> int:
    return (newest // STRIDE + 1) * STRIDE
