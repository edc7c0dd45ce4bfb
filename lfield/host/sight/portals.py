"""The portal calls of a machine as events: what is attached to it while somebody watches its host. Pure."""

from __future__ import annotations

from lfield.host.sight.teller import Teller
from lfield.vm.agent import Agent
from lfield.vm.attached import Watch
from lfield.vm.inspect import traceback
from lfield.vm.machine import Machine
from lfield.vm.memory.layout import THREAD_CALL
from lfield.vm.memory.threads import place_of


class Portals:
    """Tells how portal calls begin and end (`attached.Watch`), and whoever was attached `before` as well."""

    def __init__(self, teller: Teller, machine: Machine) -> None:
        self._teller, self._machine = teller, machine
        self._before: Watch | None = None

    def attach(self) -> None:
        """From now on; instructions to devices are told too. Who comes now hears what was skipped before."""
        self._teller.settle(at_once=True)
        if not self._teller.detailed:
            self._teller.detail(on=True)
            self._before, self._machine.attached.watch = self._machine.attached.watch, self

    def detach(self) -> None:
        """No more."""
        if self._teller.detailed:
            self._teller.detail(on=False)
            self._teller.forget_calls()
            self._machine.attached.watch, self._before = self._before, None

    def began(self, resource: Agent, thread: int, number: int, method: int, caller: str) -> None:
        """A portal has begun."""
        if self._before is not None:
            self._before.began(resource, thread, number, method, caller)
        portal = self._machine.program.core.methods[method].name
        self._teller.began(number, caller, resource.id, portal)

    def gave(self, resource: Agent, number: int, word: int) -> None:
        """A portal has come to its end."""
        if self._before is not None:
            self._before.gave(resource, number, word)
        self._teller.ended(number, "done")

    def threw(self, resource: Agent, number: int, thrown: int) -> None:
        """A portal has ended by an exception."""
        if self._before is not None:
            self._before.threw(resource, number, thrown)
        if self._teller.is_told(number):
            name, message, _ = traceback.describe(resource.block, self._machine.program, thrown)
            self._teller.ended(number, "thrown", f"{name}: {message}" if message else name)

    def died(self, resource: Agent, reason: str) -> None:
        """A resource has died, and its portals with it."""
        if self._before is not None:
            self._before.died(resource, reason)
        self._teller.resource_died(resource.id, reason)


def served_call(agent: Agent, thread: int) -> int:
    """The number of the portal call that a thread serves, 0 for none."""
    place = place_of(agent.block, thread)
    return agent.block.w[place + THREAD_CALL] if place else 0
