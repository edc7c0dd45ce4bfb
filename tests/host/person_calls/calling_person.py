"""A person who calls portals of a simulated host, over a link that keeps the answers."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from lfield.authority.identity import ALL_RIGHTS, Identity
from lfield.mission.loader import load_mission
from lfield.simulate.host_fleet import Fleet
from lfield.vm.person_calls.value_codec import decode_values, encode_values
from lfield.wire.messages import Control
from lfield.wire.observer_messages import Pause, with_epoch
from lfield.wire.person_calls.portal_call_messages import (
    MAX_ARGUMENTS,
    PortalCallCancel,
    PortalCallRequest,
    PortalCallResult,
)

CALLS = "calls:\n  anna: {Post: all}\n"


class CallingPerson:
    """A link of a person to a host of a fleet."""

    peer = "desk"

    def __init__(
        self, fleet: Fleet, name: str = "anna", host: str = "alpha", *, kind: str = "person"
    ) -> None:
        self._fleet, self._host = fleet, host
        self.identity = Identity(kind, name, ALL_RIGHTS)  # type: ignore[arg-type]
        self.results: list[PortalCallResult] = []
        self._number = 0

    def send(self, message: Control) -> None:
        """Record an answer of the host."""
        if isinstance(message, PortalCallResult):
            self.results.append(message)

    def order(
        self, portal: str, *arguments: object, resource: str = "post", **changes: object
    ) -> PortalCallRequest:
        self._number += 1
        id = f"{self.identity.name}{self._number}".encode().ljust(16, b".")
        data = encode_values(arguments, MAX_ARGUMENTS)
        fields = {"limit": 10.0, "incarnation": self._life.core.incarnation, **changes}
        return PortalCallRequest(id, resource=resource, portal=portal, arguments=data, **fields)  # type: ignore[arg-type]

    @property
    def _life(self):
        return self._fleet.runs[self._host]

    def enter(self, message: Control) -> None:
        life = self._life
        life.process.loop.enter(partial(life.host.on_message, "", message, self))

    def call(self, portal: str, *arguments: object, **changes: object) -> PortalCallRequest:
        """Start a call."""
        order = self.order(portal, *arguments, **changes)
        self.enter(order)
        return order

    def cancel(self, order: PortalCallRequest) -> None:
        self.enter(PortalCallCancel(order.id))

    def pause(self, *, lift: bool = False) -> None:
        self._number += 1
        order = Pause(f"pause{self._number}".encode().ljust(16, b"."), lift)
        self.enter(with_epoch(order, self._life.core.orders.epochs))

    def result(self, portal: str, *arguments: object, seconds: float = 3.0, **changes: object):
        """The result of a call; asserts that there is one answer."""
        before = len(self.results)
        self.call(portal, *arguments, **changes)
        self._fleet.run(seconds)
        (found,) = self.results[before:]
        return found

    def value(self, portal: str, *arguments: object, **changes: object) -> object:
        """The value that a call returns."""
        found = self.result(portal, *arguments, **changes)
        assert found.outcome == "returned", found
        (value,) = decode_values(found.value)
        return value


def fleet_of(folder: Path, program: str, deployment: str, access: str = CALLS, **files: str) -> Fleet:
    """A fleet that has started."""
    (folder / "mission.L").write_text(program)
    (folder / "mission.dL").write_text(deployment)
    if access:
        (folder / "mission.access.yaml").write_text(access)
    for name, text in files.items():
        (folder / f"mission.{name}.yaml").write_text(text)
    fleet = Fleet(load_mission(folder / "mission.dL", simulate=True), 1)
    fleet.run(5.0)
    return fleet


def log_of(fleet: Fleet) -> str:
    return "\n".join(text for _, _, text in fleet.log)
