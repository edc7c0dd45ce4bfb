"""When a host may start its coordinators, and as which generation. Pure.

A generation tells a later start of a coordinator from an earlier one, so it must grow, whatever becomes of
clocks and disks. It is a counter: one more than this host has on record and than any other host knows. One
counter serves all coordinators of a host, since they are started together.

A host that has no record may have started them before all the same: it was on another disk then. So it waits
until it has heard every other host, or is told that there was no earlier start.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable

from lfield.wire.messages import Known


class Starts:
    """The starts of one host's coordinators; `agents` are those, `others` the other hosts of the team."""

    def __init__(self, agents: Collection[str], others: Collection[str]) -> None:
        self.agents = agents
        self._unheard = set(others)
        self._record: int | None = None
        self._newest = 0
        #: From `begin` until they are started.
        self.waiting = False

    def heard(self, host: str, known: Iterable[Known]) -> None:
        """A host has said what it knows, or has ended for good: then it knows nothing any more."""
        self._unheard.discard(host)
        self.learn(known)

    def learn(self, known: Iterable[Known]) -> None:
        """Starts that anybody knows of."""
        own = (record.generation for record in known if record.agent in self.agents)
        self._newest = max(self._newest, *own, 0)

    def begin(self, record: int | None, *, first: bool) -> None:
        """The others had time to answer. `record` is the last start on record here, None without one.

        `first`: somebody says that there was none.
        """
        self._record = 0 if record is None and first else record
        self.waiting = bool(self.agents)

    @property
    def missing(self) -> list[str]:
        """The hosts that must be heard first."""
        return sorted(self._unheard) if self._record is None else []

    @property
    def next(self) -> int:
        """The generation of a start that is made now; no other host knows one as high."""
        return max(self._record or 0, self._newest) + 1

    @property
    def why(self) -> str:
        """Why nothing is started yet, for the log."""
        verb = "is" if len(self.agents) == 1 else "are"
        names = " and ".join(sorted(self.agents))
        was = "was" if len(self.missing) == 1 else "were"
        return (
            f"{names} {verb} not started before {' and '.join(self.missing)} {was} heard: this host has no "
            "record of earlier starts; `--first-start` says that there was none"
        )
