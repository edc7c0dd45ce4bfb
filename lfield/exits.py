"""The statuses a run of hosts ends with, whatever ended it; other failures bring their own (errors.py).

They stand beside the numbers of sysexits, which begin at 64. The worst of several is told: who reads only the
number must not take a vehicle in the air for a mission that failed.
"""

from __future__ import annotations

from collections.abc import Iterable

#: Every coordinator has ended as its program wanted.
DONE = 0
#: A coordinator died, was stopped before its end, or is lost for certain.
FAILED = 1
#: A device has not been seen in its safe state and at rest: somebody must look at it, now.
UNSAFE = 3
#: Another host was not heard of for too long: what became of the mission there is not known.
UNHEARD = 4
#: Somebody stopped it.
INTERRUPTED = 130

#: From harmless to the one that must be told; a status that is not here counts between FAILED and UNHEARD.
_SEVERITY = (DONE, INTERRUPTED, FAILED, None, UNHEARD, UNSAFE)


def worst(statuses: Iterable[int]) -> int:
    """The status that must be told, of several; DONE of none. Of failures that weigh alike the first."""
    return max(statuses, key=_severity, default=DONE)


def _severity(status: int) -> int:
    return _SEVERITY.index(status if status in _SEVERITY else None)
