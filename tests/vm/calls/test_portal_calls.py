"""What is decided at a portal call besides the call: later starts, older copies, and what is kept first."""

from __future__ import annotations

import random
from functools import cache

import pytest

from lfield.bytecode.program import Program
from lfield.clock import ManualClock
from lfield.errors import BlockError
from lfield.testing.golden import GoldenWorld, compile_text, run_until_idle
from lfield.vm.agent import Agent, MachineTeam, TeamMember
from lfield.vm.engine_interface import AgentLimits
from lfield.vm.machine import Machine
from lfield.vm.memory import layout

TEAM = [
    TeamMember(0, "near", "Store", "resource", 0),
    TeamMember(1, "far", "Store", "resource", 1),
    TeamMember(2, "clerk", "Clerk", "coordinator", 0),
]
CLERK, LIMITS = TEAM[2], AgentLimits()

#: Two stores on two hosts, and a clerk who does what a test says. `add` acts, `total` only queries.
STORES = """
resource Store {
  int kept;
  init(string[] arg) { }
  portal add(int n) emit int { yield(); kept = kept + n; return kept; }
  portal total() emit int { return kept; }
}
coordinator Clerk {
  Store near; Store far;
  init(string[] arg) { near = findStore("near"); far = findStore("far"); %s }
}
"""


@cache
def program(body: str) -> Program:
    return compile_text(STORES % body)


class Disk(GoldenWorld):
    """A world that packs whoever asks, and lets it go on when a test says so; at once if it is `volatile`."""

    def __init__(self, volatile: bool = False) -> None:
        super().__init__()
        self.volatile, self.asked = volatile, 0
        self.machine: Machine
        self.kept: list[tuple[Agent, bytes]] = []
        self.stopped: set[int] = set()

    def may_start_call(self, agent: Agent, acts: bool) -> bool:
        assert acts
        assert not agent.is_persisted
        self.asked += 1
        if not self.volatile:
            assert agent.frozen
            self.kept.append((agent, bytes(self.machine.pack(agent))))
            agent.is_persisted = True
        return self.volatile

    def is_superseded(self, agent: str, generation: int) -> bool:
        return generation in self.stopped


class Hosts:
    """Two hosts, in their first lives until `restart`; `images` are the bytes of every hop."""

    def __init__(self, body: str, volatile: bool = True) -> None:
        self.program, self.volatile = program(body), volatile
        self.clock = ManualClock()
        self.images: list[bytes] = []
        self.machines: list[Machine] = []
        self.disks: list[Disk] = []
        for host in (0, 1):
            self.machines.append(self._machine(host, 1 + host))
        self.machines[0].start(CLERK, LIMITS, 1)

    def _machine(self, host: int, life: int) -> Machine:
        disk = Disk(self.volatile)
        disk.machine = Machine(
            self.program, MachineTeam(TEAM, host, life), disk, self.clock, random.Random(1)
        )
        self.disks[host:] = [disk, *self.disks[host + 1 :]]
        disk.machine.start(TEAM[host], LIMITS, 0)
        return disk.machine

    def restart(self, host: int, life: int = 99) -> Machine:
        """The host has another life, and nothing of what it had."""
        self.machines[host] = self._machine(host, life)
        return self.machines[host]

    def settle(self) -> None:
        for machine in self.machines:
            run_until_idle(machine, self.clock)

    def hop(self, source: int) -> Agent:
        """Carry the clerk, who wants to leave this host, to the other one."""
        agent, _ = self.disks[source].departures.pop()
        self.images.append(bytes(self.machines[source].pack(agent)))
        self.machines[source].release(agent)
        return self.machines[1 - source].inject(CLERK, self.images[-1], LIMITS)

    def run(self, restarted: int = 0) -> list[str]:
        """All to the end; a host's next life is `restarted`, if any, while the clerk is on the other host."""
        self.settle()
        while away := [host for host in (0, 1) if self.disks[host].departures]:
            agent = self.hop(away[0])
            if restarted and self.machines[1].agents.get("clerk") is agent:
                said = self.disks[0].output
                self.restart(0, restarted)
                self.disks[0].output, restarted = said, 0
            self.machines[1 - away[0]].unfreeze(agent)
            self.settle()
        return [line for disk in self.disks for line in disk.output]


AWAY = """
Store other = findStore("near"); Store called = findStore("near"); called.total();
print(near.add(1)); far.add(1);
try { print(near.add(1)); } catch (RestartException e) { print(e.message()); print(e.source()); }
print(near.add(1)); print(other.add(1)); far.add(1);
try { called.add(1); } catch (RestartException e) { print(called.add(1)); }
"""
TOLD = (
    "near has restarted since this proxy last called it: its fields have their initial values; this call has "
    "not begun"
)


