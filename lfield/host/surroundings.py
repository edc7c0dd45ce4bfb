"""What the core of a host may look at without asking anybody: telemetry, and how its links are."""

from __future__ import annotations

from collections.abc import Mapping

from lfield.bytecode.program import DeviceCall
from lfield.capability.directory.news import Trouble
from lfield.devices.guards import Guards
from lfield.manifest import DeviceValue, Observation
from lfield.net.peers import Peers
from lfield.vm.contract import Reading
from lfield.vm.world import Pending


class Surroundings:
    """Telemetry as the guards have told it, and the links as they are: the core's `Nearby`."""

    def __init__(self, peers: Peers, guards: Guards) -> None:
        self._peers, self._guards = peers, guards

    @property
    def away(self) -> Mapping[str, float]:
        """The hosts that there is no link with, and since when."""
        return self._peers.away

    def last_heard(self, host: str) -> float | None:
        """When something last came from a host."""
        return self._peers.last_heard(host)

    def round_trip(self, host: str) -> float | None:
        """The smoothed round-trip time of the link with a host, in seconds."""
        return self._peers.watch.round_trip(host)

    def answers_within(self, host: str) -> float | None:
        """The time within which a linked host answers, in seconds."""
        return self._peers.watch.answers_within(host)

    def last(self, device: str, quantity: str) -> Observation | None:
        """The last value of a telemetry quantity, however old."""
        return self._guards.last(device, quantity)

    def trouble(self, device: str) -> Trouble | None:
        """Why a device cannot be called now."""
        return self._guards.trouble(device)

    def query(self, agent: str, call: DeviceCall) -> DeviceValue | Pending:
        """The value of a query, PENDING for what the device itself must do. Raises DeviceError."""
        return self._guards.query(agent, call.field, call.instruction)

    def reading(self, agent: str, call: DeviceCall) -> Reading | None:
        """The reading of such a query that the host keeps up to date."""
        return self._guards.reading(agent, call.field, call.instruction)

    def may_be_cancelled(self, agent: str, call: DeviceCall) -> bool:
        """Whether a call of this instruction that is under way can be given up."""
        return self._guards.may_be_cancelled(agent, call.field, call.instruction)
