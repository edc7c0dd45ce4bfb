"""What hosts say to one another of coordinators: what they know of them, hops, endings (see `messages`)."""

from __future__ import annotations

from typing import Literal

from msgspec import Struct

from lfield.wire.fields import Age, Count, Hash, MaybeName, Name, Ordinal, Text

#: Where a host's copy of a coordinator stands; see `lfield/docs/mobility.md`. PARKED: it is kept for another
#: program or deployment, and goes on when that is started.
CopyState = Literal["RUN", "FROZEN", "PREPARED", "IN DOUBT", "MOVED", "EXITED", "PARKED"]

#: How a coordinator ended. 'superseded': an earlier start of it is alive, so this one was stopped.
Outcome = Literal["done", "died", "lost", "superseded"]

#: The outcomes of a coordinator that has terminated where it ran; that one is lost is only presumed.
TERMINATED: tuple[Outcome, ...] = ("done", "died")

#: The outcomes that terminate a coordinator; 'superseded' is about one start of it only.
TERMINAL: tuple[Outcome, ...] = (*TERMINATED, "lost")

#: `Refused.kind` for an id that the receiver never saw and now never will take.
NEVER_ARRIVED = "never arrived"

#: `Refused.kind` for a copy that must end because an earlier start of its coordinator is alive.
SUPERSEDED = "superseded"


class Known(Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """What one host knows of one start of a coordinator, for greetings and `lfield ps`.

    `sequence` is the highest transfer number of this start that was used or seen here. `where` is the host
    the copy went or wants to go to (FROZEN, PREPARED, IN DOUBT, MOVED), or the host it ended on (EXITED), and
    `receiver_memory` the memory of that host to which it was sent (PREPARED, IN DOUBT, MOVED).
    `outcome` is set for EXITED, `detail` for EXITED, IN DOUBT and what is `unreadable`: it was to go on from
    the block that this host has of it, and could not.
    """

    agent: Name
    generation: Ordinal
    sequence: Ordinal
    hops: Ordinal
    state: CopyState
    where: MaybeName = ""
    outcome: Literal["", "done", "died", "lost", "superseded"] = ""
    detail: Text = ""
    receiver_memory: Count = 0
    unreadable: bool = False


class Transfer(Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """The header of a coordinator under way; `size` bytes of block follow it in the same frame.

    (agent, generation, sequence) is the transfer's id. `hops` counts this hop too. `program` is the hash
    of the program the block belongs to, `receiver_memory` the memory of the receiver it is meant for.
    """

    agent: Name
    generation: Ordinal
    sequence: Ordinal
    hops: Ordinal
    program: Hash
    receiver_memory: Count
    size: Count


class Accepted(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=1):
    """The transfer was injected, or its coordinator is known to have gone on since.

    The answer was `held` back for so many seconds, since the coordinator might have brought it.
    """

    agent: Name
    generation: Ordinal
    sequence: Ordinal
    held: Age = 0.0


class Refused(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=2):
    """The transfer was not injected and never will be.

    `kind` names the L exception to throw at the portal call, or is NEVER_ARRIVED or SUPERSEDED.
    """

    agent: Name
    generation: Ordinal
    sequence: Ordinal
    kind: Name
    reason: Text


class Inquire(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=3):
    """What became of this transfer? Answered by Accepted or Refused."""

    agent: Name
    generation: Ordinal
    sequence: Ordinal
    receiver_memory: Count


class Ended(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=4):
    """A coordinator has ended on `host`; repeated until every host has answered with EndedAck."""

    agent: Name
    generation: Ordinal
    outcome: Outcome
    detail: Text
    host: Name


class EndedAck(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=5):
    """The ending is known here."""

    agent: Name
    generation: Ordinal
