"""What leases and fences ask of their host, to be carried out in order; and what they see of coordinators."""

from __future__ import annotations

from typing import NamedTuple, Protocol

from msgspec import Struct

from lfield.wire.coordinators import Ended
from lfield.wire.quorum import Place, QuorumMessage


class Saved(NamedTuple):
    """The newest block that a host has of a coordinator, or the coordinator itself.

    `alive`: it goes on here as soon as the lease lets it, unless a fence bars it. `interval` is for how many
    seconds nobody may be heard to hold it before somebody else goes on with it; 0 for ever. `ended` is set
    when the newest start that is known here has terminated; then there is nothing to go on with. `final`:
    this host need not keep that coordinator from being recovered. Not so of one that terminated here, until a
    majority of the members has confirmed that they have it on disk.
    """

    place: Place
    alive: bool
    interval: float
    ended: Ended | None = None
    final: bool = True


class Copies(Protocol):
    """The coordinators of this host, as they are now."""

    def saved(self, agent: str) -> Saved | None:
        """The newest that is here of an agent, or its termination; None when nothing is known of it."""

    def mint(self, agent: str, above: int) -> int:
        """A generation greater than `above` and all that are known here, and of no other host's minting."""


class Tell(Struct, frozen=True):
    """Send a message to a host; drop it if there is no link, it is said again."""

    host: str
    message: QuorumMessage


class Bar(Struct, frozen=True):
    """A fence has risen: have it on disk before what comes next of that agent. What it bars stops now."""

    agent: str
    generation: int
    reason: str


class TakeOver(Struct, frozen=True):
    """Go on with an agent from its newest block here, as a new start. `reason` is for the log."""

    agent: str
    generation: int
    reason: str


class Terminate(Struct, frozen=True):
    """A coordinator has terminated, says another host: have that on disk, and keep nothing to go on from."""

    ended: Ended


class Explain(Struct, frozen=True):
    """A line for the log."""

    text: str


Effect = Tell | Bar | TakeOver | Terminate | Explain
