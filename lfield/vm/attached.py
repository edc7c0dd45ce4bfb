"""What may be attached to a machine: rules of portal calls, a watcher, stand-ins for resources, a meter.

On a robot only the rules of its mission are, if it has any: they say which calls must not begin. A watcher is
told and changes nothing; a stand-in answers the portals of one resource in the place of its program, as a
test of a mission wants it; a meter is told how much was computed, which takes time on a simulated computer.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

from lfield.vm.agent import Agent, Member
from lfield.vm.memory.block import Block

#: Why a call must not begin, '' when it may, by the ids of coordinator and resource, and the portal's index.
Rules = Callable[[str, str, int], str]


class Watch(Protocol):
    """Whoever watches the portal calls of a machine, by a `pcall` or in a `together`; `number` tells them
    apart, in one life of the host. A place is one in the resource's block, as it is for this moment.

    A call that its coordinator waits for no more goes on, and so it is told how that ends.
    """

    def began(self, resource: Agent, thread: int, number: int, method: int, caller: str) -> None:
        """A portal (by its index) has begun: its arguments are in the frame of its thread."""

    def gave(self, resource: Agent, number: int, word: int) -> None:
        """A portal has come to its end; `word` is the result, as it stood in a slot."""

    def threw(self, resource: Agent, number: int, thrown: int) -> None:
        """A portal has ended by an exception, the object at the place `thrown`."""

    def died(self, resource: Agent, reason: str) -> None:
        """A resource has died, and none of its portals goes on."""


class Asked(Protocol):
    """A portal call that a stand-in has to answer: by `give` or `throw`, now or later, once.

    An answer to a call that has ended meanwhile, since it was cancelled, is dropped.
    """

    @property
    def resource(self) -> Agent:
        """Whose portal was called."""

    @property
    def thread(self) -> int:
        """The thread in whose frame the arguments are; it runs no instruction."""

    @property
    def method(self) -> int:
        """The portal, by its index."""

    def give(self, make: Callable[[Block], int]) -> None:
        """End it with the result that `make` puts into the resource's block; that may raise Full."""

    def throw(self, kind: str, message: str) -> None:
        """End it by a built-in exception."""


class Signs(Protocol):
    """Signs of life of the hosts where agents of the team are."""

    def is_silent(self, member: Member) -> bool:
        """Whether its host has not been heard, though there is a link."""

    def ask(self, member: Member, within: float) -> None:
        """Ask its host for a heartbeat; no coordinator is sent there before it has come.

        A host that was heard in the last `within` seconds need not be asked.
        """

    def is_asked(self, member: Member) -> bool:
        """Whether that is still waited for."""

    def transit(self, member: Member) -> float:
        """In how many seconds a coordinator that leaves now would be there, as far as that was measured."""


@dataclass(slots=True)
class Attached:
    """What is attached to one machine. `rules` are asked before each portal begins. `stand_ins` by the ids of
    resources, which must not have started yet: their `init` does not run, and they are open at once. `meter`
    is given the instructions of each turn. `signs` are for hosts that are linked and may be silent."""

    rules: Rules | None = None
    watch: Watch | None = None
    meter: Callable[[int], None] | None = None
    signs: Signs | None = None
    stand_ins: dict[str, Callable[[Asked], None]] = field(default_factory=dict)
