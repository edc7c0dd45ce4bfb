"""Measurement of the scheduling delays of a computer, before the opening of devices and during a flight."""

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


class DelayedClock(LoopClock):
    """The clock of a computer that pauses for `late` seconds at each of `times`."""

    def __init__(self, late, *times):
        self.late, self.times, self.start = late, list(times), None

    def monotonic(self):
        now = super().monotonic()
        self.start = now if self.start is None else self.start
        return now + self.late * sum(self.start + when <= now for when in self.times)


def plugins():
    found = Plugins()
    found.add("lfield_mavlink:PLUGIN")
    return found


def bound(endpoint):
    needed = {"lead": {"fc": "Mavlink"}}
    (device,) = read_bindings(None, needed, plugins(), simulate=True).all
    return msgspec.structs.replace(device, endpoint=endpoint)


def test_measurement_without_delay_takes_one_second():
    async def scenario():
        start = LoopClock().monotonic()
        assert await measure_jitter(JitterLimit(0.1), LoopClock()) == pytest.approx(0.0, abs=1e-6)
        assert LoopClock().monotonic() - start == pytest.approx(SPAN, abs=0.02)

    run_jumping(scenario())


def test_single_short_delay_is_measured_and_accepted():
    assert run_jumping(measure_jitter(JitterLimit(0.1), DelayedClock(0.02, 0.4))) == pytest.approx(
        0.02, abs=1e-6
    )


def test_measurement_is_repeated_after_a_long_delay():
    assert run_jumping(measure_jitter(JitterLimit(0.1), DelayedClock(0.12, 0.4))) == pytest.approx(
        0.0, abs=1e-6
    )


def test_computer_with_repeated_delays_is_refused_before_opening():
    late = DelayedClock(0.12, *(0.4 * count for count in range(1, 3 * TRIES)))
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


def test_no_measurement_for_fakes_or_without_devices():
    class Never(SystemClock):
        def monotonic(self):
            raise AssertionError("a measurement was made")

    for devices in ([], [bound(f"{SIMULATED}lead.fc")]):
        asyncio.run(require_timely(JitterLimit(0.1), devices, Never()))


def test_doctor_measures_delays_and_advises(monkeypatch):
    monkeypatch.setattr(event_loop, "may_raise_timer_priority", lambda: False)
    late = DelayedClock(0.12, *(0.4 * count for count in range(1, 3 * TRIES)))
    found = run_jumping(scheduling_lateness(0.1, late, bound=True))
    assert found.state == "problem"
    assert found.what.startswith(
        "'silence: 0.1' is too short for this computer: heartbeats to guards are up to 0.12 s late, and "
    )
    assert found.cure.endswith("write 'silence: 0.3' if the vehicles may move for so long without their host")
    assert (
        run_jumping(scheduling_lateness(0.1, DelayedClock(0.12, *late.times), bound=False)).state == "warning"
    )
    finding = run_jumping(scheduling_lateness(0.2, DelayedClock(0.02, 0.4), bound=True))
    assert (finding.state, finding.cure) == ("ok", "")
    assert finding.what == "heartbeats to guards up to 20 ms late: fast enough for 'silence: 0.2'"


@pytest.mark.process
async def test_latch_after_silence_reports_the_delay_of_this_computer():
    with running_fake("mavlink", "--listen", "udp:127.0.0.1:0", "--set-up", "--climb", "8") as fake:
        async with guarded(bound(fake.endpoint), silence=0.5) as (flight,):
            # If the test computer is slow, the guard may latch earlier, for the same reason.
            with suppress(DeviceError):
                await flight.call("arm")
            # The sleep blocks the event loop: the host sends no heartbeats.
            time.sleep(1.5)
            reason = "the host was silent for over 500 ms, since this computer was late"
            await flight.until_note(f"in safe state 'land': {reason}")
            assert reason in flight.latched
            late = re.compile("heartbeats to the guards late by [1-9].*longest so far")
            await flight.until(
                lambda: any(map(late.match, flight.notes)), 60.0, "a warning about late heartbeats"
            )
