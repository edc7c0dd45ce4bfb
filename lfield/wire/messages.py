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

from lfield.wire.fields import Age, Count, Hash, Index, Label, MaybeName, Name, Telemetry, Text

#: The version of everything in this package. Hosts of different versions do not talk.
PROTOCOL = 5

#: Where a host's copy of a coordinator stands; see `lfield/docs/mobility.md`.
CopyState = Literal["RUN", "FROZEN", "PREPARED", "IN DOUBT", "MOVED", "EXITED"]

#: What a peer is: one of the team, or somebody who looks at it (`lfield ps`).
Role = Literal["host", "observer"]

#: How a coordinator ended. 'superseded': an earlier start of it is alive, so this one was stopped.
Outcome = Literal["done", "died", "lost", "superseded"]

#: `Refused.kind` for an id that the receiver never saw and now never will take.
NEVER_ARRIVED = "never arrived"

#: `Refused.kind` for a copy that must end because an earlier start of its coordinator is alive.
SUPERSEDED = "superseded"


class Known(Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """What one host knows of one start of a coordinator, for greetings and `lfield ps`.

    `sequence` is the highest transfer number of this start that was used or seen here. `where` is the host
    the copy went or wants to go to (FROZEN, PREPARED, IN DOUBT, MOVED), or the host it ended on (EXITED), and
    `receiver_memory` the memory of that host to which it was sent (PREPARED, IN DOUBT, MOVED).
    `outcome` is set for EXITED, `detail` for EXITED and IN DOUBT.
    """

    agent: Name
    generation: Count
    sequence: Count
    hops: Count
    state: CopyState
    where: MaybeName = ""
    outcome: Literal["", "done", "died", "lost", "superseded"] = ""
    detail: Text = ""
    receiver_memory: Count = 0


class Hello(Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """The first message of both sides of a link.

    `incarnation` is a random 63-bit number drawn at process start: the same host after a restart has
    another. `memory` is the identity of its journal, which outlives restarts; 0 for a host that keeps none.
    `program`, `deployment` and `registry` are 32-byte hashes of what all hosts of a team must have alike; an
    observer (`lfield ps`) may leave them empty, and a program that names no capability has no registry.
    `devices` says what those of its team are, '' where it has none.
    `max_block` is the largest block this host takes, in bytes.
    """

    role: Role
    host: Name
    incarnation: Count
    program: Hash = b""
    deployment: Hash = b""
    max_block: Count = 0
    coordinators: Annotated[list[Known], Meta(max_length=4096)] = []
    registry: Hash = b""
    devices: Literal["", "fakes", "hardware"] = ""
    memory: Count = 0

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


class Transfer(Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """The header of a coordinator under way; `size` bytes of block follow it in the same frame.

    (agent, generation, sequence) is the transfer's id. `hops` counts this hop too. `program` is the hash
    of the program the block belongs to, `receiver_memory` the memory of the receiver it is meant for.
    """

    agent: Name
    generation: Count
    sequence: Count
    hops: Count
    program: Hash
    receiver_memory: Count
    size: Count


class Accepted(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=1):
    """The transfer was injected, or its coordinator is known to have gone on since."""

    agent: Name
    generation: Count
    sequence: Count


class Refused(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=2):
    """The transfer was not injected and never will be.

    `kind` names the L exception to throw at the portal call, or is NEVER_ARRIVED or SUPERSEDED.
    """

    agent: Name
    generation: Count
    sequence: Count
    kind: Name
    reason: Text


class Inquire(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=3):
    """What became of this transfer? Answered by Accepted or Refused."""

    agent: Name
    generation: Count
    sequence: Count
    receiver_memory: Count


class Ended(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=4):
    """A coordinator has ended on `host`; repeated until every host has answered with EndedAck."""

    agent: Name
    generation: Count
    outcome: Outcome
    detail: Text
    host: Name


class EndedAck(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=5):
    """The ending is known here."""

    agent: Name
    generation: Count


class StatusRequest(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=6):
    """Asks a host for what `lfield ps` shows."""


class AgentStatus(Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """An agent that a host runs. `state` is a word for what it does; `heap` and `limit` are bytes."""

    id: Name
    type: Text
    kind: Literal["coordinator", "resource"]
    state: Label
    hops: Count
    served: Count
    heap: Count
    limit: Count
    threads: Count


class DeviceStatus(Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """A device of a host, with its last telemetry by quantity, however old.

    `silent` is for how long it has not been heard, None if it never was. `latched` is why it is held in its
    safe state, '' when it is in use; `moving` is what it still does there, '' once it is at rest, and before
    its safe state is confirmed that it is not.
    """

    name: Text
    telemetry: Annotated[dict[Label, Telemetry], Meta(max_length=1024)]
    silent: Age | None
    latched: Text
    moving: Text = ""


class LinkStatus(Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """Another host: for how long there has been no link to it, None while there is one."""

    host: Name
    away: Age | None


class ToldFact(Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """The value of a live attribute, `age` seconds old."""

    value: bool | int | float | Text
    age: Age


class Told(Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """What a host's directory says of an agent of the team.

    `refusal` is why it cannot be called, '' when it can. Live attributes are among `facts`, or `unknown` with
    the reason.
    """

    agent: Name
    refusal: Text
    facts: Annotated[dict[Label, ToldFact], Meta(max_length=1024)]
    unknown: Annotated[dict[Label, Text], Meta(max_length=1024)]


class ParkedStatus(Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """What a journal keeps of a coordinator for another program or deployment; the digest of both is given.

    With `state` RUN it is here, with another one it left for `where`, or may have.
    """

    agent: Name
    generation: Count
    hops: Count
    program: Hash
    state: CopyState
    where: MaybeName


class JournalStatus(Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """The journal of a host: how many commits it made in the last minute, and what it keeps for later.

    `trouble` is why nothing more should be taken in, '' when all is well.
    """

    commits: Count
    trouble: Text
    parked: Annotated[list[ParkedStatus], Meta(max_length=4096)]


class Status(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=7):
    """The answer: a host that has been `up` for so many seconds, its agents, devices and links.

    `coordinators` are all that it has seen, `directory` is what it knows of the agents of the team. `late` is
    by how many seconds its signs of life for its guards were late, the longest of the last minute, and
    `silence` for how many it may give none; both None without devices. `journal` is None for a host that
    keeps nothing.
    """

    host: Name
    address: Text
    up: Age
    program: Hash
    deployment: Hash
    agents: Annotated[list[AgentStatus], Meta(max_length=4096)]
    coordinators: Annotated[list[Known], Meta(max_length=4096)]
    devices: Annotated[list[DeviceStatus], Meta(max_length=4096)]
    links: Annotated[list[LinkStatus], Meta(max_length=4096)]
    directory: Annotated[list[Told], Meta(max_length=4096)]
    late: Age | None = None
    silence: Age | None = None
    journal: JournalStatus | None = None


class Ping(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=8):
    """Answered by a Pong with the same token: the peer's process is alive."""

    token: Count


class Pong(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=9):
    """The answer to a Ping."""

    token: Count


class EmergencyStop(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=10):
    """From an observer: bring every device of this host into its safe state and bar `release()`.

    With `lift` the bar is taken away again; the devices stay latched until the program releases them.
    """

    reason: Text
    lift: bool = False


class EmergencyStopped(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=11):
    """The answer: every device of the host, with '' when its safe state is confirmed, else why it is not."""

    devices: dict[str, Text]


class Forget(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=15):
    """From an observer: a person says that what is not known to be alive of a coordinator is lost."""

    agent: Name


class Forgotten(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=16):
    """The answer: the starts that have ended here by that word."""

    starts: Annotated[list[Count], Meta(max_length=4096)]


class FactReport(Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """The value of a live attribute, `age` seconds old when it was sent.

    `attribute` is its place among the live attributes of the agent's type, by name. `kept`: the sender keeps
    it up to date, so it ages only while nothing is heard from the sender.
    """

    attribute: Index
    value: bool | int | float | Label
    age: Age
    kept: bool


class AgentReport(Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """What has changed about one agent; `agent` is its place in the deployment.

    `trouble` is why it cannot be called, '' when it can, and `lasting` for how many seconds already, where
    that is told. `unknown` are live attributes that have no value, each with the reason.
    """

    agent: Index
    trouble: Label
    lasting: Age | None
    facts: Annotated[list[FactReport], Meta(max_length=1024)]
    unknown: Annotated[list[tuple[Index, Label]], Meta(max_length=1024)]


class Report(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=12):
    """How the agents of a host are: what has changed since its report number `since`, 0 for everything.

    `life` is the sender's incarnation. Every report of a life has a higher `sequence` than those before.
    """

    life: Count
    since: Count
    sequence: Count
    agents: Annotated[list[AgentReport], Meta(max_length=4096)]


class SignOfLife(Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """How often a host has told that it lives; `host` is its place in the deployment."""

    host: Index
    incarnation: Count
    count: Count


class Heard(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=13):
    """News of hosts that somebody misses: their last signs of life, and those that are `asked` for."""

    signs: Annotated[list[SignOfLife], Meta(max_length=4096)]
    asked: Annotated[list[SignOfLife], Meta(max_length=4096)]


class Room(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=14):
    """Whether the sender can keep coordinators that come to it: '' if so, else why it can not."""

    trouble: Text


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
    | Report
    | Heard
    | Room
)

#: Every message without a block.
Message = Hello | ForeignHello | Refuse | Control
