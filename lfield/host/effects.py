"""What the core of a host asks of its shell: the effects that `HostCore.take` gives, in their order, and what
is answered at once, `Nearby`.

Of mobility's effects two leave the core, `Send` and `SendTransfer`; the others are carried out inside.
"""

from __future__ import annotations

import math
from typing import Protocol

from msgspec import Struct

from lfield.bytecode.program import DeviceCall
from lfield.host.directory import Neighbours
from lfield.journal.pages import Key, Page
from lfield.manifest import DeviceValue
from lfield.mobility.effects import Send, SendTransfer
from lfield.vm.agent import Agent
from lfield.vm.contract import Reading
from lfield.vm.world import Pending


class Nearby(Neighbours, Protocol):
    """What a host can tell at once, without asking anybody: its telemetry, and how its links are."""

    def query(self, agent: str, call: DeviceCall) -> DeviceValue | Pending:
        """The value of a query, PENDING for what the device itself must do. Raises DeviceError."""

    def reading(self, agent: str, call: DeviceCall) -> Reading | None:
        """The reading that the host keeps up to date of such a query; None for what is no plain quantity."""

    def may_be_cancelled(self, agent: str, call: DeviceCall) -> bool:
        """Whether a call of this instruction that is under way can be given up, as its manifest says.

        Then `CancelCall` has it done; if not, it goes on to its end.
        """

    def round_trip(self, host: str) -> float | None:
        """The smoothed round-trip time of the link with a host, in seconds; None before it is measured."""

    def answers_within(self, host: str) -> float | None:
        """The time within which a linked host answers, in seconds; None while that is not known."""


class Write(Struct, frozen=True):
    """Program output, exactly as written."""

    text: str


class Say(Struct, frozen=True):
    """A line for the log; what a program says may have several `lines`.

    `told`: its event is told already, as that of a program is.
    """

    text: str
    lines: bool = False
    told: bool = False


class Complain(Struct, frozen=True):
    """A line for the log about what somebody sent, which is told once however often it comes."""

    text: str


class Call(Struct, frozen=True):
    """Have a device of this host carry an instruction out; the answer goes to `HostCore.answered`.

    What acts begins before `until`, in seconds of the host's clock, or not at all.
    """

    agent: Agent
    thread: int
    call: DeviceCall
    values: list[DeviceValue]
    until: float = math.inf


class CancelCall(Struct, frozen=True):
    """Have the call of a device be given up that this thread waits for (`Guards.cancel`).

    It comes after the `Call` that it is about, and only of what `Nearby.may_be_cancelled`. The answer goes to
    `HostCore.answered` like every other, once: a DeviceError of kind CancelledException when the device has
    done what its manifest says, or the result that was on its way.
    """

    agent: Agent
    thread: int


class MakeSafe(Struct, frozen=True):
    """Bring a device of this host into a safe state of its manifest, and hold it there.

    `users` are the coordinators that have left it without anybody who looks after it.
    """

    device: str
    state: str
    reason: str
    users: tuple[str, ...] = ()


class Died(Struct, frozen=True):
    """An agent died of an uncaught exception; its block stands as it was then."""

    agent: Agent


class Keep(Struct, frozen=True):
    """Have pages on disk and the pages of those `keys` removed, all at once, then call `HostCore.kept`.

    Batches in the order of their numbers.
    """

    number: int
    pages: list[Page]
    keys: list[Key]


class Reach(Struct, frozen=True):
    """Have a link made with a host, which is needed for a while."""

    host: str


class Changed(Struct, frozen=True):
    """What is known of coordinators has changed: whoever waits for an end looks again."""


Effect = (
    Send
    | SendTransfer
    | Write
    | Say
    | Complain
    | Call
    | CancelCall
    | MakeSafe
    | Died
    | Keep
    | Reach
    | Changed
)

CHANGED = Changed()
