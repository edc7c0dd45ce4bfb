"""Effects of the quorum core, executed by the host in order; and its read access to coordinators."""

from __future__ import annotations

from typing import NamedTuple, Protocol

from msgspec import Struct

from lfield.text.log_messages import LogLine
from lfield.wire.coordinator_messages import CheckpointId, Locate, Located, Terminated
from lfield.wire.quorum_messages import QuorumMessage


class Checkpoint(NamedTuple):
    """The newest checkpoint that a host has of a coordinator, or the live coordinator itself.

    `is_alive`: the coordinator runs here as soon as the lease permits, unless it is fenced. `interval`:
    seconds without a known holder before failover; 0 for never. `ended`: the newest known start has
    terminated, so no copy can be resumed. `is_final`: this host need not prevent a recovery. For a
    coordinator that terminated here, this holds only after a majority has confirmed the termination on disk.
    """

    position: CheckpointId
    is_alive: bool
    interval: float
    ended: Terminated | None = None
    is_final: bool = True


class CheckpointStore(Protocol):
    """The coordinators of this host in their present state."""

    def checkpoint(self, agent: str) -> Checkpoint | None:
        """The newest checkpoint or termination of an agent; None if unknown."""

    def allocate_generation(self, agent: str, above: int) -> int:
        """A generation above `above` and all known generations, which no other host allocates."""


class SendQuorumMessage(Struct, frozen=True):
    """Send a message to a host. Without a link the message is dropped, because it is repeated."""

    host: str
    message: QuorumMessage | Locate | Located


class RaiseFence(Struct, frozen=True):
    """Store a raised fencing token before later effects of that agent, and stop the starts that it fences."""

    agent: str
    generation: int
    reason: str


class PromoteCheckpoint(Struct, frozen=True):
    """Resume an agent from its newest checkpoint here as a new start; `line` is for the log."""

    agent: str
    generation: int
    line: LogLine


class RecordTermination(Struct, frozen=True):
    """Store a termination reported by another host, and delete the agent's checkpoints."""

    ended: Terminated


class LogExplanation(Struct, frozen=True):
    """Write a log line."""

    text: LogLine


Effect = SendQuorumMessage | RaiseFence | PromoteCheckpoint | RecordTermination | LogExplanation
