"""What a guard tells the host when a call is done: what it has changed, in the same write as the answer."""

from __future__ import annotations

import asyncio

from thing_guard import Output, guard_of, known_thing

from lfield.driver.binding import DeviceBinding
from lfield.driver.device import Device
from lfield.guard.messages import Call, Done, Open, Refused, Snapshot, encode
from lfield.guard.telemetry import RATE
from lfield.manifest import Instruction, Quantity
from lfield.simulate.time import JumpingLoop, LoopClock

HEIGHT = Quantity("height", "real")
CALLS = tuple(Instruction(name, (), effect="actuate", blocking=True) for name in ("rise", "answer", "fail"))


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
        raise self.error("it does not")


def _written(*names, wait=0.0):
    """What the guard writes for calls, one after the other; a list for each write."""
    binding = DeviceBinding(
        agent="alpha", field="thing", type="Thing", driver="thing", endpoint="here", safe_state="off",
        ttl=0.5, limits={}, options={}, waivers=["device_watchdog"],
    )  # fmt: skip

    async def story():
        output = Output()
        shell = guard_of(Lift, output)
        shell.data_received(encode(Open([binding], "", 9.0, known_thing(*CALLS, telemetry=(HEIGHT,)))))
        await asyncio.sleep(2 / RATE)
        output.writes.clear()
        for token, name in enumerate(names, 1):
            now = LoopClock().monotonic()
            shell.data_received(encode(Call(token, "alpha.thing", name, [], now, now + 9.0)))
            await asyncio.sleep(0.001)
        await asyncio.sleep(wait)
        await shell.close()
        return output.writes

    with asyncio.Runner(loop_factory=JumpingLoop) as runner:
        return runner.run(story())


def test_what_a_call_has_changed_comes_before_its_answer_and_with_it():
    ((snapshot, done),) = _written("rise")
    assert isinstance(snapshot, Snapshot)
    assert snapshot.values["height"].value == 2.0
    assert done == Done(1, None)


def test_that_a_device_has_answered_waits_for_its_turn():
    assert _written("answer", "answer", "answer") == [[Done(n, None)] for n in (1, 2, 3)]
    *answers, (snapshot,) = _written("answer", "answer", wait=2 / RATE)
    assert len(answers) == 2
    assert (snapshot.device, snapshot.values) == ("alpha.thing", {})


def test_who_fails_is_told_and_the_next_answer_is_written_as_ever():
    ((refused,), (snapshot, done)) = _written("fail", "rise")
    assert isinstance(refused, Refused)
    assert snapshot.values["height"].value == 2.0
    assert done == Done(2, None)
