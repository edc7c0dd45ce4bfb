"""The run id of a team: recordings of its hosts with the same id belong together. Pure.

Each host proposes an id that begins with its time of start. Hosts that meet keep the smaller one, so all of a
team agree on the id of the host that was started first. A clock that is wrong makes another id, not two.
"""

from __future__ import annotations

import time
from collections.abc import Callable


class RunIdentity:
    """The run id of one host: proposed at the wall-clock time `now`, in seconds since 1970."""

    def __init__(self, now: float, random_bytes: Callable[[int], bytes]) -> None:
        at = time.strftime("%Y%m%dT%H%M%S", time.gmtime(max(0.0, now)))
        #: The id.
        self.id = f"{at}-{random_bytes(4).hex()}"

    def on_hello(self, other: str) -> bool:
        """Another host has this id, '' for none; returns whether it is now the id of this host too."""
        if not other or other >= self.id:
            return False
        self.id = other
        return True
