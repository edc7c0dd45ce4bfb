"""The inputs of `HostCore` as data: all data that enters the core besides time and the answers of its
environment.

The shell passes each input to the core with `enter`. A recording contains the inputs, and a replay passes
them to the core again.
"""

from __future__ import annotations

from msgspec import Struct

from lfield.errors import DeviceError
from lfield.host.core import HostCore
from lfield.host.person_calls.person_calls import PersonCaller
from lfield.manifest import DeviceValue
from lfield.replication.locate.outcomes import CoordinatorOutcome, UnavailableHosts
from lfield.wire.coordinator_messages import Transfer
from lfield.wire.messages import Control, Hello
from lfield.wire.observer_messages import RecoverRequest, RecoverResponse, StartResponse
from lfield.wire.person_calls.portal_call_messages import PortalCallRequest


class HostInput(Struct, frozen=True, array_like=True):
    """Base class of all inputs."""

    def enter(self, core: HostCore) -> object:
        """Pass the input to its part of the core; returns the answer to an operator's order."""
        raise NotImplementedError


class ResourcesStart(HostInput, frozen=True, tag=1):
    """The devices are open: the resources start (`HostCore.start_resources`)."""

    first: bool = False

    def enter(self, core: HostCore) -> None:
        core.start_resources(first=self.first)


class CoordinatorsStart(HostInput, frozen=True, tag=2):
    """The other hosts had time to report: the coordinators start (`HostCore.start_coordinators`)."""

    first: bool = False

    def enter(self, core: HostCore) -> None:
        core.start_coordinators(first=self.first)


class AgentsHalt(HostInput, frozen=True, tag=3):
    """The host is stopping (`HostCore.stop_agents`)."""

    def enter(self, core: HostCore) -> None:
        core.stop_agents()


class BatchFailed(HostInput, frozen=True, tag=4):
    """Writing the journal failed, and is retried."""

    reason: str

    def enter(self, core: HostCore) -> None:
        core.on_write_failed(self.reason)


class BatchDurable(HostInput, frozen=True, tag=5):
    """All records up to those of that batch are on disk."""

    number: int

    def enter(self, core: HostCore) -> None:
        core.on_durable(self.number)


class DiskSpaceChanged(HostInput, frozen=True, tag=6):
    """The free space of the disk has changed: `problem` is the reason why the journal should admit nothing
    more, or ''.
    """

    problem: str

    def enter(self, core: HostCore) -> None:
        core.on_disk_space(self.problem)


class Linked(HostInput, frozen=True, tag=7):
    """A link with a host opened."""

    hello: Hello

    def enter(self, core: HostCore) -> None:
        core.on_linked(self.hello)


class Unlinked(HostInput, frozen=True, tag=8):
    """The last link with a host closed; `quietly`: this host did not need it."""

    host: str
    quietly: bool = False

    def enter(self, core: HostCore) -> None:
        core.on_unlinked(self.host, quietly=self.quietly)


class LinkRejected(HostInput, frozen=True, tag=9):
    """No link with a host can be made, for that reason; '' when a link is possible again."""

    host: str
    reason: str
    bundle: bytes

    def enter(self, core: HostCore) -> None:
        core.on_link_refused(self.host, self.reason, self.bundle)


class TransferArrived(HostInput, frozen=True, tag=10):
    """A coordinator arrived."""

    host: str
    header: Transfer
    block: memoryview

    def enter(self, core: HostCore) -> None:
        core.on_transfer(self.host, self.header, self.block)


class OversizeArrived(HostInput, frozen=True, tag=11):
    """A coordinator with an oversized block arrived; the block was not read."""

    host: str
    header: Transfer
    size: int

    def enter(self, core: HostCore) -> None:
        core.on_oversize(self.host, self.header, self.size)


class MessageArrived(HostInput, frozen=True, tag=12):
    """A message of a host arrived."""

    host: str
    message: Control

    def enter(self, core: HostCore) -> None:
        core.on_message(self.host, self.message)


class DeviceAnswered(HostInput, frozen=True, tag=13):
    """A device has answered the `CallDevice` of that number.

    `error` has device, reason and kind of a DeviceError; `error` is empty if there is a `value`.
    """

    number: int
    value: DeviceValue
    error: tuple[str, ...] = ()

    def enter(self, core: HostCore) -> None:
        error = self.error
        value = DeviceError(error[0], error[1], kind=error[2]) if error else self.value
        core.on_device_answer(self.number, value)


class HostExited(HostInput, frozen=True, tag=14):
    """A host has ended permanently, as reported by the process that started it."""

    host: str

    def enter(self, core: HostCore) -> None:
        core.on_host_exited(self.host)


class PauseOrdered(HostInput, frozen=True, tag=15):
    """An operator pauses the mission on this host, or resumes it."""

    on: bool
    order: bytes = b""

    def enter(self, core: HostCore) -> None:
        core.set_paused(on=self.on, order=self.order)


