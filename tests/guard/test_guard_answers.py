"""Telemetry is sent before the result, exception or latch that depends on it."""

from __future__ import annotations

import asyncio

import pytest
from thing_guard import Output, guard_of, known_thing

from lfield.driver.binding import DeviceBinding
from lfield.driver.contract import RELEASE
from lfield.driver.device import Device
from lfield.guard.messages import (
    CallDone,
    CancelInstruction,
    ClearStop,
    GuardCall,
    Latched,
    LockedOut,
    OpenDevices,
    Refused,
    Released,
    RequestSafeState,
    TelemetrySnapshot,
    encode,
)
from lfield.guard.shell import BACKLOG
from lfield.guard.telemetry import RATE
from lfield.manifest import Instruction, Quantity
from lfield.simulate.jumping_loop import JumpingLoop, LoopClock

HEIGHT = Quantity("height", "real")
NAMES = ("rise", "answer", "fail", "crash", "reject", "overshoot", "hover", "tumble")
CALLS = tuple(Instruction(name, (), effect="actuate", blocking=True, cancel="leave") for name in NAMES)


class Lift(Device):
    async def _open(self):
        return "a lift"

    async def _make_safe(self, state):
        pass

    async def do_rise(self):
        self.heard()
        self.publish(height=2.0)

    async def do_answer(self):
        self.heard()

    async def do_fail(self):
        self.publish(height=1.0)
        raise self.error("it failed")

    async def do_crash(self):
        self.publish(height=1.0)
        raise RuntimeError("a fault of the driver")

    async def do_reject(self):
        self.publish(height=1.0)
        raise ValueError("not such a value")

    async def do_overshoot(self):
        self.publish(height=1.0)
        self.breach("it is too high")
        await asyncio.sleep(9.0)

    async def do_tumble(self):
        self.publish(height=0.0)
        self.lock_out("it crashed")
        await asyncio.sleep(9.0)

    async def do_hover(self):
        self.publish(height=1.0)
        await asyncio.sleep(9.0)


def _binding():
    return DeviceBinding(
        agent="alpha", field="thing", type="Thing", driver="thing", endpoint="here", safe_state="off",
        ttl=0.5, limits={}, options={}, waivers=["device_watchdog"],
    )  # fmt: skip


def _written(*names, wait=0.0, then=(), unread=0):
    """The messages that the guard writes for successive calls and then for `then`; a list per write.

    `unread` is the number of bytes in the pipe that the host does not read.
    """
    binding = _binding()

    async def scenario():
        output = Output()
        shell = guard_of(Lift, output)
        shell.data_received(
            encode(OpenDevices([binding], "", 9.0, known_thing(*CALLS, RELEASE, telemetry=(HEIGHT,))))
        )
        await asyncio.sleep(2 / RATE)
        output.writes.clear()
        for token, name in enumerate(names, 1):
            now = LoopClock().monotonic()
            shell.data_received(encode(GuardCall(token, "alpha.thing", name, [], now, now + 9.0)))
            await asyncio.sleep(0.001)
        output.unread = unread
        for message in then:
            shell.data_received(encode(message))
            await asyncio.sleep(0.001)
        await asyncio.sleep(wait)
        await shell.close()
        return output.writes

    with asyncio.Runner(loop_factory=JumpingLoop) as runner:
        return runner.run(scenario())


def test_changed_telemetry_precedes_the_result_in_the_same_write():
    ((snapshot, done),) = _written("rise")
    assert isinstance(snapshot, TelemetrySnapshot)
    assert snapshot.values["height"].value == 2.0
    assert done == CallDone(1, None)


def test_contact_without_new_values_is_sent_periodically():
    assert _written("answer", "answer", "answer") == [[CallDone(n, None)] for n in (1, 2, 3)]
    *answers, (snapshot,) = _written("answer", "answer", wait=2 / RATE)
    assert len(answers) == 2
    assert (snapshot.device, snapshot.values) == ("alpha.thing", {})


