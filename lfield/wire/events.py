"""The numbered events of one host, which subscribers follow (`lfield events`, `logs`, `watch`).

An event carries one of the structs below: in msgpack an array that begins with its kind, a short name.
`lfield/docs/events.md` describes the condition of each event, and the bounds.
"""

from __future__ import annotations

from typing import Annotated, Literal, get_args

from msgspec import Meta, Struct

from lfield.hybrid_clock import timestamp_of
from lfield.wire.coordinator_messages import Outcome
from lfield.wire.fields import (
    Count,
    Duration,
    Index,
    Label,
    Milliseconds,
    Moment,
    Name,
    OptionalName,
    Ordinal,
    Share,
    Telemetry,
    Text,
)

# --- agents ---------------------------------------------------------------------------------------------


class AgentStarted(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag="started"):
    """An agent runs on this host. `kept`: the agent was resumed from the journal of the host."""

    agent: Name
    generation: Ordinal
    kept: bool = False


class AgentFinished(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag="finished"):
    """An agent has ended here, a resource only by dying; `detail` is the reason, with its source lines."""

    agent: Name
    generation: Ordinal
    how: Outcome
    detail: Text = ""


class MigrationInDoubt(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag="doubted"):
    """A coordinator was sent `to` another host, and it is unknown whether it arrived there."""

    agent: Name
    generation: Ordinal
    to: OptionalName
    reason: Text


class CoordinatorRecovered(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag="recovered"):
    """A coordinator was recovered on this host after the loss of its holder, as start `generation`."""

    agent: Name
    generation: Ordinal


class CoordinatorSuperseded(
    Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag="superseded"
):
    """A coordinator was stopped on this host because another start of it is alive."""

    agent: Name
    generation: Ordinal
    reason: Text


class Printed(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag="printed"):
    """Output of a program: output of `print` is a line of the `log`, output of `write` is text (`out`)."""

    agent: Name
    text: Text
    on: Literal["log", "out"] = "log"


# --- hops -----------------------------------------------------------------------------------------------
# (agent, generation, sequence) is the name of a hop in the streams of both hosts.


class MigrationStarted(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag="left"):
    """A coordinator was sent `to` another host, where it calls a `portal` of a `resource` ('' to reserve it);
    the block has `size` bytes."""

    agent: Name
    generation: Ordinal
    sequence: Ordinal
    to: Name
    resource: OptionalName
    portal: Label
    size: Count


class MigrationArrived(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag="came"):
    """A coordinator arrived from the host `of` and runs on this host; the block has `size` bytes."""

    agent: Name
    generation: Ordinal
    sequence: Ordinal
    of: Name
    size: Count


class MigrationConfirmed(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag="hopped"):
    """A coordinator's arrival is confirmed, `seconds` after its departure, by the first of: a confirmation,
    its return, its end. `seconds` is None if it left in an earlier incarnation of this host."""

    agent: Name
    generation: Ordinal
    sequence: Ordinal
    to: Name
    seconds: Duration | None


class MigrationFailed(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag="stayed"):
    """A coordinator did not arrive, and continues on this host with an `exception`, '' for none."""

    agent: Name
    generation: Ordinal
    sequence: Ordinal
    to: OptionalName
    exception: Label
    reason: Text


# --- portals, and instructions to devices ---------------------------------------------------------------


class PortalCallStarted(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag="began"):
    """A portal of a resource of this host started for a coordinator; `call` counts in this incarnation."""

    call: Ordinal
    agent: Name
    resource: Name
    portal: Label


class PortalCallEnded(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag="ended"):
    """A portal ended after `seconds` seconds; 'lost': its resource died. `detail` is the exception."""

    call: Ordinal
    agent: Name
    resource: Name
    portal: Label
    seconds: Duration
    how: Literal["done", "thrown", "lost"]
    detail: Text = ""


class DeviceCallStarted(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag="asked"):
    """An agent of this host gave a device an instruction; `device` is AGENT.FIELD, and `call` counts in this
    incarnation of the host, separately from portal calls."""

    call: Ordinal
    agent: Name
    device: Label
    instruction: Label


class DeviceCallEnded(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag="answered"):
    """A device has answered after `seconds` seconds; `error` is '' after success."""

    call: Ordinal
    agent: Name
    device: Label
    instruction: Label
    seconds: Duration
    error: Text = ""


class EventsDropped(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag="skipped"):
    """The rate limit has dropped a number of events of a kind since the last report."""

    skipped: Label
    count: Count


# --- devices --------------------------------------------------------------------------------------------


class DeviceLatched(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag="latched"):
    """A device, AGENT.FIELD, goes into its safe state, for a reason."""

    device: Label
    state: Label
    reason: Text


class SafeStateConfirmed(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag="confirmed"):
    """A device is in its safe state; `reason` as in `DeviceLatched`."""

    device: Label
    state: Label
    reason: Text


class DeviceMoving(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag="moving"):
    """The movement of a latched device in its safe state, in words; '' at rest."""

    device: Label
    moving: Text


