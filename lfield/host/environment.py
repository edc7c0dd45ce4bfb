"""Options of a host, and the core's synchronous queries: telemetry and links."""

from __future__ import annotations

import random
import secrets
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from msgspec import Struct, field

from lfield.authority.admission_policy import AdmissionPolicy
from lfield.bytecode.program import DeviceCallRecord
from lfield.capability.directory.directory_delta import Unavailability
from lfield.clock import Clock, SystemClock
from lfield.devices.device_guards import DeviceGuards
from lfield.host.recording.recording_target import RecordingTarget
from lfield.journal.journal import Journal
from lfield.manifest import DeviceValue, Observation
from lfield.net.link_manager import LinkManager
from lfield.vm.engine_interface import Reading
from lfield.vm.host_interface import Pending

if TYPE_CHECKING:
    from lfield.host.stop_orders.datagram_shell import OrderCredentials


class HostOptions(Struct):
    """Options of a host. `listen` is the address to listen on, `control_socket` the address for local
    observers.

    `journal` stores the coordinators of this host; without one they are lost with its process, and all hosts
    must report before any coordinator starts. `first_start`: an operator asserts that there was no earlier
    start. `random_bytes(n)` returns n random bytes. With `orders` the host accepts stop and pause orders as
    datagrams. `engine` is one of `lfield.vm.wasm.engine_selection.CHOICES`. `admission` decides which members
    may have links with this host. `stopwatch` measures how long programs run, `on_failure` is called first
    when the host fails. `record` is the destination of the recordings of core and guards. Times are in
    seconds.
    """

    listen: str
    dump: Path | None = None
    unreachable_after: float = 10.0
    control_socket: str = ""
    clock: Clock = field(default_factory=SystemClock)
    rng: random.Random = field(default_factory=random.Random)
    journal: Journal | None = None
    first_start: bool = False
    engine: str = "reference"
    admission: AdmissionPolicy = field(default_factory=AdmissionPolicy)
    random_bytes: Callable[[int], bytes] = secrets.token_bytes
    orders: OrderCredentials | None = None
    stopwatch: Callable[[], float] | None = None
    on_failure: Callable[[], None] = lambda: None
    record: RecordingTarget | None = None


class HostEnvironment:
    """The core's `Environment`: the last telemetry from the guards, and the links."""

    def __init__(self, links: LinkManager, guards: DeviceGuards) -> None:
        self._links, self._guards = links, guards
        #: The time of the last message from a host.
        self.last_contact_at = links.last_contact_at

    @property
    def down_since(self) -> Mapping[str, float]:
        """The hosts without a link, each with the time since when."""
        return self._links.down_since

    def round_trip(self, host: str) -> float | None:
        """The smoothed round-trip time of the link with a host, in seconds."""
        return self._links.monitor.round_trip(host)

    def answer_timeout(self, host: str) -> float | None:
        """The time within which a linked host answers, in seconds."""
        return self._links.monitor.answer_timeout(host)

    def last(self, device: str, quantity: str) -> Observation | None:
        """The last value of a telemetry quantity, however old."""
        return self._guards.last(device, quantity)

    def unavailability(self, device: str) -> Unavailability | None:
        """The reason why a device cannot be called now."""
        return self._guards.unavailability(device)

    def query(self, agent: str, call: DeviceCallRecord) -> DeviceValue | Pending:
        """The value of a query, PENDING if the device itself must answer. Raises DeviceError."""
        return self._guards.query(agent, call.field, call.instruction)

    def reading(self, agent: str, call: DeviceCallRecord) -> Reading | None:
        """The up-to-date reading of such a query."""
        return self._guards.reading(agent, call.field, call.instruction)

    def may_be_cancelled(self, agent: str, call: DeviceCallRecord) -> bool:
        """Whether a call of this instruction can be cancelled while under way."""
        return self._guards.may_be_cancelled(agent, call.field, call.instruction)
