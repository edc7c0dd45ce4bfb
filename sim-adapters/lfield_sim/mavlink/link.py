"""Several vehicles on one link: what comes is shown to each, what each sends goes to every peer."""

from __future__ import annotations

from collections.abc import Hashable, Sequence

from lfield_sim.mavlink.codec import Readers
from lfield_sim.mavlink.protocol import MavlinkFake


class MavlinkLink:
    """The vehicles of one link, told apart by their system ids."""

    def __init__(self, vehicles: Sequence[MavlinkFake]) -> None:
        self.vehicles = vehicles
        self._readers = Readers()

    def receive(self, peer: Hashable, data: bytes, *, local: bool = False) -> list[bytes]:
        """Bytes from a peer; the packets that answer them. `local` is a peer on a serial line."""
        return [
            packet
            for message in self._readers.feed(peer, data)
            for vehicle in self.vehicles
            for packet in vehicle.handle(message, local=local)
        ]

    def advance(self, seconds: float) -> list[bytes]:
        """Let time pass; the packets for every peer."""
        return [packet for vehicle in self.vehicles for packet in vehicle.advance(seconds)]
