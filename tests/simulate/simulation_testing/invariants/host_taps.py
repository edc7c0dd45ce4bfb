"""Observations of a host that are independent of the tested code: arrivals in its machine, program output.

The methods of one life are wrapped where a shell or the machine calls them; this changes nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Protocol

from lfield.simulate.host_fleet import HostRun
from lfield.vm.agent import Agent, TeamMember
from lfield.vm.engine_interface import Trap
from lfield.vm.pending_call import CallKey
from lfield.wire.coordinator_messages import Transfer
from lfield.wire.framing import Buffer
from lfield.wire.messages import Control
from lfield.wire.reservation_messages import RenewReservation


class HostObserver(Protocol):
    """An observer. All calls are at the present time, in this life of a host."""

    def on_started(self, life: HostRun, agent: Agent) -> None:
        """A coordinator was started."""

    def on_transfer(self, life: HostRun, header: Transfer) -> None:
        """A coordinator arrived over a link; its admission is decided now or later."""

    def on_admitted(self, life: HostRun, agent: Agent, *, came: bool) -> None:
        """A coordinator was put into the machine; `came` over a link, or else from the host's own disk."""

    def on_restored(self, life: HostRun, agent: Agent) -> None:
        """A coordinator was put into the machine from the host's own disk."""

    def on_resumed(self, life: HostRun, agent: Agent, kind: str) -> None:
        """A frozen coordinator may run again."""

    def on_sent(self, life: HostRun, header: Transfer, target: str, incarnation: int) -> None:
        """A coordinator was sent to another host, in that life of it; 0 if there was no link."""

    def on_step(self, life: HostRun) -> None:
        """The host has done all pending work."""

    def on_output(self, life: HostRun, agent: Agent, text: str) -> None:
        """A program has written text."""

    def on_result_durable(self, life: HostRun, key: CallKey) -> None:
        """The machine is informed that the result of a call is durable."""

    def on_granted(self, life: HostRun, agent: Agent, resource: TeamMember, number: int) -> None:
        """A coordinator has reserved a resource here, with that number."""

    def on_dropped(self, agent: Agent, held: Sequence[tuple[TeamMember, int]]) -> None:
        """A coordinator has released its reservations."""

    def on_reserved_call(
        self, life: HostRun, agent: Agent, resource: TeamMember, number: int, *, lost: bool
    ) -> None:
        """A coordinator calls a resource with its reservation number: it is served, or has lost it."""

    def on_renewed(self, message: RenewReservation) -> None:
        """A host receives a renewal by the holder of one of its resources."""


def tap(life: HostRun, observer: HostObserver) -> None:
    """Let an observer see all events of one life."""
    core, machine, peers = life.core, life.core.machine, life.host.peers
    coming: list[Transfer] = []

    def start(go: Callable[..., Agent], member: TeamMember, *more: Any) -> Agent:
        agent = go(member, *more)
        if member.kind == "coordinator":
            observer.on_started(life, agent)
        return agent

    def on_transfer(go: Callable[..., None], host: str, header: Transfer, *more: Any) -> None:
        observer.on_transfer(life, header)
        coming.append(header)
        try:
            go(host, header, *more)
        finally:
            coming.pop()

    def inject(go: Callable[..., Agent], *more: Any) -> Agent:
        agent = go(*more)
        observer.on_admitted(life, agent, came=bool(coming))
        return agent

    def restore(go: Callable[..., Agent], *more: Any) -> Agent:
        agent = go(*more)
        observer.on_restored(life, agent)
        return agent

    def resume(go: Callable[..., None], agent: Agent, kind: str, *more: Any, **named: Any) -> None:
        go(agent, kind, *more, **named)
        observer.on_resumed(life, agent, kind)

    def send_transfer(go: Callable[..., None], host: str, header: Transfer, block: Buffer) -> None:
        observer.on_sent(life, header, host, peers.incarnations.get(host, 0))
        go(host, header, block)

    def write(go: Callable[..., None], agent: Agent, text: str) -> None:
        observer.on_output(life, agent, text)
        go(agent, text)

    def log(go: Callable[..., None], agent: Agent, text: str) -> None:
        observer.on_output(life, agent, text)
        go(agent, text)

    def on_persisted(go: Callable[[CallKey], None], key: CallKey) -> None:
        observer.on_result_durable(life, key)
        go(key)

    for place, wire in (
        (machine, start), (machine, inject), (machine, restore), (machine, resume),
        (machine.pending_calls, on_persisted),
        (core, on_transfer), (core.services, write), (core.services, log), (peers, send_transfer),
    ):  # fmt: skip
        tap_calls(place, wire)
    _tap_steps(life, observer)
    _tap_reservations(life, observer)


def _tap_steps(life: HostRun, observer: HostObserver) -> None:
    def run(go: Callable[[], float | None]) -> float | None:
        pause = go()
        observer.on_step(life)
        return pause

    tap_calls(life.core, run)


def tap_meter(life: HostRun, computed: Callable[[HostRun], None]) -> None:
    """Let an observer know when the machine of a life has run an agent."""
    charge = life.core.machine.hooks.meter

    def meter(instructions: int) -> None:
        computed(life)
        if charge is not None:
            charge(instructions)

    life.core.machine.hooks.meter = meter


def _tap_reservations(life: HostRun, observer: HostObserver) -> None:
    core = life.core

    def acquire_reservation(
        go: Callable[..., int], agent: Agent, resource: TeamMember, *, nested: bool
    ) -> int:
        number = go(agent, resource, nested=nested)
        if number:
            observer.on_granted(life, agent, resource, number)
        return number

    def release_reservations(
        go: Callable[..., None], agent: Agent, held: Sequence[tuple[TeamMember, int]]
    ) -> None:
        observer.on_dropped(agent, held)
        go(agent, held)

    def may_serve(go: Callable[..., bool], agent: Agent, resource: TeamMember, number: int) -> bool:
        try:
            served = go(agent, resource, number)
        except Trap:
            observer.on_reserved_call(life, agent, resource, number, lost=True)
            raise
        if served:
            observer.on_reserved_call(life, agent, resource, number, lost=False)
        return served

    def on_message(go: Callable[..., None], host: str, message: Control) -> None:
        if isinstance(message, RenewReservation):
            observer.on_renewed(message)
        go(host, message)

    for place, wire in (
        (core.services, acquire_reservation),
        (core.services, release_reservations),
        (core.services, may_serve),
        (core, on_message),
    ):
        tap_calls(place, wire)


def tap_calls(place: object, wire: Callable[..., Any]) -> None:
    """Pass every call of a method of this name to `wire`, with the method as first argument."""
    go = getattr(place, wire.__name__)

    def tapped(*given: Any, **named: Any) -> Any:
        return wire(go, *given, **named)

    setattr(place, wire.__name__, tapped)