class StopOrdered(HostInput, frozen=True, tag=16):
    """An operator has sent an emergency stop with that reason, or has lifted it ('')."""

    reason: str
    order: bytes = b""

    def enter(self, core: HostCore) -> None:
        core.set_emergency_stop(self.reason, self.order)


class OrderExecuted(HostInput, frozen=True, tag=17):
    """An order was executed for the first time; '' for a lock-out, which acts like a stop."""

    kind: str
    id: bytes = b""

    def enter(self, core: HostCore) -> None:
        core.orders.on_executed(self.kind, self.id)


class ForgetOrdered(HostInput, frozen=True, tag=18):
    """An operator declares a coordinator lost."""

    agent: str

    def enter(self, core: HostCore) -> list[int]:
        return core.forget(self.agent)


class RecoveryOrdered(HostInput, frozen=True, tag=19):
    """An operator declares the holder of a coordinator permanently lost."""

    request: RecoverRequest

    def enter(self, core: HostCore) -> RecoverResponse:
        return core.recover(self.request)


class StartOrdered(HostInput, frozen=True, tag=20):
    """An operator starts the waiting coordinators, `without` these hosts."""

    without: list[str]

    def enter(self, core: HostCore) -> StartResponse:
        return core.startup.start(self.without)


class OutcomesFound(HostInput, frozen=True, tag=21):
    """Before this host stops, it announces all terminations, and these outcomes."""

    found: list[CoordinatorOutcome]

    def enter(self, core: HostCore) -> None:
        core.broadcast_outcomes(self.found)


class LinksPlanned(HostInput, frozen=True, tag=22):
    """The shell asks for the hosts that need links with this host now (`HostCore.needed_hosts`)."""

    def enter(self, core: HostCore) -> set[str]:
        return core.needed_hosts()


class DirectorySampled(HostInput, frozen=True, tag=23):
    """An observer asks for the state of this host: its agents are sampled (`TeamDirectory.refresh`)."""

    def enter(self, core: HostCore) -> None:
        core.directory.refresh()


class SilenceChecked(HostInput, frozen=True, tag=24):
    """Hosts other than these did not answer a query (`Membership.unavailable_hosts`)."""

    answered: list[str]
    lost_after: float
    unmet: float

    def enter(self, core: HostCore) -> UnavailableHosts:
        now, membership = core.context.clock.monotonic(), core.membership
        return membership.unavailable_hosts(self.answered, now, self.lost_after, self.unmet)


class ContactRestored(HostInput, frozen=True, tag=25):
    """All hosts are linked: none is suspected."""

    def enter(self, core: HostCore) -> None:
        core.membership.suspected.clear()


class BallotHeld(HostInput, frozen=True, tag=26):
    """The ballot about an activation that holds this host, b"" for none (`HostCore.set_ballot_hold`)."""

    ballot: bytes

    def enter(self, core: HostCore) -> None:
        core.set_ballot_hold(self.ballot)


class RunEnds(HostInput, frozen=True, tag=27):
    """The devices of a stopping host are at rest, or the host does not wait for them
    (`Coordinators.end_run`).

    The run must not end earlier: a host that is killed while its vehicles land must not start the mission
    again.
    """

    def enter(self, core: HostCore) -> None:
        core.coordinators.end_run()


class LineEntered(HostInput, frozen=True, tag=28):
    """A line of the operator's input, for one agent while it waits; without an `agent` it may be kept."""

    text: str
    agent: str = ""

    def enter(self, core: HostCore) -> str:
        return core.on_line_entered(self.text, self.agent)


class PersonCalled(HostInput, frozen=True, tag=29):
    """A person calls a portal (`PersonCalls.call`); `name` is '' for a user of this computer."""

    order: PortalCallRequest
    name: str
    label: str

    def enter(self, core: HostCore) -> None:
        core.person_calls.call(self.order, PersonCaller(self.name, self.label))


class PersonCallCancelled(HostInput, frozen=True, tag=30):
    """A person cancels the call of that id (`PersonCalls.cancel`)."""

    id: bytes
    name: str
    label: str

    def enter(self, core: HostCore) -> None:
        core.person_calls.cancel(self.id, PersonCaller(self.name, self.label))


RecordedInput = (
    ResourcesStart
    | CoordinatorsStart
    | AgentsHalt
    | BatchFailed
    | BatchDurable
    | DiskSpaceChanged
    | Linked
    | Unlinked
    | LinkRejected
    | TransferArrived
    | OversizeArrived
    | MessageArrived
    | DeviceAnswered
    | HostExited
    | PauseOrdered
    | StopOrdered
    | OrderExecuted
    | ForgetOrdered
    | RecoveryOrdered
    | StartOrdered
    | OutcomesFound
    | LinksPlanned
    | DirectorySampled
    | SilenceChecked
    | ContactRestored
    | BallotHeld
    | RunEnds
    | LineEntered
    | PersonCalled
    | PersonCallCancelled
)
