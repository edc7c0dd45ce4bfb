"""The coordinators of one host's own: when they are started, and which of them are not. Pure."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable

from lfield.host.team.coordinators import Coordinators
from lfield.host.team.leases import Leases
from lfield.mobility.starts import Starts
from lfield.wire.coordinators import Known


class Beginning:
    """The starts that a host makes. `own` are the coordinators that begin here, `others` the other hosts.

    `kept`: the host has a journal. `say` is for the log.
    """

    def __init__(
        self,
        own: Collection[str],
        others: Collection[str],
        team: Coordinators,
        leases: Leases,
        say: Callable[[str], None],
        *,
        kept: bool,
    ) -> None:
        self._own, self._team, self._leases, self._say, self._kept = own, team, leases, say, kept
        self._told = False
        self._starts = Starts(own, others)
        #: The batch that has the number of a start, and that number, until it is on the disk.
        self._counting: tuple[int, int] | None = None

    @property
    def settled(self) -> bool:
        """Whether the coordinators of this host are started, as far as they are."""
        return self._starts.begun and self._counting is None

    @property
    def wanted(self) -> Collection[str]:
        """The hosts that have to be heard."""
        return self._starts.wanted

    def begin(self, *, first: bool) -> None:
        """The others had time to answer; `first`: somebody says that there was no earlier start."""
        self._starts.begin(self._team.recovery.starts, first=first)
        self.look()

    def heard(self, host: str, known: Iterable[Known] = ()) -> None:
        """A host has greeted, or has ended for good."""
        self._starts.heard(host, known)

    def unlinked(self, host: str) -> None:
        """A host cannot be talked to any more."""
        self._starts.unlinked(host)

    def kept(self, number: int) -> None:
        """All pages up to those of that batch are on the disk."""
        if self._counting and number >= self._counting[0]:
            _, counted = self._counting
            self._counting = None
            self._begin(counted)

    def look(self) -> None:
        """Something has changed: start what may be started now."""
        if why := self._starts.why():
            self._say(why)
        if not self._team.halted and not self._waits() and self._starts.due:
            self._begin(0)

    def _waits(self) -> bool:
        """Whether a lease is waited for: who could give one may know of a later start."""
        if not self._leases.waits:
            return False
        known = self._team.mobility.knowledge()
        waiting = [a for a in self._own if a in self._leases.fenced and not self._why_not(a, known)]
        if waiting and not self._told:
            names = f"{' and '.join(waiting)} {'is' if len(waiting) == 1 else 'are'}"
            self._say(f"{names} not started before a majority of the team can be heard")
        self._told = bool(waiting)
        if waiting:
            self._leases.want()
        return self._told

    def _begin(self, counted: int) -> None:
        """Start the coordinators, once the number of that start is kept, and no later one was heard of."""
        known = self._team.mobility.knowledge()
        self._starts.learn(known)
        self._starts.beyond(max((self._leases.quorum.fences.of(agent) for agent in self._own), default=0))
        against = {agent: self._why_not(agent, known) for agent in self._own}
        if self._kept and counted < self._starts.next and not all(against.values()):
            self._counting = self._team.count(self._starts.next), self._starts.next
            return
        for agent, why in against.items():
            if why:
                self._say(f"{agent} {why}: not started again")
            else:
                self._team.carry_out(self._team.mobility.start(agent, self._starts.next))

    def _why_not(self, agent: str, known: list[Known]) -> str:
        """Why a coordinator of this host is not started now, '' if nothing is against it."""
        alive = "is alive on another host" if self._starts.alive(agent, known) else ""
        parked = self._starts.parked(agent, known)
        elsewhere = (
            f"is parked on {parked} for the program and deployment that it belongs to" if parked else ""
        )
        return self._team.recovery.why_not(agent, known) or elsewhere or alive or self._left(agent, known)

    def _left(self, agent: str, known: list[Known]) -> str:
        """The team goes on with what runs under leases from a shadow: beginning anew would forget that."""
        host = self._starts.shadowed(agent, known) if agent in self._leases.fenced else ""
        return f"has left {host}, where a copy of it is kept" if host else ""
