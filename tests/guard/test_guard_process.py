"""The guard as a process, with the MAVLink driver and its fake: flight, killed host or guard, silence.

Tests without a process are in test_guard_flights.py, in virtual time.
"""

from __future__ import annotations

import asyncio
import os
import signal
import subprocess
import sys
import textwrap
import time
from contextlib import asynccontextmanager

import msgspec
import pytest
from pymavlink import mavutil

from lfield.devices.fake_processes import start_fake
from lfield.driver.binding import SIMULATED
from lfield.driver.plugins import Plugins
from lfield.driver.sims import Sims
from lfield.errors import BindingError, DeviceError, DevicesError
from lfield.mission.bindings_file import read_bindings
from lfield.testing.driver_bench import RunningFake, guarded, running_fake

pytestmark = pytest.mark.process

#: Options of a fast vehicle, so that a flight takes seconds.
BRISK = ["--climb", "8", "--cruise", "15", "--descend", "2.4", "--land", "1.9", "--acceleration", "15"]


def plugins() -> Plugins:
    plugins = Plugins()
    plugins.add("lfield_mavlink:PLUGIN")
    return plugins


def binding(endpoint=SIMULATED, **changes):
    bound = read_bindings(None, {"alpha": {"fc": "Mavlink"}}, plugins(), simulate=True).devices["alpha"]["fc"]
    options = bound.options | changes.pop("options", {})
    return msgspec.structs.replace(bound, endpoint=endpoint, options=options, **changes)


@asynccontextmanager
async def fake(state="land"):
    with running_fake("mavlink", "--listen", "udp:127.0.0.1:0", "--set-up", state, *BRISK) as running:
        yield running


@asynccontextmanager
async def flying(running: RunningFake, **changes):
    async with guarded(binding(running.endpoint, **changes)) as (flight,):
        yield flight


@pytest.mark.few(0)
async def test_flight_through_guard_and_fake():
    async with fake() as f, flying(f) as flight:
        assert await flight.call("armed") is False
        with pytest.raises(DeviceError, match="takeoff refused: the motors are off"):
            await flight.call("takeoff", 4.0)
        await flight.call("arm")
        await flight.call("takeoff", 4.0)
        await flight.call("goTo", 6.0, -3.0, -4.0)
        north, east, _ = await flight.call("position")
        assert abs(north - 6.0) < 0.6
        assert abs(east + 3.0) < 0.6
        await flight.call("land")
        await flight.reads("landed", bool)
        assert await flight.call("age") < 2.0
        assert 0.5 < await flight.call("battery") <= 1.0


async def test_killed_guard_is_restarted_with_its_device_safe():
    async with fake("hold") as f, flying(f, safe_state="hold") as flight:
        await flight.call("arm")
        await flight.call("takeoff", 3.0)
        motion = asyncio.create_task(flight.call("goTo", 500.0, 0.0, -3.0))
        await asyncio.sleep(0)
        os.kill(flight.guard_pid, signal.SIGKILL)
        with pytest.raises(DeviceError, match=r"goTo\(\) is lost: the guard ended with status -9"):
            await motion
        await flight.until_note("in safe state 'hold': its guard died and was restarted")
        await flight.call("release")
        await flight.call("land")


@pytest.mark.few(0)
async def test_unresponsive_guard_is_replaced():
    async with fake() as f, flying(f) as flight:
        os.kill(flight.guard_pid, signal.SIGSTOP)
        await flight.until_note("guard of alpha.fc unresponsive")
        await flight.until_note("in safe state 'land': its guard died and was restarted")


@pytest.mark.few(0)
async def test_stopped_host_is_silent_and_the_vehicle_lands(tmp_path):
    """After SIGSTOP of the host the guard lands the vehicle although the pipe is still open."""
    async with fake() as f:
        host = start_host(f.endpoint)
        try:
            await asyncio.to_thread(host.stdout.readline)
            host.send_signal(signal.SIGSTOP)
            await asyncio.to_thread(wait_for_landing, f.endpoint, armed=True)
        finally:
            host.kill()
            host.communicate()


async def test_vehicle_lands_after_the_host_is_killed():
    async with fake() as f:
        host = start_host(f.endpoint)
        await asyncio.to_thread(host.stdout.readline)
        host.kill()
        await asyncio.to_thread(host.communicate)
        # The guard outlives its host, and owns the endpoint until the vehicle is on the ground and disarmed.
        await asyncio.to_thread(wait_for_landing, f.endpoint, armed=False)
        async with flying(f) as flight:
            await flight.reads("mode", lambda now: now == "LAND")
            await flight.reads("armed", lambda now: now is False)


