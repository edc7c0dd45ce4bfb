"""The timer of a guard's process on a loop with timers as coarse as uvloop's."""

from __future__ import annotations

import asyncio
import signal

from thing_guard import Output, guard_of, known_thing

from lfield.driver.binding import DeviceBinding
from lfield.driver.device import Device
from lfield.guard.messages import Beat, GuardCall, Latched, OpenDevices, encode
from lfield.guard.recording.guard_inputs import SafeStateRequested
from lfield.guard.shell import SAFE_COMMAND_TIME
from lfield.manifest import Instruction
from lfield.simulate.jumping_loop import JumpingLoop, LoopClock

SILENCE = 0.2
GO = Instruction("go", (), effect="actuate", blocking=True)


class CoarseLoop(JumpingLoop):
    """Timers in whole milliseconds; a timer that is due earlier runs at once, as a handle without a time.

    Each reading of the clock advances it slightly: otherwise no time would pass while handles run.
    """

    def time(self):
        self._jumps.now += 1e-6
        return super().time()

    def call_at(self, when, callback, *args, context=None):
        delay = round((when - self.time()) * 1000.0) / 1000.0
        if delay <= 0.0:
            return self.call_soon(callback, *args, context=context)
        return super().call_at(self.time() + delay, callback, *args, context=context)


class Thing(Device):
    async def _open(self):
        return "a thing"

    async def _make_safe(self, state):
        pass

    async def do_go(self):
        pass


BINDING = DeviceBinding(
    agent="alpha", field="thing", type="Thing", driver="thing", endpoint="here", safe_state="off",
    ttl=0.5, limits={}, options={}, waivers=["device_watchdog"],
)  # fmt: skip


def test_messages_just_before_the_timer_do_not_delay_the_latch():
    async def scenario():
        clock, output = LoopClock(), Output()
        shell = guard_of(Thing, output)
        shell.data_received(encode(OpenDevices([BINDING], "", SILENCE, known_thing(GO))))
        await asyncio.sleep(0.01)
        start = clock.monotonic()
        shell.data_received(encode(GuardCall(1, "alpha.thing", "go", [], start, start + 9.0)))
        await asyncio.sleep(SILENCE - 0.002)
        while clock.monotonic() < start + SILENCE - 0.0003:
            await asyncio.sleep(0)
        for _ in range(3):
            shell.data_received(encode(Beat(start)))
        while not any(isinstance(message, Latched) for message in output.received):
            assert clock.monotonic() < start + SILENCE + 0.001
            await asyncio.sleep(0)
        await shell.close()

    with asyncio.Runner(loop_factory=CoarseLoop) as runner:
        runner.run(scenario())


def test_a_guard_without_memory_commands_the_safe_states_once_and_is_killed(monkeypatch):
    signals, requests = [], []
    monkeypatch.setattr("lfield.guard.shell.os.kill", lambda pid, number: signals.append(number))

    async def scenario():
        shell = guard_of(Thing, Output())
        shell.data_received(encode(OpenDevices([BINDING], "", 10.0, known_thing(GO))))
        await asyncio.sleep(0.01)
        handle = shell._core.handle
        monkeypatch.setattr(shell._core, "handle", lambda event: requests.append(event) or handle(event))
        shell.crashed(MemoryError())
        assert requests == [SafeStateRequested("", "its guard is out of memory")]
        await asyncio.sleep(SAFE_COMMAND_TIME + 0.01)
        assert signals == [signal.SIGKILL]
        await shell.close()

    with asyncio.Runner(loop_factory=CoarseLoop) as runner:
        runner.run(scenario())
