"""Which hosts one host always keeps links with: its neighbours. Pure.

The hosts of a team stand in a ring, in the order of the deployment. Each keeps links with at most eight:
those at four distances from it, both ways round. The distances grow by the same factor, so that any two
hosts are a few links apart however many there are; up to nine hosts are all neighbours of one another.
While a neighbour is out of reach, the next in its place in the ring is called as well, until one answers.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

#: So many distances, each both ways round.
DISTANCES = 4
#: After so many seconds without a link the next in the ring is called as well.
PATIENCE = 3.0


def distances(hosts: int) -> list[int]:
    """How far the neighbours of a host are from it in a ring of so many, nearest first."""
    found = [0]
    for number in range(DISTANCES):
        found.append(max(found[-1] + 1, round((hosts / 2) ** (number / DISTANCES))))
    return found[1:]


class Neighbourhood:
    """The neighbours of the host `here`, a number; with `everybody` all other hosts are."""

    def __init__(self, hosts: Sequence[str], here: int, *, everybody: bool = False) -> None:
        self._hosts, self._here = hosts, here
        self._steps = [] if everybody else [(d, way) for d in distances(len(hosts)) for way in (1, -1)]
        others = range(len(hosts)) if everybody else [self._at(d, way) for d, way in self._steps]
        #: Those that have this one for a neighbour, too.
        self.near = frozenset(hosts[number] for number in others if number != here)
        #: Those that it has links with, or calls, in their place: as last asked.
        self.chosen: frozenset[str] = self.near
        self._linked: set[str] = set()
        self._since: dict[str, float] = {}

    def linked(self, host: str) -> None:
        """A host can be talked to."""
        self._linked.add(host)
        self._since.pop(host, None)

    def unlinked(self, host: str) -> None:
        """It cannot any more."""
        self._linked.discard(host)

    def wanted(self, now: float) -> frozenset[str]:
        """The neighbours, and whoever is called in the place of those that do not answer."""
        found = set(self.near)
        since: dict[str, float] = {}
        if not self.near <= self._linked:
            for distance, way in self._steps:
                for host in self._round(distance, way):
                    found.add(host)
                    if host in self._linked:
                        break
                    since[host] = self._since.get(host, now)
                    if now - since[host] < PATIENCE:
                        break
        self._since, self.chosen = since, frozenset(found)
        return self.chosen

    def _round(self, distance: int, way: int) -> Iterator[str]:
        """The hosts from that distance on, once round the ring."""
        for step in range(len(self._hosts) - 1):
            number = self._at(distance + step, way)
            if number != self._here:
                yield self._hosts[number]

    def _at(self, distance: int, way: int) -> int:
        return (self._here + way * distance) % len(self._hosts)
