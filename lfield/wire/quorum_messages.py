"""Messages of leases and failover between hosts (durability: quorum).

A lease is a host's right to let coordinators act, granted by a majority of the members for a short time. A
fence (fencing token) of an agent bars every generation of it below a number.
"""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta, Struct

from lfield.wire.coordinator_messages import CheckpointId, Terminated
from lfield.wire.fields import Count, Name, Ordinal

#: The most coordinators of one host, or fences, in a message.
MAX_RECORDS = 4096


class HeldRecord(Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """A coordinator that is alive on the sender: its start, and the number of its last transfer."""

    agent: Name
    generation: Ordinal
    sequence: Ordinal


class FencedRecord(Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """A fencing token: no start of this agent before `generation` may run."""

    agent: Name
    generation: Ordinal


class Heartbeat(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=30):
    """To a member: acknowledge the heartbeat, so that the sender may act for another lease.

    `incarnation` is the sender's incarnation, `number` counts in it. `fences` is a hash of all fences and
    terminations that it knows. `held` also names a coordinator that has terminated on the sender, until a
    majority of the members has the termination on disk.
    """

    incarnation: Count
    number: Count
    fences: Count
    held: Annotated[list[HeldRecord], Meta(max_length=MAX_RECORDS)]


class HeartbeatAck(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=31):
    """The answer: all fences and terminations of this member, or none if the hash is equal.

    `ended` has the newest termination of each coordinator. With number 0 the message is no acknowledgement:
    the journal of the sender is new.
    """

    incarnation: Count
    number: Count
    fences: Annotated[list[FencedRecord], Meta(max_length=MAX_RECORDS)]
    ended: Annotated[list[Terminated], Meta(max_length=MAX_RECORDS)] = []


class Propose(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=34):
    """To a member: fence every start before `generation`, which is the sender's own.

    `start` is the start from whose block the sender is about to resume.
    """

    agent: Name
    generation: Ordinal
    start: Ordinal = 0


class Promise(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=35):
    """The answer, when the promise is on disk.

    A `fence` above the proposed generation is a refusal, and so is `ended`: the coordinator has terminated.
    """

    agent: Name
    generation: Ordinal
    fence: Ordinal
    checkpoint: CheckpointId | None
    ended: Terminated | None = None


QuorumMessage = Heartbeat | HeartbeatAck | Propose | Promise
