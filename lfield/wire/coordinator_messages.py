"""Messages between hosts about coordinators: states, transfers, terminations (see `messages`)."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta, Struct

from lfield.wire.fields import Count, Duration, Hash, Name, OptionalName, Ordinal, Text, Timestamp

#: States of a host's copy of a coordinator; see `lfield/docs/mobility.md`. PARKED: stored for another program
#: or deployment, and resumed when that program is started.
CopyState = Literal["RUN", "FROZEN", "PREPARED", "IN DOUBT", "MOVED", "EXITED", "PARKED"]

#: The ends of a coordinator. 'superseded': an earlier start of it is alive, so this start was stopped.
Outcome = Literal["done", "died", "lost", "superseded"]

#: The outcomes of a coordinator that has terminated where it ran; a lost coordinator is only presumed dead.
TERMINATED: tuple[Outcome, ...] = ("done", "died")

#: The outcomes that terminate a coordinator; 'superseded' is about one start of it only.
TERMINAL: tuple[Outcome, ...] = (*TERMINATED, "lost")

#: The most coordinators, or starts of them, in an answer.
MAX_LOCATED = 4096

#: `TransferRefused.kind` for an id that the receiver never received and will not accept any more.
NEVER_ARRIVED = "never arrived"

#: `TransferRefused.kind` for a copy that must end because an earlier start of its coordinator is alive.
SUPERSEDED = "superseded"


class CoordinatorState(Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """The record of one host about one start of a coordinator, for handshakes and `lfield ps`.

    `sequence` is the highest transfer number of this start that was used or received here. `where` is the
    host to which the copy moved or waits to move (FROZEN, PREPARED, IN DOUBT, MOVED), or the host on which it
    ended (EXITED), and `receiver_memory` the state id of the host to which it was sent (PREPARED, IN DOUBT,
    MOVED). `outcome` is set for EXITED, `detail` for EXITED, IN DOUBT and for an `unreadable` copy, which
    could not be resumed from its stored block.
    """

    agent: Name
    generation: Ordinal
    sequence: Ordinal
    hops: Ordinal
    state: CopyState
    where: OptionalName = ""
    outcome: Literal["", "done", "died", "lost", "superseded"] = ""
    detail: Text = ""
    receiver_memory: Count = 0
    unreadable: bool = False


class Transfer(Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """A hop: the header of a coordinator in transit; `size` bytes of block follow it in the same frame.

    (agent, generation, sequence) is the id of the transfer. `hops` includes this hop. `program` is the hash
    of the program that the block belongs to, `receiver_memory` the state id of the intended receiver.
    `stamp` is the timestamp of its departure.
    """

    agent: Name
    generation: Ordinal
    sequence: Ordinal
    hops: Ordinal
    program: Hash
    receiver_memory: Count
    size: Count
    stamp: Timestamp = 0


class TransferAccepted(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=1):
    """The transfer was injected, or its coordinator is known to have moved on since.

    The answer was delayed by `held` seconds, since the coordinator itself might have returned earlier.
    """

    agent: Name
    generation: Ordinal
    sequence: Ordinal
    held: Duration = 0.0
    stamp: Timestamp = 0


class TransferRefused(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=2):
    """The transfer was not injected and will never be injected.

    `kind` names the L exception to throw at the portal call, or is NEVER_ARRIVED or SUPERSEDED.
    """

    agent: Name
    generation: Ordinal
    sequence: Ordinal
    kind: Name
    reason: Text
    stamp: Timestamp = 0


class TransferQuery(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=3):
    """Query the verdict on a transfer. Answered by Accepted or Refused."""

    agent: Name
    generation: Ordinal
    sequence: Ordinal
    receiver_memory: Count


class Terminated(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=4):
    """A coordinator has terminated on `host`; repeated until every host has answered with TerminatedAck.

    `is_of_this_run`: the sender knows that the home of the coordinator does not start it again in this run of
    the mission.
    """

    agent: Name
    generation: Ordinal
    outcome: Outcome
    detail: Text
    host: Name
    stamp: Timestamp = 0
    is_of_this_run: bool = False


class TerminatedAck(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=5):
    """The termination is recorded here."""

    agent: Name
    generation: Ordinal


class StopCoordinator(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=72):
    """From the home of a coordinator: end the run that began with start `generation`, for the coordinator
    `by`; repeated until the home knows the end. Not answered."""

    agent: Name
    generation: Ordinal
    by: Name


class CheckpointId(Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """The progress of the newest block of an agent that a host has stored.

    With `was_sent` the block was sent under that number, and may have arrived; otherwise it arrived with that
    number.
    """

    generation: Ordinal
    sequence: Ordinal
    was_sent: bool

    @property
    def sort_key(self) -> tuple[int, int, bool]:
        """The sort key of a checkpoint: greater is newer."""
        return self.generation, self.sequence, not self.was_sent


class LeaseRecord(Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """The record of one host about a coordinator under a lease.

    `checkpoint` is the newest block stored there. `holder` is the host known to run the coordinator, '' for
    none; it held this `generation` `age` seconds ago. `ended` is the newest known termination: no start up to
    that generation may be recovered.
    """

    agent: Name
    checkpoint: CheckpointId | None
    holder: OptionalName = ""
    generation: Ordinal = 0
    age: Duration = 0.0
    ended: Terminated | None = None


class Locate(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=32):
    """Query a host's records of these coordinators, or of all without `agents`; with `leases`, for failover.

    This is the only query between hosts about the location of a coordinator; answered by `Located`.
    """

    agents: Annotated[list[Name], Meta(max_length=MAX_LOCATED)] = []
    leases: bool = False


class Located(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=33):
    """The answer: `agents` as in the query, and the records of every start that the host knows.

    Lease records that depend on a pending write follow in separate answers, one for each coordinator, without
    `states`. A host also sends such an answer to correct a proposer (see `Propose`).
    """

    agents: Annotated[list[Name], Meta(max_length=MAX_LOCATED)]
    states: Annotated[list[CoordinatorState], Meta(max_length=MAX_LOCATED)] = []
    leases: Annotated[list[LeaseRecord], Meta(max_length=MAX_LOCATED)] = []

    @property
    def agent(self) -> str:
        """The coordinator whose pending write this answer waits for; '' for none."""
        return self.leases[0].agent if self.leases and not self.states else ""


#: The maximum number of calls that one coordinator waits for at one host.
Numbers = Annotated[list[Count], Meta(min_length=1, max_length=4096)]


class WatchCalls(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=67):
    """A start of a coordinator waits on the sender for the first of its calls, some of them on the receiver.

    The message is repeated while it waits. Message and answer are hints: the coordinator fetches a result by
    moving to its host.
    """

    agent: Name
    generation: Ordinal
    numbers: Numbers


class CancelCalls(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=69):
    """A start of a coordinator cancels calls on the receiver, and goes there for their outcomes. This is a
    hint.
    """

    agent: Name
    generation: Ordinal
    numbers: Numbers


class CallsEnded(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=68):
    """Calls of a start of a coordinator have ended on the sender, or are unknown there."""

    agent: Name
    generation: Ordinal
    numbers: Numbers
