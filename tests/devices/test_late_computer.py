"""A computer that is late, before its host opens devices and while they fly."""

from __future__ import annotations

import asyncio
import re
import time
from contextlib import suppress

import msgspec
import pytest

from lfield import event_loop
from lfield.clock import SystemClock
from lfield.devices.jitter_measurement import SPAN, TRIES, measure_jitter, require_timely
from lfield.devices.scheduling_jitter import JitterLimit
from lfield.driver.binding import SIMULATED
from lfield.driver.plugins import Plugins
from lfield.errors import DeviceError, DevicesError
from lfield.mission.bindings_file import read_bindings
from lfield.operator.diagnostics import scheduling_lateness
from lfield.simulate.jumping_loop import LoopClock, run_jumping
from lfield.testing.driver_bench import guarded, running_fake


class Hiccups(LoopClock):
    """The time of a computer that now and then stands still, for `late` seconds at each of some times."""

    def __init__(self, late, *times):
        self.late, self.times, self.begun = late, list(times), None

    def monotonic(self):
        now = super().monotonic()
        self.begun = now if self.begun is None else self.begun
        return now + self.late * sum(self.begun + when <= now for when in self.times)


def plugins():
    found = Plugins()
    found.add("lfield_mavlink:PLUGIN")
    return found


def bound(endpoint):
    needed = {"lead": {"fc": "Mavlink"}}
    (device,) = read_bindings(None, needed, plugins(), simulate=True).all
    return msgspec.structs.replace(device, endpoint=endpoint)


def test_a_computer_in_time_is_measured_in_a_second():
    async def story():
        begun = LoopClock().monotonic()
        assert await measure_jitter(JitterLimit(0.1), LoopClock()) == pytest.approx(0.0, abs=1e-6)
        assert LoopClock().monotonic() - begun == pytest.approx(SPAN, abs=0.02)

    run_jumping(story())


def test_one_hiccup_is_measured_and_allowed():
    assert run_jumping(measure_jitter(JitterLimit(0.1), Hiccups(0.02, 0.4))) == pytest.approx(0.02, abs=1e-6)


def test_a_computer_that_is_late_once_gets_another_second():
    assert run_jumping(measure_jitter(JitterLimit(0.1), Hiccups(0.12, 0.4))) == pytest.approx(0.0, abs=1e-6)


def test_a_computer_that_is_late_each_time_is_refused_before_anything_is_opened():
    late = Hiccups(0.12, *(0.4 * count for count in range(1, 3 * TRIES)))
    with pytest.raises(DevicesError) as refused:
        run_jumping(require_timely(JitterLimit(0.1), [bound("udp:127.0.0.1:1")], late))
    assert refused.value.exit_status == 69
    assert refused.value.problems == (
        "'silence: 0.1' is too short for this computer: heartbeats to guards are up to 0.12 s late, "
        "and the shortest possible silence is 0.3 s: "
        "reduce the load of "
        "this computer, give its guards real-time priority (LimitRTPRIO=1, see 'lfield doctor') or write "
        "'silence: 0.3' if the vehicles may move for so long without their host",
    )


def test_fakes_and_hosts_without_devices_ask_for_nothing():
    class Never(SystemClock):
        def monotonic(self):
            raise AssertionError("it is measured")

    for devices in ([], [bound(f"{SIMULATED}lead.fc")]):
        asyncio.run(require_timely(JitterLimit(0.1), devices, Never()))


def test_the_doctor_measures_and_advises(monkeypatch):
    monkeypatch.setattr(event_loop, "may_raise_timer_priority", lambda: False)
    late = Hiccups(0.12, *(0.4 * count for count in range(1, 3 * TRIES)))
    found = run_jumping(scheduling_lateness(0.1, late, bound=True))
    assert found.state == "problem"
    assert found.what.startswith(
        "'silence: 0.1' is too short for this computer: heartbeats to guards are up to 0.12 s late, and "
    )
    assert found.cure.endswith("write 'silence: 0.3' if the vehicles may move for so long without their host")
    assert run_jumping(scheduling_lateness(0.1, Hiccups(0.12, *late.times), bound=False)).state == "warning"
    well = run_jumping(scheduling_lateness(0.2, Hiccups(0.02, 0.4), bound=True))
    assert (well.state, well.cure) == ("ok", "")
    assert well.what == "heartbeats to guards up to 20 ms late: fast enough for 'silence: 0.2'"


@pytest.mark.process
def test_a_latch_for_silence_says_that_this_computer_was_late():
    async def story():
        with running_fake("mavlink", "--listen", "udp:127.0.0.1:0", "--set-up", "--climb", "8") as fake:
            async with guarded(bound(fake.endpoint), silence=0.5) as (flight,):
                # A computer that is late in earnest may have its guard latch meanwhile, for the same reason.
                with suppress(DeviceError):
                    await flight.call("arm")
                # The loop is held: neither a beat nor anything else goes out.
                time.sleep(1.5)
                why = "the host was silent for over 500 ms, since this computer was late"
                await flight.until_note(f"in safe state 'land': {why}")
                assert why in flight.latched
                late = re.compile("heartbeats to the guards late by [1-9].*longest so far")
                await flight.until(lambda: any(map(late.match, flight.notes)), 60.0, "the lateness")

    asyncio.run(story())
