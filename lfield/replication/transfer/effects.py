"""Effects of `Mobility` (hops and terminations), which the host executes in order.

They are msgspec structs rather than dataclasses because several are made on every hop, and a frozen dataclass
is several times slower. Every effect on a copy names its start (agent, generation): a host that holds another
start of the agent at that time ignores the effect.
"""

from __future__ import annotations

from msgspec import Struct

from lfield.journal.records import Record
from lfield.wire.coordinator_messages import Outcome, Transfer
from lfield.wire.framing import Buffer
from lfield.wire.messages import Control


class Send(Struct, frozen=True):
    """Send a message to a host; without a link the message is dropped, since it will be requested again."""

    host: str
    message: Control


class SendTransfer(Struct, frozen=True):
    """A hop: send a block to a host. Without a link the block is dropped, and `LinkClosed` is reported."""

    host: str
    header: Transfer
    block: Buffer


class PersistRecord(Struct, frozen=True):
    """Write a record to disk before later effects on that agent; only with a journal.

    `is_lazy`: the record may be written together with the next record that is needed.
    """

    agent: str
    record: Record
    is_lazy: bool = False


class CoordinatorStarted(Struct, frozen=True):
    """A coordinator of this host starts: record its identity."""

    agent: str
    generation: int


class ResumeCopy(Struct, frozen=True):
    """Continue the copy on this host, which has arrived or is stored at a portal call of this host."""

    agent: str
    generation: int


class MarkMigrated(Struct, frozen=True):
    """The coordinator is on another host now; the block here is its shadow.

    The answer that reported the arrival was delayed by `held` seconds.
    """

    agent: str
    generation: int
    sequence: int
    host: str
    held: float = 0.0


class ResumeWithException(Struct, frozen=True):
    """Thaw the copy and throw the L exception `kind` with `reason` at its portal call.

    `sequence` is the highest transfer number used so far, to be written into the block's header. `recovered`:
    this is a new start, and the actions of an earlier start after this call are unknown.
    """

    agent: str
    generation: int
    sequence: int
    kind: str
    reason: str
    recovered: bool = False


class MarkInDoubt(Struct, frozen=True):
    """Record that it is unknown whether `host` has received the copy, which stays frozen here. `reason` is
    for the log.
    """

    agent: str
    generation: int
    sequence: int
    host: str
    reason: str


class TerminateCopy(Struct, frozen=True):
    """End the copy on this host, running or frozen, if there is one: another start of the coordinator
    continues.
    """

    agent: str
    generation: int
    reason: str


class DropTerminated(Struct, frozen=True):
    """Another host reports that a coordinator ended there; drop all copies here."""

    agent: str
    generation: int
    outcome: Outcome
    detail: str
    host: str


class LogAnomaly(Struct, frozen=True):
    """Log once that a host has sent a message about an agent to an earlier incarnation of this host."""

    agent: str
    host: str


Effect = (
    Send
    | SendTransfer
    | PersistRecord
    | CoordinatorStarted
    | ResumeCopy
    | MarkMigrated
    | ResumeWithException
    | MarkInDoubt
    | TerminateCopy
    | DropTerminated
    | LogAnomaly
)


class TransferRefusal(Struct, frozen=True):
    """The reason why a coordinator was refused: an L exception's name and a sentence."""

    kind: str
    reason: str