@pytest.mark.parametrize("name", ["fail", "crash", "reject", "overshoot"])
def test_telemetry_precedes_an_exception_in_the_same_write(name):
    (snapshot, refused, *rest), *_ = _written(name)
    assert isinstance(snapshot, TelemetrySnapshot)
    assert snapshot.values["height"].value == 1.0
    assert isinstance(refused, Refused)
    assert all(isinstance(latched, Latched) for latched in rest)
    assert bool(rest) == (name in ("crash", "overshoot"))


@pytest.mark.parametrize(
    "end", [RequestSafeState("alpha.thing", "an operator requested it"), CancelInstruction(1, 0.0)]
)
def test_telemetry_precedes_the_refusal_of_an_ended_call(end):
    writes = _written("hover", then=[end])
    kinds = [type(message) for write in writes for message in write]
    assert kinds.index(TelemetrySnapshot) < kinds.index(Refused)


def test_telemetry_of_an_exception_ignores_backlog():
    """Periodic telemetry waits, and the newest is kept; the cause of an exception does not wait."""
    safe = RequestSafeState("alpha.thing", "an operator requested it")
    writes = _written("hover", then=[safe], unread=BACKLOG, wait=3 / RATE)
    sent_messages = [message for write in writes for message in write]
    snapshots = [message for message in sent_messages if isinstance(message, TelemetrySnapshot)]
    assert [snapshot.values["height"].value for snapshot in snapshots] == [1.0]
    assert sent_messages.index(snapshots[0]) < [type(message) for message in sent_messages].index(Refused)


def test_periodic_telemetry_waits_for_a_slow_host():
    assert _written("hover", unread=BACKLOG, wait=5 / RATE) == []


def test_lock_out_lasts_until_an_operator_ends_it():
    now = LoopClock

    async def scenario():
        output = Output()
        shell = guard_of(Lift, output)
        thing = known_thing(*CALLS, RELEASE, telemetry=(HEIGHT,))
        shell.data_received(encode(OpenDevices([_binding()], "", 99.0, thing)))
        await asyncio.sleep(2 / RATE)
        for token, name in enumerate(("tumble", "release", "rise"), 1):
            sent = now().monotonic()
            shell.data_received(encode(GuardCall(token, "alpha.thing", name, [], sent, sent + 9.0)))
            await asyncio.sleep(0.1)
        before = len(output.received)
        shell.data_received(encode(ClearStop()))
        sent = now().monotonic()
        shell.data_received(encode(GuardCall(9, "alpha.thing", "release", [], sent, sent + 9.0)))
        await asyncio.sleep(0.1)
        await shell.close()
        return output.received[:before], output.received[before:]

    with asyncio.Runner(loop_factory=JumpingLoop) as runner:
        sent_messages, after = runner.run(scenario())
    assert LockedOut("alpha.thing", "it crashed") in sent_messages
    refused = {message.token: message.reason for message in sent_messages if isinstance(message, Refused)}
    assert refused.keys() == {1, 2, 3}
    assert [token for token in refused if "estop --lift" in refused[token]] == [2, 3], refused
    assert Released("alpha.thing") in after
    assert CallDone(9, None) in after


def test_calls_that_end_before_they_start_leave_no_data():
    """A task that is cancelled before its first step runs no `finally`."""

    async def scenario():
        shell = guard_of(Lift, Output())
        thing = known_thing(*CALLS, RELEASE, telemetry=(HEIGHT,))
        shell.data_received(encode(OpenDevices([_binding()], "", 99.0, thing)))
        await asyncio.sleep(2 / RATE)
        sent = LoopClock().monotonic()
        for token in range(1, 9):
            shell.data_received(encode(GuardCall(token, "alpha.thing", "hover", [], sent, sent + 9.0)))
        await asyncio.sleep(0.01)
        running = list(shell._calls)
        await shell.close()
        return running

    with asyncio.Runner(loop_factory=JumpingLoop) as runner:
        assert runner.run(scenario()) == [8]
