"""Effects that `HostCore.drain_effects` returns for the shell to execute in order, and the synchronous
queries of the core (`Environment`).

Of mobility's effects only `Send` and `SendTransfer` leave the core; the others are executed inside it.
"""

from __future__ import annotations

import math
from typing import Protocol

from msgspec import Struct

from lfield.bytecode.program import DeviceCallRecord
from lfield.host.directory_updates.agent_sampler import DeviceReadings
from lfield.journal.records import Record, RecordKey
from lfield.manifest import DeviceValue
from lfield.replication.membership.membership import LinkContacts
from lfield.replication.transfer.effects import Send, SendTransfer
from lfield.text.log_messages import LogLine
from lfield.vm.agent import Agent
from lfield.vm.engine_interface import Reading
from lfield.vm.host_interface import Pending
from lfield.wire.person_calls.portal_call_messages import PortalCallResult


class Environment(DeviceReadings, LinkContacts, Protocol):
    """Synchronous queries of the core: telemetry, and the state of links."""

    def query(self, agent: str, call: DeviceCallRecord) -> DeviceValue | Pending:
        """The value of a query, PENDING if the device itself must answer. Raises DeviceError."""

    def reading(self, agent: str, call: DeviceCallRecord) -> Reading | None:
        """The up-to-date reading of such a query; None if it is not a plain quantity."""

    def may_be_cancelled(self, agent: str, call: DeviceCallRecord) -> bool:
        """Whether a call of this instruction can be cancelled while under way, according to its manifest.

        If so, `CancelCall` cancels the call; otherwise the call runs to its end.
        """

    def round_trip(self, host: str) -> float | None:
        """The smoothed round-trip time of the link with a host, in seconds; None before it is measured."""

    def answer_timeout(self, host: str) -> float | None:
        """The time within which a linked host answers, in seconds; None if unknown."""


class WriteOutput(Struct, frozen=True):
    """Program output of an agent, exactly as written."""

    agent: str
    text: str


class WriteLog(Struct, frozen=True):
    """A log line; the output of a program may have several `lines`.

    `is_recorded`: its event was emitted already, as for program output.
    """

    text: LogLine
    lines: bool = False
    is_recorded: bool = False


class WriteLogOnce(Struct, frozen=True):
    """A log line about received data, which is written only once."""

    text: LogLine


class CallDevice(Struct, frozen=True):
    """Have a device of this host execute an instruction; the answer is the input `DeviceAnswered` with its
    `number`.

    An actuation starts before `until`, in seconds of the host's clock, or not at all.
    """

    agent: Agent
    thread: int
    call: DeviceCallRecord
    values: list[DeviceValue]
    until: float = math.inf
    number: int = 0


class CancelCall(Struct, frozen=True):
    """Cancel the device call that this thread waits for (`DeviceGuards.cancel`).

    The effect follows the `CallDevice` that it refers to, and only if `Environment.may_be_cancelled`. The
    answer is an input like every other, once: a DeviceError of kind CancelledException after the device has
    done what its manifest prescribes, or the result if the result was already in transit.
    """

    agent: Agent
    thread: int


class MakeDeviceSafe(Struct, frozen=True):
    """Bring a device of this host into a safe state of its manifest, and latch it there.

    `users` are the coordinators that used it and are no longer confirmed alive.
    """

    device: str
    state: str
    reason: str
    users: tuple[str, ...] = ()


class DumpAgent(Struct, frozen=True):
    """An agent died of an uncaught exception; the block is unchanged since then."""

    agent: Agent


class PersistRecords(Struct, frozen=True):
    """Write records and delete those of `keys` atomically, then call `HostCore.on_durable`.

    Batches are written in the order of their numbers.
    """

    number: int
    records: list[Record]
    keys: list[RecordKey]


class OpenLink(Struct, frozen=True):
    """Request a link with a host for a while."""

    host: str


class WakeWaiters(Struct, frozen=True):
    """The records of coordinators have changed: wake all tasks that wait for an outcome."""


class AnswerPersonCall(Struct, frozen=True):
    """Send the result of a portal call to the links of the person that wait for it."""

    result: PortalCallResult


Effect = (
    Send
    | SendTransfer
    | WriteOutput
    | WriteLog
    | WriteLogOnce
    | CallDevice
    | CancelCall
    | MakeDeviceSafe
    | DumpAgent
    | PersistRecords
    | OpenLink
    | WakeWaiters
    | AnswerPersonCall
)

WAKE_WAITERS = WakeWaiters()
