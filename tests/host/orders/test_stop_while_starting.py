"""A stop that arrives before a host has opened its devices: only open devices are confirmed."""

from __future__ import annotations

import asyncio
import random
from types import SimpleNamespace

import pytest

from lfield.host.inputs import HostInput, OrderExecuted
from lfield.host.order_history.executed_orders import ExecutedOrders
from lfield.host.stop_orders.order_executor import NOT_OPEN, OrderExecutor
from lfield.wire.observer_messages import EmergencyStop

ID = bytes(16)


class GuardsStub:
    """The guards of the devices that are open."""

    def __init__(self, devices: dict[str, str]) -> None:
        self.devices = devices
        self.inhibited = ""
        self.latched, self.moving = {}, {}

    def inhibit(self, reason: str) -> None:
        self.inhibited = reason

    async def await_safe_states(self) -> dict[str, str]:
        return self.devices


def stopped(found: dict[str, str]) -> tuple[GuardsStub, list]:
    """The answers of a host with a copter, an arm and a sensor to a stop, and to the same stop again."""
    devices = [
        SimpleNamespace(name="lead.fc", is_sensor=False),
        SimpleNamespace(name="lead.arm", is_sensor=False),
        SimpleNamespace(name="lead.gps", is_sensor=True),
    ]
    core = SimpleNamespace(
        name="alpha",
        orders=ExecutedOrders(random.Random(1).randbytes),
        recorder=SimpleNamespace(on_emergency_stop=lambda who, reason, lifted: None),
        mission=SimpleNamespace(devices_of=lambda host: devices),
        coordinators=SimpleNamespace(stopped="fog", write_problem=""),
    )
    guards, answers = GuardsStub(found), []

    async def kept(seconds: float | None) -> bool:
        return True

    def dispatch(entry: HostInput) -> None:
        if isinstance(entry, OrderExecuted):
            core.orders.on_executed(entry.kind, entry.id)

    async def scenario() -> None:
        executor = OrderExecutor(core, guards, dispatch, lambda line: None, kept)
        for number in (1, 2):
            order = EmergencyStop(ID, "fog", epoch=core.orders.epochs.of("stop"))
            executor.on_order(order, "anna", answers.append)
            async with asyncio.timeout(60.0):
                while len(answers) < number:
                    await asyncio.sleep(0.001)

    asyncio.run(scenario())
    return guards, [answer.devices for answer in answers]


@pytest.mark.parametrize(
    ("open_now", "confirmed"),
    [
        ({}, {"lead.fc": NOT_OPEN, "lead.arm": NOT_OPEN}),
        ({"lead.fc": ""}, {"lead.fc": "", "lead.arm": NOT_OPEN}),
        ({"lead.fc": "", "lead.arm": ""}, {"lead.fc": "", "lead.arm": ""}),
    ],
)
def test_a_device_that_is_not_open_yet_is_not_confirmed(open_now, confirmed):
    guards, answers = stopped(open_now)
    assert guards.inhibited == "fog"
    assert answers == [confirmed, confirmed]
