"""What hosts say to one another (DESIGN section 6).

Every message is a frozen msgspec struct, written in msgpack as an array whose first item is a small
number, the tag. Decoding is strict: wrong types, strings or lists over their bounds, items too many, and
unknown tags are all refused. Three messages are not in the `Control` union because they have a frame kind
of their own: `Hello` and `Refuse`, whose outer form never changes between versions, and `Transfer`, which
is followed by the raw bytes of a block. `codec` writes and reads them all.
"""

from __future__ import annotations

import hashlib
from typing import Annotated, Literal

from msgspec import Meta, Struct

from lfield.wire.coordinators import Accepted, Ended, EndedAck, Inquire, Known, Refused
from lfield.wire.fields import (
    MAX_LIST,
    Age,
    Count,
    FactValue,
    Hash,
    Index,
    Label,
    MaybeName,
    Moment,
    Name,
    Ordinal,
    Text,
    ToldBy,
)
from lfield.wire.observing import (
    EmergencyStop,
    EmergencyStopped,
    Forget,
    Forgotten,
    OrderChallenge,
    Pause,
    Recover,
    Recovered,
    StartRequest,
    StartResponse,
    Status,
    StatusRequest,
)
from lfield.wire.orders import Epochs, RelayedAnswer, RelayedOrder
from lfield.wire.quorum import QuorumMessage
from lfield.wire.reservations import ReservationMessage
from lfield.wire.watching import WatchMessage

#: The version of everything in this package. Hosts of different versions do not talk.
PROTOCOL = 11

#: What a peer is: one of the team, or somebody who looks at it (`lfield ps`).
Role = Literal["host", "observer"]


class Hello(Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """The first message of both sides of a link.

    `incarnation` is a random 63-bit number drawn at process start: the same host after a restart has
    another. `memory` is the identity of its journal, which outlives restarts; 0 for a host that keeps none.
    `program`, `deployment`, `registry` and `access` are 32-byte hashes of what all hosts of a team must have
    alike; an observer (`lfield ps`) leaves them empty, a program that names no capability has no registry,
    and a mission without an access file no rules.
    `devices` says what those of its team are, '' where it has none.
    `max_block` is the largest block this host takes, in bytes. `recovery` says in words who decides that a
    coordinator is lost; '' where none is recovered. `origin` says in words where on the Earth its team counts
    places from; '' where nowhere. `reservation` is how long one lasts unheard, in seconds. `time` is what it
    is as far as the sender knows without the others, in seconds since 1970 UTC, and `revoked` the number of
    its revocation list; both 0 where nobody has keys. `bundle` is the digest of the bundle that it runs, of
    which those hashes are a part; b"" where it runs what its own files say, and `built` is then the digest of
    the bundle that it has made of those files: it is shown to people and not compared.
    `epochs` are what orders to stop and to pause must name (`orders`).
    """

    role: Role
    host: Name
    incarnation: Count
    program: Hash = b""
    deployment: Hash = b""
    max_block: Count = 0
    coordinators: Annotated[list[Known], Meta(max_length=4096)] = []
    registry: Hash = b""
    access: Hash = b""
    devices: Literal["", "fakes", "hardware"] = ""
    memory: Count = 0
    recovery: Text = ""
    origin: Text = ""
    reservation: Age = 0.0
    time: Moment = 0.0
    revoked: Count = 0
    bundle: Hash = b""
    built: Hash = b""
    epochs: Epochs = Epochs()

    @property
    def brief(self) -> Hello:
        """What whoever is no host hears of it: nothing of the mission, for that takes the right to ask."""
        return Hello(
            self.role,
            self.host,
            self.incarnation,
            time=self.time,
            revoked=self.revoked,
            epochs=self.epochs,
        )

    @property
    def remembers(self) -> int:
        """The identity of what this host answers from: a question for another one has no answer here."""
        return self.memory or self.incarnation

    @property
    def mission(self) -> bytes:
        """The hash of what blocks are of: a program, and the agents in whose order proxies are numbers."""
        return hashlib.sha256(self.program + self.deployment).digest()


class ForeignHello(Struct, frozen=True):
    """A greeting of another protocol version; nothing but the version can be read."""

    protocol: int


class Refuse(Struct, frozen=True):
    """Sent instead of going on when a greeting does not fit; then the link is closed."""

    reason: str


#: The token of a Ping whose answer the core of a host waits for; others are for links alone.
QUESTION = 1 << 31


class Ping(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=8):
    """Answered by a Pong with the same token: the peer's process is alive."""

    token: Count


class Pong(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=9):
    """The answer to a Ping."""

    token: Count


class FactReport(Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """The value of an attribute, `age` seconds old when it was sent.

    `attribute` is its place among the attributes of the registry, by name. `kept`: the sender keeps it up to
    date, so it ages only while nothing is heard from the sender. What was not measured does not age.
    """

    attribute: Index
    value: FactValue
    age: Age
    kept: bool
    of: ToldBy = "measured"


class AgentReport(Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """What has changed about one agent; `agent` is its place in the deployment.

    `trouble` is why it cannot be called, '' when it can, and `lasting` for how many seconds already, where
    that is told. `unknown` are live attributes that have no value, each with the reason. `holder` is the
    coordinator that has reserved it, '' for none, and `held` for how many seconds already.
    """

    agent: Index
    trouble: Label
    lasting: Age | None
    facts: Annotated[list[FactReport], Meta(max_length=1024)]
    unknown: Annotated[list[tuple[Index, Label]], Meta(max_length=1024)]
    holder: MaybeName = ""
    held: Age = 0.0


class Report(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=12):
    """How the agents of a host are: what has changed since its report number `since`, 0 for everything.

    `life` is the sender's incarnation. Every report of a life has a higher `sequence` than those before.
    """

    life: Count
    since: Ordinal
    sequence: Ordinal
    agents: Annotated[list[AgentReport], Meta(max_length=4096)]


class SignOfLife(Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """How often a host has told that it lives; `host` is its place in the deployment."""

    host: Index
    incarnation: Count
    count: Ordinal


class Heard(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=13):
    """News of hosts that somebody misses: their last signs of life, and those that are `asked` for."""

    signs: Annotated[list[SignOfLife], Meta(max_length=4096)]
    asked: Annotated[list[SignOfLife], Meta(max_length=4096)]


class Relayed(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=22):
    """A question about a transfer, or its answer, for a host that its sender has no link with.

    Every host passes it on once to all its links. `origin` numbers what its sender has relayed in one life,
    and `receiver` is the place of a host in the deployment.
    """

    origin: SignOfLife
    receiver: Index
    message: Accepted | Refused | Inquire


class Room(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=14):
    """Whether the sender can keep coordinators that come to it: '' if so, else why it can not."""

    trouble: Text


class Revocations(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=36):
    """Whose certificates count no more: a list that the authority has signed, in DER. Who has an older one
    takes it."""

    list: Annotated[bytes, Meta(max_length=MAX_LIST)]


#: Messages that share the control frame.
Control = (
    Accepted
    | Refused
    | Inquire
    | Ended
    | EndedAck
    | StatusRequest
    | Status
    | Ping
    | Pong
    | EmergencyStop
    | EmergencyStopped
    | Forget
    | Forgotten
    | Pause
    | Recover
    | Recovered
    | StartRequest
    | StartResponse
    | OrderChallenge
    | RelayedOrder
    | RelayedAnswer
    | Report
    | Heard
    | Relayed
    | Room
    | Revocations
    | QuorumMessage
    | ReservationMessage
    | WatchMessage
)

#: Every message without a block.
Message = Hello | ForeignHello | Refuse | Control
