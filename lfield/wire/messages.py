"""The messages between hosts.

Every message is a frozen msgspec struct, encoded in msgpack as an array whose first item is a small number,
the tag. Decoding is strict: wrong types, strings or lists beyond their bounds, surplus items, and unknown
tags are refused. Three messages are not in the `Control` union, because they have their own frame kinds:
`Hello` and `HandshakeRefused`, whose frame format never changes between versions, and `Transfer`, which is
followed by the raw bytes of a block. `codec` encodes and decodes all of them.
"""

from __future__ import annotations

import hashlib
from typing import Annotated, Literal

from msgspec import Meta, Struct

from lfield.wire.coordinator_messages import (
    CallsEnded,
    CancelCalls,
    CoordinatorState,
    Locate,
    Located,
    StopCoordinator,
    Terminated,
    TerminatedAck,
    TransferAccepted,
    TransferQuery,
    TransferRefused,
    WatchCalls,
)
from lfield.wire.fields import (
    MAX_LIST,
    Count,
    Duration,
    FactValue,
    Hash,
    Index,
    Label,
    Moment,
    Name,
    OptionalName,
    Ordinal,
    Text,
    Timestamp,
    ValueSource,
)
from lfield.wire.observer_messages import (
    BallotHold,
    EmergencyStop,
    EmergencyStopResult,
    ForgetRequest,
    ForgetResponse,
    InputLine,
    InputResult,
    OrderChallenge,
    Pause,
    RecoverRequest,
    RecoverResponse,
    StartRequest,
    StartResponse,
)
from lfield.wire.order_messages import Epochs, RelayedAnswer, RelayedOrder
from lfield.wire.person_calls.portal_call_messages import (
    PortalCallCancel,
    PortalCallRequest,
    PortalCallResult,
)
from lfield.wire.quorum_messages import QuorumMessage
from lfield.wire.reservation_messages import ReservationMessage
from lfield.wire.service_messages import ServiceMessage
from lfield.wire.subscription_messages import SubscriptionMessage

#: The version of all messages in this package. Hosts of different versions do not communicate.
PROTOCOL = 17

#: The role of a peer: a member of the team, an observer (`lfield ps`), or a member that keeps the connection
#: as a standby in addition to its link. A Hello of a host later makes a standby connection the link.
Role = Literal["host", "observer", "standby"]


