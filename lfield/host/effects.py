"""What the core of a host asks of its shell: the effects that `HostCore.take` gives, in their order.

Of mobility's effects two leave the core, `Send` and `SendTransfer`; the others are carried out inside.
"""

from __future__ import annotations

from msgspec import Struct

from lfield.bytecode.program import DeviceCall
from lfield.journal.pages import Page
from lfield.manifest import DeviceValue
from lfield.mobility.effects import Send, SendTransfer
from lfield.vm.agent import Agent


class Write(Struct, frozen=True):
    """Program output, exactly as written."""

    text: str


class Say(Struct, frozen=True):
    """A line for the log."""

    text: str


class Complain(Struct, frozen=True):
    """A line for the log about what somebody sent, which is told once however often it comes."""

    text: str


class Call(Struct, frozen=True):
    """Have a device of this host carry an instruction out; the answer goes to `HostCore.answered`."""

    agent: Agent
    thread: int
    call: DeviceCall
    values: list[DeviceValue]


class MakeSafe(Struct, frozen=True):
    """Bring a device of this host into a safe state of its manifest, and hold it there."""

    device: str
    state: str
    reason: str


class Died(Struct, frozen=True):
    """An agent died of an uncaught exception; its block stands as it was then."""

    agent: Agent


class Keep(Struct, frozen=True):
    """Have pages on disk, then call `HostCore.kept`; batches in the order of their numbers."""

    number: int
    pages: list[Page]


class Changed(Struct, frozen=True):
    """What is known of coordinators has changed: whoever waits for an end looks again."""


Effect = Send | SendTransfer | Write | Say | Complain | Call | MakeSafe | Died | Keep | Changed

CHANGED = Changed()
