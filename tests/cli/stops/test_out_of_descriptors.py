"""A host without free descriptors or processes while its copter flies, and the connections it accepts."""

from __future__ import annotations

import resource
import signal
import socket
import time
from contextlib import ExitStack
from pathlib import Path

import pytest

pytestmark = pytest.mark.process

#: Loaded at the start of Python: hides uvloop, so that Python's event loop is used.
WITHOUT_UVLOOP = "import sys\nsys.modules['uvloop'] = None\n"
# : Unauthenticated connections.
STRANGERS = 30


@pytest.fixture(params=["uvloop", "asyncio"])
def starved(request, flight, lfield):
    """`starved(spare)`: a flying copter under a host with `spare` free descriptors."""

    def begin(spare: int, **options):
        if request.param == "asyncio":
            lfield.write("plain/sitecustomize.py", WITHOUT_UVLOOP)
            options["env"] = {"PYTHONPATH": str(lfield.folder / "plain")}
        flown = flight(**options)
        leave_descriptors(flown.host.pid, spare)
        return flown

    return begin


def leave_descriptors(pid: int, spare: int) -> None:
    """Limit the free descriptors of a running process."""
    used = {int(entry.name) for entry in Path(f"/proc/{pid}/fd").iterdir()}
    free = [number for number in range(len(used) + spare + 1) if number not in used]
    _, hard = resource.prlimit(pid, resource.RLIMIT_NOFILE)
    resource.prlimit(pid, resource.RLIMIT_NOFILE, (free[spare], hard))


def knock(stack: ExitStack, address: tuple[str, int], count: int = STRANGERS) -> None:
    """Open connections that send nothing, and keep them open."""
    for _ in range(count):
        stack.enter_context(socket.create_connection(address, timeout=60.0))


def flies(flown) -> bool:
    return flown.witness.armed and flown.witness.mode == "GUIDED" and flown.witness.height > 2.0


@pytest.mark.few(0)
@pytest.mark.parametrize("spare", [0, 5])
def test_connections_that_cannot_be_accepted_end_no_flight(starved, spare):
    flown = starved(spare)
    with ExitStack() as stack:
        knock(stack, flown.address)
        time.sleep(2.0)
        assert flies(flown), flown.host.said
        flown.host.signal(signal.SIGTERM)
        assert flown.host.wait() == 0, flown.host.said
    flown.is_down()


@pytest.mark.few(0)
def test_an_emergency_stop_arrives_beside_many_unauthenticated_connections(starved):
    flown = starved(8)
    with ExitStack() as stack:
        knock(stack, flown.address)
        pressed = flown.ask("estop", "--reason", "a crowd")
        assert "alpha: lead.fc: safe" in pressed.said, flown.host.said
        flown.landed()
    assert "link from 127.0.0.1 closed: this host has reached its limit of open files" in flown.host.err


@pytest.mark.few(0)
def test_a_guard_that_cannot_be_restarted_is_retried_and_lands(starved):
    flown = starved(3)
    died = flown.guard
    flown.kill_guard()
    flown.host.wait_for("not restarted: .* does not start: Too many open files")
    flown.host.wait_for("not restarted: .* does not start: Too many open files")
    assert flown.host.popen.poll() is None
    leave_descriptors(flown.host.pid, 50)
    flown.has_a_guard_again(after=died)
    flown.landed()
    flown.host.signal(signal.SIGTERM)
    assert flown.host.wait() == 0, flown.host.said


@pytest.mark.few(0)
def test_a_guard_never_restarted_is_named_and_its_vehicle_lands_by_failsafe(starved):
    flown = starved(3, within=2.0)
    flown.kill_guard()
    flown.host.wait_for("guard of .* not restarted")
    flown.host.signal(signal.SIGTERM)
    assert flown.host.wait() == 3, flown.host.said
    (line,) = [line for line in flown.host.err if "NOT SAFE" in line]
    assert line.startswith("lead.fc NOT SAFE: its safe state was not confirmed")
    # The autopilot's own failsafe: its ground station is lost.
    flown.landed()


@pytest.mark.few(0)
def test_a_guard_without_a_free_process_is_retried_and_lands(flight, bounded):
    flown, group = flight(), bounded("pids")
    died = flown.guard
    group.bound(0, flown.host.pid)
    flown.kill_guard()
    flown.host.wait_for("not restarted: .* does not start: ")
    assert flown.host.popen.poll() is None
    group.bound(1000)
    flown.has_a_guard_again(after=died)
    flown.landed()
    flown.host.signal(signal.SIGTERM)
    assert flown.host.wait() == 0, flown.host.said