class Hello(Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """The first message of both sides of a link.

    `incarnation` is a random 63-bit number drawn at process start: a restarted host has another one.
    `journal_id` is the id of its journal, which survives restarts; 0 for a host without one. `program`,
    `deployment`, `registry` and `access` are 32-byte hashes of the data that must be equal on all hosts of a
    team; an observer (`lfield ps`) leaves them empty, a program that names no capability has no registry, and
    a mission without an access file no rules. `devices` is the kind of the team's devices, '' if it has none.
    `max_block` is the largest block that this host accepts, in bytes. `recovery` describes the hosts that
    decide about the loss of a coordinator; '' if no coordinator is recovered. `origin` describes the origin
    of the team's map frame on the Earth; '' for none. `reservation` is the duration of a reservation without
    renewal, in seconds. `time` is the time that the sender knows without other hosts, in seconds since 1970
    UTC, and `revoked` the number of its revocation list; both 0 without keys. `bundle` is the digest of the
    running bundle, of which those hashes are a part; b"" for a mission from files. `built` is then the digest
    of the bundle made of those files: `built` is shown to operators and not compared. `epochs` are the
    numbers that stop and pause orders must name (`orders`). `stamp` is the timestamp of the sender, `run` the
    run id of its recording.
    """

    role: Role
    host: Name
    incarnation: Count
    program: Hash = b""
    deployment: Hash = b""
    max_block: Count = 0
    coordinators: Annotated[list[CoordinatorState], Meta(max_length=4096)] = []
    registry: Hash = b""
    access: Hash = b""
    devices: Literal["", "fakes", "hardware"] = ""
    journal_id: Count = 0
    recovery: Text = ""
    origin: Text = ""
    reservation: Duration = 0.0
    time: Moment = 0.0
    revoked: Count = 0
    bundle: Hash = b""
    built: Hash = b""
    epochs: Epochs = Epochs()
    stamp: Timestamp = 0
    run: Label = ""

    @property
    def summary(self) -> Hello:
        """The part for observers, without data of the mission, which require a permission."""
        return Hello(
            self.role,
            self.host,
            self.incarnation,
            time=self.time,
            revoked=self.revoked,
            epochs=self.epochs,
        )

    @property
    def state_id(self) -> int:
        """The id of the state from which this host answers; a query for another id has no answer here."""
        return self.journal_id or self.incarnation

    @property
    def mission_hash(self) -> bytes:
        """The hash of the mission of blocks: a program, and the agents in the order of which proxies are
        numbers."""
        return hashlib.sha256(self.program + self.deployment).digest()


class IncompatibleHello(Struct, frozen=True):
    """A Hello of another protocol version; only the version can be read."""

    protocol: int


#: A part of the reason for which a host refuses a further observer: a later attempt may succeed.
TOO_MANY_OBSERVERS = "observers are linked to this host"


class HandshakeRefused(Struct, frozen=True):
    """The answer to a Hello that is not acceptable; then the link is closed."""

    reason: str


#: The token of a Ping whose answer the core of a host awaits; others are only for link health.
QUESTION = 1 << 31


class Ping(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=8):
    """A heartbeat, answered by a Pong with the same token: the peer's process is alive. Heartbeats carry a
    timestamp.
    """

    token: Count
    stamp: Timestamp = 0


class Pong(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=9):
    """The answer to a Ping."""

    token: Count


class WholeTransferRequest(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=66):
    """Request to send the last transfer of a coordinator whole: its delta refers to an unknown transfer."""

    agent: Name


class AttributeUpdate(Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """The value of an attribute, `age` seconds old when it was sent.

    `attribute` is the index among the attributes of the registry, by name. `kept`: the sender updates the
    value, so it ages only while the sender is unreachable. A value that was not measured does not age.
    """

    attribute: Index
    value: FactValue
    age: Duration
    kept: bool
    of: ValueSource = "measured"


class AgentUpdate(Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """The changes of one agent; `agent` is its index in the deployment.

    `trouble` is the reason why it cannot be called, '' if it can, and `lasting` the seconds for which this
    has been so, if known. `unknown` are live attributes without a value, each with the reason. `holder` is
    the coordinator that has reserved the agent, '' for none, and `held` the seconds since the reservation.
    """

    agent: Index
    trouble: Label
    lasting: Duration | None
    facts: Annotated[list[AttributeUpdate], Meta(max_length=1024)]
    unknown: Annotated[list[tuple[Index, Label]], Meta(max_length=1024)]
    holder: OptionalName = ""
    held: Duration = 0.0


class DirectoryUpdate(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=12):
    """The agents of a host: changes since its report number `since`, 0 for all agents.

    `incarnation` is the sender's incarnation. The `sequence` of reports increases within an incarnation.
    """

    incarnation: Count
    since: Ordinal
    sequence: Ordinal
    agents: Annotated[list[AgentUpdate], Meta(max_length=4096)]


class LivenessCounter(Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """The heartbeat counter of a host; `host` is its index in the deployment."""

    host: Index
    incarnation: Count
    count: Ordinal


class GossipUpdate(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=13):
    """Gossip about suspected hosts: their last heartbeats, and the `probes` for them."""

    counters: Annotated[list[LivenessCounter], Meta(max_length=4096)]
    probes: Annotated[list[LivenessCounter], Meta(max_length=4096)]


class RelayedMessage(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=22):
    """A query about a transfer, or its answer, for a host without a link to the sender.

    Every host forwards it once to all its links. `origin` numbers the messages that its sender has relayed in
    one incarnation, and `receiver` is the index of a host in the deployment.
    """

    origin: LivenessCounter
    receiver: Index
    message: TransferAccepted | TransferRefused | TransferQuery


class Backpressure(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=14):
    """Whether the sender can store arriving coordinators: '' if so, otherwise the reason."""

    reason: Text


class GroundQuery(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=49):
    """Query whether the vehicles of a host are on the ground; answered by `GroundReport`."""


class GroundReport(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=50):
    """For each vehicle of the sender, by device name, whether it is on the ground; None if unknown."""

    vehicles: Annotated[dict[Text, bool | None], Meta(max_length=4096)]


class RevocationUpdate(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=36):
    """A certificate revocation list signed by the CA, in DER. A receiver with an older list adopts it."""

    list: Annotated[bytes, Meta(max_length=MAX_LIST)]


#: Messages that share the control frame.
Control = (
    TransferAccepted
    | TransferRefused
    | TransferQuery
    | Terminated
    | TerminatedAck
    | StopCoordinator
    | Locate
    | Located
    | Ping
    | Pong
    | WholeTransferRequest
    | EmergencyStop
    | EmergencyStopResult
    | ForgetRequest
    | ForgetResponse
    | Pause
    | BallotHold
    | RecoverRequest
    | RecoverResponse
    | StartRequest
    | StartResponse
    | InputLine
    | InputResult
    | OrderChallenge
    | RelayedOrder
    | RelayedAnswer
    | DirectoryUpdate
    | GossipUpdate
    | RelayedMessage
    | Backpressure
    | GroundQuery
    | GroundReport
    | RevocationUpdate
    | QuorumMessage
    | ReservationMessage
    | WatchCalls
    | CallsEnded
    | CancelCalls
    | SubscriptionMessage
    | PortalCallRequest
    | PortalCallCancel
    | PortalCallResult
    | ServiceMessage
)

#: Every message without a block.
Message = Hello | IncompatibleHello | HandshakeRefused | Control
