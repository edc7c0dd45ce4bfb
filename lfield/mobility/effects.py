"""What mobility asks of its host: the effects that `Mobility` returns, to be carried out in order.

They are msgspec structs rather than dataclasses because several are made on every hop, and a frozen
dataclass takes several times as long to make. Every effect on a copy names its start (agent, generation):
a host that holds another start of that agent by now leaves it alone.
"""

from __future__ import annotations

from msgspec import Struct

from lfield.journal.pages import Page
from lfield.wire.coordinators import Outcome, Transfer
from lfield.wire.framing import Buffer
from lfield.wire.messages import Control


class Send(Struct, frozen=True):
    """Send a message to a host; drop it if the link is gone, it will be asked for again."""

    host: str
    message: Control


class SendTransfer(Struct, frozen=True):
    """Send a block to a host. If the link is gone, drop it and report `unlinked`."""

    host: str
    header: Transfer
    block: Buffer


class Persist(Struct, frozen=True):
    """Have a page on disk before the effects on that agent that come after this one; only with a journal.

    `soon`: it may wait for the next page that anything depends on.
    """

    agent: str
    page: Page
    soon: bool = False


class Began(Struct, frozen=True):
    """A coordinator of this host starts: what it is known by is kept."""

    agent: str
    generation: int


class Go(Struct, frozen=True):
    """Let the copy held here go on: it has arrived, or is kept at a portal call of this host."""

    agent: str
    generation: int


class Departed(Struct, frozen=True):
    """The coordinator lives elsewhere now; what is left here is its shadow.

    An answer that says so was `held` back for so many seconds.
    """

    agent: str
    generation: int
    sequence: int
    host: str
    held: float = 0.0


class Resume(Struct, frozen=True):
    """Thaw the copy and throw the L exception `kind` with `reason` at its portal call.

    `sequence` is the highest transfer number used so far, to be written into the block's header. `recovered`:
    it is a new start of it, and whatever an earlier one did after this call is not known either.
    """

    agent: str
    generation: int
    sequence: int
    kind: str
    reason: str
    recovered: bool = False


class InDoubt(Struct, frozen=True):
    """Whether `host` has taken the copy is not known; it stays frozen here. `reason` is for the log."""

    agent: str
    generation: int
    sequence: int
    host: str
    reason: str


class Supersede(Struct, frozen=True):
    """End the copy held here, running or frozen, if it still is: another start of the coordinator goes on."""

    agent: str
    generation: int
    reason: str


class Finished(Struct, frozen=True):
    """Another host reports that a coordinator ended there; whatever is left of it here is dropped."""

    agent: str
    generation: int
    outcome: Outcome
    detail: str
    host: str


class Note(Struct, frozen=True):
    """Something odd for the log, which says it once however often it comes; nothing to do."""

    reason: str


Effect = (
    Send | SendTransfer | Persist | Began | Go | Departed | Resume | InDoubt | Supersede | Finished | Note
)


class Refusal(Struct, frozen=True):
    """Why a coordinator was not taken: an L exception's name and a sentence."""

    kind: str
    reason: str
