"""How a host is run, and what its core may look at without asking anybody: telemetry, and its links."""

from __future__ import annotations

import random
import secrets
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from lfield.authority.admission import Admission
from lfield.bytecode.program import DeviceCall
from lfield.capability.directory.news import Trouble
from lfield.clock import Clock, SystemClock
from lfield.devices.guards import Guards
from lfield.host.stopping.shell import OrderKeys
from lfield.journal.journal import Journal
from lfield.manifest import DeviceValue, Observation
from lfield.net.peers import Peers
from lfield.vm.contract import Reading
from lfield.vm.world import Pending


@dataclass(slots=True)
class Options:
    """How a host is run. `listen` is the address to listen on, `door` the one for observers of this computer.

    `journal` keeps what this host has of coordinators; without one that is gone with its process, and all
    hosts are heard before any is started. `first_start`: somebody says that there was no start before.
    `draw` gives so many random bytes. With `orders` it takes orders to stop and to pause as datagrams.
    `engine` is one of `lfield.vm.wasm.choice.CHOICES`. `admission` says who may have links with it. Times are
    in seconds.
    """

    listen: str
    dump: Path | None = None
    unreachable_after: float = 10.0
    door: str = ""
    clock: Clock = field(default_factory=SystemClock)
    dice: random.Random = field(default_factory=random.Random)
    journal: Journal | None = None
    first_start: bool = False
    engine: str = "reference"
    admission: Admission = field(default_factory=Admission)
    draw: Callable[[int], bytes] = secrets.token_bytes
    orders: OrderKeys | None = None


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
