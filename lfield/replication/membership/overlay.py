"""Ring overlay: the neighbours with which a host always keeps links. Sans-IO.

The hosts form a ring in the order of the deployment. Each has at most eight neighbours: at four distances, in
both directions. The distances grow by a constant factor, so any two hosts are a few links apart. Up to nine
hosts form a full mesh. While a neighbour is unreachable, the next host of the ring is connected as a
substitute.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

#: Number of distances, in each direction.
LINKS_PER_SIDE = 4
#: Seconds without a link before the next host of the ring is connected as well.
REPLACE_AFTER = 3.0


def distances(hosts: int) -> list[int]:
    """Distances to the neighbours of a host in a ring of this size, nearest first."""
    found = [0]
    for number in range(LINKS_PER_SIDE):
        found.append(max(found[-1] + 1, round((hosts / 2) ** (number / LINKS_PER_SIDE))))
    return found[1:]


class Overlay:
    """The neighbours of host number `own_number`; with `is_full_mesh`, all other hosts."""

    def __init__(self, hosts: Sequence[str], own_number: int, *, is_full_mesh: bool = False) -> None:
        self._hosts, self._own_number = hosts, own_number
        self._steps = (
            [] if is_full_mesh else [(d, direction) for d in distances(len(hosts)) for direction in (1, -1)]
        )
        others = (
            range(len(hosts))
            if is_full_mesh
            else [self._host_at(d, direction) for d, direction in self._steps]
        )
        #: Hosts that have this host as a neighbour.
        self.neighbours = frozenset(hosts[number] for number in others if number != own_number)
        #: The substitutes that are connected or being connected, as of the last call.
        self.chosen: frozenset[str] = self.neighbours
        self._linked: set[str] = set()
        self._since: dict[str, float] = {}

    def on_linked(self, host: str) -> None:
        """A link opened."""
        self._linked.add(host)
        self._since.pop(host, None)

    def on_unlinked(self, host: str) -> None:
        """A link closed."""
        self._linked.discard(host)

    def links(self, now: float) -> frozenset[str]:
        """The neighbours, and a substitute for each neighbour that does not answer."""
        neighbours = set(self.neighbours)
        since: dict[str, float] = {}
        if not self.neighbours <= self._linked:
            for distance, direction in self._steps:
                for host in self._ring_from(distance, direction):
                    neighbours.add(host)
                    if host in self._linked:
                        break
                    since[host] = self._since.get(host, now)
                    if now - since[host] < REPLACE_AFTER:
                        break
        self._since, self.chosen = since, frozenset(neighbours)
        return self.chosen

    def _ring_from(self, distance: int, direction: int) -> Iterator[str]:
        """The hosts from this distance on, once around the ring."""
        for step in range(len(self._hosts) - 1):
            number = self._host_at(distance + step, direction)
            if number != self._own_number:
                yield self._hosts[number]

    def _host_at(self, distance: int, direction: int) -> int:
        return (self._own_number + direction * distance) % len(self._hosts)
