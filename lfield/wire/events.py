"""What happened on one host, numbered: the stream that watchers follow (`lfield events`, `logs`, `watch`).

What an event tells is one of the structs below. In msgpack each is an array that begins with its kind, a
short word; `as_fields` gives it by name, as `lfield events --json` shows it. `lfield/docs/events.md` says
when each is told, and what is bounded. The messages that carry events are in `watching`.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal, get_args

from msgspec import Meta, Struct, to_builtins

from lfield.wire.coordinators import Outcome
from lfield.wire.fields import Age, Count, Label, MaybeName, Moment, Name, Ordinal, Share, Telemetry, Text

# --- agents ---------------------------------------------------------------------------------------------


class Started(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag="started"):
    """An agent runs here. `kept`: it goes on from what the journal of this host had of it."""

    agent: Name
    generation: Ordinal
    kept: bool = False


class Finished(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag="finished"):
    """An agent has ended here, a resource only by dying; `detail` is why, with the lines it came from."""

    agent: Name
    generation: Ordinal
    how: Outcome
    detail: Text = ""


class Doubted(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag="doubted"):
    """It is not known whether a coordinator that was sent `to` another host arrived there."""

    agent: Name
    generation: Ordinal
    to: MaybeName
    reason: Text


class Recovered(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag="recovered"):
    """The host of a coordinator is gone: it goes on here, from the last copy, as start `generation`."""

    agent: Name
    generation: Ordinal


class Superseded(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag="superseded"):
    """A coordinator was stopped here, because another start of it goes on."""

    agent: Name
    generation: Ordinal
    reason: Text


class Printed(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag="printed"):
    """What a program says, by `print` as a line of the `log`, by `write` as it is written `out`."""

    agent: Name
    text: Text
    on: Literal["log", "out"] = "log"


# --- hops -----------------------------------------------------------------------------------------------
# (agent, generation, sequence) is the name of a hop in the streams of both hosts.


class Left(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag="left"):
    """A coordinator was sent `to` another host, where it calls a `portal` of a `resource` ('' where it
    reserves it); its block has `size` bytes."""

    agent: Name
    generation: Ordinal
    sequence: Ordinal
    to: Name
    resource: MaybeName
    portal: Label
    size: Count


class Came(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag="came"):
    """It came from the host `of` and runs here; its block has `size` bytes."""

    agent: Name
    generation: Ordinal
    sequence: Ordinal
    of: Name
    size: Count


class Hopped(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag="hopped"):
    """Whoever sent it has heard that it came, so many `seconds` after it had left, by what was first: a
    confirmation, its coming back, or its end. None where it left in an earlier life of this host."""

    agent: Name
    generation: Ordinal
    sequence: Ordinal
    to: Name
    seconds: Age | None


class Stayed(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag="stayed"):
    """It did not come there, and goes on here by that `exception`, '' for none."""

    agent: Name
    generation: Ordinal
    sequence: Ordinal
    to: MaybeName
    exception: Label
    reason: Text


# --- portals, and instructions to devices ---------------------------------------------------------------


class Began(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag="began"):
    """A portal of a resource of this host began for a coordinator; `call` counts in this life of the host."""

    call: Ordinal
    agent: Name
    resource: Name
    portal: Label


class Ended(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag="ended"):
    """A portal ended after so many `seconds`; 'lost': its resource died. `detail` is what it has thrown."""

    call: Ordinal
    agent: Name
    resource: Name
    portal: Label
    seconds: Age
    how: Literal["done", "thrown", "lost"]
    detail: Text = ""


class Asked(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag="asked"):
    """An agent of this host gave a device an instruction; `device` is AGENT.FIELD, and `call` counts in this
    life of the host, apart from those of portals."""

    call: Ordinal
    agent: Name
    device: Label
    instruction: Label


class Answered(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag="answered"):
    """The device has answered after so many `seconds`; `error` is '' when it has done as it was told."""

    call: Ordinal
    agent: Name
    device: Label
    instruction: Label
    seconds: Age
    error: Text = ""


class Skipped(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag="skipped"):
    """There were too many events of a kind to tell each: so many were left out since this was last said."""

    skipped: Label
    count: Count


# --- devices --------------------------------------------------------------------------------------------


class Latched(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag="latched"):
    """A device, AGENT.FIELD, goes into its safe state, for that reason."""

    device: Label
    state: Label
    reason: Text


class Confirmed(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag="confirmed"):
    """It is in its safe state; `reason` as before."""

    device: Label
    state: Label
    reason: Text


class Moving(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag="moving"):
    """What a latched device still does in its safe state, in words; '' once it is at rest."""

    device: Label
    moving: Text


class Released(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag="released"):
    """A device is in use again."""

    device: Label


# --- the team, and people -------------------------------------------------------------------------------


class Offered(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag="offered"):
    """An agent of the team can be called, as far as this host knows."""

    agent: Name


class Withdrawn(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag="withdrawn"):
    """An agent of the team cannot be called any more, as far as this host knows, for that reason."""

    agent: Name
    reason: Text


class Linked(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag="linked"):
    """There is a link with another host; `restarted`: it is in another life than it was."""

    peer: Name
    restarted: bool = False


class Unlinked(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag="unlinked"):
    """A link with another host is gone; `lost`: this one had a use for it."""

    peer: Name
    lost: bool = True


class Refused(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag="refused"):
    """No link with another host can be made, for that reason; '' when that is over."""

    peer: Name
    reason: Text


class Waits(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag="waits"):
    """Coordinators of this host are not started yet: their start waits for those `hosts`, or is `held` for
    that reason until an operator's command. Commas separate names; no `agents`: none waits any more."""

    agents: Text
    hosts: Text
    held: Text = ""


