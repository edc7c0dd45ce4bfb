"""Two guards never own one endpoint, for all spellings of the endpoint."""

from __future__ import annotations

import asyncio
import os
import signal
import subprocess
import sys

import pytest
from loopback import own_address

from lfield.errors import DeviceError
from lfield.guard import endpoint_lock
from lfield.guard.endpoint_lock import EndpointLock, EndpointTarget, endpoint_targets

#: Acquires a lock, prints a line, and holds the lock until it is killed.
HOLDER = """
import asyncio, sys
from lfield.guard.endpoint_lock import EndpointLock
async def main():
    lock = EndpointLock()
    await lock.acquire(sys.argv[1])
    print("held", flush=True)
    await asyncio.sleep(1000)
asyncio.run(main())
"""


@pytest.mark.parametrize(
    ("endpoint", "expected"),
    [
        ("udp:10.0.0.1:14550", [EndpointTarget("udp", "10.0.0.1", 14550)]),
        ("udpin:0.0.0.0:14550", [EndpointTarget("udpin", "0.0.0.0", 14550)]),
        ("tcp:[::1]:5760", [EndpointTarget("tcp", "::1", 5760)]),
        ("serial:/dev/ttyUSB0:57600", [EndpointTarget("device", "/dev/ttyUSB0")]),
        ("slcan:/dev/ttyUSB0@115200?bitrate=500000", [EndpointTarget("device", "/dev/ttyUSB0")]),
        ("serial:/dev/serial/by-id/usb-1:2:57600", [EndpointTarget("device", "/dev/serial/by-id/usb-1:2")]),
        ("socketcan:can0?fd=True", [EndpointTarget("socketcan", "can0")]),
        ("socketcand:10.0.0.1:29536/can0", [EndpointTarget("socketcand", "10.0.0.1", 29536, "/can0")]),
        ("pcan:PCAN_USBBUS1", [EndpointTarget("pcan", "PCAN_USBBUS1")]),
        ("virtual:bus", []),
        (
            "udp:10.0.0.1:14550, serial:/dev/ttyUSB0:57600",
            [EndpointTarget("udp", "10.0.0.1", 14550), EndpointTarget("device", "/dev/ttyUSB0")],
        ),
        ("nonsense", []),
        ("", []),
    ],
)
def test_endpoint_targets_of_an_endpoint(endpoint, expected):
    assert endpoint_targets(endpoint) == expected


async def refusal(endpoint: str) -> str:
    lock = EndpointLock()
    try:
        await lock.acquire(endpoint)
    except DeviceError as error:
        return error.reason
    finally:
        lock.release()
    return ""


@pytest.fixture
def short_timeout(monkeypatch):
    monkeypatch.setattr(endpoint_lock, "LOCK_TIMEOUT", 0.05)
    monkeypatch.setattr(endpoint_lock, "RETRY_AFTER", 0.01)


@pytest.fixture
def port(tmp_path):
    """Two names of one device."""
    device, other = tmp_path / "ttyX", tmp_path / "by-id"
    device.touch()
    other.symlink_to(device)
    return device, other


@pytest.mark.usefixtures("short_timeout")
@pytest.mark.parametrize(
    ("held", "wanted", "refused"),
    [
        ("udp:OWN:9", "udp:OWN:9", True),
        ("udp:OWN:9", "udp:OWN:19", False),
        ("udp:OWN:9", "tcp:OWN:9", False),
        ("tcp:OWN:9", "serial:/dev/null:9600, tcp:OWN:9", True),
        ("socketcand:OWN:9/can0", "socketcand:OWN:9/can0?fd=True", True),
        ("socketcand:OWN:9/can0", "socketcand:OWN:9/can1", False),
        ("virtual:one", "virtual:one", False),
    ],
)
async def test_endpoint_has_one_owner(held, wanted, refused):
    held, wanted = (endpoint.replace("OWN", own_address()) for endpoint in (held, wanted))

    lock = EndpointLock()
    await lock.acquire(held)
    reason = await refusal(wanted)
    assert (f"{wanted} is in use by process {os.getpid()}, started by" in reason) is refused
    lock.release()
    assert await refusal(wanted) == ""


@pytest.mark.usefixtures("short_timeout")
async def test_symbolic_link_to_a_device_is_the_same_endpoint(port):
    lock = EndpointLock()
    await lock.acquire(f"serial:{port[0]}:57600")
    assert "is in use by process" in await refusal(f"slcan:{port[1]}@115200")
    lock.release()


@pytest.mark.process
@pytest.mark.parametrize("hangs", [False, True])
def test_owner_process_is_named_and_its_death_frees_the_endpoint(hangs, monkeypatch):
    endpoint = f"udp:{own_address()}:9"
    with subprocess.Popen([sys.executable, "-c", HOLDER, endpoint], stdout=subprocess.PIPE) as holder:
        try:
            assert holder.stdout.readline() == b"held\n"
            monkeypatch.setattr(endpoint_lock, "LOCK_TIMEOUT", 0.2)
            if hangs:
                holder.send_signal(signal.SIGSTOP)
            for _ in range(3):
                reason = asyncio.run(refusal(endpoint))
                assert f"process {holder.pid}, started by process {os.getpid()}" in reason
        finally:
            holder.kill()
    assert asyncio.run(refusal(endpoint)) == ""
