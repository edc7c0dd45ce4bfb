"""Orders of observers, with the answers (`lfield estop`, `forget`), and the snapshot of a host.

An `EventBatch` carries the snapshot. Messages as in `messages`, which has the union of all.
"""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta, Struct
from msgspec.structs import replace

from lfield.wire.coordinator_messages import CoordinatorState, CopyState
from lfield.wire.fields import (
    MAX_INPUT,
    Count,
    Duration,
    FactValue,
    Hash,
    Label,
    Moment,
    Name,
    OptionalName,
    OrderId,
    Ordinal,
    Share,
    Telemetry,
    Text,
    ValueSource,
)
from lfield.wire.order_messages import UNKNOWN_EPOCH, Epoch, Epochs, OrderKind


class AgentStatus(Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """An agent that a host runs. `state` is its state; `heap` and `limit` are bytes."""

    id: Name
    type: Text
    kind: Literal["coordinator", "resource"]
    state: Label
    hops: Ordinal
    served: Count
    heap: Count
    limit: Count
    threads: Count


class DeviceStatus(Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """A device of a host, with its last telemetry by quantity, of any age.

    `silent` is the age of the telemetry, None without any. `latched` is the reason why the device is held in
    its safe state, '' when it is in use; `moving` describes its movement in this state, '' at rest; before
    the safe state is confirmed, `moving` says that the confirmation is pending.
    """

    name: Text
    telemetry: Annotated[dict[Label, Telemetry], Meta(max_length=1024)]
    silent: Duration | None
    latched: Text
    moving: Text = ""


class LinkStatus(Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """Another host: the time without a link to it, None while there is one.

    For a link, the smoothed round-trip time in seconds, the share of segments lost in the last minute, and
    the bytes sent (retransmissions included) and received since the link opened, with TLS overhead and
    without headers of TCP and IP; None for values that are not available. `kinds` are the bytes of the
    messages of both directions by kind of traffic (`lfield.net.coding.traffic_kinds`), before TLS. `path` and
    `standby` are the addresses of the other host in the network of the link and in the network of its standby
    connection ('' for none); both are '' if there is one network.
    """

    host: Name
    away: Duration | None
    round_trip: Duration | None = None
    loss: Share | None = None
    sent: Count | None = None
    received: Count | None = None
    kinds: Annotated[dict[Label, Count], Meta(max_length=16)] = {}
    path: Text = ""
    standby: Text = ""


class AttributeReading(Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """The value of an attribute: `measured` by a device `age` seconds ago, or stated."""

    value: FactValue
    age: Duration
    of: ValueSource = "measured"


class DirectoryEntry(Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """The entry of an agent of the team in a host's directory.

    `refusal` is the reason why the agent cannot be called, '' if it can. A measured attribute is among
    `facts`, or `unknown` with the reason.
    """

    agent: Name
    refusal: Text
    facts: Annotated[dict[Label, AttributeReading], Meta(max_length=1024)]
    unknown: Annotated[dict[Label, Text], Meta(max_length=1024)]


class ParkedStatus(Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """A coordinator in a journal that belongs to another program or deployment, with the digest of both.

    With `state` RUN the coordinator is here; with another state it left, or may have left, for `where`.
    """

    agent: Name
    generation: Ordinal
    hops: Ordinal
    program: Hash
    state: CopyState
    where: OptionalName


class PendingCallStatus(Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """A portal call that a coordinator has started here and fetches later: it runs, has ended, or is lost."""

    agent: Name
    generation: Ordinal
    resource: Name
    portal: Text
    state: Literal["running", "done", "thrown", "lost"]


class ReservedStatus(Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """A resource that a coordinator has reserved, and the seconds since then; `left` is the remaining time of
    the lease if it is not renewed.
    """

    resource: Name
    agent: Name
    generation: Ordinal
    held: Duration
    left: Duration


class JournalStatus(Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """The journal of a host: its commits in the last minute, and the stored coordinators.

    `trouble` is the reason why no new coordinator should be admitted, '' for none.
    """

    commits: Count
    trouble: Text
    parked: Annotated[list[ParkedStatus], Meta(max_length=4096)]


class BundleStatus(Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """The bundle that a host runs: its digest, its signer ('' if no signature was required), and the time."""

    digest: Hash
    by: Text = ""
    at: Moment = 0.0


class UnlinkableHost(Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """Another host to which no link can be made, and the reason; `bundle` is the digest of its bundle, b"" if
    unknown.
    """

    host: Name
    reason: Text
    bundle: Hash = b""


class StartStatus(Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """The coordinators of a host that have not started yet, and the conditions of their start.

    `hosts` are the hosts with resources that are not linked, or whose vehicles do not report whether they are
    on the ground; `without` are the hosts that the start does not wait for. `held` is the reason why the
    start waits for an operator's command, '' if it does not.
    """

    agents: Annotated[list[Name], Meta(max_length=4096)]
    hosts: Annotated[list[Name], Meta(max_length=4096)]
    without: Annotated[list[Name], Meta(max_length=4096)] = []
    held: Text = ""


class Status(Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """The snapshot of a host that has been `up` for that number of seconds: its agents, devices and links.

    `coordinators` are all coordinators of which it has records, `directory` is its directory of the agents of
    the team. `late` is the longest delay of its heartbeats to its guards in the last minute, in seconds, and
    `silence` the permitted silence; both None without devices. `journal` is None for a host without one.
    `paused`: no agent runs here until the mission is resumed. `lease` is the remaining time in seconds for
    which coordinators may act, None if they need no lease. `pending_calls` are the calls started here that
    have not been fetched, `reserved` the resources here that coordinators have reserved. `bundle` is None for
    a mission from files. `stopped` is the reason why an emergency stop locks its devices, '' for none, and
    `persist_error` describes security state that the host could not store and will lose at its end. `refused`
    are the hosts to which no link can be made, `start` is None if no coordinator of this host waits to start.
    `epochs` are the numbers that orders must name (see `orders`). `ballot` is the ballot about an activation
    that holds the mission like a pause, b"" for none. `starting`: its devices are not open yet, and no
    resource has started. `observers` are the bytes exchanged with observers, by kind of traffic. `reads` are
    the agents that wait for a line of input, in the order in which they get lines. `startable` are the
    coordinators of this host that others may start, and that do not run.
    """

    host: Name
    address: Text
    up: Duration
    program: Hash
    deployment: Hash
    agents: Annotated[list[AgentStatus], Meta(max_length=4096)]
    coordinators: Annotated[list[CoordinatorState], Meta(max_length=4096)]
    devices: Annotated[list[DeviceStatus], Meta(max_length=4096)]
    links: Annotated[list[LinkStatus], Meta(max_length=4096)]
    directory: Annotated[list[DirectoryEntry], Meta(max_length=4096)]
    late: Duration | None = None
    silence: Duration | None = None
    journal: JournalStatus | None = None
    lease: Duration | None = None
    paused: bool = False
    pending_calls: Annotated[list[PendingCallStatus], Meta(max_length=4096)] = []
    reserved: Annotated[list[ReservedStatus], Meta(max_length=4096)] = []
    bundle: BundleStatus | None = None
    stopped: Text = ""
    persist_error: Text = ""
    refused: Annotated[list[UnlinkableHost], Meta(max_length=4096)] = []
    start: StartStatus | None = None
    epochs: Epochs = Epochs()
    ballot: Annotated[bytes, Meta(max_length=16)] = b""
    starting: bool = False
    observers: Annotated[dict[Label, Count], Meta(max_length=16)] = {}
    reads: Annotated[list[Name], Meta(max_length=4096)] = []
    startable: Annotated[list[Name], Meta(max_length=4096)] = []


class EmergencyStop(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=10):
    """From an observer: bring every device of this host into its safe state and lock `release()`.

    With `lift` the lock is removed; the devices stay latched until the program releases them. `id` and
    `epoch` as in `orders`: an order with the id of an executed one is only confirmed again, and an order that
    names an epoch other than that of the host is answered by an `EpochChallenge`.
    """

    id: OrderId
    reason: Text
    lift: bool = False
    epoch: Epoch = UNKNOWN_EPOCH

    @property
    def kind(self) -> OrderKind:
        return "lift" if self.lift else "stop"


class EmergencyStopResult(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=11):
    """The answer: every device of the host, with '' when its safe state is confirmed, otherwise the reason
    why it is not.

    `trouble` is the reason why the order may be lost after a restart of the host, '' if it is stored (also
    for a host without a journal, which never stores it), or states that a later order has replaced it. `id`
    is the id of the order, and `epochs` are the present epochs of the host.
    """

    devices: dict[str, Text]
    trouble: Text = ""
    id: Annotated[bytes, Meta(max_length=16)] = b""
    epochs: Epochs = Epochs()


class ForgetRequest(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=15):
    """From an observer: declare a coordinator lost, except starts that are known to be alive."""

    agent: Name


class ForgetResponse(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=16):
    """The answer: the starts that were ended here by the request."""

    starts: Annotated[list[Count], Meta(max_length=4096)]


class RecoverRequest(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=17):
    """From an observer: the holder of a coordinator is permanently lost; recover it here.

    (generation, sequence) identifies the copy of this host that the operator confirmed, `above` is the
    highest start that any host knows.
    """

    agent: Name
    generation: Ordinal
    sequence: Ordinal
    above: Ordinal


class RecoverResponse(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=18):
    """The answer: the new start, when it is durable; 0 for a refusal, with the reason."""

    generation: Ordinal
    reason: Text = ""


class Pause(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=19):
    """From an observer: suspend all agents and bring every device into its safe state; with `lift` resume.

    It is answered by an EmergencyStopResult when it is stored. `id` and `epoch` as in EmergencyStop.
    """

    id: OrderId
    lift: bool = False
    epoch: Epoch = UNKNOWN_EPOCH

    @property
    def kind(self) -> OrderKind:
        return "resume" if self.lift else "pause"


class BallotHold(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=65):
    """From the service of this robot: suspend all agents and bring every device into its safe state until the
    result of the ballot `id` is known.

    With `lift` the result is known, which ends only the hold by this ballot. The hold is independent of a
    Pause: neither ends the other. It is answered by an EmergencyStopResult.
    """

    id: OrderId
    lift: bool = False


class OrderChallenge(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=46):
    """The answer to an EmergencyStop or a Pause that names an epoch other than that of the host: the order
    may be old, and is not executed. To confirm it, the sender repeats the order with the present epoch of its
    kind.
    """

    id: OrderId
    epochs: Epochs


class StartRequest(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=37):
    """From an observer: start the coordinators that wait, and do not wait for the hosts in `without`."""

    without: Annotated[list[Name], Meta(max_length=4096)] = []


class StartResponse(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=38):
    """The answer: the coordinators that were `started` by the request, and the conditions that others of this
    host still wait for, None if none waits. `trouble` is the reason why the request was not executed, '' if
    it was.
    """

    started: Annotated[list[Name], Meta(max_length=4096)]
    waiting: StartStatus | None = None
    trouble: Text = ""


class InputLine(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=70):
    """From an observer: a line of input for an agent of this host, while it waits for a line."""

    agent: Name
    text: Annotated[str, Meta(max_length=MAX_INPUT)]


class InputResult(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=71):
    """The answer: the reason why no agent has got the line, '' if one has."""

    trouble: Text = ""


def with_epoch(order: EmergencyStop | Pause, epochs: Epochs) -> EmergencyStop | Pause:
    """The order with the epoch of its kind from a host's `epochs`."""
    return replace(order, epoch=epochs.of(order.kind))