@pytest.mark.parametrize("life", [99, (1 << 63) - 5])
def test_each_proxy_tells_once_of_a_later_start_before_the_call_begins(life: int) -> None:
    assert Hosts(AWAY).run(restarted=life) == ["1", TOLD, "near", "1", "2", "3"]


def test_a_host_that_was_not_restarted_throws_nothing() -> None:
    assert Hosts(AWAY).run() == ["1", "2", "3", "4"]


def test_a_call_that_was_refused_at_a_limit_is_no_first_call() -> None:
    """What the proxy has not seen cannot be lost."""
    hosts = Hosts("try { near.add(1); } catch (LimitException e) { far.add(1); print(near.add(1)); }")
    hosts.machines[0].agents["near"].limits = AgentLimits(threads=0)
    assert hosts.run(restarted=99) == ["1"]


def travelling() -> bytes:
    hosts = Hosts("near.add(1); far.add(1); far.add(2);")
    hosts.settle()
    hosts.hop(0)
    return hosts.images[0]


@pytest.mark.parametrize("start", [-1, layout.START_LIMIT])
def test_a_proxy_with_an_impossible_start_is_refused(start: int) -> None:
    image = bytearray(travelling())
    words = memoryview(image).cast("q")
    place = layout.HEADER_WORDS
    while words[place] & 0xFF != layout.PROXY:
        place += words[place] >> 32
    words[place + layout.PROXY_START] = start
    with pytest.raises(BlockError, match="a proxy does not refer to a resource of its type"):
        Hosts("near.add(1); far.add(1); far.add(2);").machines[1].inject(CLERK, image, LIMITS)


# --- older copies --------------------------------------------------------------------------------------


def numbered(image: bytes, generation: int, sequence: int) -> bytes:
    words = memoryview(bytearray(image)).cast("q")
    words[layout.W_GENERATION], words[layout.W_SEQUENCE] = generation, sequence
    return bytes(words)


VISIT = "try { print(far.add(1)); } catch (UnreachableResourceException e) { print(e.message()); }"


def visited(copies: list[tuple[int, int]], stopped: set[int]) -> list[str]:
    """What copies with these generations and sequences print, which come to a store one after the other."""
    hosts = Hosts(VISIT)
    hosts.settle()
    hosts.hop(0)
    hosts.disks[1].stopped = stopped
    machine = hosts.machines[1]
    for copy in copies:
        machine.unfreeze(machine.inject(CLERK, numbered(hosts.images[0], *copy), LIMITS))
        run_until_idle(machine, hosts.clock)
    return hosts.disks[1].output


@pytest.mark.parametrize(
    ("copies", "refused"),
    [
        ([(1, 5), (1, 4)], "a later copy of clerk has called far: this older one is no longer served"),
        ([(2, 0), (1, 9)], "a later start of clerk has called far: this older one is no longer served"),
    ],
)
def test_a_resource_serves_no_older_copy(copies: list[tuple[int, int]], refused: str) -> None:
    assert visited(copies, set()) == ["1", refused]


def test_the_same_copy_and_newer_ones_are_served() -> None:
    assert visited([(1, 4), (1, 4), (1, 5), (2, 0)], set()) == ["1", "2", "3", "4"]


def test_an_earlier_start_is_served_when_the_later_one_was_stopped_for_it() -> None:
    assert visited([(2, 0), (1, 9), (1, 8)], {2})[:2] == ["1", "2"]


# --- what is kept first --------------------------------------------------------------------------------

SEVERAL = """
print(near.total()); print(near.add(1)); print(near.total()); print(near.add(1));
print(far.add(1)); print(far.add(1)); print(near.total()); print(near.add(1)); print(hops());
"""


def test_a_host_is_asked_before_each_further_call_that_acts() -> None:
    hosts = Hosts(SEVERAL)
    assert hosts.run() == ["0", "1", "1", "2", "2", "3", "2", "1", "2"]
    # Twice before it leaves and once after it came back for a query; on the other host for the second call.
    assert [disk.asked for disk in hosts.disks] == [3, 1]


