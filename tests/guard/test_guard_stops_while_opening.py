"""A guard that has to end while it opens its devices: it is finished, given up, or named."""

from __future__ import annotations

import asyncio

import pytest
from thing_guard import Output, guard_of, known_thing

from lfield.driver.binding import DeviceBinding
from lfield.driver.device import Device
from lfield.guard.messages import Failed, Open, Ready, Stop, Stopped, encode
from lfield.guard.opening import FINISH
from lfield.simulate.time import LoopClock, run_jumping

#: A device by the name of its field: seconds until it is found, and then until it is set up; -1 fails.
TIMES = {
    "quick": (0.0, 1.0),
    "absent": (100.0, 0.0),
    "slow": (0.0, 100.0),
    "broken": (0.0, -1.0),
}


class Thing(Device):
    """Asks first; what it does then changes it."""

    begun = False
    safe = 0

    async def _open(self):
        found, set_up = TIMES[self.binding.field]
        await asyncio.sleep(found)
        self.begun = True
        await asyncio.sleep(max(set_up, 0.5))
        if set_up < 0.0:
            raise self.error("it cannot be set up")
        return "a thing"

    def _touched(self):
        return self.begun

    async def _make_safe(self, state):
        self.safe += 1


class Unsaid(Thing):
    """Says nothing of when it is changed."""

    _touched = Device._touched


def stopped(*fields, kind=Thing, at=0.2, **stop):
    """What a guard says that is told to stop some time after it began to open these, and how long it took."""
    devices = [
        DeviceBinding(
            agent="a", field=field, type="Thing", driver="thing", endpoint="here", safe_state="off",
            waivers=["device_watchdog"],
        )
        for field in fields
    ]  # fmt: skip

    async def story():
        clock, output = LoopClock(), Output()
        shell = guard_of(kind, output)
        shell.data_received(encode(Open(devices, "", 0.2, known_thing())))
        await asyncio.sleep(at)
        told_at = clock.monotonic()
        shell.data_received(encode(Stop("the host is stopping", **stop)))
        await shell.exit
        await shell.close()
        return output.told, clock.monotonic() - told_at

    return run_jumping(story())


def said(told, kind):
    return [message for message in told if isinstance(message, kind)]


def test_a_device_that_was_only_asked_is_given_up_at_once():
    told, seconds = stopped("absent")
    assert said(told, Stopped) == [Stopped({})]
    assert seconds < 0.1


def test_a_device_that_is_being_set_up_is_finished_and_made_safe():
    told, seconds = stopped("quick")
    assert said(told, Ready) == [Ready({"a.quick": "a thing"})]
    assert said(told, Stopped) == [Stopped({})]
    assert seconds < 1.5


def test_of_two_on_a_bus_the_one_that_answers_is_made_safe_and_the_other_given_up():
    told, seconds = stopped("quick", "absent")
    assert said(told, Ready) == [Ready({"a.quick": "a thing"})]
    assert said(told, Stopped) == [Stopped({})]
    assert seconds < 1.5


@pytest.mark.parametrize(("stop", "within"), [({}, FINISH + 0.1), ({"at_once": True}, 0.1)])
def test_a_device_that_does_not_get_set_up_is_named(stop, within):
    told, seconds = stopped("slow", **stop)
    assert said(told, Stopped) == [Stopped({"a.slow": "it was still being set up"})]
    assert seconds < within


def test_a_device_that_says_nothing_of_it_counts_as_changed_from_the_beginning():
    told, _ = stopped("absent", kind=Unsaid)
    assert said(told, Stopped) == [Stopped({"a.absent": "it was still being set up"})]


def test_a_device_that_cannot_be_set_up_is_refused_as_without_a_stop():
    told, _ = stopped("broken")
    assert said(told, Failed) == [Failed([("a.broken", "DeviceException", "it cannot be set up")])]
