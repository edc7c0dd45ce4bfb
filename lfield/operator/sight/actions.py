"""What an operator does with a team that is watched: stop, lift, pause, resume, ask who can do something."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal, Protocol

from lfield.capability.model import Primitive
from lfield.capability.offer import Offer, Refusal
from lfield.errors import LfieldError
from lfield.wire.observing import EmergencyStopped

Order = Literal["stop", "lift", "pause", "resume"]


@dataclass(frozen=True, slots=True)
class Ordered:
    """What came of an order: the devices that did as told, those that did not, the hosts nobody reached, and
    what else hosts had to say; each with its sentence. `Seen.orders` and `Seen.stop` go on from there."""

    order: Order
    confirmed: tuple[str, ...] = ()
    unconfirmed: Mapping[str, str] = field(default_factory=dict)
    unreached: Mapping[str, str] = field(default_factory=dict)
    troubles: Mapping[str, str] = field(default_factory=dict)

    @property
    def well(self) -> bool:
        """Whether everybody has done it."""
        return not (self.unconfirmed or self.unreached)


@dataclass(frozen=True, slots=True)
class Found:
    """Who serves a primitive: the best offers, best first, how many there are; and who does not, and why.

    `units` are those of the attributes, by name.
    """

    primitive: Primitive
    offers: Sequence[Offer]
    count: int
    refusals: Sequence[Refusal]
    notes: Sequence[str]
    units: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Answer:
    """The answer to a question; `mistakes` is what is wrong with the question, drawn with carets, '' if
    nothing. `unheard` are the hosts whose word is missing, with the reasons."""

    question: str
    found: tuple[Found, ...] = ()
    unheard: Mapping[str, str] = field(default_factory=dict)
    mistakes: str = ""


class Actions(Protocol):
    """What the buttons do. Nothing is raised for what hosts or people do wrong: the answer says it."""

    @property
    def barred(self) -> Mapping[Order, str]:
        """What this person may not do, each with a sentence why and what helps: a greyed button."""

    async def stop(self, reason: str = "") -> Ordered:
        """Every device of every host into its safe state. May be pressed again at any time."""

    async def lift(self) -> Ordered:
        """The emergency is over: programs may release their devices again."""

    async def pause(self) -> Ordered:
        """No agent runs, devices in their safe states."""

    async def resume(self) -> Ordered:
        """A paused mission goes on."""

    async def query(self, text: str) -> Answer:
        """`lfield query`: who can do it."""


class Witness(Protocol):
    """Whoever shows what came of orders: it hears of each one, and of each answer as it comes."""

    def ordered(self, order: Order, hosts: Collection[str]) -> int:
        """An order is given to those hosts; the number that it has from now on."""

    def answered(self, number: int, host: str, answer: EmergencyStopped | LfieldError) -> None:
        """What a host has answered to that order, or why it was not reached."""
