"""What is seen of a host without asking the code that decides: who comes into its machine, what is said.

The wires of one life are tapped, each where a shell or the machine calls it: nothing is changed by that.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Protocol

from lfield.simulate.fleet import Life
from lfield.vm.agent import Agent, Member
from lfield.vm.begun import Key
from lfield.vm.contract import Trap
from lfield.wire.coordinators import Transfer
from lfield.wire.framing import Buffer
from lfield.wire.messages import Control
from lfield.wire.reservations import Renew


class Sees(Protocol):
    """Whoever watches. All of it happens now, in this life of a host."""

    def started(self, life: Life, agent: Agent) -> None:
        """A coordinator was begun."""

    def came(self, life: Life, header: Transfer) -> None:
        """A coordinator came over a link; whether it is taken in is decided now, or later."""

    def admitted(self, life: Life, agent: Agent, *, came: bool) -> None:
        """A coordinator was put into the machine; it `came` over a link, or else from the host's own disk."""

    def restored(self, life: Life, agent: Agent) -> None:
        """A coordinator was put into the machine as the host's own disk has it."""

    def may_run(self, life: Life, agent: Agent, kind: str) -> None:
        """A frozen coordinator may run again."""

    def sent(self, life: Life, header: Transfer, target: str, incarnation: int) -> None:
        """A coordinator was sent to another host, in that life of it; 0 if there was no link."""

    def turned(self, life: Life) -> None:
        """The host has done all there was to do."""

    def said(self, life: Life, agent: Agent, text: str) -> None:
        """A program has written something."""

    def told(self, life: Life, key: Key) -> None:
        """The machine is told that the result of a call that was begun is kept."""

    def given(self, life: Life, agent: Agent, resource: Member, number: int) -> None:
        """A coordinator has reserved a resource here, by that number."""

    def dropped(self, agent: Agent, held: Sequence[tuple[Member, int]]) -> None:
        """A coordinator has given back what it had reserved."""

    def asked(self, life: Life, agent: Agent, resource: Member, number: int, *, lost: bool) -> None:
        """A coordinator calls what it has reserved by that number: it may, or has lost it."""

    def renewed(self, message: Renew) -> None:
        """A host hears of the holder of a resource that is here."""


def tap(life: Life, sees: Sees) -> None:
    """Let somebody see all of one life."""
    core, machine, peers = life.core, life.core.machine, life.host.peers
    coming: list[Transfer] = []

    def start(go: Callable[..., Agent], member: Member, *more: Any) -> Agent:
        agent = go(member, *more)
        if member.kind == "coordinator":
            sees.started(life, agent)
        return agent

    def arrived(go: Callable[..., None], host: str, header: Transfer, *more: Any) -> None:
        sees.came(life, header)
        coming.append(header)
        try:
            go(host, header, *more)
        finally:
            coming.pop()

    def admit(go: Callable[..., Agent], *more: Any) -> Agent:
        agent = go(*more)
        sees.admitted(life, agent, came=bool(coming))
        return agent

    def restore(go: Callable[..., Agent], *more: Any) -> Agent:
        agent = go(*more)
        sees.restored(life, agent)
        return agent

    def resume(go: Callable[..., None], agent: Agent, kind: str, *more: Any, **named: Any) -> None:
        go(agent, kind, *more, **named)
        sees.may_run(life, agent, kind)

    def send_transfer(go: Callable[..., None], host: str, header: Transfer, block: Buffer) -> None:
        sees.sent(life, header, host, peers.incarnations.get(host, 0))
        go(host, header, block)

    def run(go: Callable[[], float | None]) -> float | None:
        pause = go()
        sees.turned(life)
        return pause

    def write(go: Callable[..., None], agent: Agent, text: str) -> None:
        sees.said(life, agent, text)
        go(agent, text)

    def log(go: Callable[..., None], agent: Agent, text: str) -> None:
        sees.said(life, agent, text)
        go(agent, text)

    def kept_result(go: Callable[[Key], None], key: Key) -> None:
        sees.told(life, key)
        go(key)

    for place, wire in (
        (machine, start), (machine, admit), (machine, restore), (machine, resume), (machine, kept_result),
        (core, arrived), (core, run), (core.world, write), (core.world, log), (peers, send_transfer),
    ):  # fmt: skip
        tap_calls(place, wire)
    _tap_reservations(life, sees)


def tap_meter(life: Life, computed: Callable[[Life], None]) -> None:
    """Let somebody see when the machine of a life has run an agent."""
    charge = life.core.machine.attached.meter

    def meter(instructions: int) -> None:
        computed(life)
        if charge is not None:
            charge(instructions)

    life.core.machine.attached.meter = meter


def _tap_reservations(life: Life, sees: Sees) -> None:
    core = life.core

    def take(go: Callable[..., int], agent: Agent, resource: Member, *, nested: bool) -> int:
        number = go(agent, resource, nested=nested)
        if number:
            sees.given(life, agent, resource, number)
        return number

    def drop(go: Callable[..., None], agent: Agent, held: Sequence[tuple[Member, int]]) -> None:
        sees.dropped(agent, held)
        go(agent, held)

    def serves(go: Callable[..., bool], agent: Agent, resource: Member, number: int) -> bool:
        try:
            served = go(agent, resource, number)
        except Trap:
            sees.asked(life, agent, resource, number, lost=True)
            raise
        if served:
            sees.asked(life, agent, resource, number, lost=False)
        return served

    def received(go: Callable[..., None], host: str, message: Control) -> None:
        if isinstance(message, Renew):
            sees.renewed(message)
        go(host, message)

    for place, wire in ((core.world, take), (core.world, drop), (core.world, serves), (core, received)):
        tap_calls(place, wire)


def tap_calls(place: object, wire: Callable[..., Any]) -> None:
    """Lead every call of a method of this name through `wire`, which is given the method first."""
    go = getattr(place, wire.__name__)

    def tapped(*given: Any, **named: Any) -> Any:
        return wire(go, *given, **named)

    setattr(place, wire.__name__, tapped)
