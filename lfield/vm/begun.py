"""Calls that a `together` has begun on this host: they run and end, wherever their coordinator is by then."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from lfield.vm.agent import Agent

#: Which call: the coordinator's id, the generation that began it, and the number of its ticket.
Key = tuple[str, int, int]


@dataclass(frozen=True, slots=True)
class Beginning:
    """A call that a coordinator wants to begin here: its ticket's number, the resource's id, the portal.

    `acts` says whether the portal may change something.
    """

    number: int
    resource: str
    portal: str
    acts: bool


@dataclass(slots=True, eq=False)
class Begun:
    """A call that was begun here by a start (`generation`) of the coordinator `agent`.

    `state` is "running" until it has come back; then "done" or "thrown", and `parcel` is the result or the
    exception (see `lfield.vm.memory.parcels`); "lost" when an earlier life of this host had begun it and
    has left no result. `kept` is true when the host has what came back on its disk: only then it is fetched.
    A call that nobody will fetch any more is `dropped`.

    `call` is the number of the portal call and `method` the portal's index, 0 for one that does not run in
    this life; `waiter` the coordinator and its thread that wait here for it.
    """

    agent: str
    generation: int
    number: int
    resource: str
    portal: str
    fenced: bool = False
    state: Literal["running", "done", "thrown", "lost"] = "running"
    parcel: bytes = b""
    kept: bool = False
    dropped: bool = False
    call: int = 0
    method: int = 0
    waiter: tuple[Agent, int] | None = field(default=None, repr=False)

    @property
    def key(self) -> Key:
        """Which call it is."""
        return self.agent, self.generation, self.number

    @property
    def id(self) -> str:
        """The id of the coordinator, as an agent has it: for whoever asks who calls (`Machine.caller`)."""
        return self.agent

    @property
    def ended(self) -> str:
        """Why nobody may be served for it any more; '' while it runs (`Agent.ended`)."""
        return "dropped" if self.dropped else ""