class DeviceReleased(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag="released"):
    """A device is in use again."""

    device: Label


# --- the team and operators ------------------------------------------------------------------------------


class OfferPublished(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag="offered"):
    """An agent of the team can be called, as far as this host knows."""

    agent: Name


class OfferWithdrawn(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag="withdrawn"):
    """An agent of the team can no longer be called, as far as this host knows, for a reason."""

    agent: Name
    reason: Text


class LinkUp(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag="linked"):
    """A link with another host opened; `restarted`: the incarnation of that host has changed."""

    peer: Name
    restarted: bool = False


class LinkDown(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag="unlinked"):
    """A link with another host closed; `lost`: this host still needed the link."""

    peer: Name
    lost: bool = True


class LinkRefused(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag="refused"):
    """No link with another host can be made, for a reason; '' when a link is possible again."""

    peer: Name
    reason: Text


class StartDelayed(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag="waits"):
    """Coordinators of this host are not started yet: they wait for `hosts`, or are `held` for a reason until
    an operator's command. Commas separate names; `agents` is empty when none waits."""

    agents: Text
    hosts: Text
    held: Text = ""


class InputAwaited(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag="reads"):
    """Agents of this host wait for a line of the operator's input; commas separate names, '' for none."""

    agents: Text


class EmergencyStopChanged(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag="stopped"):
    """An operator has pressed the emergency stop, or has `lifted` it."""

    by: Text
    reason: Text
    lifted: bool = False


class PauseChanged(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag="paused"):
    """An operator, or a vote of this robot, has paused the mission here or has `lifted` the pause."""

    by: Text
    lifted: bool = False
    is_vote: bool = False


class HostStopping(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag="ending"):
    """The host makes its devices safe and stops."""

    reason: Text = ""


class LineLogged(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag="logged"):
    """A line of the host's log, except output of programs; `messages.md` lists the codes."""

    text: Text
    code: Label = ""
    level: Label = ""


# --- telemetry ------------------------------------------------------------------------------------------


class DeviceTelemetry(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag="measured"):
    """The last telemetry of a device by quantity; `silent` is its age in seconds."""

    device: Label
    values: Annotated[dict[Label, Telemetry], Meta(max_length=1024)]
    silent: Duration


class AgentActivity(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag="standing"):
    """The state of an agent; its line in the program, 0 for none; and what it waits for: RESOURCE.PORTAL,
    AGENT.FIELD.INSTRUCTION, or ''."""

    agent: Name
    state: Label
    file: Label
    line: Count
    waits: Label


class LinkTelemetry(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag="path"):
    """Measurements of the link with another host: see `LinkStatus`."""

    peer: Name
    round_trip: Duration | None
    loss: Share | None
    sent: Count | None
    received: Count | None


#: Events of state changes: delivered completely to every subscriber that reads fast enough.
StateEvent = (
    AgentStarted
    | AgentFinished
    | MigrationInDoubt
    | CoordinatorRecovered
    | CoordinatorSuperseded
    | Printed
    | MigrationStarted
    | MigrationArrived
    | MigrationConfirmed
    | MigrationFailed
    | PortalCallStarted
    | PortalCallEnded
    | DeviceCallStarted
    | DeviceCallEnded
    | EventsDropped
    | DeviceLatched
    | SafeStateConfirmed
    | DeviceMoving
    | DeviceReleased
    | OfferPublished
    | OfferWithdrawn
    | LinkUp
    | LinkDown
    | LinkRefused
    | StartDelayed
    | InputAwaited
    | EmergencyStopChanged
    | PauseChanged
    | HostStopping
    | LineLogged
)
#: Sampled events: only the newest one counts, for each device, agent and link.
TelemetryEvent = DeviceTelemetry | AgentActivity | LinkTelemetry

#: The kinds of events by their name in JSON.
KINDS: dict[str, type[Struct]] = {
    str(kind.__struct_config__.tag): kind for kind in get_args(StateEvent) + get_args(TelemetryEvent)
}
TELEMETRY = frozenset(str(kind.__struct_config__.tag) for kind in get_args(TelemetryEvent))


class Event(Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """An event on a host: `at` Unix time by its own clock, `up` seconds by its monotonic clock.

    `number` counts the states of this incarnation of the host from 1, without a gap; of telemetry, it is the
    number of the last state before. `cause` is the number of the earlier event of the same incarnation that
    led to this one, 0 if unknown; that of a `MigrationArrived` is in another host's stream. `stamp` orders
    the events of all hosts: `ahead` milliseconds more than `at`, with the counter `tick`.
    """

    number: Ordinal
    at: Moment
    up: Duration
    cause: Ordinal
    what: StateEvent | TelemetryEvent
    ahead: Milliseconds = 0
    tick: Index = 0

    @property
    def stamp(self) -> int:
        """The timestamp of the event."""
        return timestamp_of(max(0, int(self.at * 1000.0) + self.ahead), self.tick)

    @property
    def kind(self) -> str:
        """The name of the kind of the event: 'left'."""
        return str(self.what.__struct_config__.tag)