def wait_for_landing(endpoint: str, *, armed: bool) -> None:
    """Waits until the vehicle lands (`armed`) or has landed; uses a second link beside the guard's."""
    station = mavutil.mavlink_connection(endpoint.replace("udp:", "udpout:"))
    end = time.monotonic() + 60.0
    while time.monotonic() < end:
        station.mav.heartbeat_send(
            mavutil.mavlink.MAV_TYPE_GCS, mavutil.mavlink.MAV_AUTOPILOT_INVALID, 0, 0, 0
        )
        heartbeat = station.recv_match(type="HEARTBEAT", blocking=True, timeout=0.5)
        if heartbeat is None or mavutil.mode_mapping_acm[heartbeat.custom_mode] != "LAND":
            continue
        if armed or not heartbeat.base_mode & mavutil.mavlink.MAV_MODE_FLAG_SAFETY_ARMED:
            station.close()
            return
    pytest.fail("the vehicle does not land")


@pytest.mark.few(0)
async def test_second_guard_at_an_endpoint_is_refused_with_the_owner():
    async with fake() as f, flying(f) as flight:
        with pytest.raises(DevicesError, match=r"is in use by process \d+, started by process") as refused:
            async with flying(f):
                pytest.fail("two guards own one vehicle")
        assert f"started by process {os.getpid()}" in str(refused.value)
        assert await flight.call("armed") is False
    async with fake() as f, flying(f), fake() as other, flying(other):
        pass


def start_host(endpoint: str) -> subprocess.Popen[bytes]:
    """A separate host that takes off, prints a line, and then waits."""
    code = f"""
        import asyncio, sys
        sys.path.insert(0, {os.path.dirname(__file__)!r})
        from test_guard_process import binding, guarded

        async def main():
            async with guarded(binding({endpoint!r})) as (flight,):
                await flight.call("arm")
                await flight.call("takeoff", 5.0)
                print("up", flush=True)
                await asyncio.sleep(3600)

        asyncio.run(main())
    """
    return subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(code)], stdin=subprocess.DEVNULL, stdout=subprocess.PIPE
    )


def problems_on_opening(*devices) -> str:
    async def attempt():
        async with guarded(*devices):
            raise AssertionError("the devices were opened")

    with pytest.raises(BindingError) as error:
        asyncio.run(attempt())
    return "\n".join(error.value.problems)


@pytest.mark.few(0)
def test_every_device_that_fails_to_open_is_reported():
    unreachable = binding("udp:127.0.0.1:9", options={"connect": 0.3})
    other = msgspec.structs.replace(binding("upd:127.0.0.1:1"), agent="beta")
    problems = problems_on_opening(unreachable, other)
    assert "alpha.fc: no heartbeat from system 1 at udp:127.0.0.1:9 within 0.3 s" in problems
    assert "beta.fc: 'upd:127.0.0.1:1' is not an endpoint; write udp:HOST:PORT, udpin:HOST:PORT" in problems


@pytest.mark.parametrize(
    ("endpoint", "words"),
    [
        ("tcp:127.0.0.1:9", "cannot open tcp:127.0.0.1:9"),
        ("serial:/dev/does-not-exist:57600", "cannot open serial:/dev/does-not-exist:57600: No such file"),
    ],
)
def test_endpoint_that_cannot_be_opened_is_reported(endpoint, words):
    assert words in problems_on_opening(binding(endpoint))


def test_two_vehicles_with_one_id_on_one_link_are_refused():
    devices = [binding("udp:127.0.0.1:9"), msgspec.structs.replace(binding("udp:127.0.0.1:9"), agent="beta")]
    assert "two devices are system 1 on udp:127.0.0.1:9" in problems_on_opening(*devices)


def test_missing_vendor_library_names_the_extra_on_the_host(tmp_path, monkeypatch):
    """pymavlink is hidden from the guard's process."""
    (tmp_path / "pymavlink.py").write_text("raise ImportError('hidden')")
    monkeypatch.setenv("PYTHONPATH", f"{tmp_path}{os.pathsep}{os.pathsep.join(p for p in sys.path if p)}")
    assert "needs pymavlink: pip install 'lfield[mavlink]'" in problems_on_opening(binding("udp:127.0.0.1:9"))


def test_driver_without_a_fake_is_reported():
    async def attempt():
        await start_fake(Sims(), [binding()])

    with pytest.raises(
        Exception, match=r"alpha.fc: there is no simulated device for driver 'mavlink' \(installed: none\)"
    ):
        asyncio.run(attempt())
