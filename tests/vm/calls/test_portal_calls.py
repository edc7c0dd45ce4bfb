"""Checks at a portal call: later starts of resources, older copies of callers, and stored blocks."""

from __future__ import annotations

from functools import cache

import pytest
from joined_hosts import JoinedHosts

from lfield.bytecode.program import Program
from lfield.errors import BlockError
from lfield.testing.golden import GoldenWorld, compile_text
from lfield.vm.agent import Agent, TeamMember
from lfield.vm.engine_interface import AgentLimits
from lfield.vm.memory import layout

TEAM = [
    TeamMember(0, "near", "Store", "resource", 0),
    TeamMember(1, "far", "Store", "resource", 1),
    TeamMember(2, "clerk", "Clerk", "coordinator", 0),
]
CLERK, LIMITS = TEAM[2], AgentLimits()

#: Two stores on two hosts, and a clerk with the code of a test. `add` acts, `total` only queries.
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
    """A world that packs each agent before an acting call; a test permits the call, or `volatile` does at
    once."""

    def __init__(self, volatile: bool) -> None:
        super().__init__()
        self.volatile, self.asked = volatile, 0
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


def joined(body: str, volatile: bool = True) -> JoinedHosts:
    return JoinedHosts(program(body), TEAM, place=lambda: Disk(volatile))


def printed(hosts: JoinedHosts, restarted: int = 0) -> list[str]:
    """The output of a whole run; `restarted`: host 0 gets this life while the clerk is on host 1."""
    if restarted:
        hosts.still()
        clerk = hosts.hop(0)
        hosts.restart(0, life=restarted)
        hosts.machines[1].unfreeze(clerk)
    hosts.run()
    return hosts.printed


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
def test_each_proxy_reports_a_later_start_once_before_the_call_begins(life: int) -> None:
    assert printed(joined(AWAY), restarted=life) == ["1", TOLD, "near", "1", "2", "3"]


def test_a_host_that_was_not_restarted_raises_no_exception() -> None:
    assert printed(joined(AWAY)) == ["1", "2", "3", "4"]


def test_a_call_refused_at_a_limit_is_no_first_call() -> None:
    """A state that the proxy has not seen cannot be lost."""
    hosts = joined("try { near.add(1); } catch (LimitException e) { far.add(1); print(near.add(1)); }")
    hosts.machines[0].agents["near"].limits = AgentLimits(threads=0)
    assert printed(hosts, restarted=99) == ["1"]


def travelling() -> bytes:
    hosts = joined("near.add(1); far.add(1); far.add(2);")
    hosts.still()
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
        joined("near.add(1); far.add(1); far.add(2);").machines[1].inject(CLERK, image, LIMITS)


# --- older copies --------------------------------------------------------------------------------------


def numbered(image: bytes, generation: int, sequence: int) -> bytes:
    words = memoryview(bytearray(image)).cast("q")
    words[layout.W_GENERATION], words[layout.W_SEQUENCE] = generation, sequence
    return bytes(words)


VISIT = "try { print(far.add(1)); } catch (UnreachableResourceException e) { print(e.message()); }"


def visited(copies: list[tuple[int, int]], stopped: set[int]) -> list[str]:
    """The output of copies with these generations and sequences, which arrive one after the other."""
    hosts = joined(VISIT)
    hosts.still()
    hosts.hop(0)
    hosts.places[1].stopped = stopped
    machine = hosts.machines[1]
    for copy in copies:
        machine.unfreeze(machine.inject(CLERK, numbered(hosts.images[0], *copy), LIMITS))
        hosts.still()
    return hosts.places[1].output


@pytest.mark.parametrize(
    ("copies", "refused"),
    [
        ([(1, 5), (1, 4)], "a later copy of clerk has called far: this older one is no longer served"),
        ([(2, 0), (1, 9)], "a later start of clerk has called far: this older one is no longer served"),
    ],
)
def test_a_resource_refuses_older_copies(copies: list[tuple[int, int]], refused: str) -> None:
    assert visited(copies, set()) == ["1", refused]


def test_the_same_copy_and_newer_ones_are_served() -> None:
    assert visited([(1, 4), (1, 4), (1, 5), (2, 0)], set()) == ["1", "2", "3", "4"]


def test_an_earlier_start_is_served_when_the_later_one_was_stopped_for_it() -> None:
    assert visited([(2, 0), (1, 9), (1, 8)], {2})[:2] == ["1", "2"]


