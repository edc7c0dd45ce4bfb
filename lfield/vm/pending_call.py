"""Pending calls of a `together` on this host, which run independently of their coordinator."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from msgspec import Struct

from lfield.vm.agent import Agent

#: Key of a call: the coordinator's id, the generation that started it, and the number of its ticket.
CallKey = tuple[str, int, int]


class CallRequest(Struct, frozen=True):
    """Request of a coordinator to start a call here: ticket number, resource id, portal.

    `has_side_effects`: the portal may have side effects.
    """

    number: int
    resource: str
    portal: str
    has_side_effects: bool


@dataclass(slots=True, eq=False)
class PendingCall:
    """A call that a start (`generation`) of the coordinator `agent` has started here.

    `state` is "running", then "done" or "thrown" with the result or exception in `result` (see
    `lfield.vm.memory.serialised_results`); "lost" if an earlier incarnation of this host started the call and
    has no result. `is_persisted`: the result is on disk, and may be fetched. A call that will never be
    fetched is `dropped`.

    A call of a future (`is_future`) runs to its end, even if its coordinator has dropped the future.
    `failure` is the exception of a call as text.

    `deadline` is its nearest time limit in ns of the coordinator's clock, 0 for none; `is_expired`: this
    limit cancelled the call.

    A call of a person has the name of the caller as `agent`, and `is_of_person`.

    `call` is the number of the portal call and `method` the portal's index, 0 if the call does not run in
    this incarnation; `waiter` is the coordinator and thread that wait here for the call.
    """

    agent: str
    generation: int
    number: int
    resource: str
    portal: str
    fenced: bool = False
    state: Literal["running", "done", "thrown", "lost"] = "running"
    result: bytes = b""
    is_persisted: bool = False
    dropped: bool = False
    deadline: int = 0
    is_expired: bool = False
    is_future: bool = False
    failure: str = ""
    call: int = 0
    method: int = 0
    is_of_person: bool = False
    waiter: tuple[Agent, int] | None = field(default=None, repr=False)

    @property
    def key(self) -> CallKey:
        return self.agent, self.generation, self.number

    @property
    def id(self) -> str:
        """The id of the coordinator under the name that an agent has for it, for `Machine.caller`."""
        return self.agent

    @property
    def cancel_reason(self) -> str:
        """The reason that the portal gets when the coordinator cancels the call."""
        event = "has cancelled" if self.is_future else "has left the together that called"
        return f"{self.agent} {event} {self.portal}()"

    @property
    def ended(self) -> str:
        """The reason why the call must not be served any more; '' while it runs (`Agent.ended`)."""
        return "dropped" if self.dropped else ""