class Stopped(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag="stopped"):
    """Somebody has pressed the emergency stop, or has `lifted` it."""

    by: Text
    reason: Text
    lifted: bool = False


class Paused(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag="paused"):
    """Somebody has paused the mission here, or has `lifted` that."""

    by: Text
    lifted: bool = False


class Ending(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag="ending"):
    """The host makes its devices safe and ends: nothing runs here any more."""

    reason: Text = ""


class Logged(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag="logged"):
    """A line of the host's log that no program has printed."""

    text: Text


# --- telemetry ------------------------------------------------------------------------------------------


class Measured(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag="measured"):
    """The last telemetry of a device by quantity, however old; it was not heard for so many seconds."""

    device: Label
    values: Annotated[dict[Label, Telemetry], Meta(max_length=1024)]
    silent: Age


class Standing(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag="standing"):
    """What an agent does, in a word; the line of L at which it stands, 0 for none; and what it waits for:
    RESOURCE.PORTAL, AGENT.FIELD.INSTRUCTION, or ''."""

    agent: Name
    state: Label
    file: Label
    line: Count
    waits: Label


class Path(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag="path"):
    """What is measured of the link with another host: see `LinkStatus`."""

    peer: Name
    round_trip: Age | None
    loss: Share | None
    sent: Count | None
    received: Count | None


#: What changes once and is told once: no watcher that keeps up loses one.
State = (
    Started
    | Finished
    | Doubted
    | Recovered
    | Superseded
    | Printed
    | Left
    | Came
    | Hopped
    | Stayed
    | Began
    | Ended
    | Asked
    | Answered
    | Skipped
    | Latched
    | Confirmed
    | Moving
    | Released
    | Offered
    | Withdrawn
    | Linked
    | Unlinked
    | Refused
    | Waits
    | Stopped
    | Paused
    | Ending
    | Logged
)
#: Of what is told again and again only the newest counts, for each device, agent and link.
Thinned = Measured | Standing | Path

#: The kinds of events, by the word that JSON has for each.
KINDS: dict[str, type[Struct]] = {
    str(kind.__struct_config__.tag): kind for kind in get_args(State) + get_args(Thinned)
}
TELEMETRY = frozenset(str(kind.__struct_config__.tag) for kind in get_args(Thinned))


class Event(Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """What happened on a host: `at` Unix time by its own clock, `up` seconds by its monotonic clock.

    `number` counts the states of this life of the host from 1, without a gap; of telemetry it is the number
    of the last state before it. `cause` is the number of the earlier event of the same life that led to this
    one, 0 where none is known. What led to a `Came` is the `Left` of the same hop, in another host's stream.
    """

    number: Ordinal
    at: Moment
    up: Age
    cause: Ordinal
    what: State | Thinned

    @property
    def kind(self) -> str:
        """Its word: 'left'."""
        return str(self.what.__struct_config__.tag)


def as_fields(event: Event) -> dict[str, Any]:
    """An event by names: number, at, up, cause, kind, and the fields of its kind. JSON can have it all."""
    what = event.what
    told = {name: to_builtins(getattr(what, name)) for name in what.__struct_fields__}
    head = {"number": event.number, "at": event.at, "up": event.up, "cause": event.cause}
    return {**head, "kind": event.kind, **told}