# --- blocks are stored first ---------------------------------------------------------------------------

SEVERAL = """
print(near.total()); print(near.add(1)); print(near.total()); print(near.add(1));
print(far.add(1)); print(far.add(1)); print(near.total()); print(near.add(1)); print(hops());
"""


def test_a_host_is_asked_before_each_further_acting_call() -> None:
    hosts = joined(SEVERAL)
    assert printed(hosts) == ["0", "1", "1", "2", "2", "3", "2", "1", "2"]
    # Twice before it leaves and once after it returned for a query; on the other host for the second call.
    assert [disk.asked for disk in hosts.places] == [3, 1]


def test_a_call_waits_until_its_block_is_stored_and_begins_once() -> None:
    hosts = joined("print(near.add(5)); print(near.add(5));", volatile=False)
    (disk, machine) = hosts.places[0], hosts.machines[0]
    for request_count in (1, 2):
        hosts.still()
        (agent, _) = disk.kept[-1]
        assert agent.frozen
        assert disk.asked == request_count
        assert len(disk.output) == request_count - 1
        machine.unfreeze(agent)
    hosts.still()
    assert disk.output == ["5", "10"]
    assert disk.asked == 2


def test_a_call_whose_block_was_not_stored_has_not_begun() -> None:
    body = "try { near.add(5); } catch (LimitException e) { print(e.message()); } print(near.add(5));"
    hosts = joined(body, volatile=False)
    hosts.still()
    disk, machine = hosts.places[0], hosts.machines[0]
    machine.resume(disk.kept[0][0], "LimitException", "the disk is full", "near")
    hosts.still()
    assert disk.asked == 2
    machine.unfreeze(disk.kept[1][0])
    hosts.still()
    assert disk.output == ["the disk is full", "5"]


def test_a_coordinator_stopped_meanwhile_does_not_continue() -> None:
    hosts = joined("near.add(5);", volatile=False)
    hosts.still()
    disk, machine = hosts.places[0], hosts.machines[0]
    disk.kept[0][0].ended = "dropped"
    machine.unfreeze(disk.kept[0][0])
    hosts.still()
    assert machine.agents["near"].served == 0


def test_an_arrived_coordinator_is_frozen_until_it_is_released_once() -> None:
    hosts = joined("print(far.add(1));", volatile=False)
    hosts.still()
    agent = hosts.hop(0)
    hosts.still()
    assert agent.frozen
    assert not hosts.places[1].output
    hosts.machines[1].unfreeze(agent)
    hosts.machines[1].unfreeze(agent)
    hosts.still()
    assert hosts.places[1].output == ["1"]
    assert hosts.places[1].asked == 0


def test_a_block_names_the_call_at_which_it_stands() -> None:
    hosts = joined("far.total();")
    hosts.still()
    agent = hosts.hop(0)
    assert hosts.machines[1].itinerary.current_target(agent) == (TEAM[1], "total")
    # A block whose proxy is null is valid: its call throws a NullException.
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


def test_a_block_stored_at_a_local_call_continues_after_a_crash_with_an_exception() -> None:
    """The trail and the hops of the coordinator are unchanged, because it has not left."""
    hosts = joined(RECOVERS, volatile=False)
    hosts.still()
    for source in (0, 1):
        hosts.machines[1 - source].unfreeze(hosts.hop(source))
        hosts.still()
    ((_, image),) = hosts.places[0].kept
    machine = hosts.restart(0)
    agent = machine.restore(CLERK, image, LIMITS)
    assert agent.block.trail() == [0, 1, 0]
    assert machine.itinerary.current_target(agent) == (TEAM[0], "add")
    machine.resume(agent, "RestartException", "the call may have begun", "near")
    hosts.still()
    disk = hosts.places[0]
    assert disk.output == ["the call may have begun", "near", "2", "as new"]
    machine.unfreeze(disk.kept[-1][0])
    hosts.still()
    assert disk.output[4:] == ["7"]


def test_a_block_that_arrived_for_a_call_continues_after_a_crash_with_an_exception() -> None:
    hosts = joined(
        "try { far.add(7); } catch (RestartException e) { print(e.message()); } print(far.add(1));"
    )
    hosts.still()
    hosts.hop(0)
    machine = hosts.restart(1)
    machine.resume(machine.inject(CLERK, hosts.images[0], LIMITS), "RestartException", "not begun", "far")
    hosts.still()
    assert hosts.places[1].output == ["not begun", "1"]
