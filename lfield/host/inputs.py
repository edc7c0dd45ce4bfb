"""The inputs of `HostCore` as data: all that enters it besides time and the answers of its environment.

The shell passes each to `HostCore.on_input`. A recording contains them, and a replay passes them again.
"""

from __future__ import annotations

from msgspec import Struct

from lfield.manifest import DeviceValue
from lfield.replication.locate.outcomes import CoordinatorOutcome
from lfield.wire.coordinator_messages import Transfer
from lfield.wire.messages import Control, Hello
from lfield.wire.observer_messages import RecoverRequest


class HostInput(Struct, frozen=True, array_like=True):
    """Base class of all inputs."""


class ResourcesStart(HostInput, frozen=True, tag=1):
    """The devices are open: the resources start (`HostCore.start_resources`)."""

    first: bool = False


class CoordinatorsStart(HostInput, frozen=True, tag=2):
    """The other hosts had time to report: the coordinators start (`HostCore.start_coordinators`)."""

    first: bool = False


class AgentsHalt(HostInput, frozen=True, tag=3):
    """The host is stopping (`HostCore.stop_agents`)."""


class BatchFailed(HostInput, frozen=True, tag=4):
    """Writing the journal failed, and is retried."""

    reason: str


class BatchDurable(HostInput, frozen=True, tag=5):
    """All records up to those of that batch are on disk."""

    number: int


class DiskSpaceChanged(HostInput, frozen=True, tag=6):
    """Why the journal should admit nothing more, or ''."""

    trouble: str


class Linked(HostInput, frozen=True, tag=7):
    """A link with a host opened."""

    hello: Hello


class Unlinked(HostInput, frozen=True, tag=8):
    """The last link with a host closed; `quietly`: this host did not need it."""

    host: str
    quietly: bool = False


class LinkRejected(HostInput, frozen=True, tag=9):
    """No link with a host can be made, for that reason; '' when it can again."""

    host: str
    reason: str
    bundle: bytes


class TransferArrived(HostInput, frozen=True, tag=10):
    """A coordinator arrived."""

    host: str
    header: Transfer
    block: memoryview


class OversizeArrived(HostInput, frozen=True, tag=11):
    """A coordinator with an oversized block arrived; the block was not read."""

    host: str
    header: Transfer
    size: int


class MessageArrived(HostInput, frozen=True, tag=12):
    """A message of a host arrived."""

    host: str
    message: Control


class DeviceAnswered(HostInput, frozen=True, tag=13):
    """A device has answered the `CallDevice` of that number.

    `error` has device, reason and kind of a DeviceError; it is empty if there is a `value`.
    """

    number: int
    value: DeviceValue
    error: tuple[str, ...] = ()


class HostExited(HostInput, frozen=True, tag=14):
    """A host has ended permanently, as reported by the process that started it."""

    host: str


class PauseOrdered(HostInput, frozen=True, tag=15):
    """An operator pauses the mission on this host, or resumes it."""

    on: bool
    order: bytes = b""


class StopOrdered(HostInput, frozen=True, tag=16):
    """An operator has sent an emergency stop with that reason, or has lifted it ('')."""

    reason: str
    order: bytes = b""


class OrderExecuted(HostInput, frozen=True, tag=17):
    """An order was executed for the first time; '' for a lock-out, which holds like a stop."""

    kind: str
    id: bytes = b""


class ForgetOrdered(HostInput, frozen=True, tag=18):
    """An operator declares a coordinator lost."""

    agent: str


class RecoveryOrdered(HostInput, frozen=True, tag=19):
    """An operator declares the holder of a coordinator permanently lost."""

    request: RecoverRequest


class StartOrdered(HostInput, frozen=True, tag=20):
    """An operator starts the waiting coordinators, `without` these hosts."""

    without: list[str]


class OutcomesFound(HostInput, frozen=True, tag=21):
    """This host is about to stop: all terminations, and these outcomes, are announced."""

    found: list[CoordinatorOutcome]


class LinksPlanned(HostInput, frozen=True, tag=22):
    """The shell asks for the hosts to have links with now (`HostCore.needed_hosts`)."""


class BallotHeld(HostInput, frozen=True, tag=23):
    """The ballot about an activation that holds this host, b"" for none (`HostCore.set_ballot_hold`)."""

    ballot: bytes


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
    | BallotHeld
)
