"""What hosts say to one another about leases, and about who goes on with a coordinator (durability: quorum).

A lease is a host's right to let coordinators act, given by a majority of the members for a short while. A
fence of an agent bars every generation of it below a number.
"""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta, Struct

from lfield.wire.coordinators import Ended
from lfield.wire.fields import Age, Count, MaybeName, Name, Ordinal

#: The most coordinators of one host, or fences, that a message names.
MOST = 4096


class Held(Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """A coordinator that is alive on the sender: the start of it, and the number of its last transfer."""

    agent: Name
    generation: Ordinal
    sequence: Ordinal


class Barred(Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """No start of this agent before `generation` may run any more."""

    agent: Name
    generation: Ordinal


class Place(Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """How far the newest block goes that a host has kept of an agent.

    With `left` it was sent away under that number, and may have arrived; else it came under it.
    """

    generation: Ordinal
    sequence: Ordinal
    left: bool

    @property
    def order(self) -> tuple[int, int, bool]:
        """Greater is newer."""
        return self.generation, self.sequence, not self.left


class Heartbeat(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=30):
    """To a member: acknowledge this, and the sender may act for a while longer.

    `life` is the sender's incarnation, `number` counts in it. `fences` is a hash of all fences and
    terminations that it knows. `held` also names a coordinator that has terminated on the sender, until a
    majority of the members has that termination on disk.
    """

    life: Count
    number: Count
    fences: Count
    held: Annotated[list[Held], Meta(max_length=MOST)]


class Ack(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=31):
    """The answer: all fences and terminations of this member, or none where the hash is the same.

    `ended` has the newest termination of each coordinator. With number 0 the sender acknowledges nothing: its
    journal is new.
    """

    life: Count
    number: Count
    fences: Annotated[list[Barred], Meta(max_length=MOST)]
    ended: Annotated[list[Ended], Meta(max_length=MOST)] = []


class Seek(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=32):
    """What do you know of this coordinator, of which nothing was heard here for too long?"""

    agent: Name


class Sought(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=33):
    """The answer: the newest block that is kept here, and on which host the coordinator is known to live.

    `holder` is '' when that is not known; it held that `generation` so long ago, in seconds. `ended` is the
    newest termination that the sender knows: no start up to that generation may be recovered.
    """

    agent: Name
    place: Place | None
    holder: MaybeName = ""
    generation: Ordinal = 0
    age: Age = 0.0
    ended: Ended | None = None


class Propose(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=34):
    """To a member: bar every start before `generation`, which is the sender's own.

    `start` is the start whose block the sender is about to go on from.
    """

    agent: Name
    generation: Ordinal
    start: Ordinal = 0


class Promise(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=35):
    """The answer, once it is on disk.

    A `fence` beyond the proposed generation refuses it, and so does `ended`: the coordinator has terminated.
    """

    agent: Name
    generation: Ordinal
    fence: Ordinal
    place: Place | None
    ended: Ended | None = None


QuorumMessage = Heartbeat | Ack | Seek | Sought | Propose | Promise
