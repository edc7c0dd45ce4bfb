"""No memory for a host, its guard, or both, while the copter flies: the copter is safe within seconds. A
planted thread in one of the two processes allocates all available memory.
"""

from __future__ import annotations

import resource
import signal
from contextlib import suppress
from pathlib import Path

import pytest
from copter_flight import DEPLOYMENT, PROGRAM

pytestmark = pytest.mark.process

#: Words in the command lines of the two processes.
HOST, GUARD = "up", "lfield.guard.process"
#: Loaded at the start of Python. The thread waits for a file and removes it, so that the leak occurs once.
LEAK = """
import os, resource, sys, threading, time

def eat():
    while True:
        try:
            bound = int(open({file!r}).read())
            os.unlink({file!r})
            break
        except (OSError, ValueError):
            time.sleep(0.05)
    if bound:
        size = int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (size + bound, -1))
    held, piece = [], 1 << 20
    while True:
        try:
            held.append(bytearray(piece) if bound else bytearray(b"x") * piece)
        except MemoryError:
            piece = max(piece // 2, 64)
            if piece == 64:
                time.sleep(0.005)

if {victim!r} in sys.orig_argv:
    threading.Thread(target=eat, daemon=True).start()
"""
#: Every allocation of the host's core fails after a file is created.
REFUSED = """
import os
import lfield.host.core as core

going_on = core.HostCore.run

def run(self):
    if os.path.exists({file!r}):
        raise MemoryError
    return going_on(self)

core.HostCore.run = run
"""
# : Seconds until the vehicle has been ordered to land: silence, and the load of the computer.
SOON = 45.0
MIB = 1 << 20


class Leaking:
    """A flying copter; `starve` starts a leak in one of its processes."""

    def __init__(self, flight, lfield, victim: str, **options):
        self._file = lfield.folder / "leak"
        lfield.write("leaks/sitecustomize.py", LEAK.format(file=str(self._file), victim=victim))
        self.flown = flight(env={"PYTHONPATH": str(lfield.folder / "leaks")}, **options)

    def starve(self, bound: int) -> None:
        """Start the leak with a limit of additional bytes; 0 sets no limit."""
        new_file = self._file.with_suffix(".new")
        new_file.write_text(str(bound))
        new_file.rename(self._file)

    def lands(self) -> None:
        """Wait until the vehicle starts to land, and has landed."""
        self.flown.witness.until(lambda seen: seen.mode == "LAND", SOON)
        self.flown.landed()


@pytest.mark.few(0)
def test_a_host_without_memory_ends_with_70_and_its_copter_on_the_ground(flight, lfield):
    lfield.write("broken/sitecustomize.py", REFUSED.format(file=str(lfield.folder / "refuse")))
    flown = flight(env={"PYTHONPATH": str(lfield.folder / "broken")})
    lfield.write("refuse", "")
    assert flown.host.wait() == 70, flown.host.said
    assert "alpha stopped: out of memory; its devices go to their safe states" in flown.host.err
    flown.is_down()


@pytest.mark.few(0)
def test_the_copter_of_a_host_with_exhausted_memory_lands(flight, lfield):
    leaking = Leaking(flight, lfield, HOST, within=2.0)
    leaking.starve(2 * MIB)
    # An idle host may continue, so a request is sent: the answer needs memory.
    with suppress(AssertionError):
        leaking.flown.ask("ps")
    leaking.flown.host.signal(signal.SIGTERM)
    leaking.lands()
    # The process ends in order, by a failure of a library, or by the kernel.
    leaking.flown.host.popen.wait(60)


@pytest.mark.few(0)
def test_a_guard_with_exhausted_memory_ends_and_the_next_one_lands_the_copter(flight, lfield):
    leaking = Leaking(flight, lfield, GUARD)
    guard = leaking.flown.guard
    leaking.starve(2 * MIB)
    leaking.lands()
    leaking.flown.has_a_guard_again(after=guard)
    leaking.flown.host.signal(signal.SIGTERM)
    assert leaking.flown.host.wait() == 0, leaking.flown.host.said


#: All processes allocate up to their limits at the same time.
GREEDY = """
class Link {
    public Link next;
    public Link(Link rest) { next = rest; }
}
coordinator Greedy {
    init(string[] arg) {
        sleep(s2f(arg[1]));
        Link all = null;
        while (true) all = new Link(all);
    }
}
"""


@pytest.mark.few(0)
def test_agents_that_exhaust_the_memory_do_not_keep_the_copter_up(flight, lfield):
    agents = "".join(f"//Greedy:greedy{i}@alpha?2.0\n" for i in range(6))
    flown = flight(program=PROGRAM + GREEDY, deployment=DEPLOYMENT + agents, heap="4 MiB")
    size = int(Path(f"/proc/{flown.host.pid}/statm").read_text().split()[0]) * resource.getpagesize()
    resource.prlimit(flown.host.pid, resource.RLIMIT_AS, (size + 8 * MIB, -1))
    flown.host.wait_for("greedy[0-9]+ died of")
    flown.host.signal(signal.SIGTERM)
    flown.witness.until(lambda seen: seen.mode == "LAND", SOON)
    flown.landed()
    assert flown.host.wait() in (0, 70), flown.host.said


@pytest.mark.few(0)
@pytest.mark.parametrize("victims", ["host", "guard", "host of both"])
def test_the_copter_of_a_process_killed_for_its_memory_lands(flight, lfield, bounded, victims):
    group = bounded("memory")
    leaking = Leaking(flight, lfield, GUARD if victims == "guard" else HOST)
    host, guard = leaking.flown.host, leaking.flown.guard
    group.bound(24 * MIB, *{"host": [host.pid], "guard": [guard]}.get(victims, [host.pid, guard]))
    leaking.starve(0)
    leaking.lands()
    if victims == "guard":
        host.wait_for("guard of lead.fc died with status -9: restarting it")
        leaking.flown.has_a_guard_again(after=guard)
        assert "lead.fc" in leaking.flown.ask("ps").said
        host.signal(signal.SIGTERM)
        assert host.wait() == 0, host.said
    else:
        assert host.wait() == -signal.SIGKILL
        assert lfield.left() != []
