"""A guard that has to end while it opens its devices: it is finished, given up, or named."""

from __future__ import annotations

import asyncio

import pytest
from thing_guard import Output, guard_of, known_thing

from lfield.driver.binding import DeviceBinding
from lfield.driver.device import Device
from lfield.guard.device_opener import FINISH_TIMEOUT
from lfield.guard.messages import DevicesOpened, Latched, OpenDevices, OpenFailed, Stop, Stopped, encode
from lfield.simulate.jumping_loop import LoopClock, run_jumping

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


def stopped(*fields, kind=Thing, at=0.2, latched="", **stop):
    """What a guard says that is told to stop some time after it began to open these, and how long it took.

    `latched` is why it was started again; `at` is None for a stop together with the request to open.
    """
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
        request = encode(OpenDevices(devices, latched, 0.2, known_thing()))
        if at is not None:
            shell.data_received(request)
            request = b""
            await asyncio.sleep(at)
        told_at = clock.monotonic()
        shell.data_received(request + encode(Stop("the host is stopping", **stop)))
        await shell.exit
        await shell.close()
        return output.received, clock.monotonic() - told_at

    return run_jumping(story())


def said(told, kind):
    return [message for message in told if isinstance(message, kind)]


def test_a_device_that_was_only_asked_is_given_up_at_once():
    told, seconds = stopped("absent")
    assert said(told, Stopped) == [Stopped({})]
    assert seconds < 0.1


def test_a_device_that_is_being_set_up_is_finished_and_made_safe():
    told, seconds = stopped("quick")
    assert said(told, DevicesOpened) == [DevicesOpened({"a.quick": "a thing"})]
    assert said(told, Stopped) == [Stopped({})]
    assert seconds < 1.5


def test_of_two_on_a_bus_the_one_that_answers_is_made_safe_and_the_other_given_up():
    told, seconds = stopped("quick", "absent")
    assert said(told, DevicesOpened) == [DevicesOpened({"a.quick": "a thing"})]
    assert said(told, Stopped) == [Stopped({})]
    assert seconds < 1.5


@pytest.mark.parametrize(("stop", "within"), [({}, FINISH_TIMEOUT + 0.1), ({"at_once": True}, 0.1)])
def test_a_device_that_does_not_get_set_up_is_named(stop, within):
    told, seconds = stopped("slow", **stop)
    assert said(told, Stopped) == [Stopped({"a.slow": "opening was not complete"})]
    assert seconds < within


def test_a_device_that_says_nothing_of_it_counts_as_changed_from_the_beginning():
    told, _ = stopped("absent", kind=Unsaid)
    assert said(told, Stopped) == [Stopped({"a.absent": "opening was not complete"})]


def test_a_device_that_cannot_be_set_up_is_refused_as_without_a_stop():
    told, _ = stopped("broken")
    assert said(told, OpenFailed) == [OpenFailed([("a.broken", "DeviceException", "it cannot be set up")])]


def test_a_guard_that_is_started_again_makes_its_devices_safe_before_it_obeys_a_stop():
    told, _ = stopped("quick", at=None, latched="its guard died and was restarted")
    assert said(told, DevicesOpened) == [DevicesOpened({"a.quick": "a thing"})]
    assert said(told, Stopped) == [Stopped({})]
    assert [(m.confirmed, m.reason) for m in said(told, Latched)] == [
        (False, "its guard died and was restarted"),
        (True, "its guard died and was restarted"),
    ]


def test_a_guard_that_is_started_again_and_stopped_at_once_names_what_it_has_not_opened():
    told, _ = stopped("quick", at=None, latched="its guard died and was restarted", at_once=True)
    assert said(told, Stopped) == [Stopped({"a.quick": "opening was not complete"})]
