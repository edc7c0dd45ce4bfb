"""What observers of a host ask and order, and what they are told (`lfield ps`, `query`, `estop`, `forget`).

Hosts ask one another for a `Status` too. Messages as in `messages`, which has the union of all.
"""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta, Struct
from msgspec.structs import replace

from lfield.wire.coordinators import CopyState, Known
from lfield.wire.fields import (
    Age,
    Count,
    FactValue,
    Hash,
    Label,
    MaybeName,
    Moment,
    Name,
    OrderId,
    Ordinal,
    Share,
    Telemetry,
    Text,
    ToldBy,
)
from lfield.wire.orders import UNKNOWN, Epoch, Epochs, Kind


class StatusRequest(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=6):
    """Asks a host for what `lfield ps` shows."""


class AgentStatus(Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """An agent that a host runs. `state` is a word for what it does; `heap` and `limit` are bytes."""

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
    """Another host: for how long there has been no link to it, None while there is one.

    Of a link the smoothed round-trip time in seconds, the share of segments sent that were lost in the last
    minute, and the bytes sent (the repeated ones too) and received since it was made, with what TLS adds and
    without headers of TCP and IP; None for what is not measured.
    """

    host: Name
    away: Age | None
    round_trip: Age | None = None
    loss: Share | None = None
    sent: Count | None = None
    received: Count | None = None


class ToldFact(Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """The value of an attribute: `measured`, `age` seconds ago, told by a device of itself, or stated."""

    value: FactValue
    age: Age
    of: ToldBy = "measured"


class Told(Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """What a host's directory says of an agent of the team.

    `refusal` is why it cannot be called, '' when it can. What must be measured is among `facts`, or `unknown`
    with the reason.
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
    generation: Ordinal
    hops: Ordinal
    program: Hash
    state: CopyState
    where: MaybeName


class BegunStatus(Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """A portal call that a coordinator has begun here and fetches later: it runs, has ended, or is lost."""

    agent: Name
    generation: Ordinal
    resource: Name
    portal: Text
    state: Literal["running", "done", "thrown", "lost"]


class ReservedStatus(Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """A resource that a coordinator has reserved, for how many seconds already; so many are `left` of its
    lease, should nothing be heard of it."""

    resource: Name
    agent: Name
    generation: Ordinal
    held: Age
    left: Age


class JournalStatus(Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """The journal of a host: how many commits it made in the last minute, and what it keeps for later.

    `trouble` is why nothing more should be taken in, '' when all is well.
    """

    commits: Count
    trouble: Text
    parked: Annotated[list[ParkedStatus], Meta(max_length=4096)]


class BundleStatus(Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """The bundle that a host runs: its digest, who has signed it ('' where nobody had to), and when."""

    digest: Hash
    by: Text = ""
    at: Moment = 0.0


class RefusedHost(Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """Another host that no link can be made with, and why; `bundle` is the digest of the bundle that it runs,
    b"" where that is not known."""

    host: Name
    reason: Text
    bundle: Hash = b""


class StartStatus(Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """The coordinators of a host that are not started yet, and what their start waits for.

    `hosts` are those that have resources and are not linked, or have vehicles that do not say whether they
    are on the ground; `without` are those that the start does not wait for. `held` is why the start waits for
    an operator's command, '' where it does not.
    """

    agents: Annotated[list[Name], Meta(max_length=4096)]
    hosts: Annotated[list[Name], Meta(max_length=4096)]
    without: Annotated[list[Name], Meta(max_length=4096)] = []
    held: Text = ""


class Status(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=7):
    """The answer: a host that has been `up` for so many seconds, its agents, devices and links.

    `coordinators` are all that it has seen, `directory` is what it knows of the agents of the team. `late` is
    by how many seconds its signs of life for its guards were late, the longest of the last minute, and
    `silence` for how many it may give none; both None without devices. `journal` is None for a host that
    keeps nothing. `paused`: no agent runs here until the mission is resumed. For so many seconds yet its
    `lease` lets coordinators act, None where they need none. `begun` are the calls that were begun here and
    are still to be fetched, `reserved` the resources here that coordinators have reserved. `bundle` is None
    for a mission that was read from files. `stopped` is why an emergency stop bars its devices, '' for none,
    and `unkept` what it could not keep of whom it believes, and forgets with its end. `refused` are the hosts
    with which no link can be made, `start` is None where no coordinator of this host waits to be started.
    `epochs` are what orders must name (see `orders`).
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
    lease: Age | None = None
    paused: bool = False
    begun: Annotated[list[BegunStatus], Meta(max_length=4096)] = []
    reserved: Annotated[list[ReservedStatus], Meta(max_length=4096)] = []
    bundle: BundleStatus | None = None
    stopped: Text = ""
    unkept: Text = ""
    refused: Annotated[list[RefusedHost], Meta(max_length=4096)] = []
    start: StartStatus | None = None
    epochs: Epochs = Epochs()


class EmergencyStop(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=10):
    """From an observer: bring every device of this host into its safe state and bar `release()`.

    With `lift` the bar is taken away again; the devices stay latched until the program releases them. `id`
    and `epoch` as in `orders`: an order with the id of one that was executed is only confirmed again, and one
    that names another epoch than the host has is answered by a `Challenge`.
    """

    id: OrderId
    reason: Text
    lift: bool = False
    epoch: Epoch = UNKNOWN

    @property
    def kind(self) -> Kind:
        """Which order this is."""
        return "lift" if self.lift else "stop"


class EmergencyStopped(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=11):
    """The answer: every device of the host, with '' when its safe state is confirmed, else why it is not.

    `trouble` is why the host may not know of that when it is started again, '' when it will. It is '' also of
    a host without a journal, which never does. Or it says that the order was ended by a later one. `id` is
    that of the order, and `epochs` are those of the host now.
    """

    devices: dict[str, Text]
    trouble: Text = ""
    id: Annotated[bytes, Meta(max_length=16)] = b""
    epochs: Epochs = Epochs()


class Forget(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=15):
    """From an observer: a person says that what is not known to be alive of a coordinator is lost."""

    agent: Name


class Forgotten(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=16):
    """The answer: the starts that have ended here by that word."""

    starts: Annotated[list[Count], Meta(max_length=4096)]


class Recover(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=17):
    """From an observer: a person says that whoever held a coordinator is gone for good; go on with it.

    (generation, sequence) is the copy of this host that the person was told of, `above` the highest start
    that any host knows.
    """

    agent: Name
    generation: Ordinal
    sequence: Ordinal
    above: Ordinal


class Recovered(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=18):
    """The answer: as which start it goes on, once that is kept; 0 when it does not, with the reason."""

    generation: Ordinal
    reason: Text = ""


class Pause(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=19):
    """From an observer: let no agent run, bring every device into its safe state; with `lift` let all go on.

    Answered by an EmergencyStopped, when that is kept. `id` and `epoch` as in EmergencyStop.
    """

    id: OrderId
    lift: bool = False
    epoch: Epoch = UNKNOWN

    @property
    def kind(self) -> Kind:
        """Which order this is."""
        return "resume" if self.lift else "pause"


class OrderChallenge(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=46):
    """The answer to an EmergencyStop or a Pause with another epoch than the host has: it may be old, and is
    not executed. Whoever still wants it sends it again with the epoch of its kind."""

    id: OrderId
    epochs: Epochs


class StartRequest(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=37):
    """From an observer: start the coordinators that wait, and do not wait for the hosts in `without`."""

    without: Annotated[list[Name], Meta(max_length=4096)] = []


class StartResponse(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=38):
    """The answer: the coordinators that were `started` by that request, and what others of this host still
    wait for, None where none does. `trouble` is why nothing was done, '' where it was."""

    started: Annotated[list[Name], Meta(max_length=4096)]
    waiting: StartStatus | None = None
    trouble: Text = ""


def named(order: EmergencyStop | Pause, epochs: Epochs) -> EmergencyStop | Pause:
    """An order that names the epoch of its kind of a host with these `epochs`."""
    return replace(order, epoch=epochs.of(order.kind))