def test_a_call_waits_until_its_block_is_kept_and_begins_once() -> None:
    hosts = Hosts("print(near.add(5)); print(near.add(5));", volatile=False)
    (disk, machine) = hosts.disks[0], hosts.machines[0]
    for asked in (1, 2):
        hosts.settle()
        (agent, _) = disk.kept[-1]
        assert agent.frozen
        assert disk.asked == asked
        assert len(disk.output) == asked - 1
        machine.unfreeze(agent)
    hosts.settle()
    assert disk.output == ["5", "10"]
    assert disk.asked == 2


def test_a_call_that_could_not_be_kept_has_not_begun_and_the_next_is_asked_about() -> None:
    body = "try { near.add(5); } catch (LimitException e) { print(e.message()); } print(near.add(5));"
    hosts = Hosts(body, volatile=False)
    hosts.settle()
    disk, machine = hosts.disks[0], hosts.machines[0]
    machine.resume(disk.kept[0][0], "LimitException", "the disk is full", "near")
    run_until_idle(machine, hosts.clock)
    assert disk.asked == 2
    machine.unfreeze(disk.kept[1][0])
    run_until_idle(machine, hosts.clock)
    assert disk.output == ["the disk is full", "5"]


def test_a_coordinator_that_was_stopped_meanwhile_does_not_go_on() -> None:
    hosts = Hosts("near.add(5);", volatile=False)
    hosts.settle()
    disk, machine = hosts.disks[0], hosts.machines[0]
    disk.kept[0][0].ended = "dropped"
    machine.unfreeze(disk.kept[0][0])
    run_until_idle(machine, hosts.clock)
    assert machine.agents["near"].served == 0


def test_who_arrives_is_frozen_until_it_may_go_and_is_not_asked_about() -> None:
    hosts = Hosts("print(far.add(1));", volatile=False)
    hosts.settle()
    agent = hosts.hop(0)
    hosts.settle()
    assert agent.frozen
    assert not hosts.disks[1].output
    hosts.machines[1].unfreeze(agent)
    hosts.machines[1].unfreeze(agent)
    hosts.settle()
    assert hosts.disks[1].output == ["1"]
    assert hosts.disks[1].asked == 0


def test_a_block_says_which_call_it_stands_at() -> None:
    hosts = Hosts("far.total();")
    hosts.settle()
    agent = hosts.hop(0)
    assert hosts.machines[1].itinerary.current_target(agent) == (TEAM[1], "total")
    # A block whose proxy is null is sound: its call throws a NullException.
    w = agent.block.w
    frame = w[w[layout.W_THREADS] + layout.THREAD_FRAME]
    for slot in range(1, (w[frame] >> 32) - layout.FRAME_SLOTS):
        w[frame + layout.FRAME_SLOTS + slot] = 0
    assert hosts.machines[1].itinerary.current_target(agent) is None


# --- after a crash -------------------------------------------------------------------------------------

RECOVERS = """
near.total(); far.total(); near.add(1);
try { near.add(7); } catch (RestartException e) { print(e.message()); print(e.source()); }
print(hops());
try { near.add(7); } catch (RestartException e) { print("as new"); }
print(near.add(7));
"""


def test_a_block_that_was_kept_at_a_local_call_goes_on_in_another_life_with_an_exception() -> None:
    """Its trail and its hops are what they were: it has not left."""
    hosts = Hosts(RECOVERS, volatile=False)
    hosts.settle()
    for source in (0, 1):
        hosts.machines[1 - source].unfreeze(hosts.hop(source))
        hosts.settle()
    ((_, image),) = hosts.disks[0].kept
    machine = hosts.restart(0)
    agent = machine.restore(CLERK, image, LIMITS)
    assert agent.block.trail() == [0, 1, 0]
    assert machine.itinerary.current_target(agent) == (TEAM[0], "add")
    machine.resume(agent, "RestartException", "the call may have begun", "near")
    run_until_idle(machine, hosts.clock)
    (disk,) = hosts.disks[:1]
    assert disk.output == ["the call may have begun", "near", "2", "as new"]
    machine.unfreeze(disk.kept[0][0])
    run_until_idle(machine, hosts.clock)
    assert disk.output[4:] == ["7"]


def test_a_block_that_came_for_a_call_goes_on_in_another_life_with_an_exception() -> None:
    hosts = Hosts("try { far.add(7); } catch (RestartException e) { print(e.message()); } print(far.add(1));")
    hosts.settle()
    hosts.hop(0)
    machine = hosts.restart(1)
    machine.resume(machine.inject(CLERK, hosts.images[0], LIMITS), "RestartException", "not begun", "far")
    run_until_idle(machine, hosts.clock)
    assert hosts.disks[1].output == ["not begun", "1"]
