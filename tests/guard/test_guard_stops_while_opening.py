"""A stop during the opening of devices: opening is finished, aborted, or reported as incomplete."""

from __future__ import annotations

import asyncio

import pytest
from thing_guard import Output, guard_of, known_thing

from lfield.driver.binding import DeviceBinding
from lfield.driver.device import Device
from lfield.guard.device_opener import FINISH_TIMEOUT
from lfield.guard.messages import DevicesOpened, Latched, OpenDevices, OpenFailed, Stop, Stopped, encode
from lfield.simulate.jumping_loop import LoopClock, run_jumping

#: By field name: seconds until the device is found, and seconds of its setup; -1 fails.
TIMES = {
    "quick": (0.0, 1.0),
    "absent": (100.0, 0.0),
    "slow": (0.0, 100.0),
    "broken": (0.0, -1.0),
}


class Thing(Device):
    """A device that is first only queried; its setup then changes its state."""

    started = False
    safe = 0

    async def _open(self):
        found, set_up = TIMES[self.binding.field]
        await asyncio.sleep(found)
        self.started = True
        await asyncio.sleep(max(set_up, 0.5))
        if set_up < 0.0:
            raise self.error("it cannot be set up")
        return "a thing"

    def _touched(self):
        return self.started

    async def _make_safe(self, state):
        self.safe += 1


class ThingWithoutTouched(Thing):
    """Does not report when its setup starts."""

    _touched = Device._touched


def stopped(*fields, kind=Thing, at=0.2, latched="", **stop):
    """The messages of a guard that is stopped some time after the start of opening, and the duration.

    `latched` is the reason of its restart; `at` is None for a stop together with the open request.
    """
    devices = [
        DeviceBinding(
            agent="a", field=field, type="Thing", driver="thing", endpoint="here", safe_state="off",
            waivers=["device_watchdog"],
        )
        for field in fields
    ]  # fmt: skip

    async def scenario():
        clock, output = LoopClock(), Output()
        shell = guard_of(kind, output)
        request = encode(OpenDevices(devices, latched, 0.2, known_thing()))
        if at is not None:
            shell.data_received(request)
            request = b""
            await asyncio.sleep(at)
        stopped_at = clock.monotonic()
        shell.data_received(request + encode(Stop("the host is stopping", **stop)))
        await shell.exit
        await shell.close()
        return output.received, clock.monotonic() - stopped_at

    return run_jumping(scenario())


def of_kind(sent, kind):
    return [message for message in sent if isinstance(message, kind)]


def test_device_that_was_only_queried_is_abandoned_at_once():
    sent, seconds = stopped("absent")
    assert of_kind(sent, Stopped) == [Stopped({})]
    assert seconds < 0.1


def test_device_in_setup_is_opened_and_made_safe():
    sent, seconds = stopped("quick")
    assert of_kind(sent, DevicesOpened) == [DevicesOpened({"a.quick": "a thing"})]
    assert of_kind(sent, Stopped) == [Stopped({})]
    assert seconds < 1.5


def test_stop_makes_the_answering_device_safe_and_abandons_the_other():
    sent, seconds = stopped("quick", "absent")
    assert of_kind(sent, DevicesOpened) == [DevicesOpened({"a.quick": "a thing"})]
    assert of_kind(sent, Stopped) == [Stopped({})]
    assert seconds < 1.5


@pytest.mark.parametrize(("stop", "within"), [({}, FINISH_TIMEOUT + 0.1), ({"at_once": True}, 0.1)])
def test_device_with_incomplete_setup_is_named(stop, within):
    sent, seconds = stopped("slow", **stop)
    assert of_kind(sent, Stopped) == [Stopped({"a.slow": "opening was not complete"})]
    assert seconds < within


def test_device_without_touched_state_counts_as_changed():
    sent, _ = stopped("absent", kind=ThingWithoutTouched)
    assert of_kind(sent, Stopped) == [Stopped({"a.absent": "opening was not complete"})]


def test_failed_setup_is_reported_also_during_a_stop():
    sent, _ = stopped("broken")
    assert of_kind(sent, OpenFailed) == [OpenFailed([("a.broken", "DeviceException", "it cannot be set up")])]


def test_restarted_guard_makes_its_devices_safe_before_a_stop():
    sent, _ = stopped("quick", at=None, latched="its guard died and was restarted")
    assert of_kind(sent, DevicesOpened) == [DevicesOpened({"a.quick": "a thing"})]
    assert of_kind(sent, Stopped) == [Stopped({})]
    assert [(m.confirmed, m.reason) for m in of_kind(sent, Latched)] == [
        (False, "its guard died and was restarted"),
        (True, "its guard died and was restarted"),
    ]


def test_immediate_stop_of_a_restarted_guard_names_unopened_devices():
    sent, _ = stopped("quick", at=None, latched="its guard died and was restarted", at_once=True)
    assert of_kind(sent, Stopped) == [Stopped({"a.quick": "opening was not complete"})]
